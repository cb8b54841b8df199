"""Videos that lack pictures. Good videos of variable rate keep their positions without a warning;
for damaged ones a warning says that frame ids are wrong."""

from __future__ import annotations

import warnings
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from tests.kits.synthetic_road import CAMERA, images, write_video

N_FRAMES = 40


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return images(N_FRAMES)  # type: ignore[return-value]


def read(path: Path, frames: tuple[int, int] | None = None) -> tuple[list[int], list[str]]:
    """The frame ids of a video, and what is said about it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ids = [p.frame_id for p in read_pictures(open_source(path), CAMERA, frames=frames)]
    return ids, [str(w.message) for w in caught]


def damaged(path: Path, target: Path) -> Path:
    """The video with a twentieth of its bytes set to zero, from its middle on."""
    content = bytearray(path.read_bytes())
    middle, some = len(content) // 2, len(content) // 20
    content[middle : middle + some] = bytes(some)
    target.write_bytes(content)
    return target


@pytest.mark.parametrize(
    ("ending", "four"), [("avi", "MJPG"), ("avi", "XVID"), ("mkv", "mp4v"), ("mp4", "mp4v")]
)
def test_a_good_video_has_every_position_and_nothing_is_said(
    tmp_path: Path, pictures: list[np.ndarray], ending: str, four: str
) -> None:
    video = write_video(tmp_path / f"a.{ending}", pictures, four=four)
    assert read(video) == (list(range(N_FRAMES)), [])
    assert read(video, (7, 12)) == ([7, 8, 9, 10, 11], [])
    assert read(video, (35, N_FRAMES)) == (list(range(35, N_FRAMES)), [])


@pytest.mark.parametrize(
    ("ending", "four", "where"),
    [("avi", "XVID", "frames: dropped"), ("mkv", "mp4v", "frames (some before frame ")],
)
def test_a_video_damaged_in_its_middle_is_said_to_have_wrong_frame_ids(
    tmp_path: Path, pictures: list[np.ndarray], ending: str, four: str, where: str
) -> None:
    good = write_video(tmp_path / f"good.{ending}", pictures, four=four)
    bad = damaged(good, tmp_path / f"bad.{ending}")
    ids, (said,) = read(bad)
    assert N_FRAMES // 2 < len(ids) < N_FRAMES
    assert ids == list(range(len(ids)))
    assert said.startswith(f"{bad}: lacks {N_FRAMES - len(ids)} of its {N_FRAMES} {where}")
    assert said.endswith("or damaged; the frame ids after such a place are too low")
    # Before the damage nothing is wrong.
    assert read(bad, (0, 10)) == (list(range(10)), [])


def test_pictures_after_a_damaged_place_keep_their_positions_where_the_container_tells(
    tmp_path: Path, pictures: list[np.ndarray]
) -> None:
    good = write_video(tmp_path / "good.mp4", pictures, four="mp4v")
    bad = damaged(good, tmp_path / "bad.mp4")
    ids, (said,) = read(bad)
    n_lost = N_FRAMES - len(ids)
    (first,) = {k + 1 for k, later in pairwise(ids) if later != k + 1}
    assert 0 < n_lost < 10
    assert ids == [*range(first), *range(first + n_lost, N_FRAMES)]
    assert said.startswith(f"{bad}: frame {first} and {n_lost - 1} later ones cannot be decoded")
    # The last pictures do not hang on the damaged ones any more.
    images = {p.frame_id: p.image for p in read_pictures(open_source(good), CAMERA)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = list(read_pictures(open_source(bad), CAMERA))
        some = list(read_pictures(open_source(bad), CAMERA, frames=(N_FRAMES - 3, N_FRAMES)))
    for picture in (*found[:10], *found[-3:], *some):
        np.testing.assert_array_equal(picture.image, images[picture.frame_id])
    assert [p.frame_id for p in some] == [37, 38, 39]


def test_a_damaged_video_of_variable_rate_breaks_off(
    tmp_path: Path, pictures: list[np.ndarray]
) -> None:
    video = write_video(tmp_path / "a.mp4", pictures, four="mp4v")
    video.write_bytes(with_times(video.read_bytes(), [0.25, 0.25, 0.25, 3.25] * (N_FRAMES // 4)))
    ids, (said,) = read(damaged(video, tmp_path / "bad.mp4"))
    assert ids == list(range(len(ids)))
    assert f"breaks off in frame {len(ids)}, it should have {N_FRAMES}" in said


def with_times(video: bytes, steps: list[float]) -> bytes:
    """An MP4 whose pictures are due at other times: steps, in units of the old one, between them.
    The index is behind the pictures, so that it may grow."""
    at = video.index(b"stts") - 4
    size = int.from_bytes(video[at : at + 4], "big")
    unit = int.from_bytes(video[at + 20 : at + 24], "big")
    rows = b"".join((1).to_bytes(4, "big") + round(unit * s).to_bytes(4, "big") for s in steps)
    box = b"stts" + bytes(4) + len(steps).to_bytes(4, "big") + rows
    box = (4 + len(box)).to_bytes(4, "big") + box
    changed = bytearray(video[:at] + box + video[at + size :])
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        start = video.index(name) - 4
        longer = int.from_bytes(video[start : start + 4], "big") + len(box) - size
        changed[start : start + 4] = longer.to_bytes(4, "big")
    return bytes(changed)


def test_a_video_of_variable_rate_is_good(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    video = write_video(tmp_path / "a.mp4", pictures, four="mp4v")
    video.write_bytes(with_times(video.read_bytes(), [0.25, 0.25, 0.25, 3.25] * (N_FRAMES // 4)))
    times = cv2.VideoCapture(str(video))
    due = []
    while times.grab():
        due.append(times.get(cv2.CAP_PROP_POS_MSEC))
    assert max(np.diff(due)) > 10 * min(np.diff(due)), "its rate is variable"
    assert read(video) == (list(range(N_FRAMES)), [])
