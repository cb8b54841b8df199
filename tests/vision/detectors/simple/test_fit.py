"""Lines found in single pictures of known roads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors.simple import fit
from egolane_pgm.vision.detectors.simple import kernels as _kernels
from egolane_pgm.vision.detectors.simple.fit import Found, find_lines, view_for
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import Paint, road
from tests.reference import line_finder

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)
DEFAULTS = resolve_parameters(FINDING, {}, 1)
VIEW = view_for(CAMERA, DEFAULTS)
STRAIGHT = {**DEFAULTS, "curve": "line"}
STRAIGHT_VIEW = view_for(CAMERA, STRAIGHT)
WIDTH = 3.66


def parallel(offset, heading=0.0, curvature=0.0, lines=(-1, 0, 1, 2), **more):
    return [Paint(offset + k * WIDTH, heading=heading, curvature=curvature, **more) for k in lines]


def at(found: Found, x: float):
    return found.shape @ np.array([1, x, x**2 / 2, x**3 / 6])


def found_in(image, view=VIEW, parameters=DEFAULTS, **more) -> Found:
    return find_lines(view, image, parameters, **more)


@pytest.mark.parametrize("shape", [(-9, 0.1, 0.03, 0), (3, 0, 0, 0.003), (-2, 0, 0.03, -0.006)])
def test_the_visible_length_of_a_line_follows_its_bends(shape):
    rows = np.arange(0, len(VIEW.x_m), 4)
    x = VIEW.x_m[rows]
    y = np.polyval([shape[3] / 6, shape[2] / 2, shape[1], shape[0]], x)
    column = np.floor((y - VIEW.y_m[0]) / VIEW.across_m + 0.5).astype(int)
    is_inside = (column >= 0) & (column < len(VIEW.y_m))
    n_seen = VIEW.valid[rows[is_inside], column[is_inside]].sum()
    assert 0 < n_seen < len(rows)
    assert fit._visible(VIEW, np.array([shape])) == pytest.approx([n_seen * 4 * VIEW.along_m])


@needs_compiler
@settings(max_examples=12, deadline=None)
@given(
    st.floats(-3.2, -0.5),
    st.floats(-0.05, 0.05),
    st.floats(-0.0012, 0.0012),
    st.integers(0, 2**31),
)
def test_random_clothoids_are_found_to_within_centimetres(offset, heading, curvature, seed):
    lines = parallel(offset, heading, curvature)
    found = found_in(road(lines, camera=CAMERA, seed=seed))
    for x, tolerance in ((0, 0.15), (10, 0.05), (25, 0.08)):
        true = [p.offset_m + x * (heading + x * curvature / 2) for p in lines]
        places = at(found, x)
        for place, line in zip(true, lines, strict=True):
            if abs(line.offset_m) < 6 and abs(place) < 6:
                assert np.abs(places - place).min() < tolerance
        if x == 10:
            assert all(np.abs(np.array(true) - place).min() < 0.1 for place in places)
    assert (np.diff(found.shape[:, 0]) > 0).all()


@needs_compiler
@settings(max_examples=6, deadline=None)
@given(st.floats(-3.2, -0.5), st.floats(-0.05, 0.05), st.integers(0, 2**31))
def test_straight_lines_stay_straight_and_are_found_to_within_centimetres(offset, heading, seed):
    lines = parallel(offset, heading)
    image = road(lines, camera=CAMERA, seed=seed)
    found = found_in(image, STRAIGHT_VIEW, STRAIGHT)
    assert (found.shape[:, 2:] == 0).all()
    for line in lines:
        if abs(line.offset_m) < 5:
            k = np.argmin(np.abs(found.shape[:, 0] - line.offset_m))
            assert found.shape[k, 0] == pytest.approx(line.offset_m, abs=0.05)
            assert found.shape[k, 1] == pytest.approx(heading, abs=0.005)


def test_a_car_that_pitches_still_finds_parallel_lines():
    # 0.4 degrees: the lane is 14 % wider 30 m ahead than the calibration says.
    lines = parallel(-1.8)
    pitched = replace(CAMERA, pitch_deg=CAMERA.pitch_deg + 0.4)
    found = found_in(road(lines, camera=pitched))
    for line in lines[:3]:
        assert np.abs(found.shape[:, 0] - line.offset_m).min() < 0.06


def mirrored(camera: Camera) -> Camera:
    return replace(camera, cx=camera.width - 1 - camera.cx, yaw_deg=-camera.yaw_deg)


@pytest.mark.parametrize("seed", range(3))
def test_a_mirrored_picture_has_mirrored_lines(seed):
    camera = replace(CAMERA, yaw_deg=1.5, cx=500.0)
    lines = [Paint(-1.5, 4.0, 12.0, 0.02, 0.0006), Paint(2.1, heading=0.02, curvature=0.0006)]
    image = road(lines, camera=camera, seed=seed)
    found = found_in(image, view_for(camera, DEFAULTS))
    other = found_in(np.ascontiguousarray(image[:, ::-1]), view_for(mirrored(camera), DEFAULTS))
    assert len(found.score) == len(other.score) == 2
    np.testing.assert_allclose(at(other, 10), -at(found, 10)[::-1], atol=0.02)
    np.testing.assert_allclose(other.shape[:, 0], -found.shape[::-1, 0], atol=0.05)


@pytest.mark.parametrize("grey", [0, 40, 128, 255])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_picture_without_a_road_has_no_lines(grey, noise):
    shape = (CAMERA.height, CAMERA.width, 3)
    values = grey + noise * np.random.default_rng(0).standard_normal(shape)
    found = found_in(np.clip(values, 0, 255).astype(np.uint8))
    assert found.shape.shape == (0, 4)
    assert len(found.score) == 0


def test_marking_off_the_plane_of_the_road_is_dropped():
    image = road(parallel(-1.8), camera=CAMERA)
    on_road = np.ones(VIEW.valid.shape, dtype=bool)
    on_road[:, VIEW.y_m > 0] = False
    found = found_in(image, on_road=on_road)
    assert len(found.score) >= 1
    assert (found.shape[:, 0] < 0.2).all()


@pytest.mark.parametrize(("seed", "n_headings"), [(0, 5), (1, 41), (2, 41), (3, 2), (4, 1)])
def test_scores_of_what_lines_share_are_the_same_as_in_numpy(seed, n_headings):
    rng = np.random.default_rng(seed)
    n = 60
    pieces = (
        rng.uniform(4, 35, n),
        rng.uniform(-10, 10, n),
        rng.uniform(0.01, 0.2, n),
        rng.uniform(4, 35, n),
        rng.normal(0, 0.05, n),
        rng.uniform(0.04, 0.3, n),
    )
    headings = np.linspace(-0.1, 0.12, n_headings)
    grid = (headings, np.linspace(-0.002, 0.002, 3), np.linspace(-0.01, 0.01, 3))
    ours = _kernels.common_scores(*pieces, *grid, 9.0, 0.1)
    twin = line_finder.common_scores(*pieces, *grid, 9.0, 0.1)
    np.testing.assert_allclose(ours, twin, rtol=1e-9)
    assert ours.max() > 0
