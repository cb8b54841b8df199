"""How the filters read evidence: hard or soft, inputs, and what does not fit."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import Compiled, compile_network
from egolane_pgm.inference.filtering import filter_beliefs, read_evidence
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    METHODS,
    assert_same_beliefs,
    brute_force,
    draw_evidence,
    graph,
)

every_method = pytest.mark.parametrize("method", METHODS)


@functools.cache
def compiled_paper(n_lanes: int = 4) -> Compiled:
    module = graph("sensor_failure")
    parameters = resolve_parameters(module.PARAMETERS, {}, n_lanes)
    return compile_network(module.build(n_lanes, parameters), module.HIDDEN, module.OBSERVED)


# --- hard evidence -------------------------------------------------------------------------------


def test_hard_evidence_is_the_most_probable_value_and_a_tie_keeps_all_that_share_it() -> None:
    soft = Evidence({"D": np.array([[0.2, 0.5, 0.3], [0.4, 0.4, 0.2], [0.0, 0.0, 0.0]])})
    hard = read_evidence(soft, "hard").likelihoods["D"]
    np.testing.assert_array_equal(hard[:2], [[0, 1, 0], [1, 1, 0]])
    assert read_evidence(soft, "soft") is soft
    nearly = Evidence({"D": np.array([[0.4, 0.4 * (1 - 1e-10), 0.2], [0.4, 0.4 - 1e-6, 0.2]])})
    np.testing.assert_array_equal(
        read_evidence(nearly, "hard").likelihoods["D"], [[1, 1, 0], [1, 0, 0]]
    )


def test_hard_evidence_on_a_tuple_of_nodes_is_their_most_probable_combination() -> None:
    soft = Evidence({("A", "B"): np.array([[[0.1, 0.2], [0.4, 0.3]]])})
    np.testing.assert_array_equal(
        read_evidence(soft, "hard").likelihoods["A", "B"], [[[0, 0], [1, 0]]]
    )


def test_an_unknown_reading_of_evidence_is_refused_with_a_suggestion() -> None:
    soft = Evidence({"D": np.ones((1, 2))})
    with pytest.raises(InputError, match=r"evidence reading 'hards' \(did you mean 'hard'\?\)"):
        read_evidence(soft, "hards")


# --- evidence that does not fit ------------------------------------------------------------------


def test_an_unknown_method_is_refused_with_a_suggestion() -> None:
    evidence = draw_evidence(compiled_paper(), 1, np.random.default_rng(0))
    with pytest.raises(InputError, match=r"filter 'exakt' \(did you mean 'exact'\?\)"):
        filter_beliefs(compiled_paper(), evidence, "exakt")


@pytest.mark.parametrize(
    ("likelihoods", "message"),
    [
        ({"DetectorOutput": np.ones((2, 4))}, "observed node WOR: the evidence has nothing for it"),
        (
            {"DetectorOutput": np.ones((2, 4)), "WOR": np.ones((2, 2)), "GPS": np.ones((2, 4))},
            "evidence for GPS: the graph does not observe such a node",
        ),
        (
            {"DetectorOutput": np.ones((2, 3)), "WOR": np.ones((2, 2))},
            r"evidence for DetectorOutput: shape \(2, 3\), the graph needs \(2, 4\)",
        ),
    ],
)
def test_evidence_that_does_not_fit_the_network_is_refused_naming_the_node(
    likelihoods: dict[str, np.ndarray], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        filter_beliefs(compiled_paper(), Evidence(likelihoods))


def test_an_input_that_is_missing_unknown_or_out_of_range_is_refused() -> None:
    tables = [
        *within("Speed", [], [0.5, 0.5]),
        *prior("Lane", np.full((2, 2), 0.5), ["Speed"]),
        *dynamics("Lane", ["Speed", previous("Lane")], np.stack([np.eye(2), np.full((2, 2), 0.5)])),
        *within("D", ["Lane"], np.eye(2)),
    ]
    compiled = compile_network(declare(tables, ["D"]), ["Lane"], ["D"], ["Speed"])
    seen = {"D": np.ones((2, 2))}
    for inputs, message in [
        ({}, "input node Speed: the evidence has nothing for it"),
        ({"Sped": np.zeros(2, dtype=int)}, "input node Speed: the evidence has nothing"),
        ({"Speed": np.array([0, 2])}, r"input Speed: outside 0\.\.1"),
        ({"Speed": np.array([-1, 0])}, r"input Speed: outside 0\.\.1"),
    ]:
        with pytest.raises(InputError, match=message):
            filter_beliefs(compiled, Evidence(seen, inputs))
    with pytest.raises(InputError, match="input Speed: the graph has no such input node"):
        filter_beliefs(
            compiled_paper(),
            Evidence(
                {"DetectorOutput": np.ones((1, 4)), "WOR": np.ones((1, 2))},
                {"Speed": np.zeros(1, dtype=int)},
            ),
        )


@every_method
@pytest.mark.parametrize("key", [("Z", "X", "Y"), ("Y", "Z", "X"), ("Z", "Y", "X")])
def test_evidence_on_three_nodes_has_its_axes_in_the_order_of_its_key(
    method: str, key: tuple[str, str, str]
) -> None:
    """X, Y and Z have 2, 3 and 4 values, and evidence of their own beside the joint one."""
    rng = np.random.default_rng(3)
    sizes = {"X": 2, "Y": 3, "Z": 4}
    tables = [
        *prior("Lane", [0.4, 0.6]),
        *dynamics("Lane", [previous("Lane")], rng.dirichlet(np.ones(2), 2)),
    ]
    for name, size in sizes.items():
        tables += within(name, ["Lane"], rng.dirichlet(np.ones(size), 2))
    observed = ("X", "Y", "Z", key)
    compiled = compile_network(declare(tables, observed), ["Lane"], observed)
    evidence = draw_evidence(compiled, 2, rng, zeros=0)
    right = brute_force(tables, ["Lane"], evidence, method)
    ours = filter_beliefs(compiled, evidence, method)
    assert_same_beliefs(ours, right)


@every_method
def test_two_inputs_select_the_transition_by_their_names(method: str) -> None:
    rng = np.random.default_rng(7)
    tables = [
        *within("InputA", [], [0.5, 0.5]),
        *within("InputB", [], [0.2, 0.3, 0.5]),
        *prior("Lane", rng.dirichlet(np.ones(2), (3, 2)), ["InputB", "InputA"]),
        *dynamics(
            "Lane", ["InputB", previous("Lane"), "InputA"], rng.dirichlet(np.ones(2), (3, 2, 2))
        ),
        *within("D", ["Lane"], rng.dirichlet(np.ones(2), 2)),
    ]
    compiled = compile_network(declare(tables, ["D"]), ["Lane"], ["D"], ["InputA", "InputB"])
    evidence = draw_evidence(compiled, 4, rng)
    right = brute_force(tables, ["Lane"], evidence, method)
    assert_same_beliefs(filter_beliefs(compiled, evidence, method), right)
