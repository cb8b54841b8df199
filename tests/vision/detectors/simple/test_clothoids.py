"""Clothoids, drawn exactly: curvature and its rate in one picture and over a drive."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.simple.contours import Strips
from egolane_pgm.vision.detectors.simple.finder import MONO, follower
from egolane_pgm.vision.detectors.simple.fit import fit_lines, view_for
from egolane_pgm.vision.detectors.simple.parameters import FINDING, TRACKING
from egolane_pgm.vision.detectors.simple.tracking import Tracks, advance, lines_of, no_tracks, rules
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import Paint, road

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)
CLOTHOID = resolve_parameters(FINDING, {}, 1)
VIEW = view_for(CAMERA, CLOTHOID)

#: Metres per frame, and offsets of the lines.
STEP_M = 2.7
OFFSETS = (-5.5, -1.8, 1.86, 5.5)

#: The rates of transition curves that a car may take at some 120 and 100 km/h.
RATES = (3e-5, -6e-5)

N_FRAMES = 24


def curvature_at(rate: float, frame: int) -> float:
    """Of a car that drives on from a bend to one to the other side."""
    return rate * (frame - N_FRAMES / 2) * STEP_M


@cache
def pictures(rate: float) -> tuple[Picture, ...]:
    """A drive along a clothoid, in the middle of a lane, all lines but the outer ones dashed."""
    out = []
    for frame in range(N_FRAMES):
        more = {"curvature": curvature_at(rate, frame), "rate": rate}
        inner = [Paint(o, 4.5, 12.0, **more) for o in OFFSETS[1:-1]]
        outer = [Paint(o, **more) for o in (OFFSETS[0], OFFSETS[-1])]
        out.append(Picture(frame, road(inner + outer, frame * STEP_M, camera=CAMERA, seed=frame)))
    return tuple(out)


@needs_compiler
@pytest.mark.parametrize("rate", RATES)
def test_over_a_drive_rate_curvature_and_offsets_are_followed(rate: float) -> None:
    follow, rule = follower(CAMERA, resolve_parameters(MONO, {}, 1), curve="clothoid")
    tracks = no_tracks(rule)
    for picture in pictures(rate):
        tracks = follow(tracks, picture)
        if picture.frame_id < 12:
            continue
        lines = lines_of(tracks, rule)
        shape = lines.shape[lines.is_valid]
        assert shape[:, 3] == pytest.approx(np.full(len(shape), rate), rel=0.5)
        for offset in OFFSETS[1:-1]:
            assert np.abs(shape[:, 0] - offset).min() < 0.06
    assert np.median(shape[:, 3]) == pytest.approx(rate, rel=0.3)
    assert np.median(shape[:, 2]) == pytest.approx(curvature_at(rate, N_FRAMES - 1), abs=3e-4)


def strips_of(shape: FloatArray, reach: list[tuple[int, int]], seed: int) -> Strips:
    """Contours on lines (M, 4), in some rows each, with a centimetre of noise."""
    rng = np.random.default_rng(seed)
    rows = [np.arange(low, high) for low, high in reach]
    row, contour = np.concatenate(rows), np.repeat(np.arange(len(rows)), [len(r) for r in rows])
    x, line = VIEW.x_m[row], shape[contour]
    y = np.einsum("nj,nj->n", line, np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6], axis=1))
    middle = np.array([VIEW.x_m[r].mean() for r in rows])
    slope = shape[:, 1] + middle * (shape[:, 2] + middle * shape[:, 3] / 2)
    return Strips(
        row,
        x,
        y + rng.normal(0, 0.01, len(x)),
        np.full(len(x), 0.15),
        contour,
        middle,
        slope,
        np.full(len(rows), 0.02),
    )


def mirrored(strips: Strips) -> Strips:
    return replace(strips, y_m=-strips.y_m, slope=-strips.slope)


@needs_compiler
@settings(max_examples=25, deadline=None)
@given(
    st.floats(-3.0, -0.6),
    st.floats(-0.06, 0.06),
    st.floats(-0.002, 0.002),
    st.floats(-6e-5, 6e-5),
    st.sampled_from(["line", "parabola", "clothoid"]),
    st.integers(0, 2**31),
)
def test_mirrored_contours_give_mirrored_lines(
    offset: float, heading: float, curvature: float, rate: float, curve: str, seed: int
) -> None:
    shape = np.array([[offset + k * 3.66, heading, curvature, rate] for k in range(-1, 3)])
    strips = strips_of(shape, [(20, 290), (60, 110), (150, 260), (10, 250)], seed)
    parameters = {**CLOTHOID, "curve": curve}
    found, other = (fit_lines(VIEW, s, parameters) for s in (strips, mirrored(strips)))
    assert len(found.score) >= 3
    scale = np.array([1, 1e-2, 1e-3, 1e-5])
    np.testing.assert_allclose(other.shape / scale, -found.shape[::-1] / scale, atol=0.02)


_SEEN = st.lists(st.sampled_from([True, True, True, False]), min_size=4, max_size=4)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(_SEEN, min_size=1, max_size=25),
    st.sampled_from(["line", "parabola", "clothoid"]),
    st.integers(0, 2**31),
)
def test_mirrored_lines_are_followed_mirrored_and_covariances_stay_positive_definite(
    frames: list[list[bool]], curve: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rule = rules(resolve_parameters(TRACKING, {}, 1), curve=curve)
    ours, other = no_tracks(rule), no_tracks(rule)
    for is_seen in frames:
        shape = rng.normal(0, [0.05, 0.005, 3e-4, 2e-5], (4, 4))
        shape[:, 0] += OFFSETS
        shape = shape[is_seen]
        cover = rng.random(len(shape))
        ours = advance(ours, rule, shape, cover)
        other = advance(other, rule, -shape[::-1], cover[::-1])
        lines, twin = lines_of(ours, rule), lines_of(other, rule)
        np.testing.assert_allclose(twin.shape, -lines.shape[::-1], atol=1e-9)
        np.testing.assert_array_equal(twin.is_valid, lines.is_valid[::-1])
        np.testing.assert_array_equal(twin.lri, lines.lri[::-1])
        assert_sound(ours, rule.n_values)


def assert_sound(tracks: Tracks, n_values: int) -> None:
    """Every covariance is positive definite in the values that the lines have."""
    for covariance in tracks.covariance[:, :n_values, :n_values]:
        scale = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 0
