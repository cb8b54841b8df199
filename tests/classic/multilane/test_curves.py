"""Fits of curves in the picture beside plain NumPy, and the motion that they share."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.classic.multilane import curves
from egolane_pgm.types import FloatArray, IntArray

T = np.linspace(-1, 1, 101)
SCALE = np.array([60.0, 45.0])
pixels = st.floats(-200, 200)


def marked(
    rng: np.random.Generator, curve: FloatArray, n: int = 80
) -> tuple[FloatArray, FloatArray]:
    """Points near a curve, a quarter of them anywhere."""
    t = rng.uniform(-1, 1, n)
    u = curves.value(curve, t) + rng.normal(0, 1.5, n)
    u[: n // 4] = rng.uniform(-300, 300, n // 4)
    return t, u


def best_by_numpy(
    t: FloatArray, u: FloatArray, chosen: IntArray, error: float, degree: int
) -> tuple[FloatArray, int]:
    best, most = np.zeros(3), 0
    for trial in chosen:
        some = trial[: degree + 1]
        if len(set(t[some])) <= degree:
            continue
        curve = np.zeros(3)
        curve[: degree + 1] = np.linalg.solve(t[some, None] ** np.arange(degree + 1), u[some])
        n = int((np.abs(u - curves.value(curve, t)) <= error).sum())
        if n > most:
            best, most = curve, n
    return best, most


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("seed", range(10))
def test_the_best_of_random_curves_equals_plain_numpy(seed: int, degree: int) -> None:
    rng = np.random.default_rng(seed)
    t, u = marked(rng, np.array([20.0, -150, 40]))
    t[5] = t[6]
    chosen = rng.integers(len(t), size=(15, 3))
    chosen[0] = 5, 6, 7
    curve, most = curves.best_curve(t, u, chosen, 6.0, degree)
    expected, n = best_by_numpy(t, u, chosen, 6.0, degree)
    assert most == n > 0
    np.testing.assert_allclose(curve, expected, atol=1e-6)


@pytest.mark.parametrize(("bend", "degree"), [(0.0, 1), (60.0, 2)])
def test_a_consensus_leaves_strays_out_and_bends_only_where_that_holds_more(
    bend: float, degree: int
) -> None:
    rng = np.random.default_rng(0)
    true = np.array([20.0, -150, bend])
    t, u = marked(rng, true)
    held, found = curves.consensus(t, u, rng.random((60, 3)), 6.0)
    assert found == degree
    assert held[20:].mean() > 0.9
    np.testing.assert_allclose(curves.fit(t[held], u[held], found), true, atol=3)


@settings(max_examples=50, deadline=None)
@given(pixels, pixels, pixels, st.integers(1, 2))
def test_a_fit_equals_polyfit_and_is_mirrored_with_its_points(
    a: float, b: float, c: float, degree: int
) -> None:
    rng = np.random.default_rng(0)
    t, u = marked(rng, np.array([a, b, c]))
    curve = curves.fit(t, u, degree)
    np.testing.assert_allclose(curve[: degree + 1], np.polyfit(t, u, degree)[::-1], atol=1e-6)
    np.testing.assert_allclose(curves.fit(t, -u, degree), -curve, atol=1e-6)


def test_a_prior_holds_a_curve_where_there_are_no_points() -> None:
    before = np.array([10.0, -100, 0])
    t = np.full(3, 0.9)
    curve = curves.fit(t, curves.value(before, t) + 4, 2, before)
    assert np.abs(curves.value(curve - before, T)).max() < 6
    many = np.linspace(-1, 1, 500)
    np.testing.assert_allclose(
        curves.fit(many, curves.value(before, many) + 4, 2, before)[0], before[0] + 4, atol=0.1
    )


@settings(max_examples=50, deadline=None)
@given(pixels, pixels, pixels, pixels)
def test_lines_on_a_plane_move_together(q: float, r: float, one: float, other: float) -> None:
    """A car that turns and moves sideways adds the same straight curve to all of them; one line
    of three that goes its own way is outvoted."""
    before = np.array([[0.0, one, 3], [100, other, -5], [-200, 40, 0]])
    motion = np.array([q, r, 0])
    now = before + motion
    now[2] += 50
    np.testing.assert_allclose(curves.common_motion(before, now), motion, atol=1e-6)
    np.testing.assert_allclose(curves.common_motion(before[:0], now[:0]), 0)


def test_a_parallel_curve_goes_through_points_of_the_next_line() -> None:
    line = np.array([30.0, -120, 15])
    t = np.linspace(-0.3, 0.6, 12)
    beside = line + 3.5 * np.array([*SCALE, 0])
    found = curves.parallel(t, curves.value(beside, t), line, SCALE)
    np.testing.assert_allclose(found, beside)


def test_points_near_a_prediction_are_found_though_it_is_wrong() -> None:
    rng = np.random.default_rng(1)
    true = np.array([20.0, -150, 10])
    t, u = marked(rng, true)
    held = curves.nearby(t, u, true + np.array([12.0, -9, 0]), rng.normal(0, 20, (200, 2)), 6.0)
    assert held[20:].mean() > 0.9
    assert (np.abs(u[held] - curves.value(true, t[held])) < 12).all()
