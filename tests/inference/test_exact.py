"""Beliefs, flags and log evidence against decimal numbers of 60 digits, where tables and evidence
span many decades: over all frames together not more than floating-point numbers hold."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from egolane_pgm.graphs.cpds import Table, declare, dynamics, previous, prior, within
from egolane_pgm.inference import filtering
from egolane_pgm.inference.compile import Compiled, compile, with_tables
from egolane_pgm.inference.expected_counts import FREE, expected_counts
from egolane_pgm.inference.filtering import METHODS, filter_beliefs, step
from egolane_pgm.inference.kernels import banded
from egolane_pgm.inference.layout import layout
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, lag_rest, lag_step, smooth_beliefs
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.learning.em import fit_tables
from egolane_pgm.types import Beliefs, Evidence, FloatArray
from tests.conformance.networks import random_network
from tests.reference import exact
from tests.reference import inference as reference

N_FRAMES = 5
#: Beliefs above this have nine digits; what is below is below.
SMALL = 1e-290

every_method = pytest.mark.parametrize("method", METHODS)
some = settings(max_examples=25, deadline=None, derandomize=True)
#: Four networks drawn at random, one with sizes that are constants, one with a band.
networks = st.integers(0, 5)
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def _nothing_is_warned_of() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def wide(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Numbers of any size up to one, zeros and equals among them."""
    decades = rng.choice([0.0, 1.0, 3.0, 8.0], shape) * rng.random(shape)
    values = 10.0**-decades
    values[rng.random(shape) < 0.15] = 0.0
    values[rng.random(shape) < 0.1] = 1e-8
    values[rng.random(shape) < 0.1] = 1.0
    return values


