"""Forward-backward and fixed-lag smoothing, for every graph."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.inference.compile import with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.kernels.sweeps import smooth_frames
from egolane_pgm.inference.smoothing import (
    LagState,
    fixed_lag_beliefs,
    lag_rest,
    lag_step,
    smooth_beliefs,
)
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.types import Beliefs, Evidence, FloatArray, InputError
from tests.conformance.networks import (
    any_compiled,
    draw_evidence,
    few,
    frames_to_enumerate,
    graph,
    graph_names,
    seeds,
    small_parameters,
    template,
)
from tests.kits.trajectories import enumerated_smoothing
from tests.reference import inference as reference

every_graph = pytest.mark.parametrize("name", graph_names())


def assert_same_marginals(
    ours: Beliefs, right: dict[str, np.ndarray], tolerance: float = 1e-9
) -> None:
    assert set(ours.marginals) == set(right)
    for name, values in right.items():
        np.testing.assert_allclose(
            ours.marginals[name], values, rtol=0, atol=tolerance, err_msg=name
        )


# --- against the right answer --------------------------------------------------------------------


@every_graph
def test_every_graph_agrees_with_adding_up_all_trajectories(name: str) -> None:
    rng = np.random.default_rng(1)
    module = graph(name)
    tables = module.tables(2, small_parameters(name, 2, rng))
    compiled = with_tables(template(name, 2), tables)
    n_frames = frames_to_enumerate(compiled)
    evidence = draw_evidence(compiled, n_frames, rng)
    answers = enumerated_smoothing(tables, module.hidden, evidence, range(n_frames))
    for lag, right in enumerate(answers):
        ours = fixed_lag_beliefs(compiled, evidence, lag)
        assert_same_marginals(ours, right)
        if lag == n_frames - 1:
            assert_same_marginals(smooth_beliefs(compiled, evidence), right)


# --- properties ----------------------------------------------------------------------------------


@few
@given(seed=seeds)
def test_lag_zero_is_the_filter_and_a_lag_beyond_the_end_the_whole_smoother(seed: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 12, np.random.default_rng(seed))
    filtered = filter_beliefs(compiled, evidence, "exact")
    whole = smooth_beliefs(compiled, evidence)
    none = fixed_lag_beliefs(compiled, evidence, 0)
    assert_same_marginals(none, dict(filtered.marginals), 1e-12)
    for lag in (11, 12, 50):
        ours = fixed_lag_beliefs(compiled, evidence, lag)
        assert_same_marginals(ours, dict(whole.marginals), 1e-12)
    for beliefs in (none, whole):
        np.testing.assert_array_equal(beliefs.log_evidence, filtered.log_evidence)
        np.testing.assert_array_equal(beliefs.is_impossible, filtered.is_impossible)


@few
@given(seed=seeds, lag=st.integers(0, 6))
def test_kernel_and_twin_give_the_same(seed: int, lag: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 40, np.random.default_rng(seed))
    right = reference.smooth_beliefs(compiled, evidence)
    assert_same_marginals(smooth_beliefs(compiled, evidence), dict(right.marginals), 1e-10)
    right = reference.fixed_lag_beliefs(compiled, evidence, lag)
    assert_same_marginals(fixed_lag_beliefs(compiled, evidence, lag), dict(right.marginals), 1e-10)


@few
@given(seed=seeds, lag=st.integers(0, 5))
def test_frame_by_frame_equals_the_whole_sequence(seed: int, lag: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 9, np.random.default_rng(seed))
    right = fixed_lag_beliefs(compiled, evidence, lag)
    state: LagState | None = None
    answers = []
    for t in range(9):
        frame = evidence.take(slice(t, t + 1))
        state, belief = lag_step(compiled, state, frame, lag)
        assert len(belief) == (t >= lag)
        assert len(state.recent.filtered) <= lag + 1
        answers.append(belief)
    assert state is not None
    answers.append(lag_rest(compiled, state))
    for name in compiled.hidden:
        joined = np.concatenate([b.marginals[name] for b in answers])
        np.testing.assert_allclose(joined, right.marginals[name], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(
        np.concatenate([b.is_impossible for b in answers]), right.is_impossible
    )
    np.testing.assert_allclose(
        np.concatenate([b.log_evidence for b in answers]), right.log_evidence, atol=1e-12
    )


@pytest.mark.parametrize(
    ("filtered", "likelihood"),
    [
        # A state that cannot be sets no scale, however well it would explain the rest.
        ([[0.25, 0.75, 0.0]] * 4, [[2e-200, 2e-200, 1.0]] * 4),
        # Later evidence that is zero for every state is ignored; nothing becomes NaN.
        ([[0.75, 0.25, 0.0], [0.0, 0.0, 1.0]], [[1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
    ],
)
def test_where_nothing_moves_the_smoother_keeps_the_filtered_belief(
    filtered: FloatArray, likelihood: FloatArray
) -> None:
    filtered, likelihood = np.array(filtered), np.array(likelihood)
    n_frames = len(filtered)
    smoothed, index = np.empty_like(filtered), np.zeros(n_frames, dtype=np.int64)
    begins, still = np.arange(n_frames) == 0, np.eye(3)[None]
    smooth_frames(filtered, likelihood, still, index, begins, smoothed, np.zeros((0, 0, 0)))
    right = reference.smooth(filtered, likelihood, still, index, n_frames)
    np.testing.assert_allclose(smoothed, right, rtol=1e-9)
    np.testing.assert_allclose(smoothed, filtered)


def test_no_frames_give_no_beliefs_and_the_frame_ids_given_are_kept() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0))
    ids = np.array([4, 7, 8])
    for infer in (smooth_beliefs, partial(fixed_lag_beliefs, lag=1), filter_beliefs):
        found = infer(compiled, evidence, frame_id=ids)
        np.testing.assert_array_equal(found.frame_id, ids)
        nothing = infer(compiled, evidence.take(slice(0, 0)))
        assert nothing.lane.shape == (0, 3)


SEQUENCES: dict[str, Callable[..., Beliefs]] = {
    "exact": partial(filter_beliefs, method="exact"),
    "assumed_density": partial(filter_beliefs, method="assumed_density"),
    "smoothed": smooth_beliefs,
    "lag 0": partial(fixed_lag_beliefs, lag=0),
    "lag 20": partial(fixed_lag_beliefs, lag=20),
}


@pytest.mark.parametrize("name", SEQUENCES)
@pytest.mark.parametrize("seed", range(8))
def test_joined_sequences_are_inferred_one_by_one(seed: int, name: str) -> None:
    """To the bit. One sequence is shorter than the lag; BLAS sums 16 rows at a time."""
    compiled, infer = any_compiled(seed), SEQUENCES[name]
    rng, lengths = np.random.default_rng(seed), [48, 16, 32, 64]
    parts = [draw_evidence(compiled, n, rng) for n in lengths]
    is_first = np.zeros(sum(lengths), dtype=bool)
    is_first[np.cumsum([0, *lengths[:-1]])] = True
    joined = infer(compiled, Evidence.concat(parts), is_first=is_first)
    apart = Beliefs.concat([infer(compiled, part) for part in parts])
    for node, values in apart.marginals.items():
        np.testing.assert_array_equal(joined[node], values)
    np.testing.assert_array_equal(joined.log_evidence, apart.log_evidence)
    path = viterbi(compiled, Evidence.concat(parts), is_first=is_first)
    paths = [viterbi(compiled, part) for part in parts]
    pd.testing.assert_frame_equal(
        path.states.reset_index(drop=True),
        pd.concat([each.states for each in paths], ignore_index=True),
    )
    assert path.log_probability == sum(each.log_probability for each in paths)


def test_what_cannot_be_smoothed_is_refused_in_a_line() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0))
    with pytest.raises(InputError, match="lag -1: must not be negative"):
        fixed_lag_beliefs(compiled, evidence, -1)
