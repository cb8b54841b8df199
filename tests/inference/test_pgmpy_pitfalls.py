"""The order of a table's axes, which pgmpy 1.1.2 mixes up between the slices, does not matter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import dynamics, previous, prior, quiet, within
from egolane_pgm.inference.compile import compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.types import Evidence
from tests.conformance.networks import METHODS, assert_same_beliefs, brute_force

START = np.array([0.3, 0.7])
MOVES = np.array([[0.9, 0.1], [0.2, 0.8]])


def two_parents(order: tuple[str, str]) -> Any:
    """A and B persist, D sees both: table P(D | B, A), the edges in `order`."""
    sees = np.array([[[0.9, 0.1], [0.6, 0.4]], [[0.3, 0.7], [0.2, 0.8]]])  # [b, a, d]
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.models import DynamicBayesianNetwork

    network = DynamicBayesianNetwork([((n, 0), (n, 1)) for n in "AB"])
    network.add_edges_from([((n, 0), ("D", 0)) for n in order] + [(("D", 0), ("D_ve", 0))])
    for s in (0, 1):
        columns = sees.reshape(-1, 2).T
        network.add_cpds(
            TabularCPD(("D", s), 2, columns, [("B", s), ("A", s)], [2, 2]),
            TabularCPD(("D_ve", s), 2, np.full((2, 2), 0.5), [("D", s)], [2]),
        )
    for n in "AB":
        network.add_cpds(
            TabularCPD((n, 0), 2, START.reshape(-1, 1)),
            TabularCPD((n, 1), 2, MOVES.T, [(n, 0)], [2]),
        )
    declared = [
        *(t for n in "AB" for t in prior(n, START)),
        *(t for n in "AB" for t in dynamics(n, [previous(n)], MOVES)),
        *within("D", ["B", "A"], sees),
    ]
    return network, declared


@pytest.mark.parametrize("order", [("A", "B"), ("B", "A")])
@pytest.mark.parametrize("method", METHODS)
def test_axes_keep_their_names_whatever_the_order_of_the_edges(
    order: tuple[str, str], method: str
) -> None:
    soft = np.array([[0.2, 0.8], [0.9, 0.1], [0.4, 0.6]])
    with quiet():
        network, declared = two_parents(order)
    compiled = compile(network, hidden=["A", "B"], observed=["D"])
    evidence = Evidence({"D": soft})
    right = brute_force(declared, ["A", "B"], evidence, method)
    assert_same_beliefs(filter_beliefs(compiled, evidence, method), right, 1e-12)


@pytest.mark.parametrize("filled_in", [False, True], ids=["by us", "by pgmpy"])
@pytest.mark.parametrize("given", [0, 1])
@pytest.mark.parametrize("order", [("A", "B"), ("B", "A")])
def test_a_table_that_one_slice_lacks_is_that_of_the_other_by_name(
    order: tuple[str, str], given: int, filled_in: bool
) -> None:
    """`initialize_initial_state` copies P(D | B, A) to the other slice as P(D | A, B), the edges'
    order, without moving the axes."""
    with quiet():
        network, declared = two_parents(order)
        network.remove_cpds(("D", 1 - given), ("D_ve", 1 - given))
        if filled_in:
            network.initialize_initial_state()
    compiled = compile(network, hidden=["A", "B"], observed=["D"])
    evidence = Evidence({"D": np.array([[0.2, 0.8], [0.9, 0.1], [0.4, 0.6]])})
    right = brute_force(declared, ["A", "B"], evidence, "exact")
    assert_same_beliefs(filter_beliefs(compiled, evidence, "exact"), right, 1e-12)


def test_what_was_written_for_both_slices_is_kept_whatever_its_numbers() -> None:
    """P(D | B, A) in the first frame and P(D | A, B) later, with the same numbers on purpose."""
    with quiet():
        network, _ = two_parents(("A", "B"))
        from pgmpy.factors.discrete import TabularCPD

        columns = network.get_cpds(("D", 0)).get_values()
        network.remove_cpds(("D", 1))
        network.add_cpds(TabularCPD(("D", 1), 2, columns, [("A", 1), ("B", 1)], [2, 2]))
    compiled = compile(network, hidden=["A", "B"], observed=["D"])
    first, later = compiled.tables["D", 0], compiled.tables["D", 1]
    assert [p[0] for p in first.parents] == [p[0] for p in later.parents]
    np.testing.assert_array_equal(first.values, later.values.swapaxes(0, 1))


def test_an_intervention_with_evidence_needs_the_cut_network() -> None:
    """Z -> X, Z and X -> Y -> E: pgmpy's own query of Y, given E and do(X), ignores E."""
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.inference import CausalInference, VariableElimination
    from pgmpy.models import DiscreteBayesianNetwork

    y_of, e_of = np.array([[0.9, 0.6], [0.3, 0.2]]), np.array([0.1, 0.7])  # [x, z], [y]
    with quiet():
        network = DiscreteBayesianNetwork([("Z", "X"), ("Z", "Y"), ("X", "Y"), ("Y", "E")])
        network.add_cpds(
            TabularCPD("Z", 2, START[:, None]),
            TabularCPD("X", 2, MOVES.T, ["Z"], [2]),
            TabularCPD("Y", 2, [y_of.ravel(), 1 - y_of.ravel()], ["X", "Z"], [2, 2]),
            TabularCPD("E", 2, [1 - e_of, e_of], ["Y"], [2]),
        )
        wrong = CausalInference(network).query(["Y"], do={"X": 1}, evidence={"E": 1})
        cut = VariableElimination(network.do(["X"])).query(["Y"], evidence={"X": 1, "E": 1})
    alone = np.array([y_of[1] @ START, 1 - y_of[1] @ START])
    np.testing.assert_allclose(cut.values, alone * e_of / (alone @ e_of), atol=1e-12)
    assert np.abs(wrong.values - cut.values).max() > 0.1
