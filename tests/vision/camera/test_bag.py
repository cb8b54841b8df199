"""Pictures in bags: each encoding gives the picture back, and the stamps go with the lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.recordings import files_of, read_lines
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from tests.kits.drives import done, refused
from tests.kits.image_bags import START_S, write_images
from tests.kits.synthetic_road import CAMERA, N_FRAMES, write_place


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the video of a drive, and its pictures in a bag."""
    folder = write_place(tmp_path_factory.mktemp("bag"))
    images = [each.image for each in read_pictures(open_source(folder / "drive.avi"), CAMERA)]
    write_images(folder / "images", images)
    return folder


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_detector_sees_in_a_bag_what_it_sees_in_the_video_at_the_times_of_the_stamps(
    place: Path, tmp_path: Path, kind: str
) -> None:
    bag = place / "images" if kind == "folder" else files_of(place / "images")[0]
    words = ("--camera", place / "cam.yaml")
    done("detect", place / "drive.avi", *words, "-o", tmp_path / "video.csv")
    done("detect", bag, *words, "--set", "recording.topic=front", "-o", tmp_path / "bag.csv")
    video, lines = read_lines(tmp_path / "video.csv"), read_lines(tmp_path / "bag.csv")
    np.testing.assert_array_equal(lines.offset_m, video.offset_m)
    step = np.full(N_FRAMES - 1, 0.08)
    step[9] = 0.16
    np.testing.assert_allclose(np.diff(lines.time_s), step, atol=1e-6)
    assert lines.time_s[0] == START_S


@pytest.mark.parametrize(
    "encoding", ["png", "jpeg", "bgr8", "rgb8", "bgra8", "mono8", "mono16", "8UC3"]
)
def test_each_encoding_gives_the_picture_back(tmp_path: Path, encoding: str) -> None:
    smooth = np.tile(np.linspace(0, 255, CAMERA.width), (CAMERA.height, 1))
    image = np.dstack(
        [smooth, smooth, smooth] if "mono" in encoding else [smooth, 255 - smooth, smooth * 0]
    )
    source = open_source(write_images(tmp_path / "bag", [image.astype(np.uint8)] * 2, encoding))
    shown = [picture.image for picture in read_pictures(source, CAMERA, frames=(1, 2))]
    assert len(shown) == 1
    tolerance = 12 if encoding == "jpeg" else 1 if encoding == "mono16" else 0
    np.testing.assert_allclose(
        shown[0].astype(int), image.astype(np.uint8).astype(int), atol=tolerance
    )


@pytest.mark.parametrize(
    ("encoding", "topics", "message"),
    [
        (
            "8UC2",
            ("/a",),
            "picture 0 on /a: its encoding '8UC2' of 480x270 pixels cannot be read",
        ),
        ("other", ("/a",), "picture 0 on /a: its 'other' cannot be read"),
        ("png", ("/a", "/b"), "name one as topic; topics of pictures: /a, /b"),
    ],
)
def test_pictures_that_cannot_be_read_are_refused(
    tmp_path: Path, encoding: str, topics: tuple[str, ...], message: str
) -> None:
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    bag = write_images(tmp_path / "bag", [image] * 2, encoding, topics)
    with pytest.raises(InputError) as info:
        list(read_pictures(open_source(bag), CAMERA))
    assert message in str(info.value)


def test_a_topic_without_pictures_is_refused_with_those_that_have_some(place: Path) -> None:
    words = ("--camera", place / "cam.yaml", "-o", place / "l.csv")
    message = refused("detect", place / "images", "--set", "recording.topic=/rear", *words)
    assert "no pictures on /rear; topics of pictures: /front" in message
    with pytest.raises(InputError, match="only a bag has topics"):
        open_source(place / "drive.avi", "/a")
