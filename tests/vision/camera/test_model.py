"""The model of a camera above a flat road."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import (
    Camera,
    axes,
    distorted,
    image_to_road,
    read_camera,
    road_to_image,
    scaled,
    undistorted,
    vanishing_point,
    with_vanishing_point,
    write_camera,
)

LEVEL = Camera(1280, 720, 1000.0, 1000.0, 640.0, 360.0, height_m=1.5)
LENS = (-0.2485, -0.0195, -0.0006, 0.0002, 0.0086)

cameras = st.builds(
    Camera,
    st.just(1280),
    st.just(720),
    st.floats(800, 1400),
    st.floats(800, 1400),
    st.floats(600, 700),
    st.floats(300, 420),
    height_m=st.floats(0.8, 3.0),
    pitch_deg=st.floats(-5, 5),
    yaw_deg=st.floats(-5, 5),
    roll_deg=st.floats(-5, 5),
    lateral_m=st.floats(-1, 1),
    distortion=st.sampled_from([(0.0,) * 5, LENS]),
)


def test_a_level_camera_sees_a_point_where_the_pinhole_formula_puts_it():
    u, v = road_to_image(LEVEL, 10.0, 2.0)
    assert (float(u), float(v)) == pytest.approx((640 + 1000 * 2 / 10, 360 + 1000 * 1.5 / 10))


@given(cameras)
def test_the_axes_of_a_camera_are_at_right_angles_and_right_handed(camera):
    directions = axes(camera)
    np.testing.assert_allclose(directions @ directions.T, np.eye(3), atol=1e-12)
    right, down, forward = directions
    # Vehicle coordinates (forward, right, up) are left-handed.
    np.testing.assert_allclose(np.cross(right, down), -forward, atol=1e-12)


def test_points_behind_the_camera_are_not_in_the_picture():
    u, v = road_to_image(replace(LEVEL, distortion=LENS), [-5.0, 0.0, 5.0], 0.0)
    assert np.isnan(u).tolist() == np.isnan(v).tolist() == [True, True, False]


#: Every coefficient matters.
STRONG = (-0.2485, 0.05, -0.003, 0.002, -0.02)
RATIONAL = (0.4, 0.05, -0.003, 0.002, 0.01, 0.7, 0.1, 0.02)


@pytest.mark.parametrize(
    ("lens", "bends"), [("plumb_bob", STRONG), ("rational_polynomial", RATIONAL)]
)
def test_the_lens_is_opencvs(lens, bends):
    camera = replace(LEVEL, fy=980.0, lens=lens, distortion=bends)
    u, v = (part.ravel() for part in np.meshgrid(np.linspace(0, 1279, 9), np.linspace(0, 719, 7)))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0 * u + 1], axis=-1)
    pinhole = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    there = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), pinhole, np.array(bends))[0]
    np.testing.assert_allclose(distorted(camera, u, v), there[:, 0].T, atol=1e-6)
    np.testing.assert_allclose(undistorted(camera, *there[:, 0].T), [u, v], atol=1e-2)


@given(cameras, st.floats(6, 40), st.floats(-3, 3))
def test_a_road_point_comes_back_from_its_pixel(camera, x, y):
    back = image_to_road(camera, *road_to_image(camera, x, y))
    assert np.allclose(back, (x, y), atol=1e-3 * x)


@given(cameras, st.floats(500, 800), st.floats(300, 420))
def test_turning_to_a_vanishing_point_gives_that_vanishing_point(camera, u, v):
    turned = with_vanishing_point(camera, u, v)
    assert vanishing_point(turned) == pytest.approx((u, v), abs=1e-6)


def test_a_camera_comes_back_from_its_file(tmp_path):
    plain = replace(LEVEL, pitch_deg=1.0, yaw_deg=2.0, roll_deg=3.0, lateral_m=0.1)
    ignore = ((0, 600, 1280, 720), (-5, 0, 200, 30))
    for camera in (
        plain,
        replace(plain, distortion=LENS, baseline_m=0.5, lane_width_m=3.3, ignore=ignore),
    ):
        write_camera(tmp_path / "cam.yaml", camera, "by hand\nwith care: twice")
        assert read_camera(tmp_path / "cam.yaml") == camera


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("height_m: 1.5", "width: is missing"),
        ("[1, 2]", "needs keys and values, e.g. 'height_m: 1.3'"),
        ("{a", "is not YAML"),
        ("GOOD\nheigth: 3", "unknown key 'heigth' (did you mean 'height'?)"),
        ("GOOD\nheight_m: 1500", "height_m: 1500 is not between 0.2 and 10 (metres above"),
        ("GOOD\nfx: .nan", "fx: nan is not 1 finite number"),
        ("GOOD\nwidth: 100.5", "width: 100.5 is not 1 whole number"),
        ("GOOD\ndistortion: [1, 2]", "distortion: (1, 2) is not 5 finite numbers"),
        ("GOOD\nignore: [[0, 9, 10, 5]]", "ignore: needs rectangles left, top"),
        ("GOOD\nignore: [[0, 0, 10, 1.5]]", "1.5) is not 4 whole numbers"),
    ],
)
def test_a_bad_camera_file_is_refused_in_one_line(tmp_path, text, message):
    good = {"width": 1280, "height": 720, "fx": 1000, "fy": 1000, "cx": 640, "cy": 360}
    good["height_m"] = 1.5
    path = tmp_path / "cam.yaml"
    is_changed = text.startswith("GOOD\n")
    path.write_text(yaml.safe_dump(good | yaml.safe_load(text[5:])) if is_changed else text)
    with pytest.raises(InputError) as caught:
        read_camera(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.floats(0.3, 3.0), st.floats(5, 60), st.floats(-8, 8), st.floats(-5, 5), st.floats(-3, 3))
def test_a_scaled_camera_shows_the_same_in_a_picture_of_another_size(
    times: float, x: float, y: float, pitch: float, yaw: float
) -> None:
    camera = Camera(
        1280, 720, 1100.0, 1090.0, 650.0, 350.0, 1.4, pitch, yaw,
        distortion=(-0.2, 0.01, 0.001, 0.0, 0.0), baseline_m=0.4, ignore=((0, 601, 1279, 720),),
    )  # fmt: skip
    resized = scaled(camera, round(1280 * times), round(720 * times))
    u, v = road_to_image(camera, x, y)
    other_u, other_v = road_to_image(resized, x, y)
    # A pixel's middle is a whole number, its edges are at halves.
    assert (other_u + 0.5) / resized.width == pytest.approx((u + 0.5) / camera.width, abs=1e-9)
    assert (other_v + 0.5) / resized.height == pytest.approx((v + 0.5) / camera.height, abs=1e-9)
    assert resized.baseline_m == camera.baseline_m
    assert resized.height_m == camera.height_m
    ((left, top, right, bottom),) = resized.ignore
    assert left == 0
    assert top <= 601 * resized.height / 720 < top + 1
    assert right - 1 < 1279 * resized.width / 1280 <= right
    assert bottom == resized.height


def test_a_camera_is_not_scaled_to_another_aspect_ratio() -> None:
    camera = Camera(1280, 720, 1100.0, 1090.0, 650.0, 350.0, 1.4)
    with pytest.raises(InputError, match="another aspect ratio than the 1280x720"):
        scaled(camera, 1280, 700)
