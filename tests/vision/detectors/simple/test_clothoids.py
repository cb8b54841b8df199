"""Clothoids, drawn exactly: curvature and its rate in one picture and over a drive."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.simple.finder import MONO, follower
from egolane_pgm.vision.detectors.simple.parameters import TRACKING
from egolane_pgm.vision.detectors.simple.tracking import Tracks, advance, lines_of, no_tracks, rules
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import Paint, road

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)

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
