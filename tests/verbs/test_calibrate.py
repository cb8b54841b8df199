"""The command `egolane calibrate`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.vision.camera.model import read_camera
from tests.kits.calibration_kit import TRUE
from tests.kits.drives import done, refused


def test_the_command_calibrates_from_chessboards_and_stills(boards, stills, tmp_path):
    out = tmp_path / "a" / "cam.yaml"
    output = done(
        "calibrate", stills, "--chessboards", boards / "*.png", "--lane-width", 3.7,
        "--ignore", 0, 700, 1280, 720, "-o", out,
    ).output  # fmt: skip
    camera = read_camera(out)
    assert camera.height_m == pytest.approx(TRUE.height_m, rel=0.03)
    assert camera.ignore == ((0, 700, 1280, 720),)
    comment = [line for line in out.read_text().splitlines() if line.startswith("#")]
    text = "\n".join(comment)
    for word in ("chessboards (9x6 inner corners) of 10", "px RMS", "meet at", "3.7 m"):
        assert word in text
    assert output.count("px RMS\n") >= 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere/*.jpg"], "nowhere/*.jpg: has no pictures"),
        (["x", "--ignore", "1", "2"], "'--ignore': '-o'"),
    ],
)
def test_bad_options_are_one_line(tmp_path, arguments, message):
    assert message in refused("calibrate", *arguments, "-o", tmp_path / "cam.yaml")
    assert not (tmp_path / "cam.yaml").exists()


def test_boards_and_road_of_different_sizes_are_refused(boards, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640, 3), np.uint8))
    words = (tmp_path / "a.png", "--chessboards", boards)
    output = refused("calibrate", *words, "-o", tmp_path / "c.yaml")
    assert "the chessboards are 1280x720, the road's pictures 640x480" in output


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("--ignore 0 720 480 900", "--ignore: 0 720 480 900 is not in a picture of 1280x720"),
        ("--ignore 1280 0 1300 90", "--ignore: 1280 0 1300 90 is not in a picture of 1280x720"),
        ("--lane-width 3700", "lane_width_m: 3700.0 is not between 2 and 6 (metres)"),
    ],
)
def test_what_does_not_fit_the_pictures_or_a_road_is_refused(
    stills: Path, tmp_path: Path, given: str, message: str
) -> None:
    target = tmp_path / "cam.yaml"
    words = (stills, *given.split(), "-o", target)
    assert refused("calibrate", *words) == message
    assert not target.exists()


def test_the_lens_may_come_from_a_camera_file(stills: Path, tmp_path: Path) -> None:
    lens = tmp_path / "ros.yaml"
    matrix = [TRUE.fx, 0, TRUE.cx, 0, TRUE.fy, TRUE.cy, 0, 0, 1]
    lens.write_text(
        f"image_width: {TRUE.width}\nimage_height: {TRUE.height}\n"
        f"camera_matrix: {{rows: 3, cols: 3, data: {matrix}}}\ndistortion_model: plumb_bob\n"
        f"distortion_coefficients: {{rows: 1, cols: 5, data: {list(TRUE.distortion)}}}\n"
    )
    words = (stills, "--chessboards", lens, "--lane-width", 3.7)
    done("calibrate", *words, "-o", tmp_path / "cam.yaml")
    camera = read_camera(tmp_path / "cam.yaml")
    assert camera.height_m == pytest.approx(TRUE.height_m, rel=0.03)
    assert (camera.fx, camera.distortion) == (TRUE.fx, TRUE.distortion)
