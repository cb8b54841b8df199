"""EM of a network's tables: never down, the right answer, nothing possible lost."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.graphs.cpds import dynamics, previous, prior, uniform, within
from egolane_pgm.inference.compile import Compiled, compile_tables, counted_tables
from egolane_pgm.inference.expected_counts import FREE
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameters
from egolane_pgm.studies.em import drawn_tables, fit_tables
from egolane_pgm.types import Evidence, InputError, IntArray
from tests.conformance.networks import compiled_graph, draw_evidence, draw_graph, graph
from tests.conftest import needs_compiler


def a_case(seed: int, n_frames: int = 40) -> tuple[Compiled, Evidence, Any, Any]:
    """A random network with evidence, some of it known, in some sequences."""
    rng = np.random.default_rng(seed)
    drawn = draw_graph(rng)
    compiled = drawn.compiled()
    evidence = draw_evidence(compiled, n_frames, rng, zeros=0.1)
    node = str(rng.choice(drawn.hidden))
    value = rng.integers(compiled.cardinality[node], size=n_frames)
    known = {node: np.where(rng.random(n_frames) < 0.7, FREE, value)}
    return compiled, evidence, known, rng.random(n_frames) < 0.1


@given(seed=st.integers(0, 2**32 - 1), strength=st.sampled_from([0.0, 0.5, 20.0, 1000.0]))
@settings(max_examples=40, deadline=None)
def test_no_iteration_lowers_the_log_posterior(seed: int, strength: float) -> None:
    compiled, evidence, known, is_first = a_case(seed)
    fitted = fit_tables(compiled, evidence, known, is_first, strength=strength, iterations=12)
    history = fitted.log_posterior
    assert (np.diff(history) >= -1e-9 * np.abs(history[:-1]) - 1e-9).all()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_what_was_possible_stays_so_and_nothing_else_becomes_so(seed: int) -> None:
    compiled, evidence, known, is_first = a_case(seed)
    start = counted_tables(compiled)
    fitted = fit_tables(compiled, evidence, known, is_first, strength=1e-3, iterations=30)
    for node, table in start.items():
        np.testing.assert_array_equal(fitted.tables[node].values > 0, table.values > 0)
    after = fitted.compiled
    for node, table in compiled.tables.items():
        if (node[0], 1) not in start and node not in start:
            assert after.tables[node] is table


def paper_case(n_lanes: int = 3, **changes: float) -> Compiled:
    module = graph("sensor_failure")
    defaults: dict[str, Any] = {p.name: p.default for p in module.parameters}
    parameters: Parameters = {**defaults, **changes}
    return compiled_graph(module, n_lanes, parameters)


def a_drive_of(compiled: Compiled, n_frames: int, seed: int) -> tuple[Evidence, IntArray]:
    """Evidence that is certain about what was observed, and the lanes, drawn from the network."""
    rng = np.random.default_rng(seed)
    move, sensor, output, wor = (
        compiled.tables[name, 1].values for name in ("Lane", "SensorState", "DetectorOutput", "WOR")
    )
    lane, state = 0, 0
    lanes, outputs, wors = [], [], []
    for _ in range(n_frames):
        lane = int(rng.choice(len(move), p=move[lane]))
        state = int(rng.choice(2, p=sensor[state]))
        lanes.append(lane)
        outputs.append(rng.choice(len(move), p=output[state, lane]))
        wors.append(rng.choice(2, p=wor[state]))
    eye = {"DetectorOutput": np.eye(len(move))[outputs], "WOR": np.eye(2)[wors]}
    return Evidence(eye), np.array(lanes)


@needs_compiler
@pytest.mark.parametrize("labelled", [True, False])
def test_em_finds_the_tables_that_the_drive_was_drawn_from(labelled: bool) -> None:
    compiled = paper_case(sigma1=0.45, sigma2=0.3, p1=0.97, p2=0.9, p3=0.9, p4=0.8)
    evidence, lane = a_drive_of(compiled, 20_000, seed=1)
    start = paper_case(sigma1=0.6, sigma2=0.5, p1=0.9, p2=0.8, p3=0.7, p4=0.7)
    known = {"Lane": lane} if labelled else None
    fitted = fit_tables(start, evidence, known, strength=1.0, iterations=400)
    right = counted_tables(compiled)
    for node in (("Lane", 1), ("SensorState", 1), ("WOR", 1)):
        np.testing.assert_allclose(fitted.tables[node].values, right[node].values, atol=0.05)
    output = fitted.tables["DetectorOutput", 1].values
    np.testing.assert_allclose(output[0], right["DetectorOutput", 1].values[0], atol=0.05)


def test_the_prior_is_worth_as_many_frames_as_it_says() -> None:
    """Every label known: the counts are whole numbers, and a row is their mean with the prior."""
    compiled = paper_case()
    lane = np.array([0, 0, 1, 1, 1, 0, 0, 0])
    evidence = Evidence({"DetectorOutput": np.ones((8, 3)), "WOR": np.ones((8, 2))})
    fitted = fit_tables(compiled, evidence, {"Lane": lane}, strength=10, iterations=1)
    start = counted_tables(compiled)["Lane", 1].values
    counts = np.array([[3, 1, 0], [1, 2, 0], [0, 0, 0]])
    right = (counts + 10 * start) / (counts + 10 * start).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(fitted.tables["Lane", 1].values, right, atol=1e-12)
    strong = fit_tables(compiled, evidence, {"Lane": lane}, strength=1e9)
    np.testing.assert_allclose(strong.tables["Lane", 1].values, start, atol=1e-7)


def test_each_table_has_its_own_strength_and_the_prior_does_not_depend_on_the_start() -> None:
    compiled = paper_case(sigma1=0.45, p1=0.97, p3=0.9, p4=0.8)
    evidence, _ = a_drive_of(compiled, 2000, seed=1)
    declared = counted_tables(compiled)
    start = drawn_tables(declared, np.random.default_rng(0))
    strength = {"Lane": 1e9, "WOR": 1e-6, "SensorState": 1e9, "DetectorOutput": 1e9}
    fitted = fit_tables(compiled, evidence, strength=strength, start=start)
    for node, table in declared.items():
        moved = np.abs(fitted.tables[node].values - table.values).max()
        assert (moved > 1e-3) == (node[0] == "WOR")
        np.testing.assert_array_equal(start[node].values > 0, table.values > 0)
        np.testing.assert_allclose(start[node].values.sum(axis=-1), 1)
    prior = sum(
        strength[node[0]] * (table.values * np.log(fitted.tables[node].values / table.values)).sum()
        for node, table in declared.items()
    )
    log_evidence = filter_beliefs(fitted.compiled, evidence).log_evidence.sum()
    assert fitted.log_posterior[-1] == pytest.approx(log_evidence + prior)


def test_values_with_the_same_tables_are_warned_of(recwarn: pytest.WarningsRecorder) -> None:
    same = within("O", ["S"], uniform(2, 3))
    tables = [*prior("S", uniform(2)), *dynamics("S", [previous("S")], uniform(2, 2)), *same]
    compiled = compile_tables(tables, hidden=["S"], observed=["O"])
    evidence = draw_evidence(compiled, 50, np.random.default_rng(0), zeros=0)
    with pytest.warns(UserWarning, match="S: 0 and 1 have the same tables, so EM cannot tell"):
        fit_tables(compiled, evidence, iterations=2)
    recwarn.clear()
    fit_tables(compiled, evidence, {"S": np.zeros(50, dtype=int)}, iterations=2)
    other = dict(counted_tables(compiled))
    other["O", 1] = replace(other["O", 1], values=np.array([[0.5, 0.3, 0.2], [0.2, 0.3, 0.5]]))
    fit_tables(compiled, evidence, start=other, iterations=2)
    assert not recwarn.list


@pytest.mark.parametrize("strength", [-1, np.inf, {"S": -2}])
def test_a_strength_below_zero_is_refused(strength: Any) -> None:
    compiled, evidence = paper_case(), Evidence({})
    with pytest.raises(InputError, match=r"strength: .* is not a number of frames, 0 or more"):
        fit_tables(compiled, evidence, strength=strength)
