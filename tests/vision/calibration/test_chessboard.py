"""Calibration of a camera from chessboards and labelled lines."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.types import InputError
from egolane_pgm.vision.calibration.chessboard import calibrate_lens, find_board
from egolane_pgm.vision.calibration.road_lines import assumed_camera
from egolane_pgm.vision.camera.model import (
    image_to_road,
    undistorted,
)
from tests.kits.calibration_kit import TRUE, cameras, lines_of, unturned, view_of_lines


def test_a_lens_is_recovered_from_drawn_chessboards(boards):
    lens = calibrate_lens(sorted(boards.iterdir()))
    found = lens.camera
    assert (found.width, found.height) == (1280, 720)
    assert (found.fx, found.fy) == pytest.approx((TRUE.fx, TRUE.fy), rel=0.01)
    assert (found.cx, found.cy) == pytest.approx((TRUE.cx, TRUE.cy), abs=12)
    assert len(lens.rms_px) >= 8
    assert max(lens.rms_px.values()) < 0.3
    # The bend at the picture's border matters, its coefficients trade with each other.
    edge = np.array([100.0, 1180.0]), np.array([360.0, 360.0])
    rays = [(undistorted(c, *edge)[0] - c.cx) / c.fx for c in (found, TRUE)]
    assert np.diff(rays[0]) == pytest.approx(np.diff(rays[1]), rel=0.01)


def test_pictures_that_cannot_be_used_are_left_out_with_one_line_each(boards, tmp_path):
    for path in sorted(boards.iterdir())[:6]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    cv2.imwrite(str(tmp_path / "x_empty.png"), np.full((720, 1280, 3), 128, np.uint8))
    cv2.imwrite(str(tmp_path / "x_small.png"), np.full((480, 640, 3), 128, np.uint8))
    part = cv2.imread(str(tmp_path / "0.png"))
    corners = find_board(part, 9, 6)
    part[int(np.median(corners[:, 1])) :] = 220
    cv2.imwrite(str(tmp_path / "x_part.png"), part)
    (tmp_path / "x_text.png").write_text("no picture")
    lens = calibrate_lens(sorted(tmp_path.iterdir()))
    reasons = {line.split(": ")[0].rsplit("/", 1)[1]: line for line in lens.skipped}
    assert "no chessboard of 9x6" in reasons["x_empty.png"]
    assert "640x480, most are 1280x720" in reasons["x_small.png"]
    assert "no chessboard of 9x6" in reasons["x_part.png"]
    assert "is not a picture that can be read" in reasons["x_text.png"]
    with pytest.raises(InputError, match=r"0 of 1 pictures.*; .*x_text.png: is not a picture"):
        calibrate_lens([tmp_path / "x_text.png"])
    assert tmp_path / "x_part.png" not in lens.rms_px


def test_too_few_chessboards_are_refused_with_the_first_reason(boards, stills):
    with pytest.raises(InputError, match=r"3 of 3 pictures show the whole chessboard.*needs 5"):
        calibrate_lens(sorted(boards.iterdir())[:3])
    with pytest.raises(InputError, match=r"[01] of 6 .*8x6.*check `board`"):
        calibrate_lens(sorted(boards.iterdir())[:6], columns=8)
    with pytest.raises(InputError, match=r"0 of 3 pictures.*no chessboard of 9x6"):
        calibrate_lens(sorted(stills.iterdir()))


@settings(deadline=None, max_examples=25)
@given(cameras, st.floats(-0.02, 0.02), st.floats(-0.001, 0.001), st.integers(0, 99))
def test_any_camera_is_recovered_from_lines(camera, heading, curvature, seed):
    offsets = np.array([-5.4, -1.8, 1.8, 5.4])
    frames = [
        lines_of(camera, offsets + shift, heading * sign, curvature * sign, 0.3, seed + k)
        for k, (shift, sign) in enumerate(((0.0, 1), (0.3, -1), (-0.3, 1), (0.1, -1)))
    ]
    view = view_of_lines(camera, unturned(camera), frames)
    assert view.camera.height_m == pytest.approx(camera.height_m, rel=0.02)
    assert view.camera.pitch_deg == pytest.approx(camera.pitch_deg, abs=0.15)
    assert view.camera.yaw_deg == pytest.approx(camera.yaw_deg, abs=0.3)
    assert view.camera.roll_deg == camera.roll_deg


def test_offsets_hardly_depend_on_the_focal_length_assumed():
    camera = replace(TRUE, distortion=(0.0,) * 5)
    frames = [lines_of(camera, np.array([-5.4, -1.8, 1.8, 5.4]) + d) for d in (0.0, 0.4)]
    points = np.concatenate(lines_of(camera, [-2.0, 1.5]))
    offsets = []
    assumed = assumed_camera(1280, 720)
    for zoom in (0.7, 1.0, 1.4):
        lens = replace(assumed, fx=assumed.fx * zoom, fy=assumed.fy * zoom)
        view = view_of_lines(camera, lens, frames)
        offsets.append(image_to_road(view.camera, *points.T)[1])
    assert np.abs(offsets[0] - offsets[2]).max() < 0.05


def test_a_line_that_is_missed_does_not_double_the_height():
    frames = [lines_of(TRUE, offsets) for offsets in ([-5.4, -1.8, 1.8], [-1.8, 1.8], [-5.4, 1.8])]
    view = view_of_lines(TRUE, unturned(TRUE), frames)
    assert view.camera.height_m == pytest.approx(TRUE.height_m, rel=0.01)
    assert (~view.is_lane).sum() == 1
