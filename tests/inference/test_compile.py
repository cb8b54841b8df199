"""What compile accepts, against brute force on networks drawn at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import (
    Table,
    declare,
    dynamics,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.inference.compile import Compiled, compile, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.types import InputError, Observed
from tests.conformance.networks import (
    KEEP,
    METHODS,
    SEES,
    assert_filters_agree,
    assert_same_beliefs,
    brute_force,
    draw_evidence,
    draw_graph,
    frames_to_enumerate,
    shuffle_axes,
    simple_tables,
)

OF_TWO = np.array([[[0.7, 0.3], [0.4, 0.6]], [[0.1, 0.9], [0.5, 0.5]]])


def compiled_simple() -> Compiled:
    return compile(declare(simple_tables(), ["D"]), hidden=["A"], observed=["D"])


@pytest.mark.parametrize("seed", range(60))
def test_random_networks_agree_with_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = draw_graph(rng)
    compiled = graph.compiled()
    evidence = draw_evidence(compiled, frames_to_enumerate(compiled), rng)
    right = {m: brute_force(graph.tables, graph.hidden, evidence, m) for m in METHODS}
    assert_filters_agree(compiled, evidence, right)


@pytest.mark.parametrize("seed", range(6))
def test_tables_that_name_their_axes_in_another_order_compile_to_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = draw_graph(rng)
    compiled = graph.compiled()
    shuffled = shuffle_axes(graph.tables, rng)
    other = replace(graph, tables=shuffled).compiled()
    evidence = draw_evidence(compiled, 5, rng)
    for method in METHODS:
        right = filter_beliefs(compiled, evidence, method)
        assert_same_beliefs(filter_beliefs(other, evidence, method), right, 1e-13)
        renewed = with_tables(compiled, shuffled)
        assert_same_beliefs(filter_beliefs(renewed, evidence, method), right, 1e-13)


def test_new_tables_of_another_shape_or_other_parents_are_refused() -> None:
    compiled = compiled_simple()
    wider = [t for t in simple_tables() if t.node[0] != "D"] + within("D", ["A"], uniform(2, 3))
    with pytest.raises(InputError, match="D: the table has other parents or values"):
        with_tables(compiled, wider)
    rootless = [t for t in simple_tables() if t.node != ("A", 1)] + [
        Table(("A", 1), (), uniform(2))
    ]
    with pytest.raises(InputError, match="A: the table has other parents or values"):
        with_tables(compiled, rootless)


def test_new_tables_must_be_of_this_network_and_those_not_given_are_kept() -> None:
    compiled = compiled_simple()
    with pytest.raises(InputError, match="E: the compiled network has no such node"):
        with_tables(compiled, [*simple_tables(), *within("E", ["A"], SEES)])
    some = with_tables(compiled, dynamics("A", [previous("A")], KEEP[::-1]))
    np.testing.assert_array_equal(some.transition[0], KEEP[::-1])
    np.testing.assert_array_equal(some.groups[0].emission, SEES)


@pytest.mark.parametrize(
    "changed",
    [
        [Table(("D", 0), (("A", 0),), SEES[::-1].copy())],
        within("F", ["A"], np.eye(2)[::-1]),
        within("F", ["A"], SEES),
    ],
)
def test_new_numbers_may_change_the_part_that_a_node_has(changed: list[Table]) -> None:
    """An emission may come to differ between the slices, a function to be another or uncertain."""
    tables = [*simple_tables(), *within("F", ["A"], np.eye(2))]
    compiled = compile(declare(tables, ["D"]), hidden=["A", "F"], observed=["D"])
    assert compiled.n_states == 2
    nodes = {table.node for table in changed}
    now = [*changed, *(table for table in tables if table.node not in nodes)]
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0))
    right = {m: brute_force(now, ["A", "F"], evidence, m) for m in METHODS}
    assert_filters_agree(with_tables(compiled, changed), evidence, right)


def refused(
    tables: Sequence[Table],
    hidden: Sequence[str] = ("A",),
    observed: Sequence[Observed] = ("D",),
    inputs: Sequence[str] = (),
    declared: Sequence[Observed] | None = None,
) -> str:
    network = declare(tables, observed if declared is None else declared)
    with pytest.raises(InputError) as error:
        compile(network, hidden=hidden, observed=observed, inputs=inputs)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("what", ["hidden", "observed", "inputs"])
def test_a_name_instead_of_a_list_of_names_is_refused(what: str) -> None:
    names: dict[str, Any] = {"observed": ["D"], what: "AD"}
    with pytest.raises(InputError, match=rf"^{what}: needs a list of nodes, e\.g\. \['AD'\]$"):
        compile(declare(simple_tables(), ["D"]), **names)


def test_all_nodes_that_are_not_observed_are_hidden_and_lane_in_any_case() -> None:
    tables = [*simple_tables("Lane"), *within("E", ["Lane"], SEES)]
    assert compile(declare(tables, ["D"]), observed=["D"]).hidden == ("Lane", "E")
    assert compile(declare(tables, ["D", "E"]), observed=["D", "E"]).hidden == ("Lane",)
    seen = [["Lane", "E"], "D"]  # a list of nodes is one of nodes observed jointly
    joint = compile(declare(tables, [("Lane", "E"), "D"]), observed=seen)  # type: ignore[arg-type]
    assert joint.hidden == ("Lane",)
    assert set(joint.observed) == {("Lane", "E"), "D"}


def test_missing_virtual_evidence_children_are_added() -> None:
    observed = ("D", ("A", "D"))
    compiled = compile(declare(simple_tables(), ["D"]), hidden=["A"], observed=observed)
    assert {("D_ve", 0), ("A+D_ve", 1)} <= set(compiled.network.nodes())
    whole = compile(declare(simple_tables(), observed), hidden=["A"], observed=observed)
    evidence = draw_evidence(whole, 3, np.random.default_rng(0))
    right = {m: filter_beliefs(whole, evidence, m) for m in METHODS}
    assert_filters_agree(compiled, evidence, right)


def test_values_have_the_names_of_the_network_or_those_given_and_lanes_count_from_one() -> None:
    tables = simple_tables("Lane")
    plain = compile(declare(tables, ["D"]), hidden=["Lane"], observed=["D"])
    assert plain.values == {"Lane": ("1", "2"), "D": ("0", "1")}
    named = declare(tables, ["D"], {"D": ("left", "right")})
    of_network = compile(named, hidden=["Lane"], observed=["D"])
    assert of_network.values == {"Lane": ("1", "2"), "D": ("left", "right")}
    given = compile(named, hidden=["Lane"], observed=["D"], values={"D": ("a", "b")})
    assert given.values["D"] == ("a", "b")
    for names in (("a", "b", "c"), ("a", "a")):
        with pytest.raises(InputError, match="D: has 2 values, but their names are a, "):
            compile(named, hidden=["Lane"], observed=["D"], values={"D": names})


@pytest.mark.parametrize("seed", range(4))
def test_the_network_of_a_compiled_graph_is_the_one_that_was_compiled(seed: int) -> None:
    graph = draw_graph(np.random.default_rng(seed))
    compiled = graph.compiled()
    network = compiled.network
    right = declare(graph.tables, graph.observed)
    assert set(network.edges()) == set(right.edges())
    for cpd in right.cpds:
        ours = network.get_cpds(cpd.variable)
        assert ours.variables == cpd.variables
        np.testing.assert_array_equal(ours.values, cpd.values)
        name = cpd.variable[0]
        if name in compiled.values:
            assert ours.state_names[cpd.variable] == list(compiled.values[name])
    again = compile(network, hidden=graph.hidden, observed=graph.observed, inputs=graph.inputs)
    assert again.values == compiled.values
    np.testing.assert_array_equal(again.transition, compiled.transition)


def sensor_bias(inside: Sequence[str] = ("A",)) -> list[Table]:
    """One persistent node, and D that sees it and keeps its own value for a while."""
    return [
        *simple_tables()[:2],
        *prior("D", SEES, list(inside)),
        *dynamics("D", [*inside, previous("D")], OF_TWO),
    ]


INPUT = within("Input", [], [0.5, 0.5])


@pytest.mark.parametrize(
    ("tables", "hidden", "observed", "inputs", "state"),
    [
        (sensor_bias(), ["A"], ["D"], [], ["A", "D"]),
        ([*simple_tables(), *within("F", ["A"], SEES)], ["A", "F"], ["D"], [], ["A", "F"]),
        ([*simple_tables(), *within("F", ["D"], SEES)], ["A", "F"], ["D"], [], ["A", "F", "D"]),
        ([*simple_tables(), *within("F", ["D"], np.eye(2))], ["A", "F"], ["D"], [], ["A", "D"]),
        ([*simple_tables()[:2], *INPUT, *within("D", ["A", "Input"], OF_TWO)], ["A"], ["D"],
         ["Input"], ["A", "D"]),
        ([*simple_tables(), *INPUT, *within("F", ["Input"], np.eye(2))], ["A", "F"], ["D"],
         ["Input"], ["A", "F"]),
        ([*simple_tables()[:2], *prior("D", SEES, ["A"]), *dynamics("D", ["A"], SEES[::-1])],
         ["A"], ["D"], [], ["A", "D"]),
        ([*simple_tables(), *prior("F", KEEP, ["A"]), *dynamics("F", ["A"], np.eye(2))],
         ["A", "F"], ["D"], [], ["A", "F"]),
        ([*within("A", [], [0.3, 0.7]), *within("D", ["A"], SEES)], ["A"], ["D"], [], ["A"]),
        # E is a parent of D, which is carried; as its child it is a plain emission.
        ([*sensor_bias(["E"]), *within("E", ["A"], SEES)], ["A"], ["D", "E"], [], ["A", "D", "E"]),
        ([*sensor_bias(), *within("E", ["A", "D"], OF_TWO)], ["A"], ["D", "E"], [], ["A", "D"]),
        ([*prior("A", [0.3, 0.7]), *dynamics("A", [previous("A"), previous("F")], OF_TWO),
          *within("F", ["A"], np.eye(2)), *within("D", ["A"], SEES)], ["A", "F"], ["D"], [],
         ["A", "F"]),
        ([*simple_tables(), *within("F", [], [0.0, 1.0]), *within("E", ["F"], SEES)],
         ["A", "F"], ["D", "E"], [], ["A"]),
        ([*simple_tables(), *within("E", ["D"], SEES), *within("F", ["A", "E"], OF_TWO),
          *within("G", ["D"], SEES[::-1])], ["A"], ["G", "E", "D", "F"], [], ["A", "E", "D"]),
        ([*simple_tables(), *within("E", ["A"], SEES)], ["A"], ["D", ("E", "D")], [], ["A", "D"]),
    ],
    ids=["edge into observed", "passing hidden", "hidden of observed", "function of observed",
         "input of observed", "function of input", "first emission differs",
         "first function differs", "nothing persists", "parent of a carried one", "its child",
         "function that later frames depend on", "constant", "observed with children",
         "two evidences"],
)  # fmt: skip
def test_only_what_must_be_carried_or_is_no_plain_emission_is_in_the_state(
    tables: list[Table],
    hidden: list[str],
    observed: list[str],
    inputs: list[str],
    state: list[str],
) -> None:
    compiled = compile(declare(tables, observed), hidden=hidden, observed=observed, inputs=inputs)
    assert list(compiled.state_nodes) == state
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0))
    right = {m: brute_force(tables, hidden, evidence, m) for m in METHODS}
    assert_filters_agree(compiled, evidence, right)


def test_a_joint_state_too_large_is_refused_with_its_size_and_its_nodes() -> None:
    n = 65
    tables = [t for name in ("A", "B") for t in prior(name, uniform(n))]
    tables += [t for m in ("A", "B") for t in dynamics(m, [previous(m)], uniform(n, n))]
    tables += within("D", ["A"], uniform(n, 2))
    assert (
        refused(tables, ["A", "B"])
        == "the joint state has 4225 values (A 65 x B 65), more than 4096"
    )


OF_INPUT = [
    *INPUT,
    *prior("A", KEEP, ["Input"]),
    *dynamics("A", ["Input", previous("A")], OF_TWO),
    *within("D", ["A"], SEES),
]
AFTER_INPUT = [
    *prior("A", [0.5, 0.5]),
    *dynamics("A", [previous("Input")], KEEP),
    *INPUT,
    *within("D", ["A"], SEES),
]
CONSTANT = [*within("A", [], [0.0, 1.0]), *within("D", ["A"], SEES)]


@pytest.mark.parametrize(
    ("tables", "hidden", "observed", "inputs", "message"),
    [
        (simple_tables(), ["Aa"], ["D"], [], "Aa: declared, but not a node of the network"),
        (simple_tables(), ["A"], [("D", "Ghost")], [], "Ghost: declared, but not a node"),
        (simple_tables(), ["A"], ["D"], ["Ghost"], "Ghost: declared, but not a node"),
        (simple_tables(), ["A", "A"], ["D"], [], "A: declared more than once"),
        (simple_tables(), ["A"], ["D", ("D",)], [], "D_ve: declared more than once"),
        (simple_tables(), ["A"], [("D", "D")], [], "D: declared more than once"),
        (simple_tables(), [], ["D", "A"], [], "no hidden node is declared"),
        (sensor_bias(), [], ["D"], [], "A: neither hidden, observed, input nor virtual evidence"),
        (CONSTANT, ["A"], ["D"], [], "every hidden node (A) is a constant"),
        ([*simple_tables(), *within("I", ["A"], SEES)], ["A"], ["D"], ["I"],
         "I: an input node may not have parents"),
        (AFTER_INPUT, ["A"], ["D"], ["Input"], "Input: an input acts within its slice only"),
        (OF_INPUT, ["A", "Input"], ["D"], ["Input"], "Input: is declared both hidden and input"),
        (OF_INPUT, ["A"], ["D", "Input"], ["Input"], "Input: is declared both observed and input"),
    ],
)  # fmt: skip
def test_declarations_that_do_not_fit_the_network_are_refused(
    tables: list[Table],
    hidden: list[str],
    observed: list[Observed],
    inputs: list[str],
    message: str,
) -> None:
    assert refused(tables, hidden, observed, inputs, declared=["D"]).startswith(message)


def test_a_virtual_evidence_node_is_a_leaf_of_what_it_observes() -> None:
    base = list(simple_tables())
    other = [*base, *within("D_ve", ["A"], uniform(2, 2))]
    assert refused(other, declared=[]) == "D_ve: its parents must be D in the same slice"
    parent = [*base, *within("D_ve", ["D"], uniform(2, 2)), *within("E", ["D_ve"], SEES)]
    message = refused(parent, observed=("D", "E"), declared=["E"])
    assert message == "E at t has the parent D_ve at t, for which there is no table"
    # A hidden node observed directly, one slice late: the names alone would match.
    late = [
        *base,
        Table(("A_ve", 0), (), uniform(2)),
        Table(("A_ve", 1), (("A", 0),), uniform(2, 2)),
    ]
    message = refused(late, observed=("D", "A"), declared=["D"])
    assert message == "A_ve: its parents must be A in the same slice"
