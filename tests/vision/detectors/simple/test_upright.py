"""Vehicles on the road: what they hide, and that their edges are no lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.camera.model import Camera, road_to_image
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.fit import Found, find_lines, from_above, view_for
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from egolane_pgm.vision.detectors.simple.upright import free_road, is_daylight
from tests.kits.synthetic_road import Paint, road

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)
DEFAULTS = resolve_parameters(FINDING, {}, 1)
BLIND = resolve_parameters(FINDING, {"shadow_share": 0.0}, 1)
VIEW = view_for(CAMERA, DEFAULTS)
#: Wide, as lines less than 2.2 m apart are never both kept.
LANE = (Paint(-2.4), Paint(2.4))


def with_box(
    image: Image,
    x_m: float,
    left_m: float,
    right_m: float,
    *,
    camera: Camera = CAMERA,
    gain: float = 1.0,
) -> Image:
    """The picture with the back of a vehicle x_m ahead: dark below its bumper, a grey body with
    bright posts from there up to 1.5 m above the road, dimmed as a whole."""
    image = image.copy()
    posts = np.linspace(left_m + 0.2, right_m - 0.2, 3)
    for low, high, left, right, grey in (
        (0.0, 0.3, left_m, right_m, 12),
        (0.3, 1.5, left_m, right_m, 60),
        *((0.3, 1.5, p - 0.04, p + 0.04, 220) for p in posts),
    ):
        # A height h above the road, x ahead, is seen where the road is x H / (H - h) ahead; above
        # the camera it is as far above the horizon.
        u, _ = road_to_image(camera, np.full(2, x_m), np.array([left, right]))
        _, foot = road_to_image(camera, x_m, 0.0)
        per_m = (foot - _horizon(camera)) / camera.height_m
        top, below = foot - high * per_m, foot - low * per_m
        part = image[int(top) : int(below), int(u[0]) : int(u[1]) + 1]
        part[:] = grey
    return (image * gain).astype(np.uint8)


def _horizon(camera: Camera) -> float:
    _, v = road_to_image(camera, 1e6, 0.0)
    return float(v)


def inside(found: Found, left_m: float, right_m: float, x: float = 10.0) -> np.ndarray:
    """Lines between two offsets, x metres ahead."""
    places = found.shape @ np.array([1, x, x**2 / 2, x**3 / 6])
    return places[(places > left_m) & (places < right_m)]


@pytest.mark.parametrize("gain", [0.4, 1.0])
@pytest.mark.parametrize("x_m", [9.0, 13.0, 18.0])
def test_a_vehicle_in_the_lane_leaves_no_line_inside_it(x_m: float, gain: float) -> None:
    image = with_box(road(LANE, camera=CAMERA), x_m, -0.9, 0.9, gain=gain)
    found = find_lines(VIEW, image, DEFAULTS)
    assert not len(inside(found, -2, 2))
    for line in (-2.4, 2.4):
        assert len(inside(found, line - 0.1, line + 0.1)) == 1


def test_without_the_search_for_vehicles_their_edges_become_a_line() -> None:
    image = with_box(road(LANE, camera=CAMERA), 9.0, -0.9, 0.9)
    assert len(inside(find_lines(VIEW, image, BLIND), -2, 2))


def test_the_road_beside_and_before_a_vehicle_is_free_and_the_road_behind_it_is_not() -> None:
    image = with_box(road(LANE, camera=CAMERA), 12.0, -0.9, 0.9)
    free = free_road(VIEW, from_above(VIEW, image), DEFAULTS)
    ray = np.abs(VIEW.y_m / VIEW.x_m[:, None])
    behind = (VIEW.x_m[:, None] > 12.3) & (ray < 0.85 / 12)
    assert not free[behind].any()
    assert free[(VIEW.x_m[:, None] < 11) | (ray > 1.05 / 12)].all()


@pytest.mark.parametrize("seed", range(3))
def test_a_road_without_vehicles_is_free_to_the_far_end(seed: int) -> None:
    image = road(LANE, camera=CAMERA, seed=seed)
    assert free_road(VIEW, from_above(VIEW, image), DEFAULTS).all()
    ours, blind = find_lines(VIEW, image, DEFAULTS), find_lines(VIEW, image, BLIND)
    np.testing.assert_array_equal(ours.shape, blind.shape)


def test_the_shade_of_a_bridge_and_a_dark_seam_are_road() -> None:
    above = from_above(VIEW, road(LANE, camera=CAMERA))
    shade, seam = above.copy(), above.copy()
    shade[(VIEW.x_m > 12) & (VIEW.x_m < 20)] //= 5
    seam[np.ix_(VIEW.x_m > 12, np.abs(VIEW.y_m) < 0.15)] //= 5
    assert free_road(VIEW, shade, DEFAULTS).all()
    assert free_road(VIEW, seam, DEFAULTS).all()


@pytest.mark.parametrize("sky", [150, 10, 0])
def test_a_road_under_a_dark_sky_is_not_daylight(sky: int) -> None:
    image = road(LANE, camera=CAMERA)
    image[: int(_horizon(CAMERA))] = sky
    assert is_daylight(CAMERA, image) == (sky == 150)


def test_lines_are_found_on_a_black_road_at_night() -> None:
    image = road(LANE, camera=CAMERA)
    noise = np.random.default_rng(0).random(image.shape) < 0.2
    image = np.where(image < 150, noise, image).astype(np.uint8)
    image[: int(_horizon(CAMERA))] = 0
    assert not is_daylight(CAMERA, image)
    found = find_lines(VIEW, image, DEFAULTS)
    for line in (-2.4, 2.4):
        assert len(inside(found, line - 0.1, line + 0.1)) == 1


def test_only_road_counts_as_light() -> None:
    image = road(LANE, camera=CAMERA)
    top = int(_horizon(CAMERA))
    image[:top] = 10
    # A lit mirror in the sky.
    image[: top // 2, 200:700] = 250
    assert is_daylight(CAMERA, image)
    assert not is_daylight(replace(CAMERA, ignore=((200, 0, 700, top // 2),)), image)
