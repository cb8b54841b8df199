"""Fits to known values: they reach the minimum, of tables and of numbers."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, dynamics, previous, prior, sticky, uniform, within
from egolane_pgm.inference.compile import Compiled, compile_tables, counted_tables
from egolane_pgm.inference.expected_counts import FREE
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.gradient import log_loss_gradient
from egolane_pgm.inference.sampling import sample
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.studies.gradient_fit import fit_numbers, fit_tables_to_known
from egolane_pgm.studies.structures import repetition
from egolane_pgm.types import Evidence, IntArray
from tests.conftest import needs_compiler

pytestmark = needs_compiler

N = 3
NAMES = ("sigma1", "sigma2", "p1", "p2", "p3", "p4")
BOUNDS = [(1e-3, 3.0), (1e-3, 3.0), *[(0.0, 1.0)] * 4]
IS_SCALE = [True, True, False, False, False, False]
TRUE = np.array([0.45, 0.6, 0.95, 0.85, 0.9, 0.8])
START = [0.6, 0.9, 0.8, 0.8, 0.7, 0.7]


def tables_of(numbers: Any) -> list[Table]:
    given = dict(zip(NAMES, map(float, numbers), strict=True))
    return sensor_failure.tables(N, resolve_parameters(sensor_failure.PARAMETERS, given, N))


def network_of(numbers: Any) -> Compiled:
    roles: Any = {"observed": sensor_failure.OBSERVED, "hidden": sensor_failure.HIDDEN}
    return compile_tables(tables_of(numbers), **roles)


def drawn(n_frames: int = 3000, share: float = 1.0) -> tuple[Evidence, dict[str, IntArray], Any]:
    """A drive of the paper's graph in two sequences, a share of its lanes known."""
    network = network_of(TRUE)
    values = sample(network, n_frames, seed=1)
    hard = Evidence.hard(values[["DetectorOutput", "WOR"]], network)
    evidence = Evidence({key: each + 0.05 for key, each in hard.likelihoods.items()})
    lane = values["Lane"].cat.codes.to_numpy(np.int64)
    is_known = np.random.default_rng(0).random(n_frames) < share
    is_first = np.isin(np.arange(n_frames), [0, n_frames // 2])
    return evidence, {"Lane": np.where(is_known, lane, FREE)}, is_first


def test_six_numbers_end_where_a_direct_search_of_the_same_sum_ends() -> None:
    data = drawn(1500, share=0.2)
    start, block = np.array(START), 10.0

    def coordinates(v: Any) -> Any:
        return np.append(np.log(v[:2]), np.log(v[2:] / (1 - v[2:])))

    def cost(v: Any) -> float:
        loss = log_loss_gradient(network_of(v), *data).loss
        return loss / block + float(((coordinates(v) - coordinates(start)) ** 2).sum()) / 2

    fit = fit_numbers(
        network_of(START), data, tables_of, START, BOUNDS, IS_SCALE, block=block, centre=START
    )
    assert fit.log_posterior[-1] == pytest.approx(-cost(fit.numbers), rel=1e-6)
    ends = [(1e-3, 3.0)] * 2 + [(1e-3, 0.999)] * 4
    tight: Any = {"maxfev": 1500, "xatol": 1e-4, "fatol": 1e-4}
    direct = minimize(cost, fit.numbers, method="Nelder-Mead", bounds=ends, options=tight)
    assert -fit.log_posterior[-1] < direct.fun + 1e-2
    assert fit.log_posterior[-1] > fit.log_posterior[0] + 1


def test_a_first_frame_may_list_its_parents_in_another_order() -> None:
    """Two tables of one node, whose axes differ in the frames that come first and later."""
    rng = np.random.default_rng(0)
    rows = rng.dirichlet(np.ones(2), (3, 2))
    hidden = [*prior("Lane", uniform(3)), *dynamics("Lane", [previous("Lane")], sticky(*[0.9] * 3))]
    hidden += [*prior("B", uniform(2)), *dynamics("B", [previous("B")], sticky(0.9, 0.9))]

    def tables(numbers: Any, order: tuple[int, int]) -> list[Table]:
        later = numbers[0] * rows + (1 - numbers[0]) / 2
        parents = tuple(np.array(["Lane", "B"])[[*order]].tolist())
        first = (0.3 * later + 0.35).transpose(*order, 2)
        shown = Table(("S", 0), tuple((name, 0) for name in parents), first)
        return [*hidden, shown, Table(("S", 1), (("Lane", 1), ("B", 1)), later)]

    evidence = Evidence({"S": rng.random((100, 2))})
    data = evidence, {"Lane": rng.integers(3, size=100)}, np.arange(100) % 10 == 0
    found = []
    for order in ((0, 1), (1, 0)):
        network = compile_tables(tables([0.5], order), observed=("S",), hidden=("Lane", "B"))
        of = functools.partial(tables, order=order)
        found.append(fit_numbers(network, data, of, [0.5], [(0, 1)], [False], centre=[0.5]).numbers)
    np.testing.assert_allclose(*found)
    assert abs(found[0] - 0.5) > 1e-3


def test_tables_of_a_tiny_prior_lose_less_than_the_truth_and_one_of_a_large_prior_stay() -> None:
    data = drawn()
    start = network_of(START)
    losses = []
    for strength in (1e-3, 1e9):
        fit = fit_tables_to_known(start, data, strength=strength, block=1)
        losses.append(log_loss_gradient(fit.compiled, *data).loss)
        for node, table in counted_tables(start).items():
            values = fit.tables[node].values
            np.testing.assert_allclose(values.sum(axis=-1), 1)
            np.testing.assert_array_equal(values > 0, table.values > 0)
            if strength > 1:
                np.testing.assert_allclose(values, table.values, atol=1e-6)
    right = log_loss_gradient(network_of(TRUE), *data).loss
    assert losses[0] < right < losses[1]


def test_named_nodes_alone_are_fitted() -> None:
    start = network_of(START)
    fit = fit_tables_to_known(start, drawn(), nodes=["WOR"], strength=10, block=1)
    for node, table in counted_tables(start).items():
        is_same = np.array_equal(fit.tables[node].values, table.values)
        assert is_same is (node[0] != "WOR")


def test_a_detector_that_repeats_itself_is_found_from_no_repetition() -> None:
    lane = [*prior("Lane", uniform(2)), *dynamics("Lane", [previous("Lane")], sticky(0.95, 0.95))]
    shown = np.array([[0.7, 0.3], [0.3, 0.7]])
    first = within("D", ["Lane"], shown)[:1]
    node = ("D", 1)
    parents = (("Lane", 1), ("D", 0))

    def network(rho: float) -> Compiled:
        tables = [*lane, *first, Table(node, parents, repetition(shown, rho))]
        return compile_tables(tables, observed=("D",), hidden=("Lane",))

    values = sample(network(0.8), 4000, seed=0)
    known = {"Lane": values["Lane"].cat.codes.to_numpy(np.int64)}
    data = Evidence.hard(values[["D"]], network(0.8)), known, None
    start = network(1e-3)
    fit = fit_tables_to_known(start, data, strength=1, block=1, bases={node: shown})
    found = fit.tables[node].values
    # The same value again, less what the lane alone shows.
    rho = found[:, 0, 0] - found[:, 1, 0]
    np.testing.assert_allclose(rho, rho[0])
    assert rho[0] == pytest.approx(0.8, abs=0.1)
    losses = [log_loss_gradient(each, *data).loss for each in (network(0.8), fit.compiled)]
    assert losses[1] < losses[0]


def log_evidence(evidence: Evidence, numbers: Any) -> float:
    return float(filter_beliefs(network_of(numbers), evidence).log_evidence.sum())


def test_numbers_without_labels_end_where_a_direct_search_of_the_evidence_ends() -> None:
    evidence, _, _ = drawn(4000)
    network = network_of(TRUE)
    fit = fit_numbers(network, (evidence, {}, None), tables_of, START, BOUNDS, IS_SCALE)
    assert fit.log_posterior[-1] == pytest.approx(log_evidence(evidence, fit.numbers))
    direct = minimize(
        lambda x: -log_evidence(evidence, x),
        START,
        method="Nelder-Mead",
        bounds=BOUNDS,
        options={"maxfev": 1500, "xatol": 1e-4, "fatol": 1e-3},
    )
    assert fit.log_posterior[-1] > -direct.fun - 0.5
    np.testing.assert_allclose(fit.numbers, TRUE, atol=0.12)


def test_a_start_out_of_bounds_is_moved_into_them() -> None:
    short, _, _ = drawn(300)
    network = network_of(START)
    found = [
        fit_numbers(
            network, (short, {}, None), tables_of, [*START[:5], p4], BOUNDS, IS_SCALE, iterations=3
        ).numbers
        for p4 in (1.0, 1.5)
    ]
    np.testing.assert_array_equal(*found)
