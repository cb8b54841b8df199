"""Camera files of ROS, OpenCV and Kalibr, and the lens of a fisheye."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import (
    Camera,
    distorted,
    read_camera,
    undistorted,
    write_camera,
)

MATRIX = [900.0, 0.0, 640.0, 0.0, 910.0, 360.0, 0.0, 0.0, 1.0]

ROS = f"""
image_width: 1280
image_height: 720
camera_name: front
camera_matrix: {{rows: 3, cols: 3, data: {MATRIX}}}
distortion_model: MODEL
distortion_coefficients: {{rows: 1, cols: 4, data: BENDS}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""

MESSAGE = f"""
header: {{frame_id: front}}
width: 1280
height: 720
distortion_model: MODEL
D: BENDS
K: {MATRIX}
"""

KALIBR = """
cam0:
  camera_model: pinhole
  intrinsics: [900.0, 910.0, 640.0, 360.0]
  distortion_model: MODEL
  distortion_coeffs: BENDS
  resolution: [1280, 720]
cam1: {camera_model: pinhole, intrinsics: [1.0, 1.0, 1.0, 1.0], resolution: [10, 10]}
"""

BENDS = (-0.27, 0.09, 0.001, -0.002)
RATIONAL = (0.4, 0.05, -0.003, 0.002, 0.01, 0.7, 0.1, 0.02)


def _filled(text: str, model: str, bends: tuple[float, ...] = BENDS) -> str:
    return text.replace("MODEL", model).replace("BENDS", str(list(bends)))


def _opencv(path: Path, bends: tuple[float, ...]) -> None:
    """A file as OpenCV's calibration sample writes it."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Tue Dec  1 10:00:00 2026")
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("camera_matrix", np.reshape(MATRIX, (3, 3)))
    storage.write("distortion_coefficients", np.array([bends]))
    storage.write("height_m", 1.3)
    storage.release()


@pytest.mark.parametrize(
    ("text", "lens"),
    [
        (_filled(ROS, "plumb_bob"), "plumb_bob"),
        (_filled(ROS, "equidistant"), "equidistant"),
        (_filled(ROS, "rational_polynomial").replace("rational_polynomial", "''"), "plumb_bob"),
        (_filled(MESSAGE, "plumb_bob", (*BENDS, 0.0)), "plumb_bob"),
        (_filled(KALIBR, "radtan"), "plumb_bob"),
        (_filled(KALIBR, "equidistant"), "equidistant"),
        (_filled(MESSAGE, "rational_polynomial", RATIONAL), "rational_polynomial"),
        (".yaml", "plumb_bob"),
        (".yaml", "rational_polynomial"),
        (".xml", "plumb_bob"),
    ],
)
def test_the_lens_is_read_and_the_mounting_is_asked_for(
    tmp_path: Path, text: str, lens: str
) -> None:
    bends = {"plumb_bob": (*BENDS, 0.0), "equidistant": BENDS, "rational_polynomial": RATIONAL}[
        lens
    ]
    path = tmp_path / ("camera" + (text if text.startswith(".") else ".yaml"))
    if text.startswith("."):
        _opencv(path, bends)
    else:
        path.write_text(text)
        with pytest.raises(InputError, match=r"height_m: is missing; the file has the lens only"):
            read_camera(path)
        path.write_text(f"{text}\nheight_m: 1.3\n")
    expected = Camera(
        1280, 720, 900.0, 910.0, 640.0, 360.0, height_m=1.3, lens=lens, distortion=bends
    )
    assert read_camera(path) == expected
    write_camera(tmp_path / "ours.yaml", expected)
    assert read_camera(tmp_path / "ours.yaml") == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_filled(ROS, "mei"), "distortion_model: 'mei' is not one of plumb_bob, rational_"),
        (_filled(MESSAGE, "plumb_bob", (*BENDS, 0.0, 0.1, 0.0, 0.0)), "D: has more than the 5"),
        (_filled(MESSAGE, "plumb_bob", (0.1,)), "D: needs 0 or 2 or 4 or 5 or 8 or 12 or 14"),
        (_filled(KALIBR, "none").replace("pinhole", "omni"), "camera_model: 'omni' is not pinhole"),
        (_filled(KALIBR, "none").replace("[900.0, ", "["), "intrinsics: needs 4 or 9 numbers"),
        ("%YAML:1.0\n---\nmodel_type: MEI\nxi: {a: 1}\n", "model_type: 'MEI' is not pinhole"),
        ("%YAML:1.0\n---\na:\n   b: {c: [1, {d: 2}]}\n", "unknown key 'a'"),
        (f"%YAML:1.0\n---\na: {'{a: ' * 3000}1{'}' * 3000}\n", "is not a FileStorage"),
        ("%YAML:1.0\n---\na: {data: 1}\n", "is not a FileStorage"),
        ("%YAML:1.0\n---\na: !!opencv-matrix\n   data: null\n", "is not a FileStorage"),
        ("%YAML:1.0\n---\n- 1\n", "is not a FileStorage"),
        ("<?xml", "is not a FileStorage of OpenCV that can be read"),
    ],
)
def test_another_lens_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_camera(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_a_fisheye_bends_as_in_opencv_and_back() -> None:
    bends = (-0.01, 0.02, -0.005, 0.001)
    camera = Camera(
        1280, 720, 400.0, 410.0, 640.0, 360.0, height_m=1.3, lens="equidistant", distortion=bends
    )
    rays = np.random.default_rng(0).uniform(-3, 3, (50, 2))
    matrix = np.array([[400.0, 0, 640.0], [0, 410.0, 360.0], [0, 0, 1]])
    theirs = cv2.fisheye.distortPoints(rays[None], matrix, np.array(bends))[0]
    u, v = 400 * rays[:, 0] + 640, 410 * rays[:, 1] + 360
    ours = np.stack(distorted(camera, u, v), axis=-1)
    np.testing.assert_allclose(ours, theirs, atol=1e-6)
    np.testing.assert_allclose(undistorted(camera, *ours.T), (u, v), atol=1e-3)
