"""What compile refuses, and that the one line of it names the node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from egolane_pgm.inference import compile as _roles
from egolane_pgm.inference.compile import compile_network
from egolane_pgm.types import InputError, Observed
from tests.conformance.networks import (
    KEEP,
    SEES,
    assert_filters_agree,
    draw_evidence,
    simple_tables,
)
from tests.reference.oracle import oracle_filter

OF_TWO = np.array([[[0.7, 0.3], [0.4, 0.6]], [[0.1, 0.9], [0.5, 0.5]]])


# --- what is refused, and that the line names the node -------------------------------------------


def refused(
    tables: Sequence[Table],
    hidden: Sequence[str] = ("A",),
    observed: Sequence[Observed] = ("D",),
    inputs: Sequence[str] = (),
    declared: Sequence[Observed] | None = None,
) -> str:
    network = declare(tables, observed if declared is None else declared)
    with pytest.raises(InputError) as error:
        compile_network(network, hidden, observed, inputs)
    message = str(error.value)
    assert "\n" not in message
    return message


def edited(edit: Callable[[Any, Callable[..., Any]], None]) -> str:
    """The refusal of the simple network after `edit(network, TabularCPD)`."""
    with quiet():
        from pgmpy.factors.discrete import TabularCPD

        network = declare(simple_tables(), ["D"])
        edit(network, TabularCPD)
    with pytest.raises(InputError) as error:
        compile_network(network, ["A"], ["D"])
    return str(error.value)


def cpd_of(network: Any, node: str, s: int) -> Any:
    return next(c for c in network.cpds if tuple(c.variable) == (node, s))


def test_a_table_that_does_not_match_its_parents_is_refused_naming_both() -> None:
    def edit(network: Any, cpd: Callable[..., Any]) -> None:
        network.cpds.remove(cpd_of(network, "D", 1))
        network.cpds.append(cpd(("D", 1), 2, SEES.T, [("A", 0)], [2]))

    message = edited(edit)
    assert message == "D in slice 1: its table is given A[t], its edges come from A[t+1]"


def test_a_missing_table_of_the_second_slice_is_refused() -> None:
    message = edited(lambda network, _: network.cpds.remove(cpd_of(network, "A", 1)))
    assert message == "A: no table for slice 1; declare both slices in full"


def test_two_tables_for_one_node_are_refused() -> None:
    message = edited(lambda network, _: network.cpds.append(cpd_of(network, "A", 1)))
    assert message == "A: two tables for slice 1"


def test_a_table_with_another_number_of_rows_than_its_parent_has_values_is_refused() -> None:
    def edit(network: Any, cpd: Callable[..., Any]) -> None:
        network.cpds.remove(cpd_of(network, "D", 1))
        network.cpds.append(cpd(("D", 1), 2, np.full((2, 3), 0.5), [("A", 1)], [3]))

    assert edited(edit) == "D: its table has 3 rows for A, which has 2 values"


def test_another_number_of_values_in_the_second_slice_is_refused() -> None:
    tables = [
        *prior("A", [0.5, 0.5]),
        *dynamics("A", [previous("B")], uniform(2, 3)),
        *prior("B", [0.5, 0.5]),
        *dynamics("B", [previous("B")], KEEP),
        *within("D", ["B"], SEES),
    ]
    assert refused(tables, ["A", "B"]) == "A: has 2 values in the first frame and 3 later"


@pytest.mark.parametrize(
    ("hidden", "observed", "inputs", "named"),
    [
        (("Aa",), ("D",), (), "Aa"),
        (("A", "Ghost"), ("D",), (), "Ghost"),
        (("A",), ("D", "Ghost"), (), "Ghost"),
        (("A",), (("D", "Ghost"),), (), "Ghost"),
        (("A",), ("D",), ("Ghost",), "Ghost"),
    ],
)
def test_a_name_that_is_no_node_is_refused(
    hidden: tuple[str, ...], observed: tuple[Observed, ...], inputs: tuple[str, ...], named: str
) -> None:
    message = refused(simple_tables(), hidden, observed, inputs, declared=["D"])
    assert message.startswith(f"{named}: declared, but not a node of the network")


def test_a_mistyped_name_gets_a_suggestion() -> None:
    message = refused(simple_tables("Lane"), ["Lain"], ["D"])
    assert message.endswith("(did you mean 'Lane'?)")


def test_an_observed_node_without_its_virtual_evidence_child_is_refused() -> None:
    message = refused(simple_tables(), ("A",), ("D",), declared=[])
    assert message == "D_ve: an observed node needs this virtual-evidence child"
    message = refused(simple_tables(), ("A",), (("A", "D"),), declared=["D"])
    assert message.startswith("A+D_ve: ")


def test_a_stray_node_is_refused() -> None:
    tables = [*simple_tables(), *within("E", ["A"], SEES)]
    assert refused(tables) == "E: neither hidden, observed, input nor virtual evidence"


@pytest.mark.parametrize(
    ("hidden", "observed", "named"),
    [
        (("A", "A"), ("D",), "A"),
        (("A",), ("D", "D"), "D_ve"),
        (("A",), ("D", ("D",)), "D_ve"),
        (("A",), (("D", "D"),), "D"),
    ],
)
def test_a_node_that_is_declared_twice_is_refused(
    hidden: tuple[str, ...], observed: tuple[Observed, ...], named: str
) -> None:
    message = refused(simple_tables(), hidden, observed, declared=["D"])
    assert message == f"{named}: declared more than once"


def test_a_hidden_node_that_neither_persists_nor_is_a_function_is_refused() -> None:
    tables = [*simple_tables(), *within("F", ["A"], SEES)]
    message = refused(tables, ["A", "F"])
    assert message.startswith("F: a hidden node without an edge across the slices must be a determ")
    of_observed = [*simple_tables(), *within("F", ["D"], np.eye(2))]
    message = refused(of_observed, ["A", "F"])
    assert message == "F: a hidden node may not depend on observed D"


def test_a_hidden_node_may_be_a_constant() -> None:
    tables = [*simple_tables(), *within("F", [], [0.0, 1.0]), *within("E", ["F"], SEES)]
    network = declare(tables, ["D", "E"])
    compiled = compile_network(network, ["A", "F"], ["D", "E"])
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0), zeros=0)
    right = oracle_filter(network, ["A", "F"], ["D", "E"], evidence)
    np.testing.assert_allclose(right.marginals["F"], [[0, 1]] * 3)
    assert_filters_agree(compiled, evidence, {"exact": right})


def test_a_function_of_an_input_is_refused() -> None:
    tables = [*simple_tables(), *within("I", [], [0.5, 0.5]), *within("F", ["I"], np.eye(2))]
    message = refused(tables, ["A", "F"], inputs=["I"])
    assert message.startswith("F: a hidden node without an edge across the slices must be a func")


def test_a_function_that_differs_between_the_slices_is_refused() -> None:
    tables = [
        *simple_tables(),
        Table(("F", 0), (("A", 0),), np.eye(2)),
        Table(("F", 1), (("A", 1),), np.eye(2)[::-1]),
    ]
    assert refused(tables, ["A", "F"]) == "F: its table differs between the slices"


def test_an_observed_node_with_an_edge_across_the_slices_is_refused() -> None:
    tables = [
        *prior("A", [0.5, 0.5]),
        *dynamics("A", [previous("A")], KEEP),
        *prior("D", SEES, ["A"]),
        *dynamics("D", ["A", previous("D")], OF_TWO),
    ]
    assert refused(tables) == "D: observed nodes may not have edges across the slices"


def test_an_emission_that_differs_between_the_slices_is_refused() -> None:
    tables = [t for t in simple_tables() if t.node != ("D", 1)]
    tables.append(Table(("D", 1), (("A", 1),), SEES[::-1].copy()))
    assert refused(tables) == "D: its table differs between the slices"


def test_a_joint_state_too_large_is_refused_with_its_size_and_its_nodes() -> None:
    n = 65
    tables = [t for name in ("A", "B") for t in prior(name, uniform(n))]
    tables += [t for m in ("A", "B") for t in dynamics(m, [previous(m)], uniform(n, n))]
    tables += within("D", ["A"], uniform(n, 2))
    assert (
        refused(tables, ["A", "B"])
        == "the joint hidden state has 4225 values (A 65 x B 65), more than 4096"
    )


def test_a_joint_state_of_just_the_largest_size_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    network = declare(simple_tables(), ["D"])
    monkeypatch.setattr(_roles, "MAX_STATES", 2)
    assert compile_network(network, ["A"], ["D"]).n_states == 2
    monkeypatch.setattr(_roles, "MAX_STATES", 1)
    with pytest.raises(InputError, match=r"2 values \(A 2\), more than 1"):
        compile_network(network, ["A"], ["D"])


def test_a_transition_or_emission_too_large_is_refused_with_its_nodes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tables = [
        *within("I", [], uniform(3)),
        *prior("A", uniform(3, 2), ["I"]),
        *dynamics("A", ["I", previous("A")], uniform(3, 2, 2)),
        *within("D", ["A"], uniform(2, 7)),
    ]
    monkeypatch.setattr(_roles, "MAX_ENTRIES", 11)
    message = refused(tables, inputs=["I"])
    assert message == "the transition has 3 x 2 x 2 entries (I 3 x A 2), more than 11"
    monkeypatch.setattr(_roles, "MAX_ENTRIES", 13)
    message = refused(tables, inputs=["I"])
    assert message == "D: D 7 values for 2 joint states are more than 13 entries"


def test_a_network_in_which_nothing_persists_is_refused() -> None:
    tables = [*within("A", [], [0.0, 1.0]), *within("D", ["A"], SEES)]
    message = refused(tables)
    assert message.startswith("no hidden node (A) has an edge across the slices")


def test_inputs_are_roots_that_act_within_their_slice_on_hidden_nodes_only() -> None:
    root = within("I", [], [0.5, 0.5])
    tables = [*simple_tables(), *within("I", ["A"], SEES)]
    assert refused(tables, inputs=["I"]) == "I: an input node may not have parents"
    tables = [*prior("A", [0.5, 0.5]), *dynamics("A", [previous("I")], KEEP), *root]
    tables += [*prior("B", [0.5, 0.5]), *dynamics("B", [previous("B")], KEEP)]
    tables += within("D", ["A"], SEES)
    message = refused(tables, ["A", "B"], inputs=["I"])
    assert message == "I: an input acts within its slice only"
    tables = [*simple_tables()[:2], *root, *within("D", ["A", "I"], OF_TWO)]
    message = refused(tables, inputs=["I"])
    assert message == "D: an observed node may not depend on input I"


@pytest.mark.parametrize(
    ("hidden", "observed", "message"),
    [
        (("A", "I"), ("D",), "I: is declared both hidden and input"),
        (("A",), ("D", "I"), "I: is declared both observed and input"),
    ],
)
def test_an_input_is_nothing_else(
    hidden: tuple[str, ...], observed: tuple[Observed, ...], message: str
) -> None:
    tables = [
        *within("I", [], [0.5, 0.5]),
        *prior("A", KEEP, ["I"]),
        *dynamics("A", ["I", previous("A")], OF_TWO),
        *within("D", ["A"], SEES),
    ]
    assert refused(tables, hidden, observed, ["I"]) == message


def test_a_virtual_evidence_node_is_a_binary_leaf_of_what_it_observes() -> None:
    base = list(simple_tables())
    three = [*base, *within("D_ve", ["D"], uniform(2, 3))]
    assert refused(three, declared=[]) == "D_ve: a virtual-evidence node is binary"
    other = [*base, *within("D_ve", ["A"], uniform(2, 2))]
    assert refused(other, declared=[]) == "D_ve: its parents must be D in the same slice"
    parent = [*base, *within("D_ve", ["D"], uniform(2, 2)), *within("E", ["D_ve"], SEES)]
    message = refused(parent, observed=("D", "E"), declared=["E"])
    assert message == "D_ve: a virtual-evidence node may not have children"
    # A hidden node observed directly, one slice late: the names alone would match.
    late = [
        *base,
        Table(("A_ve", 0), (), uniform(2)),
        Table(("A_ve", 1), (("A", 0),), uniform(2, 2)),
    ]
    message = refused(late, observed=("D", "A"), declared=["D"])
    assert message == "A_ve: its parents must be A in the same slice"
