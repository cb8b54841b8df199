"""The E step: expected counts of every table, against adding up every trajectory."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings

from egolane_pgm.graphs.cpds import SliceNode, Table, declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import Compiled, compile, counted_tables
from egolane_pgm.inference.expected_counts import FREE, Expected, expected_counts
from egolane_pgm.types import Evidence, InputError, IntArray
from tests.conformance.networks import (
    compiled_graph,
    draw_evidence,
    draw_graph,
    draw_parameters,
    graph,
    graph_names,
    seeds,
    simple_tables,
)
from tests.kits.trajectories import trajectories
from tests.reference import inference as reference


def enumerated(
    tables: Sequence[Table],
    counted: Mapping[SliceNode, Table],
    evidence: Evidence,
    known: Mapping[str, IntArray],
    sizes: Mapping[str, int],
    emissions: Collection[str],
) -> tuple[dict[SliceNode, np.ndarray], list[bool], float]:
    """Expected counts of one sequence, the flags, and P(evidence, known) by its logarithm."""
    likelihoods = dict(evidence.likelihoods)
    for node, value in known.items():
        sure = (value[:, None] == np.arange(sizes[node])) | (value == FREE)[:, None]
        likelihoods[node] = likelihoods.get(node, 1.0) * sure.astype(float)
    seen = Evidence(likelihoods, evidence.inputs)
    paths, flags = trajectories(tables, seen)
    total = math.fsum(weight for _, weight in paths)
    counts = {node: np.zeros(table.values.shape) for node, table in counted.items()}
    # A table that holds in the first frame and later; a plain emission is left out where flagged.
    always = {node for node, s in counted if (node, 0) not in counted}
    for path, weight in paths:
        for t, now in enumerate(path):
            for (name, s), table in counted.items():
                if name in always:
                    if flags[t] and name in emissions:
                        continue
                    index = [now[p] for p, _ in table.parents]
                elif s != min(t, 1):
                    continue
                else:
                    index = [now[p] if ps == s else path[t - 1][p] for p, ps in table.parents]
                counts[name, s][(*index, now[name])] += weight / total
    return counts, flags, math.log(total)


def draw_known(
    compiled: Compiled, n_frames: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    node = str(rng.choice(compiled.hidden))
    value = rng.integers(compiled.cardinality[node], size=n_frames)
    return {node: np.where(rng.random(n_frames) < 0.5, FREE, value)}


def assert_right(
    compiled: Compiled,
    tables: Sequence[Table],
    evidence: Evidence,
    known: Mapping[str, IntArray],
    starts: Sequence[int],
) -> None:
    counted = counted_tables(compiled)
    edges = [*starts, len(evidence)]
    right = {node: np.zeros(table.values.shape) for node, table in counted.items()}
    flags: list[bool] = []
    log_evidence = 0.0
    for a, b in pairwise(edges):
        part = slice(a, b)
        counts, here, log_part = enumerated(
            tables,
            counted,
            evidence.take(part),
            {node: value[part] for node, value in known.items()},
            compiled.cardinality,
            {name for (name, _), place in compiled.places.items() if isinstance(place.target, int)},
        )
        for node in right:
            right[node] += counts[node]
        flags += here
        log_evidence += log_part
    is_first = np.isin(np.arange(len(evidence)), starts)
    found = expected_counts(compiled, evidence, known, is_first)
    assert found.is_impossible.tolist() == flags
    assert set(found.counts) == set(right)
    for node, count in right.items():
        np.testing.assert_allclose(found.counts[node], count, atol=1e-9, err_msg=str(node))
    assert found.log_evidence == pytest.approx(log_evidence, abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_random_networks_agree_with_adding_up_every_trajectory(seed: int) -> None:
    """Inputs, functions, joint evidence, leaves that depend on each other, two sequences."""
    rng = np.random.default_rng(seed)
    drawn = draw_graph(rng)
    compiled = drawn.compiled()
    # The number of trajectories is to the power of this.
    n_frames = 3 if compiled.n_states <= 8 else 2
    evidence = draw_evidence(compiled, n_frames, rng, zeros=0.2)
    starts = [0, 1] if seed % 2 else [0]
    assert_right(compiled, drawn.tables, evidence, draw_known(compiled, n_frames, rng), starts)


@pytest.mark.parametrize("name", [n for n in graph_names() if not n.startswith("position_in")])
def test_every_discrete_graph_agrees_with_adding_up_every_trajectory(name: str) -> None:
    module = graph(name)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        parameters = draw_parameters(module.parameters, 2, rng)
        compiled = compiled_graph(module, 2, parameters)
        evidence = draw_evidence(compiled, 2, rng)
        lane = np.array([FREE, int(rng.integers(2))])
        assert_right(compiled, module.tables(2, parameters), evidence, {"Lane": lane}, [0])


def drawn_case(seed: int, n_frames: int) -> tuple[Compiled, list[Table], Evidence, IntArray]:
    rng = np.random.default_rng(seed)
    module = graph("sensor_failure")
    parameters = draw_parameters(module.parameters, 3, rng)
    compiled = compiled_graph(module, 3, parameters)
    lane = np.where(rng.random(n_frames) < 0.7, FREE, rng.integers(3, size=n_frames))
    evidence = draw_evidence(compiled, n_frames, rng)
    return compiled, module.tables(3, parameters), evidence, lane


@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_the_counts_equal_those_in_plain_numpy(seed: int) -> None:
    compiled, _, evidence, lane = drawn_case(seed, 60)
    is_first = np.random.default_rng(seed).random(60) < 0.1
    one = expected_counts(compiled, evidence, {"Lane": lane}, is_first)
    other = reference.expected_counts(compiled, evidence, {"Lane": lane}, is_first)
    np.testing.assert_array_equal(one.is_impossible, other.is_impossible)
    assert one.log_evidence == pytest.approx(other.log_evidence, rel=1e-9, abs=1e-7)
    for node in one.counts:
        np.testing.assert_allclose(one.counts[node], other.counts[node], atol=1e-7)


def totals(found: Expected) -> dict[SliceNode, float]:
    return {node: float(count.sum()) for node, count in found.counts.items()}


def test_a_table_that_holds_in_every_frame_is_counted_over_all_of_them() -> None:
    """F is drawn anew in each frame, D keeps its own value: one table, and two."""
    rng = np.random.default_rng(0)
    tables = [
        *simple_tables()[:2],
        *within("F", ["A"], rng.dirichlet(np.ones(3), 2)),
        *prior("D", rng.dirichlet(np.ones(2), 3), ["F"]),
        *dynamics("D", ["F", previous("D")], rng.dirichlet(np.ones(2), (3, 2))),
    ]
    compiled = compile(declare(tables, ["D"]), hidden=["A", "F"], observed=["D"])
    evidence = draw_evidence(compiled, 4, rng, zeros=0)
    found = expected_counts(compiled, evidence, is_first=np.array([True, False, False, True]))
    expected = {("A", 0): 2, ("A", 1): 2, ("F", 1): 4, ("D", 0): 2, ("D", 1): 2}
    assert totals(found) == pytest.approx(expected)
    assert_right(compiled, tables, evidence, {}, [0, 3])


def test_a_known_value_that_cannot_be_is_left_out_and_flagged() -> None:
    tables = [*simple_tables()]
    tables[1] = Table(("A", 1), (("A", 0),), np.eye(2))
    compiled = compile(declare(tables, ["D"]), hidden=["A"], observed=["D"])
    evidence = Evidence({"D": np.ones((4, 2))})
    known = np.array([0, 1, FREE, 0])
    found = expected_counts(compiled, evidence, {"A": known})
    assert found.is_impossible.tolist() == [False, True, False, False]
    np.testing.assert_allclose(found.counts["A", 1], [[3, 0], [0, 0]])


def test_functions_and_tables_that_an_input_selects_are_not_counted() -> None:
    module = graph("position_in_lane")
    small = {**{p.name: p.default for p in module.parameters}, "cells": 2, "motion_bins": 3}
    compiled = compiled_graph(module, 2, small)
    assert counted_tables(compiled) == {}


def test_known_values_of_a_node_that_is_not_hidden_are_refused() -> None:
    compiled, _, evidence, lane = drawn_case(1, 5)
    message = r"known values of Lain, which is no hidden node \(did you mean 'Lane'\?\)"
    with pytest.raises(InputError, match=message):
        expected_counts(compiled, evidence, {"Lain": lane})
