"""The lane width as a distribution: one step against its formulas, and what it finds on roads whose
scale is known."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence.line_geometry import scale
from egolane_pgm.evidence.line_geometry.scale import GRID, N_QUANTILES, WidthBelief, follow
from egolane_pgm.types import BoolArray, FloatArray
from tests.reference import line_geometry as reference

EXPECTED = 3.5
MEDIAN = N_QUANTILES // 2

#: One step of the grid of widths.
STEP = 1.0201
#: No two lines in different places.
NOTHING = ([], [1.8], [math.nan, math.nan, math.nan], [1.8, 1.8, 1.8], [math.nan, -1.7, math.nan])


def road(
    width: float | FloatArray,
    n_frames: int = 600,
    seed: int = 0,
    *,
    n_lines: int = 4,
    missed: float = 0.2,
) -> FloatArray:
    """Lines (T, L) around a vehicle that wanders over the road, some of them missed; the lane width
    may be another one in each frame."""
    rng = np.random.default_rng(seed)
    vehicle = np.cumsum(rng.normal(0, 0.03, n_frames)) % 1
    places = np.arange(n_lines) - n_lines // 2 - vehicle[:, None]
    places = places + rng.normal(0, 0.035, places.shape)
    offset = places * np.broadcast_to(width, n_frames)[:, None]
    return np.where(rng.random(offset.shape) < missed, np.nan, offset)


def widths_of(
    offset: FloatArray, expected: float = EXPECTED, strong: BoolArray | None = None
) -> tuple[FloatArray, WidthBelief]:
    """The quantiles before each frame, (T, 7), and the belief after the last one."""
    belief = scale.new_belief(expected)
    strong = np.isfinite(offset) if strong is None else strong
    return follow(belief, offset, strong), belief


def median_error(offset: FloatArray, true: float | FloatArray) -> FloatArray:
    """By which share the median is off, (T,)."""
    widths, _ = widths_of(offset)
    return np.asarray(np.abs(widths[:, MEDIAN] / true - 1))


def assert_is_belief(belief: WidthBelief) -> None:
    for each in (belief.steady, belief.wandering):
        assert each.min() >= 0
        assert each.sum() == pytest.approx(1, abs=1e-6)
    assert 0 <= belief.counts[0] <= 1
    assert belief.counts[1] >= 0
    assert (belief.pairs >= 0).all()
    assert (belief.pairs <= belief.counts[1] + 1e-9).all()


def assert_are_quantiles(widths: FloatArray) -> None:
    assert np.isfinite(widths).all()
    assert (np.diff(widths, axis=1) >= 0).all()
    assert (widths > 0.999 * GRID[0]).all()
    assert (widths < 1.001 * GRID[-1]).all()


# --- one step ------------------------------------------------------------------------------------


def likelihood_of_gap(gap: float) -> FloatArray:
    """Of each width: 40 % of gaps are 1 to 4 lanes, within 6 % of a lane."""
    found = np.full(len(GRID), 0.6)
    for j, width in enumerate(GRID):
        for lanes in (1, 2, 3, 4):
            if max(1, round(gap / width)) == lanes:
                away = (gap / width - lanes) / 0.06
                found[j] += 0.4 * math.exp(-0.5 * away**2) / (0.06 * math.sqrt(2 * math.pi))
    return found


@pytest.mark.parametrize("steps", [(170, 0), (165, 171), (140, 200)])
def test_a_step_is_that_of_two_hidden_markov_models(steps: tuple[int, int]) -> None:
    """Two gaps, or a single one; widths and gaps are points of the grid."""
    neighbours = [float(GRID[k]) for k in steps if k]
    lines = np.cumsum([-2.0, *neighbours])
    gaps = [*neighbours, sum(neighbours)] if len(neighbours) == 2 else neighbours
    if len(gaps) == 3:
        # The gap between every other line is rounded to the grid.
        gaps[2] = float(GRID[round(math.log(gaps[2] / GRID[0]) / math.log(GRID[1] / 0.1))])
    widths, belief = widths_of(lines[None])

    prior = np.array([1 / (1 + (math.log(w / EXPECTED) / 0.1) ** 2) for w in GRID])
    prior /= prior.sum()
    n = len(prior)
    steady, wandering, around = prior.copy(), prior.copy(), np.zeros(n)
    for j in range(1, n - 1):
        steady[j] += scale.STEADY_MOVES * (prior[j - 1] - 2 * prior[j] + prior[j + 1])
    steady /= steady.sum()
    shape = np.array([math.exp(-0.5 * (0.02 * d / scale.WANDERS) ** 2) for d in range(-15, 16)])
    for j in range(n):
        for d in range(-15, 16):
            if 0 <= j + d < n:
                around[j + d] += steady[j] * shape[d + 15] / shape.sum()
    for j in range(n):
        left, right = prior[max(j - 1, 0)], prior[min(j + 1, n - 1)]
        wandering[j] += scale.WANDERING_MOVES * (left - 2 * prior[j] + right)
    wandering += scale.RETURNS * (around - wandering)
    wandering /= wandering.sum()
    share = scale.MAY_WANDER
    below = np.cumsum(share * wandering + (1 - share) * steady)
    expected = [GRID[np.flatnonzero(below >= (k + 0.5) / 7)[0]] for k in range(7)]
    np.testing.assert_allclose(widths[0], expected, rtol=1e-12)

    likelihood = np.prod([likelihood_of_gap(gap) for gap in gaps], axis=0)
    of_wandering = share * (wandering * likelihood ** (1 / 10)).sum()
    of_steady = (1 - share) * (steady * likelihood ** (1 / 10)).sum()
    assert belief.counts[0] == pytest.approx(of_wandering / (of_wandering + of_steady))
    steady *= likelihood ** (1 / 20)
    wandering *= likelihood ** (1 / 10)
    np.testing.assert_allclose(belief.steady, steady / steady.sum(), rtol=1e-9)
    np.testing.assert_allclose(belief.wandering, wandering / wandering.sum(), rtol=1e-9)
    assert belief.counts[1] == len(gaps) // 3
    if len(gaps) == 3:
        is_pair = np.abs(gaps[2] / GRID - 2) < 0.15
        np.testing.assert_array_equal(belief.pairs, is_pair)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_lines=st.integers(0, 7), far=st.floats(0.5, 200))
def test_the_kernel_equals_its_twin(seed: int, n_lines: int, far: float) -> None:
    """Lines anywhere and those of a road, after a stretch in which two lanes were hardly seen."""
    rng = np.random.default_rng(seed)
    anywhere = rng.uniform(-far, far, (30, n_lines))
    offset = np.where(rng.random((30, 1)) < 0.5, road(far / 3, 30, seed, n_lines=n_lines), anywhere)
    strong = np.isfinite(offset) & (rng.random(offset.shape) < 0.9)
    belief, twin = scale.new_belief(EXPECTED), scale.new_belief(EXPECTED)
    for each in (belief, twin):
        if seed % 2:
            each.counts[:] = 0.4, 2500
            each.pairs[:] = np.random.default_rng(seed).uniform(0, 150, len(GRID))
    widths = follow(belief, offset, strong)
    with reference.plain():
        plain = follow(twin, offset, strong)
    np.testing.assert_allclose(widths, plain, rtol=1e-12)
    for name in ("steady", "wandering", "pairs", "counts"):
        np.testing.assert_allclose(
            getattr(belief, name), getattr(twin, name), rtol=1e-8, atol=1e-60, err_msg=name
        )


# --- whatever the lines are ----------------------------------------------------------------------

ANY = st.one_of(st.floats(-20, 20), st.floats(), st.sampled_from([0.0, 5e-324, 1e308, -1.7e308]))


@settings(max_examples=100, deadline=None)
@given(
    frames=st.lists(st.lists(ANY, min_size=4, max_size=4), max_size=8),
    expected=st.floats(0.2, 2000),
)
def test_it_stays_a_belief_whatever_the_lines_are(
    frames: list[list[float]], expected: float
) -> None:
    offset = np.array(frames, dtype=float).reshape(-1, 4)
    widths, belief = widths_of(offset, expected)
    assert widths.shape == (len(frames), N_QUANTILES)
    assert_are_quantiles(widths)
    assert_is_belief(belief)


@pytest.mark.parametrize(
    "lines",
    [
        [-1e308, 0.2, 3.0, 1e308],
        [-1.7e308, 0.1, 1.7e308, math.nan],
        [5e-324, 1e-323, 0.0, 1e-322],
        [1e30, 2e30, 3e30, 5e30],
        [1e-300, 2e-300, -1e-300, 0.0],
        [1.8, 1.8, 1.8, 1.8],
    ],
)
def test_numbers_from_nowhere_do_not_stay(lines: list[float]) -> None:
    offset = road(3.0, 400)
    offset[150:160] = lines
    widths, belief = widths_of(offset)
    assert_are_quantiles(widths)
    assert_is_belief(belief)
    assert (np.abs(widths[150:, MEDIAN] / 3.0 - 1) < 0.05).all()


@pytest.mark.parametrize("lines", NOTHING)
def test_frames_without_a_gap_are_no_evidence(lines: list[float]) -> None:
    offset = np.tile(np.array(lines, dtype=float), (2000, 1))
    widths, belief = widths_of(offset)
    none, _ = widths_of(np.empty((2000, 0)))
    np.testing.assert_array_equal(widths, none)
    assert_is_belief(belief)
    np.testing.assert_allclose(widths[:, MEDIAN], EXPECTED, rtol=STEP - 1)
    # Before the first gap, the width is all but known to be the expected one.
    assert widths[-1, -1] > 1.1 * EXPECTED


def test_weak_lines_do_not_count() -> None:
    offset = road(5.0)
    weak, _ = widths_of(offset, strong=np.zeros(offset.shape, dtype=bool))
    none, _ = widths_of(np.empty((len(offset), 0)))
    np.testing.assert_array_equal(weak, none)
    anywhere = np.random.default_rng(0).uniform(-9, 9, offset.shape)
    both = np.hstack([offset, anywhere])
    strong = np.hstack([np.isfinite(offset), np.zeros(offset.shape, dtype=bool)])
    np.testing.assert_array_equal(widths_of(both, strong=strong)[0], widths_of(offset)[0])


@pytest.mark.parametrize("seed", range(3))
def test_no_later_frame_changes_the_width_before(seed: int) -> None:
    offset = road(2.7, 500, seed, n_lines=5)
    whole, _ = widths_of(offset)
    for n in (0, 1, 77, 300):
        np.testing.assert_array_equal(widths_of(offset[:n])[0], whole[:n])
        other = np.concatenate([offset[:n], 3 * offset[n:]])
        # The width before frame n is known before its lines are.
        np.testing.assert_array_equal(widths_of(other)[0][: n + 1], whole[: n + 1])


@pytest.mark.parametrize("n_lines", [2, 5])
def test_one_frame_after_the_other_is_the_same_as_all_at_once(n_lines: int) -> None:
    offset = road(2.7, 400, n_lines=n_lines)
    offset[::7, 1:] = np.nan
    whole, after = widths_of(offset)
    for cuts in (range(401), [0, 0, 3, 150, 150, 399, 400]):
        belief = scale.new_belief(EXPECTED)
        parts = []
        for a, b in pairwise(cuts):
            # As many slots as these frames need.
            part = offset[a:b][:, np.isfinite(offset[a:b]).any(axis=0)]
            parts.append(follow(belief, part, np.isfinite(part)))
        np.testing.assert_array_equal(np.concatenate(parts), whole)
        for name in ("steady", "wandering", "pairs", "counts"):
            np.testing.assert_array_equal(getattr(belief, name), getattr(after, name))


# --- roads whose scale is known ------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    log_width=st.floats(math.log(0.3), math.log(3000)),
    seed=st.integers(0, 2**32 - 1),
    n_lines=st.integers(3, 5),
)
def test_a_steady_scale_is_found_in_seconds_and_stays(
    log_width: float, seed: int, n_lines: int
) -> None:
    width = math.exp(log_width)
    offset = road(width, 1000, seed, n_lines=n_lines)
    assert (median_error(offset, width)[120:] < 0.05).all()
    widths, _ = widths_of(offset)
    assert widths[-1, -1] / widths[-1, 0] < 1.1


@pytest.mark.parametrize("width", [2.0, 3.0, 4.5])
def test_two_lines_that_are_one_lane_apart_tell_the_scale_as_well(width: float) -> None:
    offset = road(width, 3000, n_lines=2)
    assert (median_error(offset, width)[200:] < 0.05).all()


@settings(max_examples=20, deadline=None)
@given(log_unit=st.floats(math.log(0.1), math.log(1000)), seed=st.integers(0, 1000))
def test_the_width_does_not_depend_on_the_unit(log_unit: float, seed: int) -> None:
    """Once the lines are seen: the expected width is that of metres."""
    unit = math.exp(log_unit)
    offset = road(3.6, 400, seed)
    metres, other = widths_of(offset)[0], widths_of(unit * offset)[0]
    ratio = other[150:] / (unit * metres[150:])
    assert (np.abs(np.log(ratio)) < 2 * math.log(STEP)).all()
    # If the expected width is in that unit too, from the first frame on.
    alike, _ = widths_of(unit * offset, unit * EXPECTED)
    ratio = alike / (unit * metres)
    assert (np.abs(np.log(ratio[:, MEDIAN])) < 2 * math.log(STEP)).all()


@pytest.mark.parametrize("n_lines", [3, 4, 5])
@pytest.mark.parametrize("factor", [1.6, 1 / 1.6])
def test_another_scale_is_found_within_half_a_minute(factor: float, n_lines: int) -> None:
    true = np.where(np.arange(4500) < 1500, EXPECTED, factor * EXPECTED)
    error = median_error(road(true, 4500, n_lines=n_lines), true)
    assert (error[:1500] < 0.05).all()
    assert (error[1500:1530] > 0.3).all()
    assert (error[1800:] < 0.05).mean() > 0.97
    assert (error[3000:] < 0.05).all()


@pytest.mark.parametrize("factor", [1.6, 1 / 1.6])
def test_with_two_lines_another_scale_is_found_within_minutes(factor: float) -> None:
    """Lines 1.6 lanes apart may be anything; ten frames a second."""
    true = np.where(np.arange(7500) < 1500, EXPECTED, factor * EXPECTED)
    error = median_error(road(true, 7500, n_lines=2, missed=0.1), true)
    assert (error[:1500] < 0.05).all()
    assert (error[1500 + 7 * 600 :] < 0.05).all()


def test_half_a_minute_without_every_other_line_changes_nothing() -> None:
    offset = road(3.6, 2000, n_lines=5, missed=0.1)
    offset[1000:1300, 1::2] = np.nan
    assert (median_error(offset, 3.6)[100:] < 0.05).all()


@pytest.mark.parametrize(("n_lines", "share"), [(3, 0.45), (4, 0.65), (5, 0.75)])
@pytest.mark.parametrize("by", [0.15, -0.15])
@pytest.mark.parametrize("seed", range(2))
def test_a_scale_that_wanders_for_twenty_seconds_is_followed(
    by: float, n_lines: int, share: float, seed: int
) -> None:
    time = np.arange(2000)
    swing = np.sin(np.pi * np.clip((time - 1000) / 200, 0, 1))
    true = 3.6 * (1 + by * swing)
    error = median_error(road(true, 2000, seed, n_lines=n_lines), true)
    during = error[1000:1200]
    assert (during < 0.05).mean() > share
    # Better than a width that stays what it was.
    still = np.abs(3.6 / true[1000:1200] - 1)
    assert during.mean() < 0.75 * still.mean()
    assert (error[1300:] < 0.05).all()


def test_a_scale_that_always_wanders_is_known_to_do_so() -> None:
    time = np.arange(3000)
    true = 3.6 * (1 + 0.15 * np.sin(2 * np.pi * time / 200))
    _, belief = widths_of(road(true, 3000))
    assert belief.counts[0] > 0.95
    _, belief = widths_of(road(3.6, 3000))
    assert belief.counts[0] < 0.05
