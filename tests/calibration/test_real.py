"""Calibration of cameras from real pictures."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.calibration.chessboard import calibrate_lens
from egolane_pgm.calibration.labels import line_points, read_labels
from egolane_pgm.calibration.road_lines import find_in_stills
from egolane_pgm.calibration.straight_road import assumed_camera, view_from, view_of_road
from egolane_pgm.camera.model import (
    Camera,
    image_to_road,
)
from egolane_pgm.camera.pictures import files_matching


@pytest.fixture(scope="session")
def pictures() -> Path:
    """The folder of real pictures."""
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "camera"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("real pictures: needs EGOLANE_DATA with a folder camera")
    return folder


# --- real pictures ---


def test_the_camera_of_the_real_chessboards_and_straight_stills(pictures, tmp_path):
    folder = pictures / "carnd"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/carnd")
    lens = calibrate_lens(files_matching(str(folder / "camera_cal" / "*.jpg")))
    assert (lens.fx, lens.fy) == pytest.approx((1156, 1151), abs=8)
    assert (lens.cx, lens.cy) == pytest.approx((672, 389), abs=8)
    assert len(lens.boards) >= 15
    assert len(lens.boards) + len(lens.skipped) == 20
    assert any("9x5 inner corners seen" in line for line in lens.skipped)
    camera = Camera(
        1280, 720, lens.fx, lens.fy, lens.cx, lens.cy, 1.0,
        distortion=lens.distortion, ignore=((0, 670, 1280, 720),),
    )  # fmt: skip
    stills = files_matching(str(folder / "test_images" / "straight_lines*.jpg"))
    found = find_in_stills(camera, stills)
    view = view_from(camera, found.ahead, found.each, found.fits, 3.7, "stills")
    assert view.vanishing_point == pytest.approx((639.5, 419.6), abs=3)
    assert view.camera.height_m == pytest.approx(1.25, abs=0.03)
    for lines in found.lines:
        y = np.array([np.median(image_to_road(view.camera, *points.T)[1]) for points in lines])
        width = y[y > 0].min() - y[y < 0].max()
        assert width == pytest.approx(3.7, abs=0.1)


def test_the_camera_of_the_real_labels(pictures):
    if not (pictures / "tusimple_frames").is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/tusimple_frames")
    # The last 55 stay unseen, for detectors.
    frames = read_labels(pictures / "tusimple_frames" / "labels.jsonl")[:55]
    lines = [line_points(frame) for frame in frames]
    view = view_of_road(assumed_camera(1280, 720), lines, 3.66)
    assert view.vanishing_point == pytest.approx((658, 236), abs=6)
    assert view.camera.height_m == pytest.approx(1.68, abs=0.04)


def test_the_camera_of_the_real_lane_change_from_found_lines_only(pictures):
    folder = pictures / "lane_change_right"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/lane_change_right")
    masks = ((0, 0, 692, 130), (120, 300, 400, 480), (0, 360, 692, 480))
    camera = replace(assumed_camera(692, 480), ignore=masks)
    found = find_in_stills(camera, files_matching(str(folder))[::5])
    view = view_from(camera, found.ahead, found.each, found.fits, 3.5, "stills")
    assert view.vanishing_point == pytest.approx((470, 214), abs=5)
    assert view.camera.height_m == pytest.approx(1.2, abs=0.08)
