"""Properties of the filters that hold whatever the graph, the parameters and the evidence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import Compiled, compile, compile_tables
from egolane_pgm.inference.expected_counts import expected_counts
from egolane_pgm.inference.filtering import filter_beliefs, harden, step
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    METHODS,
    any_compiled,
    assert_same_beliefs,
    brute_force,
    draw_evidence,
    few,
    seeds,
    template,
)
from tests.reference import inference as reference

every_method = pytest.mark.parametrize("method", METHODS)


@every_method
@few
@given(seed=seeds)
def test_kernel_and_twin_give_the_same(method: str, seed: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 60, np.random.default_rng(seed))
    right = reference.filter_beliefs(compiled, evidence, method)
    assert_same_beliefs(filter_beliefs(compiled, evidence, method), right, 1e-11)


@pytest.mark.parametrize("exponent", [-1000, -600, 600, 1000])
def test_evidence_of_any_scale_in_three_groups_equals_a_computation_in_logarithms(
    exponent: int,
) -> None:
    compiled = three_groups()
    rng = np.random.default_rng(0)
    ordinary = Evidence({name: rng.uniform(0.1, 1.0, (20, 2)) for name in "ABC"})
    is_scaled = np.arange(20) % 3 == 1
    scaled = Evidence(
        {k: np.ldexp(v, exponent * is_scaled[:, None]) for k, v in ordinary.likelihoods.items()}
    )
    right = reference.filter_beliefs(compiled, scaled)
    assert not right.is_impossible.any()
    for method in METHODS:
        found = filter_beliefs(compiled, scaled, method)
        without = filter_beliefs(compiled, ordinary, method)
        np.testing.assert_array_equal(found.lane, without.lane)
        expected = without.log_evidence + is_scaled * 3 * exponent * np.log(2)
        np.testing.assert_allclose(found.log_evidence, expected, rtol=1e-14)
    exact = filter_beliefs(compiled, scaled)
    assert_same_beliefs(exact, right, 1e-12 * np.abs(right.log_evidence).max())
    path = viterbi(compiled, scaled)
    assert path.log_probability == pytest.approx(
        reference.path_probability(compiled, scaled, path.lane - 1), rel=1e-13
    )
    counts = expected_counts(compiled, scaled)
    assert counts.log_evidence == pytest.approx(right.log_evidence.sum(), rel=1e-13)
    for node, each in expected_counts(compiled, ordinary).counts.items():
        np.testing.assert_allclose(counts.counts[node], each, rtol=1e-12)


def three_groups() -> Compiled:
    """Lane with three observed children."""
    rng = np.random.default_rng(1)
    tables = [
        *prior("Lane", [0.2, 0.5, 0.3]),
        *dynamics("Lane", [previous("Lane")], rng.dirichlet(np.ones(3), 3)),
    ]
    for name in ("A", "B", "C"):
        tables += within(name, ["Lane"], rng.dirichlet(np.ones(2), 3))
    return compile_tables(tables, observed=("A", "B", "C"), hidden=("Lane",))


@every_method
@few
@given(seed=seeds)
def test_frame_by_frame_equals_the_whole_sequence(method: str, seed: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 15, np.random.default_rng(seed))
    whole = filter_beliefs(compiled, evidence, method)
    state = None
    for t in range(15):
        state, belief = step(compiled, state, evidence.take(slice(t, t + 1)), method)
        for name in compiled.hidden:
            np.testing.assert_allclose(
                belief.marginals[name][0], whole.marginals[name][t], rtol=0, atol=1e-13
            )
        np.testing.assert_allclose(belief.log_evidence[0], whole.log_evidence[t], atol=1e-12)
        assert belief.is_impossible[0] == whole.is_impossible[t]


@every_method
def test_stepping_leaves_the_earlier_state_as_it_was(method: str) -> None:
    compiled = template("sensor_failure", 4)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0), zeros=0)
    first, _ = step(compiled, None, evidence.take(slice(0, 1)), method)
    before = first.copy()
    _, once = step(compiled, first, evidence.take(slice(1, 3)), method)
    _, again = step(compiled, first, evidence.take(slice(1, 3)), method)
    np.testing.assert_array_equal(first, before)
    np.testing.assert_array_equal(once.lane, again.lane)


def test_hard_evidence_is_the_most_probable_value_and_a_tie_keeps_all_that_share_it() -> None:
    soft = Evidence({"D": np.array([[0.2, 0.5, 0.3], [0.4, 0.4, 0.2], [0.0, 0.0, 0.0]])})
    hard = harden(soft).likelihoods["D"]
    np.testing.assert_array_equal(hard[:2], [[0, 1, 0], [1, 1, 0]])
    nearly = Evidence({"D": np.array([[0.4, 0.4 * (1 - 1e-10), 0.2], [0.4, 0.4 - 1e-6, 0.2]])})
    np.testing.assert_array_equal(harden(nearly).likelihoods["D"], [[1, 1, 0], [1, 0, 0]])
    joint = Evidence({("A", "B"): np.array([[[0.1, 0.2], [0.4, 0.3]]])})
    np.testing.assert_array_equal(harden(joint).likelihoods["A", "B"], [[[0, 0], [1, 0]]])


@pytest.mark.parametrize(
    ("likelihoods", "message"),
    [
        ({"DetectorOutput": np.ones((2, 4))}, "observed node WOR: the evidence has nothing for it"),
        (
            {"DetectorOutput": np.ones((2, 4)), "WOR": np.ones((2, 2)), "GPS": np.ones((2, 4))},
            "evidence for GPS: the graph has no such observed node",
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
        filter_beliefs(template("sensor_failure", 4), Evidence(likelihoods))


def test_an_input_that_is_missing_unknown_or_out_of_range_is_refused() -> None:
    compiled, plain = template("position_in_lane", 2), template("sensor_failure", 4)
    moving, still = (draw_evidence(c, 2, np.random.default_rng(0)) for c in (compiled, plain))
    last = compiled.cardinality["LineMotion"] - 1
    for inputs, message in [
        ({}, "input node LineMotion: the evidence has nothing for it"),
        ({"LineMotoin": np.zeros(2, dtype=int)}, "input node LineMotion: the evidence has nothing"),
        ({"LineMotion": np.array([0, last + 1])}, rf"input LineMotion: outside 0\.\.{last}"),
        ({"LineMotion": np.array([-1, 0])}, rf"input LineMotion: outside 0\.\.{last}"),
    ]:
        with pytest.raises(InputError, match=message):
            filter_beliefs(compiled, Evidence(moving.likelihoods, inputs))
    with pytest.raises(InputError, match=r"filter 'exakt' \(did you mean 'exact'\?\)"):
        filter_beliefs(compiled, moving, "exakt")
    with pytest.raises(InputError, match="evidence for Speed: the graph has no such input node"):
        filter_beliefs(plain, Evidence(still.likelihoods, {"Speed": np.zeros(2, dtype=int)}))


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
    compiled = compile(declare(tables, observed), hidden=["Lane"], observed=observed)
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
    compiled = compile(
        declare(tables, ["D"]), hidden=["Lane"], observed=["D"], inputs=["InputA", "InputB"]
    )
    evidence = draw_evidence(compiled, 4, rng)
    right = brute_force(tables, ["Lane"], evidence, method)
    assert_same_beliefs(filter_beliefs(compiled, evidence, method), right)
