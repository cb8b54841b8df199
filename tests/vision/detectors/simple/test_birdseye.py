"""The bird's-eye view."""

from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.vision.camera.model import Camera, road_to_image
from egolane_pgm.vision.detectors.simple.birdseye import look, make_view

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)
LENS = (-0.2485, -0.0195, -0.0006, 0.0002, 0.0086)


def pattern(x, y):
    """Something smooth on the road."""
    return 120 + 60 * np.sin(x / 2) * np.cos(y)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, LENS])
def test_the_road_is_seen_from_above_where_it_is(distortion):
    from egolane_pgm.vision.camera.model import image_to_road

    camera = replace(CAMERA, distortion=distortion, yaw_deg=1.0, lateral_m=0.3)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = image_to_road(camera, u, v)
    image = np.nan_to_num(pattern(x, y)).astype(np.uint8)
    view = make_view(camera, 6, 15, -3, 3)
    above = look(view, image).astype(float)
    true = pattern(view.x_m[:, None], view.y_m)
    assert np.abs(above - true)[view.valid].mean() < 1.5
    assert (above[~view.valid] == 0).all()


def test_rows_run_from_far_to_near_and_pixels_have_their_size():
    view = make_view(CAMERA, 5, 25, -8, 8, along_m=0.25, across_m=0.05)
    assert view.valid.shape == (len(view.x_m), len(view.y_m)) == (80, 320)
    assert np.diff(view.x_m) == pytest.approx(-0.25)
    assert np.diff(view.y_m) == pytest.approx(0.05)
    assert (view.x_m[0], view.y_m[-1]) == pytest.approx((24.875, 7.975))


def test_a_lens_that_folds_over_does_not_show_the_picture_twice():
    camera = replace(CAMERA, fx=500.0, fy=500.0, distortion=(-0.35, 0.0, 0.0, 0.0, 0.0))
    view = make_view(camera, 2, 20, -30, 30, across_m=0.2)
    u, v = road_to_image(camera, view.x_m[:, None], view.y_m)
    inside = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    # The lens equation turns back where 1 - 3 * 0.35 r^2 = 0.
    fu, fv = road_to_image(camera, view.x_m[:, None], view.y_m, undistorted=True)
    radius = np.hypot((fu - camera.cx) / 500, (fv - camera.cy) / 500)
    folded = inside & (radius > 1.01 * np.sqrt(1 / (3 * 0.35)))
    assert folded.any()
    assert not view.valid[folded].any()
    assert view.valid[inside & (radius < 0.9)].all()


def test_ignored_parts_are_not_seen():
    view = make_view(CAMERA, 5, 25, -5, 5)
    less = make_view(replace(CAMERA, ignore=((0, 430, 960, 540), (0, 0, 300, 540))), 5, 25, -5, 5)
    u, v = road_to_image(CAMERA, view.x_m[:, None], view.y_m)
    np.testing.assert_array_equal(less.valid, view.valid & (v < 430) & (u >= 300))
    assert (look(less, np.full((540, 960), 200, np.uint8))[~less.valid] == 0).all()
