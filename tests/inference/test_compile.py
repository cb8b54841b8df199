"""What compile accepts, against the oracle on networks drawn at random."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import (
    Table,
    declare,
    dynamics,
    previous,
    prior,
    quiet,
    uniform,
    within,
)
from egolane_pgm.inference.compile import Compiled, compile_network, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    KEEP,
    METHODS,
    SEES,
    RandomGraph,
    assert_filters_agree,
    assert_same_beliefs,
    brute_force,
    draw_evidence,
    draw_graph,
    shuffle_axes,
    simple_tables,
)
from tests.reference.oracle import oracle_assumed_density, oracle_filter

OF_TWO = np.array([[[0.7, 0.3], [0.4, 0.6]], [[0.1, 0.9], [0.5, 0.5]]])


def compiled_simple() -> Compiled:
    return compile_network(declare(simple_tables(), ["D"]), ["A"], ["D"])


def compiled_random(graph: RandomGraph) -> tuple[Any, Compiled]:
    network = declare(graph.tables, graph.observed)
    return network, compile_network(network, graph.hidden, graph.observed, graph.inputs)


# --- any two-slice network, against the oracle ---------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_random_networks_agree_with_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = draw_graph(rng)
    network, compiled = compiled_random(graph)
    evidence = draw_evidence(compiled, 3, rng)
    arguments = (network, graph.hidden, graph.observed, evidence, graph.inputs)
    right = {
        "exact": oracle_filter(*arguments),
        "assumed_density": oracle_assumed_density(*arguments),
    }
    assert_filters_agree(compiled, evidence, right)


@pytest.mark.parametrize("seed", range(100, 112))
def test_random_networks_agree_with_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = draw_graph(rng)
    _, compiled = compiled_random(graph)
    evidence = draw_evidence(compiled, 2, rng)
    right = {m: brute_force(graph.tables, graph.hidden, evidence, m) for m in METHODS}
    assert_filters_agree(compiled, evidence, right)


def test_the_random_networks_contain_every_kind_of_node_and_edge() -> None:
    graphs = [draw_graph(np.random.default_rng(seed)) for seed in range(40)]
    tables = [[t for t in g.tables if t.node[1] == 1] for g in graphs]
    by_name = [{t.node[0]: {p for p, _ in t.parents} for t in some} for some in tables]
    assert any(g.inputs for g in graphs)
    assert any("F1" in g.hidden for g in graphs)
    assert any("F0" in parents["P1"] for parents in by_name)
    assert any("D" in parents["E"] for parents in by_name)
    assert any(("E", "D") in g.observed for g in graphs)
    assert any("D" in g.observed for g in graphs)
    assert any(("D", "E") in g.observed and "E" in g.observed for g in graphs)
    assert any(key in g.hidden for g in graphs for key in g.observed)
    assert any(isinstance(k, tuple) and set(k) & set(g.hidden) for g in graphs for k in g.observed)
    across = {
        (parent[0], t.node[0]) for some in tables for t in some for parent in t.parents
        if parent[1] == 0
    }  # fmt: skip
    assert {("P0", "P0"), ("P0", "P1"), ("P1", "P0")} <= across


@pytest.mark.parametrize("seed", range(6))
def test_tables_that_name_their_axes_in_another_order_compile_to_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = draw_graph(rng)
    _, compiled = compiled_random(graph)
    shuffled = shuffle_axes(graph.tables, rng)
    _, other = compiled_random(RandomGraph(shuffled, graph.hidden, graph.observed, graph.inputs))
    evidence = draw_evidence(compiled, 5, rng)
    for method in METHODS:
        right = filter_beliefs(compiled, evidence, method)
        assert_same_beliefs(filter_beliefs(other, evidence, method), right, 1e-13)
        renewed = with_tables(compiled, shuffled)
        assert_same_beliefs(filter_beliefs(renewed, evidence, method), right, 1e-13)


def test_a_network_written_in_plain_pgmpy_compiles_whatever_the_order_of_its_edges() -> None:
    """A, B persist; D depends on both, declared as D | B, A over edges A->D, B->D."""
    with quiet():
        from pgmpy.factors.discrete import TabularCPD
        from pgmpy.models import DynamicBayesianNetwork

        network = DynamicBayesianNetwork(
            [(("A", 0), ("D", 0)), (("B", 0), ("D", 0)), (("D", 0), ("D_ve", 0))]
            + [((n, 0), (n, 1)) for n in "AB"]
        )
        sees = np.random.default_rng(0).dirichlet(np.ones(2), (2, 2))  # [b, a, d]
        columns = sees.reshape(-1, 2).T
        for s in (0, 1):
            network.add_cpds(
                TabularCPD(("D", s), 2, columns, [("B", s), ("A", s)], [2, 2]),
                TabularCPD(("D_ve", s), 2, np.full((2, 2), 0.5), [("D", s)], [2]),
            )
        for n in "AB":
            network.add_cpds(
                TabularCPD((n, 0), 2, [[0.5], [0.5]]), TabularCPD((n, 1), 2, KEEP.T, [(n, 0)], [2])
            )
    compiled = compile_network(network, ("A", "B"), ("D",))
    emission = compiled.groups[0].emission.reshape(2, 2, 2)
    np.testing.assert_allclose(emission, sees.transpose(1, 0, 2))  # [a, b, d]


def test_a_transition_reads_the_state_before_in_its_rows() -> None:
    compiled = compiled_simple()
    np.testing.assert_allclose(compiled.transition[0], KEEP)
    np.testing.assert_allclose(compiled.prior[0], [0.5, 0.5])
    np.testing.assert_allclose(compiled.groups[0].emission, SEES)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 3, 2, 1), (2, 0, 3, 1), (3, 2, 1, 0)])
def test_leaves_that_hang_together_in_a_chain_are_one_group_in_the_order_declared(
    order: tuple[int, ...],
) -> None:
    """D <- E <- F, and G sees D: whichever is declared first, one emission table holds them all."""
    rng = np.random.default_rng(0)
    both = rng.dirichlet(np.ones(2), (2, 2))
    tables = [
        *simple_tables(),
        *within("E", ["D"], SEES),
        *within("F", ["A", "E"], both),
        *within("G", ["D"], SEES[::-1]),
    ]
    observed = tuple("DEFG"[k] for k in order)
    compiled = compile_network(declare(tables, observed), ["A"], observed)
    assert compiled.observed == observed
    assert len(compiled.groups) == 1
    evidence = draw_evidence(compiled, 2, rng)
    right = {m: brute_force(tables, ["A"], evidence, m) for m in METHODS}
    assert_filters_agree(compiled, evidence, right)


def test_an_input_selects_the_transition_and_the_prior() -> None:
    tables = [
        *within("Speed", [], [0.5, 0.5]),
        *prior("A", KEEP, ["Speed"]),
        *dynamics("A", ["Speed", previous("A")], OF_TWO),
        *within("D", ["A"], np.eye(2)),
    ]
    compiled = compile_network(declare(tables, ["D"]), ["A"], ["D"], ["Speed"])
    evidence = Evidence({"D": np.ones((2, 2))}, {"Speed": np.array([1, 0])})
    belief = filter_beliefs(compiled, evidence, "exact").marginals["A"]
    np.testing.assert_allclose(belief[0], KEEP[1])
    np.testing.assert_allclose(belief[1], KEEP[1] @ OF_TWO[0])


# --- new tables in a compiled network ------------------------------------------------------------


def test_new_tables_of_another_shape_or_other_parents_are_refused() -> None:
    compiled = compiled_simple()
    wider = [t for t in simple_tables() if t.node[0] != "D"] + within("D", ["A"], uniform(2, 3))
    with pytest.raises(InputError, match="D: the table has other parents or another shape"):
        with_tables(compiled, wider)
    rootless = [t for t in simple_tables() if t.node != ("A", 1)] + [
        Table(("A", 1), (), uniform(2))
    ]
    with pytest.raises(InputError, match="A: the table has other parents or another shape"):
        with_tables(compiled, rootless)


def test_new_tables_must_be_complete_and_of_this_network() -> None:
    compiled = compiled_simple()
    with pytest.raises(InputError, match="A: no table for slice 1"):
        with_tables(compiled, [t for t in simple_tables() if t.node != ("A", 1)])
    with pytest.raises(InputError, match="E: the compiled network has no such node"):
        with_tables(compiled, [*simple_tables(), *within("E", ["A"], SEES)])


def test_new_tables_that_the_compiled_structure_could_not_honour_are_refused() -> None:
    differing = [t for t in simple_tables() if t.node != ("D", 0)]
    differing.append(Table(("D", 0), (("A", 0),), SEES[::-1].copy()))
    with pytest.raises(InputError, match="D: its table differs between the slices"):
        with_tables(compiled_simple(), differing)
    differing[-1] = Table(("D", 0), (), uniform(2))
    with pytest.raises(InputError, match="D: its table differs between the slices"):
        with_tables(compiled_simple(), differing)
    tables = [*simple_tables(), *within("F", ["A"], np.eye(2))]
    compiled = compile_network(declare(tables, ["D"]), ["A", "F"], ["D"])
    assert with_tables(compiled, tables).n_states == 2
    with pytest.raises(InputError, match="F: another function needs the network compiled anew"):
        with_tables(compiled, [*simple_tables(), *within("F", ["A"], np.eye(2)[::-1])])


def test_new_tables_leave_the_compiled_network_as_it_was() -> None:
    compiled = compiled_simple()
    before = compiled.transition.copy()
    changed = [t for t in simple_tables() if t.node != ("A", 1)]
    changed += dynamics("A", [previous("A")], KEEP[::-1])
    assert not np.allclose(with_tables(compiled, changed).transition, before)
    np.testing.assert_array_equal(compiled.transition, before)
