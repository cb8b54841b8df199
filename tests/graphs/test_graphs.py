"""Every graph of the package goes through the same tests; they are found by listing the folder."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.contracts import Graph
from egolane_pgm.graphs import position_in_lane
from egolane_pgm.graphs.cpds import declare
from egolane_pgm.inference.compile import Compiled, compile, compile_tables, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence
from tests.conformance.networks import (
    METHODS,
    assert_filters_agree,
    brute_force,
    compiled_graph,
    draw_evidence,
    draw_parameters,
    graph,
    graph_names,
    tables_of,
)

GRAPHS = graph_names()
every_graph = pytest.mark.parametrize("name", GRAPHS)


def defaults(name: str, n_lanes: int, **given: object) -> Parameters:
    return resolve_parameters(graph(name).parameters, given, n_lanes)


def test_the_papers_graph_and_its_variants_are_found() -> None:
    assert {"sensor_failure", "wor_on_lane", "lane_only", "no_wor"} <= set(GRAPHS)


@every_graph
@pytest.mark.parametrize("n_lanes", [2, 4])
def test_a_graph_compiles_to_the_same_from_its_tables_as_from_its_network(
    name: str, n_lanes: int
) -> None:
    module, parameters = graph(name), defaults(name, n_lanes)
    roles = {
        "hidden": module.hidden,
        "observed": module.observed,
        "inputs": module.inputs,
        "values": (module.values or {}),
    }
    network = declare(tables_of(module, n_lanes, parameters), module.observed)
    of_network = compile(network, **roles)
    of_tables = compile_tables(tables_of(module, n_lanes, parameters), **roles)
    for part in ("state_nodes", "inputs", "cardinality", "values", "observed"):
        assert getattr(of_tables, part) == getattr(of_network, part), part
    np.testing.assert_array_equal(of_tables.prior, of_network.prior)
    np.testing.assert_array_equal(of_tables.transition, of_network.transition)
    for ours, theirs in zip(of_tables.groups, of_network.groups, strict=True):
        np.testing.assert_array_equal(ours.emission, theirs.emission)


@every_graph
def test_parameters_have_a_default_that_passes_their_own_check_and_a_meaning(name: str) -> None:
    specs = graph(name).parameters
    assert len({spec.name for spec in specs}) == len(specs)
    for spec in specs:
        assert spec.check(spec.default, 3, spec.name) == spec.default
        assert len(spec.doc) > 10
        if spec.is_searched:
            low, high = spec.search_range
            assert low <= spec.default <= high  # type: ignore[operator]


@every_graph
@pytest.mark.parametrize("method", METHODS)
def test_both_filters_agree_with_brute_force_on_tiny_cases(name: str, method: str) -> None:
    module = graph(name)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        n_lanes = 2 if seed else 3
        parameters = draw_parameters(module.parameters, n_lanes, rng)
        compiled = compiled_graph(graph(name), n_lanes, parameters)
        evidence = draw_evidence(compiled, 2, rng)
        right = brute_force(tables_of(module, n_lanes, parameters), module.hidden, evidence, method)
        assert_filters_agree(compiled, evidence, {method: right})


@every_graph
def test_new_parameters_in_a_compiled_graph_equal_a_graph_built_with_them(name: str) -> None:
    module = graph(name)
    for n_lanes in (1, 3, 4):
        rng = np.random.default_rng(n_lanes)
        compiled = compiled_graph(graph(name), n_lanes, defaults(name, n_lanes))
        parameters = draw_parameters(module.parameters, n_lanes, rng)
        quick = with_tables(compiled, tables_of(module, n_lanes, parameters))
        assert_same_arrays(quick, compiled_graph(graph(name), n_lanes, parameters))


def assert_same_arrays(ours: Compiled, right: Compiled) -> None:
    np.testing.assert_allclose(ours.prior, right.prior, rtol=1e-14, atol=0)
    np.testing.assert_allclose(ours.transition, right.transition, rtol=1e-14, atol=0)
    assert [g.observed for g in ours.groups] == [g.observed for g in right.groups]
    for group, other in zip(ours.groups, right.groups, strict=True):
        np.testing.assert_allclose(group.emission, other.emission, rtol=1e-14, atol=0)


@every_graph
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_lanes=st.integers(1, 5))
def test_the_mirrored_road_gives_the_mirrored_belief(name: str, seed: int, n_lanes: int) -> None:
    module = graph(name)
    rng = np.random.default_rng(seed)
    parameters = draw_parameters(module.parameters, n_lanes, rng)
    if "map_wrong" in parameters:
        # With fewer lanes than values of Lane the mirrored belief is no reversed array.
        parameters["map_wrong"] = 0.0
    mirrored_parameters = {
        k: tuple(reversed(v)) if isinstance(v, tuple) else v for k, v in parameters.items()
    }
    compiled = compiled_template(name, n_lanes)
    here = with_tables(compiled, tables_of(module, n_lanes, parameters))
    there = with_tables(compiled, tables_of(module, n_lanes, mirrored_parameters))
    evidence = draw_evidence(compiled, 6, rng)
    mirrored = Evidence(
        {k: mirror(k, v) for k, v in evidence.likelihoods.items()},
        {k: mirrored_input(k, v, parameters) for k, v in evidence.inputs.items()},
    )
    for method in METHODS:
        belief = filter_beliefs(here, evidence, method)
        other = filter_beliefs(there, mirrored, method)
        np.testing.assert_allclose(other.lane, belief.lane[:, ::-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(other.log_evidence, belief.log_evidence, rtol=0, atol=1e-9)
        for node in set(module.hidden) - {"Lane"}:
            seen = other.marginals[node][:, mirrored_values(module, node, belief.marginals[node])]
            np.testing.assert_allclose(seen, belief.marginals[node], rtol=0, atol=1e-9)


def mirrored_values(module: Graph, node: str, marginal: np.ndarray) -> list[int]:
    """The values of a node as seen in a mirror: LEFT is RIGHT."""
    if node == "RoadPosition":
        return list(range(marginal.shape[1]))[::-1]
    names = (module.values or {}).get(node, range(marginal.shape[1]))
    other_side = {"LEFT": "RIGHT", "RIGHT": "LEFT"}
    return [names.index(other_side.get(name, name)) for name in names]


@functools.cache
def compiled_template(name: str, n_lanes: int) -> Compiled:
    """Compiled once for each number of lanes; the tests put their own tables in."""
    return compiled_graph(graph(name), n_lanes, defaults(name, n_lanes))


def mirror(key: object, values: np.ndarray) -> np.ndarray:
    names = (key,) if isinstance(key, str) else key
    lateral = ("Lane", "DetectorOutput", "RoadPosition")
    axes = [1 + k for k, n in enumerate(names) if n in lateral]  # type: ignore
    return np.flip(values, axes)


def mirrored_input(name: str, index: np.ndarray, parameters: Parameters) -> np.ndarray:
    """LineMotion as seen in a mirror."""
    bins, n = int(parameters["motion_bins"]), len(position_in_lane.COASTING)  # type: ignore[arg-type]
    many, seen = np.divmod(index, bins)
    passed, coasted = np.divmod(index - 2 * bins - 1, n)
    unseen = 2 * bins + 1 + passed * n + n - 1 - coasted
    displaced = many * bins + bins - 1 - seen
    return np.select([index < 2 * bins, index == 2 * bins], [displaced, index], unseen)


def test_the_papers_tables_are_the_papers_rows() -> None:
    parameters = defaults("sensor_failure", 3, p1=0.9, p2=0.8, p3=0.7, p4=0.6, sigma1=0.5)
    tables = {t.node: t for t in tables_of(graph("sensor_failure"), 3, parameters)}
    # Rows are the value before, columns the value now, OK first.
    np.testing.assert_allclose(tables["SensorState", 1].values, [[0.9, 0.1], [0.2, 0.8]])
    np.testing.assert_allclose(tables["WOR", 1].values, [[0.7, 0.3], [0.4, 0.6]])
    row = np.exp(-0.5 * (np.array([-1.0, 0.0, 1.0]) / 0.5) ** 2)
    np.testing.assert_allclose(tables["Lane", 1].values[1], row / row.sum(), rtol=1e-14)
    detector = tables["DetectorOutput", 1]
    assert detector.parents == (("SensorState", 1), ("Lane", 1))
    np.testing.assert_allclose(detector.values[1], np.full((3, 3), 1 / 3))
    np.testing.assert_allclose(tables["Lane", 0].values, np.full(3, 1 / 3))
