"""The kernels of Aly's detector against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from egolane_pgm.classic.bezier import kernels
from tests.reference import bezier

SEEDS = range(5)


@pytest.fixture(params=SEEDS)
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    return np.random.default_rng(request.param)


def points(rng: np.random.Generator, n: int = 60) -> np.ndarray:
    """A noisy line and clutter, (N, 2), sorted by row."""
    row = np.sort(rng.uniform(0, 99, n))
    line = 30 + 0.05 * row + rng.normal(0, 0.3, n)
    column = np.where(rng.random(n) < 0.6, line, rng.uniform(0, 79, n))
    return np.stack([column, row], axis=1)


def test_the_best_line(rng: np.random.Generator) -> None:
    sample = rng.integers(60, size=(40, 4))
    given = points(rng), rng.random(60), sample, 0.5, 6, 0.3
    line, score = kernels.ransac_line(*given)
    expected, best = bezier.ransac_line(*given)
    assert best > 0
    assert score == pytest.approx(best)
    np.testing.assert_allclose(line, expected, atol=1e-9)


def test_the_best_spline(rng: np.random.Generator) -> None:
    sample = np.sort(np.array([rng.choice(60, 5, replace=False) for _ in range(30)]), axis=1)
    ridge = rng.random((100, 80))
    given = points(rng), sample, 0.5, ridge, 2, 0.01, 1.2, 1.5
    control, score = kernels.ransac_spline(*given[:4])
    expected, best = bezier.ransac_spline(*given)
    assert np.isfinite(best)
    assert score == pytest.approx(best)
    np.testing.assert_allclose(control, expected, rtol=1e-6, atol=1e-6)
    assert kernels.ransac_spline(*given[:2], 1.1, ridge)[1] == -np.inf


def test_a_spline_goes_through_four_points(rng: np.random.Generator) -> None:
    four = points(rng)[::15]
    control = kernels.bezier_through(four)
    np.testing.assert_allclose(control, bezier.bezier_through(four), atol=1e-9)
    size = np.r_[0, np.cumsum(np.linalg.norm(np.diff(four, axis=0), axis=1))]
    for point, t in zip(four, size / size[-1], strict=True):
        np.testing.assert_allclose(kernels.bezier(control, t), point, atol=1e-9)
