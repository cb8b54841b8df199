"""Videos as they are, and those that lack pictures: a warning says that frame ids are wrong."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from tests.kits.synthetic_road import CAMERA, images, write_video

N_FRAMES = 40


@pytest.fixture(scope="module")
def pictures() -> list[Image]:
    return images(N_FRAMES)


def read(path: Path, frames: tuple[int, int] | None = None) -> tuple[list[int], list[str]]:
    """The frame ids of a video and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ids = [p.frame_id for p in read_pictures(open_source(path), CAMERA, frames=frames)]
    return ids, [str(w.message) for w in caught]


@pytest.mark.parametrize(
    ("ending", "four"), [("avi", "MJPG"), ("avi", "XVID"), ("mkv", "mp4v"), ("mp4", "mp4v")]
)
def test_a_good_video_has_every_position_and_no_warning(
    tmp_path: Path, pictures: list[Image], ending: str, four: str
) -> None:
    video = write_video(tmp_path / f"a.{ending}", pictures, four=four)
    assert read(video) == (list(range(N_FRAMES)), [])
    assert read(video, (7, 12)) == ([7, 8, 9, 10, 11], [])
    assert read(video, (35, N_FRAMES)) == (list(range(35, N_FRAMES)), [])


@pytest.mark.parametrize(("ending", "four"), [("avi", "XVID"), ("mkv", "mp4v")])
def test_a_video_damaged_in_its_middle_warns_of_wrong_frame_ids(
    tmp_path: Path, pictures: list[Image], ending: str, four: str
) -> None:
    video = write_video(tmp_path / f"bad.{ending}", pictures, four=four)
    content = bytearray(video.read_bytes())
    middle, some = len(content) // 2, len(content) // 20
    content[middle : middle + some] = bytes(some)
    video.write_bytes(content)
    ids, (message,) = read(video)
    assert N_FRAMES // 2 < len(ids) < N_FRAMES
    assert ids == list(range(len(ids)))
    assert message.startswith(
        f"{video}: has {len(ids)} of the {N_FRAMES} frames that it should have"
    )
    # Before the damage nothing is wrong.
    assert read(video, (0, 10)) == (list(range(10)), [])
