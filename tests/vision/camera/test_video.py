"""Videos as they are, videos that lack pictures, and videos with a variable frame rate."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.vision.camera.model import write_camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from egolane_pgm.vision.detectors.pictures import read_pictures as read_lines
from tests.kits.synthetic_road import CAMERA, images, write_video

OWN = str(Path(__file__).parents[3] / "examples/my_detector.py")

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


@pytest.mark.parametrize("more", [1, 3])
def test_an_avi_that_counts_one_picture_too_many_is_whole(
    tmp_path: Path, pictures: list[Image], more: int
) -> None:
    video = write_video(tmp_path / "a.avi", pictures)
    content = bytearray(video.read_bytes())
    at = content.index(b"strh") + 40
    struct.pack_into("<I", content, at, N_FRAMES + more)
    video.write_bytes(content)
    ids, messages = read(video)
    assert (len(ids), len(messages)) == (N_FRAMES, more > 1)


@pytest.mark.parametrize(("ending", "four"), [("avi", "XVID"), ("mkv", "mp4v"), ("mp4", "mp4v")])
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


def with_steps(video: Path, steps: list[float]) -> Path:
    """Give the pictures of an .mp4 other durations, in the durations that they had."""
    data = video.read_bytes()
    at = data.index(b"stts") - 4
    size, _, _, n, _, usual = struct.unpack(">I4sIIII", data[at : at + 24])
    assert (n, data.index(b"mdat") < at) == (1, True)
    rows = b"".join(struct.pack(">II", 1, round(step * usual)) for step in steps)
    table = struct.pack(">I4sII", 16 + len(rows), b"stts", 0, len(steps)) + rows
    changed = bytearray(data[:at] + table + data[at + size :])
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        k = changed.index(box) - 4
        (before,) = struct.unpack(">I", changed[k : k + 4])
        changed[k : k + 4] = struct.pack(">I", before + len(table) - size)
    video.write_bytes(changed)
    return video


@pytest.mark.parametrize(
    ("steps", "frames", "given", "rate"),
    [
        ([1.0] * 12, None, None, 12.5),
        ([0.5] * 7 + [1.7] * 5, None, None, 25.0),
        ([0.5] * 4 + [1.0] * 4 + [1.5] * 4, [2, 9], None, 12.5),
        # A rate that is given replaces the stamps.
        ([0.5] * 7 + [1.7] * 5, None, 10.0, 12.5),
    ],
)
def test_the_times_of_a_video_are_its_time_stamps(
    tmp_path: Path, steps: list[float], frames: list[int] | None, given: float | None, rate: float
) -> None:
    write_camera(tmp_path / "cam.yaml", CAMERA)
    video = with_steps(write_video(tmp_path / "a.mp4", images(12), four="mp4v"), steps)
    recording = {"path": str(video), "camera": str(tmp_path / "cam.yaml"), "detector": OWN}
    recording |= {} if frames is None else {"frames": frames}
    recording |= {} if given is None else {"frame_rate": given}
    experiment = ego.load_experiment({"name": "a", "n_lanes": 1, "recording": recording})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        log, found = read_lines(experiment)
    stamps = np.concatenate([[0.0], np.cumsum(steps)[:-1]]) / 12.5
    times = stamps if given is None else np.arange(12) / given
    assert log.time_s == pytest.approx(times[slice(*(frames or [0, 12]))], abs=1e-4)
    assert found == pytest.approx(rate, rel=0.01)
