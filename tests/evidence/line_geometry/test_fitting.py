"""Each step of expectation-maximisation, against its formula written out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.evidence import line_geometry
from egolane_pgm.evidence.line_geometry import fitting
from egolane_pgm.evidence.line_geometry.fitting import (
    LARGEST_SIGMA_M,
    SMALLEST_SIGMA_M,
    Statistics,
    expect,
    maximise,
)
from egolane_pgm.evidence.line_geometry.model import LANE_M, REACH_M, LineModel, line_model, places
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import FloatArray
from tests.conftest import needs_compiler
from tests.reference.line_geometry import log_prior

W = LANE_M
N = 2
N_LINES = N + 3


def resolved(**given: object) -> Parameters:
    return resolve_parameters(line_geometry.PARAMETERS, {"lane_width_m": W, **given}, N)


def guess() -> LineModel:
    """A first guess, and a model that is not it."""
    return replace(line_model(N, resolved()), sigmas_m=np.full(N_LINES, 0.2))


def on_the_way() -> LineModel:
    first = guess()
    sigma = np.array([0.1, 0.15, 0.2, 0.25, 0.12])
    return LineModel(
        first.rates * 0.9,
        0.5 * (first.class_shares + 0.25),
        sigma,
        np.array([0.8, 1.1]),
        first.clutter * 1.5,
    )


#: Lines of each kind by their distance from their place: those of the right shoulder lie outwards.
MEAN_M = np.array([0.02, -0.01, 0.05, -0.07, 0.11])
SPREAD_M = np.array([0.1, 0.12, 0.15, 0.1, 0.08])


def counted(
    mean_m: FloatArray = MEAN_M, spread_m: FloatArray = SPREAD_M, n: int = 500
) -> tuple[Statistics, FloatArray, FloatArray]:
    """Statistics, and the lines that they are of: distances and weights (n, N_LINES)."""
    rng = np.random.default_rng(0)
    away = mean_m + spread_m * rng.normal(size=(n, N_LINES))
    weight = rng.uniform(0.1, 1, (n, N_LINES))
    moments = [(weight * away**k).sum(axis=0) for k in range(3)]
    share = rng.dirichlet(np.ones(N), N_LINES).T
    classes = rng.dirichlet(np.ones(4), N_LINES) * moments[0][:, None]
    frames = np.array([400.0, 300.0])
    clutter = np.array([3.0, 20.0, 8.0, 9.0])
    return Statistics(0.0, frames, share * moments[0], classes, *moments, clutter), away, weight


# --- the M step ----------------------------------------------------------------------------------


#: A prior that hardly counts.
WEAK = 1e-9


@pytest.fixture(autouse=True)
def strength(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> float:
    """The frames that the first guess is worth."""
    value: float = getattr(request, "param", WEAK)
    monkeypatch.setattr(fitting, "STRENGTH", value)
    return value


@pytest.mark.parametrize("strength", [WEAK, 40.0], indirect=True)
def test_sigmas_are_the_spread_about_the_place_that_a_line_is_moved_to(strength: float) -> None:
    model, first = on_the_way(), guess()
    found, away, weight = counted()
    fitted = maximise(found, model, first)
    moved = (places(fitted, W) - places(model, W))[0]
    square = (weight * (away - moved) ** 2).sum(axis=0) + strength * first.sigmas_m**2
    np.testing.assert_allclose(fitted.sigmas_m**2, square / (weight.sum(axis=0) + strength))
    # Only the shoulders move: without a prior, to the mean of what is seen of them.
    np.testing.assert_allclose(moved[:-2], 0, atol=1e-12)
    if strength == WEAK:
        np.testing.assert_allclose(moved[-2:], np.average(away, axis=0, weights=weight)[-2:])
    else:
        assert (np.abs(moved[-2:]) > 0.01).all()


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("outwards", [True, False])
def test_a_shoulder_stays_near_the_road_and_its_sigma_is_about_where_it_stays(
    side: int, outwards: bool
) -> None:
    mean = np.zeros(N_LINES)
    mean[N + 1 + side] = 4.0 * (1 if outwards == (side == 1) else -1)
    found, *_ = counted(mean)
    fitted = maximise(found, on_the_way(), guess())
    assert fitted.shoulders[side] == pytest.approx(1.6 if outwards else 0.4)
    assert fitted.shoulders[1 - side] == pytest.approx(on_the_way().shoulders[1 - side], abs=0.01)
    # What is metres off says: no line at all.
    assert fitted.sigmas_m[N + 1 + side] == LARGEST_SIGMA_M


def test_sigmas_stay_between_a_hand_and_a_lane_marking_apart() -> None:
    spread = np.array([1e-4, 0.12, 2.0, 1e-4, 2.0])
    found, *_ = counted(np.zeros(N_LINES), spread)
    sigma = maximise(found, on_the_way(), guess()).sigmas_m
    assert sigma[[0, 3]].tolist() == [SMALLEST_SIGMA_M] * 2
    assert sigma[[2, 4]].tolist() == [LARGEST_SIGMA_M] * 2
    assert sigma[1] == pytest.approx(0.12, rel=0.1)


def expected_posterior(
    model: LineModel, before: LineModel, found: Statistics, first: LineModel
) -> float:
    """What the M step makes as large as it can, with log_prior."""
    shift = (places(model, W) - places(before, W))[0]
    squares = found.moment2 - 2 * shift * found.moment1 + shift**2 * found.moment0
    expected = model.rates.sum(axis=1) + 2 * REACH_M * model.clutter.sum()
    value = (found.lines * np.log(model.rates)).sum() - found.frames @ expected
    value += (found.classes * np.log(model.class_shares)).sum()
    value += (found.clutter * np.log(model.clutter)).sum()
    value -= (found.moment0 * np.log(model.sigmas_m) + 0.5 * squares / model.sigmas_m**2).sum()
    return float(value) + log_prior(model, first)


def changed(model: LineModel) -> Iterator[tuple[str, LineModel]]:
    """The model with one of its numbers a little larger or smaller."""
    for field in ("rates", "sigmas_m", "clutter"):
        for index in np.ndindex(getattr(model, field).shape):
            for factor in (0.98, 1.02):
                value = getattr(model, field).copy()
                value[index] *= factor
                yield f"{field}{index}", replace(model, **{field: value})
    for k in range(N_LINES):
        for c in range(4):
            shares = model.class_shares.copy()
            shares[k, c] *= 1.02
            shares[k] /= shares[k].sum()
            yield f"class_shares[{k}]", replace(model, class_shares=shares)


@pytest.mark.parametrize("strength", [WEAK, 3.0, 200.0], indirect=True)
def test_no_other_model_is_more_probable_than_the_fitted_one(strength: float) -> None:
    found, *_ = counted()
    model, first = on_the_way(), guess()
    fitted = maximise(found, model, first)
    best = expected_posterior(fitted, model, found, first)
    assert best > expected_posterior(model, model, found, first)
    for name, other in changed(fitted):
        assert expected_posterior(other, model, found, first) < best, name


def test_the_first_guess_is_the_most_probable_before_any_frame() -> None:
    first = guess()
    best = log_prior(first, first)
    for name, other in changed(first):
        assert log_prior(other, first) < best, name
    for shoulders in ([0.85, 0.9], [0.9, 0.95]):
        assert log_prior(replace(first, shoulders=np.array(shoulders)), first) < best


# --- the E step ----------------------------------------------------------------------------------


@needs_compiler
def test_the_likelihood_of_frames_is_that_of_a_poisson_process() -> None:
    model = on_the_way()
    offset = np.array([[-1.7, 1.9], [-5.3, 0.0], [0.0, 0.0]])
    kind = np.array([[1, 0], [2, -1], [-1, -1]])
    lane = np.array([0, 1, 1])
    cells = 8
    expected = model.rates.sum(axis=1) + 2 * REACH_M * model.clutter.sum()
    log_p = 0.0
    for t in range(3):
        inside = np.ones(cells)
        for u in range(cells):
            for o, c in zip(offset[t], kind[t], strict=True):
                if c < 0:
                    continue
                z = o + ((u + 0.5) / cells - 0.5) * W - places(model, W)[lane[t]]
                normal = np.exp(-0.5 * (z / model.sigmas_m) ** 2) / model.sigmas_m
                rate = model.rates[lane[t]] * model.class_shares[:, c]
                inside[u] *= rate @ normal / np.sqrt(2 * np.pi) + model.clutter[c]
        log_p += np.log(inside.mean()) - expected[lane[t]]
    found = expect(offset, kind, lane, model, cells)
    assert found.log_likelihood == pytest.approx(log_p)
    assert found.frames.tolist() == [1, 2]
