"""Stills taken out of a video."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.calibration import video_stills
from egolane_pgm.vision.calibration.video_stills import take_stills
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_image
from tests.kits.synthetic_road import write_video

SHAPE = (64, 96)


def flat(grey: int) -> Image:
    return np.full((*SHAPE, 3), grey, np.uint8)


def video_of(folder: Path, greys: list[int]) -> Path:
    return write_video(folder / "drive.avi", [flat(grey) for grey in greys])


def positions(stills: list[Path]) -> list[int]:
    return [int(path.stem.removeprefix("frame_")) for path in stills]


def test_all_frames_of_a_short_video_are_taken(tmp_path: Path) -> None:
    video = open_source(video_of(tmp_path, [10 * k for k in range(20)]))
    seen: list[int] = []
    stills = take_stills(video, tmp_path, lambda places: (seen.append(k) or k for k in places))
    assert positions(stills) == seen == list(range(20))
    for k, still in enumerate(stills):
        assert np.abs(read_image(still).astype(int) - 10 * k).mean() < 3


@pytest.mark.parametrize("jump", [5, 10_000])
def test_frames_of_a_long_one_are_spread_over_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump: int
) -> None:
    monkeypatch.setattr(video_stills, "TAKEN", 5)
    monkeypatch.setattr(video_stills, "_JUMP", jump)
    greys = [2 * k for k in range(101)]
    stills = take_stills(open_source(video_of(tmp_path, greys)), tmp_path)
    assert positions(stills) == [0, 25, 50, 75, 100]
    for still, k in zip(stills, positions(stills), strict=True):
        assert np.abs(read_image(still).astype(int) - 2 * k).mean() < 3


def test_frames_of_a_car_at_rest_are_left_out(tmp_path: Path) -> None:
    stills = take_stills(open_source(video_of(tmp_path, [0, 0, 0, 90, 90, 180])), tmp_path)
    assert positions(stills) == [0, 3, 5]


def test_a_video_that_does_not_say_how_long_it_is_is_refused(tmp_path: Path) -> None:
    video = replace(open_source(video_of(tmp_path, [0, 50])), n_frames=None)
    with pytest.raises(InputError, match=r"drive\.avi: does not say how many frames it has"):
        take_stills(video, tmp_path)