def wide_rows(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Conditional rows of such numbers."""
    rows = wide(rng, *shape)
    rows[..., rng.integers(shape[-1])] = 1.0
    return np.asarray(rows / rows.sum(axis=-1, keepdims=True))


def drawn(kind: int, rng: np.random.Generator) -> Compiled:
    """A network with such tables."""
    if kind < 4:
        graph, compiled = random_network(kind)
        tables, known = [], {}
        for table in graph.tables:
            name, shape = table.node[0], table.values.shape
            same = (name, table.values.tobytes())
            if same not in known:
                is_certain = np.isin(table.values, (0.0, 1.0)).all()
                known[same] = table.values if is_certain else wide_rows(rng, *shape)
            tables.append(Table(table.node, table.parents, known[same]))
        return with_tables(compiled, tables)
    if kind == 4:
        sizes, seen = {"N0": 4, "N1": 2}, {"D0": 4, "D1": 2}
        tables = []
        for name, size in sizes.items():
            tables += prior(name, wide_rows(rng, size))
            tables += dynamics(name, [previous("N0"), previous("N1")], wide_rows(rng, 4, 2, size))
        for name, size in seen.items():
            tables += within(name, ["N0", "N1"], wide_rows(rng, 4, 2, size))
    else:
        sizes, seen = {"N0": 2, "N1": 6}, {"D0": 2, "D1": 6}
        near = np.abs(np.subtract.outer(np.arange(6), np.arange(6))) <= 1
        floor = rng.choice([0.0, 1e-8, 1e-3])
        band = np.where(near, wide(rng, 6, 6) + np.eye(6), 0.0)
        band = band / band.sum(axis=1, keepdims=True) * (1 - 6 * floor) + floor
        tables = [
            *prior("N0", wide_rows(rng, 2)),
            *dynamics("N0", [previous("N0")], wide_rows(rng, 2, 2)),
            *prior("N1", wide_rows(rng, 6)),
            *dynamics("N1", [previous("N1")], band),
            *within("D0", ["N0"], wide_rows(rng, 2, 2)),
            *within("D1", ["N1"], np.eye(6) if rng.random() < 0.5 else wide_rows(rng, 6, 6)),
        ]
    observed = list(seen)
    return compile(declare(tables, observed), hidden=list(sizes), observed=observed)


def drawn_evidence(compiled: Compiled, rng: np.random.Generator) -> Evidence:
    """Such numbers, of any scale."""
    likelihoods = {}
    for key in compiled.observed:
        names = (key,) if isinstance(key, str) else key
        values = wide(rng, N_FRAMES, *(compiled.cardinality[n] for n in names))
        scale = 10.0 ** rng.choice([0, 0, 0, -40, 40], N_FRAMES)
        likelihoods[key] = values * scale.reshape(-1, *[1] * len(names))
    inputs = {n: rng.integers(compiled.cardinality[n], size=N_FRAMES) for n in compiled.inputs}
    return Evidence(likelihoods, inputs)


def case(kind: int, seed: int) -> tuple[Compiled, Evidence]:
    """A network and evidence of it."""
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(banded, "MIN_STATES", 2 if kind == 5 else 10**9)
        compiled = drawn(kind, rng)
        assert layout(compiled).band is None or kind == 5
    return compiled, drawn_evidence(compiled, rng)


def right_of(make: Callable[[], Beliefs]) -> Beliefs:
    """What such arithmetic gives; a case in which rounding decides is not looked at."""
    try:
        return make()
    except exact.Borderline:
        assume(False)
        raise AssertionError from None


def assert_right(ours: Beliefs, right: Beliefs) -> None:
    np.testing.assert_array_equal(ours.is_impossible, right.is_impossible)
    np.testing.assert_allclose(ours.log_evidence, right.log_evidence, rtol=1e-11, atol=1e-9)
    for name, values in right.marginals.items():
        np.testing.assert_allclose(ours.marginals[name].sum(axis=1), 1, rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(
            ours.marginals[name], values, rtol=1e-9, atol=SMALL * 1e-9, err_msg=name
        )


@every_method
@some
@given(kind=networks, seed=seeds)
def test_filters_are_right(method: str, kind: int, seed: int) -> None:
    compiled, evidence = case(kind, seed)
    right = right_of(lambda: exact.beliefs(compiled, exact.forward(compiled, evidence, method)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(filtering, "MIN_FIXED_FRAMES", 1 if kind == 4 else 10**9)
        assert_right(filter_beliefs(compiled, evidence, method), right)
    assert_right(reference.filter_beliefs(compiled, evidence, method), right)
    state, parts = None, []
    for t in range(N_FRAMES):
        state, part = step(compiled, state, evidence.take(slice(t, t + 1)), method)
        parts.append(part)
    assert_right(Beliefs.joined(parts), right)


@some
@given(kind=networks, seed=seeds, lag=st.integers(0, N_FRAMES))
def test_smoothers_and_the_most_probable_path_are_right(kind: int, seed: int, lag: int) -> None:
    compiled, evidence = case(kind, seed)
    passed: list[exact.Exact] = []

    def make(lag: int) -> Beliefs:
        passed[:] = [exact.forward(compiled, evidence)]
        return exact.beliefs(compiled, passed[0], exact.smoothed(compiled, passed[0], lag))

    right = right_of(partial(make, lag))
    assert_right(fixed_lag_beliefs(compiled, evidence, lag), right)
    assert_right(reference.fixed_lag_beliefs(compiled, evidence, lag), right)
    state, parts = None, []
    for t in range(N_FRAMES):
        state, part = lag_step(compiled, state, evidence.take(slice(t, t + 1)), lag)
        parts.append(part)
    assert state is not None
    assert_right(Beliefs.joined([*parts, lag_rest(compiled, state)]), right)
    whole = right_of(partial(make, N_FRAMES))
    assert_right(smooth_beliefs(compiled, evidence), whole)
    path = viterbi(compiled, evidence)
    np.testing.assert_array_equal(path.is_impossible, right.is_impossible)
    best = exact.best_probability(compiled, passed[0])
    np.testing.assert_allclose(path.log_probability, best, rtol=1e-11, atol=1e-9)


@some
@given(kind=st.integers(0, 4), seed=seeds)
def test_expected_counts_are_right(kind: int, seed: int) -> None:
    """A small count has its digits too: a row of a table is learned from what it is of the row."""
    compiled, evidence = case(kind, seed)
    rng = np.random.default_rng(seed)
    node = str(rng.choice(compiled.hidden))
    value = rng.integers(compiled.cardinality[node], size=N_FRAMES)
    known = {node: np.where(rng.random(N_FRAMES) < 0.7, FREE, value)}
    is_first = rng.random(N_FRAMES) < 0.15
    try:
        right, passed = exact.expected_counts(compiled, evidence, known, is_first)
    except exact.Borderline:
        assume(False)
    for counted in (expected_counts, reference.expected_counts):
        found = counted(compiled, evidence, known, is_first)
        np.testing.assert_array_equal(found.is_impossible, passed.is_impossible)
        log_evidence = passed.log_evidence.sum()
        np.testing.assert_allclose(found.log_evidence, log_evidence, rtol=1e-11, atol=1e-9)
        for of, counts in right.items():
            np.testing.assert_allclose(
                found.counts[of].reshape(-1), np.array(counts, float), rtol=1e-9, atol=SMALL
            )


@settings(some, max_examples=60)
@given(kind=networks, seed=seeds, strength=st.sampled_from([0.0, 1e-9, 1.0, 1e9]))
def test_learning_is_never_down_and_never_no_number(kind: int, seed: int, strength: float) -> None:
    compiled, evidence = case(kind, seed)
    fitted = fit_tables(compiled, evidence, strength=strength, iterations=8)
    before = expected_counts(compiled, evidence).is_impossible
    history = fitted.log_posterior
    assert np.isfinite(history).all()
    # What a frame is worth that was impossible before is nothing to compare.
    if (fitted.is_impossible == before).all():
        least = -1e-9 * np.abs(history[:-1]) - 1e-9 - 1e-14 * strength
        assert (np.diff(history) >= least).all()
    for table in fitted.tables.values():
        np.testing.assert_allclose(table.values.sum(axis=-1), 1, rtol=1e-9)
