"""Between picture and road: what is looked at, and curves of the picture as lines of the road."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.classic.multilane import curves
from egolane_pgm.classic.multilane.road import (
    flattened,
    places_of,
    road_of,
    shapes_of,
)
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera, road_to_image

CAMERA = Camera(1280, 720, 1065.0, 1065.0, 639.5, 359.5, height_m=1.65, pitch_deg=-6.6)
WIDTHS = 0.078, 0.3
ROAD = road_of(CAMERA, 55.0, *WIDTHS)
X = np.linspace(4, 50, 200)


def curve_of(camera: Camera, y: np.ndarray) -> np.ndarray:
    """The curve of the picture nearest to a line y(X) of the road, by its rows."""
    road = road_of(camera, 55.0, *WIDTHS)
    u, v = road_to_image(camera, X, y)
    inside = (v >= road.top) & (v < road.bottom)
    t, column = flattened(road, v[inside], u[inside])
    rows = np.linspace(t.min(), t.max(), 100)
    return curves.fit(rows, np.interp(rows, t[::-1], column[::-1]), 2)


@settings(max_examples=30, deadline=None)
@given(st.floats(-4, 4), st.floats(-0.05, 0.05))
def test_a_straight_line_keeps_its_place_and_heading(offset: float, heading: float) -> None:
    curve = curve_of(CAMERA, offset + heading * X)
    assert abs(curve[2]) < 0.01
    (shape,) = shapes_of(ROAD, curve[None] * [1, 1, 0])
    np.testing.assert_allclose(shape, [offset, heading, 0, 0], atol=0.01)


@pytest.mark.parametrize("curvature", [-8e-4, 8e-4])
def test_a_bent_line_is_where_it_is_nearby_but_bends_less(curvature: float) -> None:
    """A parabola of the picture, as the paper has it, is none of the road."""
    (shape,) = shapes_of(ROAD, curve_of(CAMERA, 1.8 + curvature * X**2 / 2)[None])
    for x in (0, 10, 20):
        place = shape[0] + x * shape[1] + x**2 / 2 * shape[2]
        assert place == pytest.approx(1.8 + curvature * x**2 / 2, abs=0.1)
    assert 0.2 < shape[2] / curvature < 1


def test_a_mirrored_curve_is_the_mirrored_line() -> None:
    curve = np.array([[700.0, 90, 12]])
    mirror = np.array([[CAMERA.width - 1 - 700.0, -90, -12]])
    np.testing.assert_allclose(shapes_of(ROAD, curve), -shapes_of(ROAD, mirror), atol=1e-9)
    np.testing.assert_allclose(places_of(ROAD, curve), -places_of(ROAD, mirror))


def test_a_lens_that_bends_lines_changes_no_line() -> None:
    bent = replace(CAMERA, distortion=(-0.2, 0.03, 0.0, 0.0, 0.0))
    road = road_of(bent, 55.0, *WIDTHS)
    (shape,) = shapes_of(road, curve_of(bent, 1.8 + 0.01 * X)[None])
    np.testing.assert_allclose(shape[:2], [1.8, 0.01], atol=0.02)


def test_a_marking_is_as_wide_as_on_the_road() -> None:
    u, v = road_to_image(CAMERA, np.full(2, 5.0), np.array([-0.15, 0.15]))
    assert ROAD.widest[round(float(v[0])) - ROAD.top] == pytest.approx(u[1] - u[0], rel=0.02)
    # Far away a marking has at least 3 pixels, and up to 15 may be one.
    assert ROAD.narrowest[0] == 3
    assert ROAD.widest[0] == 15
    assert (np.diff(ROAD.widest) >= 0).all()


@pytest.mark.parametrize("pitch_deg", [-30.0, 20.0])
def test_a_camera_that_looks_past_the_road_is_refused_in_one_line(pitch_deg: float) -> None:
    camera = replace(CAMERA, pitch_deg=pitch_deg)
    if pitch_deg < 0:
        # All of the picture shows road.
        assert road_of(camera, 55.0, *WIDTHS).top == 0
        return
    with pytest.raises(InputError, match=r"only 0 rows .* 55 m ahead; check its pitch"):
        road_of(camera, 55.0, *WIDTHS)
