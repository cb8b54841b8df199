"""Many lags in one pass: each is that of the fixed-lag smoother, and both ends are those of filter
and smoother."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.inference.compile import with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.lags import beliefs_by_lag
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, smooth_beliefs
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    any_compiled,
    assert_same_beliefs,
    draw_evidence,
    few,
    graph,
    random_network,
    seeds,
    template,
)


@few
@given(seed=seeds, lags=st.lists(st.integers(0, 14), max_size=5))
def test_each_lag_is_that_of_the_fixed_lag_smoother(seed: int, lags: list[int]) -> None:
    """Any network, also with inputs; in any order, and some lags twice or beyond the end."""
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 12, np.random.default_rng(seed))
    found = list(beliefs_by_lag(compiled, evidence, lags))
    assert [lag for lag, _ in found] == sorted(set(lags))
    for lag, beliefs in found:
        assert_same_beliefs(beliefs, fixed_lag_beliefs(compiled, evidence, lag), 1e-10)


def test_a_network_with_inputs_is_among_them() -> None:
    assert any(random_network(seed)[1].inputs for seed in range(13))


@few
@given(seed=seeds)
def test_lag_zero_is_the_filter_and_as_many_frames_as_there_are_the_smoother(seed: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 9, np.random.default_rng(seed))
    found = dict(beliefs_by_lag(compiled, evidence, [0, 7, 8, 1000]))
    assert_same_beliefs(found[0], filter_beliefs(compiled, evidence, "exact"), 1e-12)
    whole = smooth_beliefs(compiled, evidence)
    for lag in (8, 1000):
        assert_same_beliefs(found[lag], whole, 1e-12)
    # One frame less, and only the first frame knows less.
    rest = slice(1, None)
    assert_same_beliefs(found[7].take(rest), whole.take(rest), 1e-10)


def test_impossible_frames_and_frame_ids_are_those_of_the_smoother() -> None:
    compiled = any_compiled(2)
    evidence = draw_evidence(compiled, 6, np.random.default_rng(1), zeros=0)
    for values in evidence.likelihoods.values():
        values[3] = 0
    ids = np.array([4, 7, 8, 9, 12, 13])
    for lag, beliefs in beliefs_by_lag(compiled, evidence, [0, 2, 9], frame_id=ids):
        right = fixed_lag_beliefs(compiled, evidence, lag, frame_id=ids)
        assert beliefs.is_impossible.tolist() == [False, False, False, True, False, False]
        assert_same_beliefs(beliefs, right, 1e-12)
        np.testing.assert_array_equal(beliefs.frame_id, ids)


def test_a_long_wait_does_not_underflow_however_unlikely_each_frame_is() -> None:
    compiled = any_compiled(0)
    evidence = draw_evidence(compiled, 3000, np.random.default_rng(0), 0)
    for values in evidence.likelihoods.values():
        values *= 1e-100
    ((_, beliefs),) = beliefs_by_lag(compiled, evidence, [900])
    assert not beliefs.is_impossible.any()
    assert_same_beliefs(beliefs, fixed_lag_beliefs(compiled, evidence, 900), 1e-9)


def test_belief_and_look_ahead_may_each_be_sure_of_another_state() -> None:
    """As in the smoother: belief and look-ahead are each sure of another state by 1e-200."""
    tiny = 1e-200
    specs = graph("lane_only").PARAMETERS
    tables = graph("lane_only").tables(
        2, resolve_parameters(specs, {"sigma1": 1e-3, "sigma2": 1e-3}, 2)
    )
    compiled = with_tables(template("lane_only", 2), tables)
    detector = np.array([[1.0, tiny], [3 * tiny, 1.0], [1.0, 1.0]])
    ((_, beliefs),) = beliefs_by_lag(compiled, Evidence({"DetectorOutput": detector}), [1])
    np.testing.assert_allclose(beliefs.lane[0], [0.75, 0.25], rtol=1e-9)


def test_no_frames_give_no_beliefs_and_a_negative_lag_is_refused() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0))
    nothing = dict(beliefs_by_lag(compiled, evidence.take(slice(0, 0)), [0, 2]))
    assert [beliefs.lane.shape for beliefs in nothing.values()] == [(0, 3), (0, 3)]
    with pytest.raises(InputError, match="lag -1: must not be negative"):
        next(beliefs_by_lag(compiled, evidence, [2, -1]))
