"""The camera that OpenLane's files say themselves, on a hand-made file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import read_camera, write_camera
from egolane_pgm.vision.formats.openlane import read_own_camera
from tests.kits.drives import done, refused

OFFSETS = [-5.3, -1.7, 1.9]
INTRINSIC = np.array([[2059.0, 0, 940.0], [0, 2058.0, 630.0], [0, 0, 1]])

#: From the camera's frame (x forward, y left, z up) to the car's: 2 degrees down, 1 to the right, 1
#: rolled; 2.1 m high, .3 m left of the middle.
DOWN, RIGHT, ROLL = np.deg2rad([2.0, 1.0, 1.0])
EXTRINSIC = np.eye(4)
EXTRINSIC[:3, :3] = (
    np.array([[np.cos(RIGHT), np.sin(RIGHT), 0], [-np.sin(RIGHT), np.cos(RIGHT), 0], [0, 0, 1]])
    @ np.array([[np.cos(DOWN), 0, np.sin(DOWN)], [0, 1, 0], [-np.sin(DOWN), 0, np.cos(DOWN)]])
    @ np.array([[1, 0, 0], [0, np.cos(ROLL), -np.sin(ROLL)], [0, np.sin(ROLL), np.cos(ROLL)]])
)
EXTRINSIC[:3, 3] = 1.5, 0.3, 2.1

#: As OpenLane's evaluation brings its camera's frame into one with x right, y down, z forward.
TO_PINHOLE = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def pixels(offset: float) -> FloatArray:
    """(2, P): a straight line `offset` to the right of the car's middle, in the picture."""
    ahead = np.linspace(8, 60, 25)
    car = np.stack([ahead + 1.5, np.full(25, -offset), np.zeros(25)])
    seen = np.linalg.inv(EXTRINSIC) @ np.concatenate([car, np.ones((1, 25))])
    u, v, w = INTRINSIC @ TO_PINHOLE @ seen[:3]
    return np.stack([u / w, v / w])


def write_file(folder: Path, **more: Any) -> Path:
    lines = [{"category": 2, "uv": pixels(offset).tolist(), "attribute": 0} for offset in OFFSETS]
    content = {
        "file_path": "validation/segment-1/150767370180138600.jpg",
        "intrinsic": INTRINSIC.tolist(),
        "extrinsic": EXTRINSIC.tolist(),
        "lane_lines": lines,
        **more,
    }
    path = folder / "150767370180138600.json"
    path.write_text(json.dumps(content))
    return path


def test_lines_in_pixels_are_read_with_the_camera_of_their_file(tmp_path: Path) -> None:
    log = read_lines(write_file(tmp_path), format="openlane")
    np.testing.assert_allclose(log.offset_m, [OFFSETS], atol=0.01)


def test_a_camera_that_is_given_comes_first(tmp_path: Path) -> None:
    file = write_file(tmp_path)
    camera = read_own_camera(file)
    higher = read_lines(file, format="openlane", camera=camera)
    np.testing.assert_allclose(higher.offset_m, [OFFSETS], atol=0.01)
    # A camera twice as high would see everything twice as large.
    write_camera(tmp_path / "cam.yaml", camera)
    text = (tmp_path / "cam.yaml").read_text()
    (tmp_path / "cam.yaml").write_text(text.replace("height_m: 2.1", "height_m: 4.2"))
    higher = read_lines(file, format="openlane", camera=tmp_path / "cam.yaml")
    # Offsets are those of the car's middle, from which the camera is .3 m to the left.
    expected = 2 * (np.array([OFFSETS]) + 0.3) - 0.3
    np.testing.assert_allclose(higher.offset_m, expected, atol=0.02)


def test_the_command_writes_the_camera_of_a_file(tmp_path: Path) -> None:
    file, out = write_file(tmp_path), tmp_path / "cam.yaml"
    done("calibrate", "--openlane", file, "-o", out, "--ignore", "0,1200,1920,1280")
    camera = read_camera(out)
    assert (camera.width, camera.height) == (1920, 1280)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (2059.0, 2058.0, 940.0, 630.0)
    assert camera.height_m == pytest.approx(2.1)
    assert camera.pitch_deg == pytest.approx(-2.0)
    assert camera.yaw_deg == pytest.approx(1.0)
    assert abs(camera.roll_deg) == pytest.approx(1.0)
    assert camera.lateral_m == pytest.approx(-0.3)
    assert camera.ignore == ((0, 1200, 1920, 1280),)
    assert "# Camera: as " in out.read_text()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"intrinsic": None}, "has no intrinsic and extrinsic, which say what its camera is"),
        ({"intrinsic": [[1, 2], [3, 4]]}, "intrinsic is no 3 x 3 matrix of numbers"),
        ({"intrinsic": "lens"}, "intrinsic is no 3 x 3 matrix of numbers"),
        ({"intrinsic": np.eye(3).tolist()}, "intrinsic and extrinsic: fx: 1.0 is not between"),
        ({"extrinsic": np.eye(4).tolist()}, "intrinsic and extrinsic: height_m: 0.0 is not"),
        ({"extrinsic": np.eye(3).tolist()}, "extrinsic is no 4 x 4 matrix"),
    ],
)
def test_a_file_that_names_no_camera_is_refused(
    tmp_path: Path, more: dict[str, Any], said: str
) -> None:
    file = write_file(tmp_path, **more)
    told = refused("calibrate", "--openlane", file, "-o", tmp_path / "cam.yaml")
    assert told.count(str(file)) == 1
    assert said in told
    assert not (tmp_path / "cam.yaml").exists()


def test_openlane_goes_alone(tmp_path: Path) -> None:
    file = write_file(tmp_path)
    options = ("--openlane", file, "-o", tmp_path / "cam.yaml")
    assert "--openlane: goes alone" in refused("calibrate", *options, "--lane-width", 3.5)
    out_of_it = refused("calibrate", *options, "--size", "640x480", "--ignore", "700,0,800,9")
    assert "is not in a picture of 640x480" in out_of_it
    before = file.read_text()
    assert str(file) in refused("calibrate", "--openlane", file, "-o", file)
    assert file.read_text() == before
