"""The camera over a flat road."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.camera import (
    Camera,
    image_to_road,
    read_camera,
    road_homography,
    road_to_image,
    vanishing_point,
    with_vanishing_point,
    write_camera,
)
from egolane_pgm.types import InputError

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


def test_looking_up_moves_the_horizon_down_and_looking_right_moves_the_road_left():
    assert vanishing_point(replace(LEVEL, pitch_deg=2.0))[1] > 360
    assert vanishing_point(replace(LEVEL, yaw_deg=2.0))[0] < 640


def test_a_clockwise_roll_lifts_the_right_hand_side_of_the_road_in_the_picture():
    rolled = replace(LEVEL, roll_deg=5.0)
    _, left = road_to_image(rolled, 10.0, -2.0)
    _, right = road_to_image(rolled, 10.0, 2.0)
    assert right < left


@given(cameras, st.floats(6, 40), st.floats(-3, 3))
def test_a_road_point_comes_back_from_its_pixel(camera, x, y):
    back = image_to_road(camera, *road_to_image(camera, x, y))
    assert np.allclose(back, (x, y), atol=1e-3 * x)


@given(cameras, st.floats(5, 60), st.floats(-10, 10))
def test_the_homography_is_the_undistorted_projection(camera, x, y):
    u, v, w = road_homography(camera) @ [x, y, 1.0]
    assert w > 0
    assert np.allclose((u / w, v / w), road_to_image(camera, x, y, undistorted=True))


@given(cameras, st.floats(500, 800), st.floats(300, 420))
def test_turning_to_a_vanishing_point_gives_that_vanishing_point(camera, u, v):
    turned = with_vanishing_point(camera, u, v)
    assert vanishing_point(turned) == pytest.approx((u, v), abs=1e-6)


def test_the_sky_has_no_road_under_it():
    x, y = image_to_road(LEVEL, [640.0, 640.0], [360.0, 100.0])
    assert np.isnan(x).all()
    assert np.isnan(y).all()


def test_a_camera_comes_back_from_its_file(tmp_path):
    camera = replace(LEVEL, distortion=LENS, baseline_m=0.5)
    write_camera(tmp_path / "cam.yaml", camera, "by hand")
    assert read_camera(tmp_path / "cam.yaml") == camera


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("height_m: 1.5", "width: is missing"),
        ("[1, 2]", "needs the keys of a camera"),
        ("{a", "is not YAML"),
        ("GOOD\nheigth: 3", "unknown key 'heigth' (did you mean 'height'?)"),
        ("GOOD\nheight_m: 1500", "height_m: 1500 is not between 0.2 and 10 (metres above"),
        ("GOOD\nfx: .nan", "fx: nan is not a finite number"),
        ("GOOD\nwidth: 100.5", "width: 100.5 is not a whole number of pixels"),
        ("GOOD\ndistortion: [1, 2]", "distortion: needs the five numbers"),
        ("GOOD\ndistortion: 3", "distortion: needs the five numbers"),
        ("GOOD\npitch_deg: up", "pitch_deg: 'up' is not a finite number"),
    ],
)
def test_a_bad_camera_file_is_refused_in_one_line(tmp_path, text, message):
    good = "width: 1280\nheight: 720\nfx: 1000\nfy: 1000\ncx: 640\ncy: 360\nheight_m: 1.5"
    path = tmp_path / "cam.yaml"
    path.write_text(text.replace("GOOD", good))
    with pytest.raises(InputError) as caught:
        read_camera(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_camera_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read: No such file"):
        read_camera(tmp_path / "none.yaml")
