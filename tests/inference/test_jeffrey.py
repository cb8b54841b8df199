"""Soft evidence read by Jeffrey's rule: as the posterior of the observed node."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import compile, with_tables
from egolane_pgm.inference.filtering import filter_beliefs, read_evidence, step
from egolane_pgm.inference.layout import evidence_blocks
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    METHODS,
    any_compiled,
    assert_same_beliefs,
    draw_evidence,
    few,
    graph,
    graph_names,
    random_network,
    seeds,
    small_parameters,
    template,
)
from tests.kits.trajectories import enumerated_jeffrey
from tests.reference import inference as reference

every_method = pytest.mark.parametrize("method", METHODS)


@pytest.mark.parametrize("name", graph_names())
@every_method
def test_every_graph_agrees_with_weighting_all_trajectories(name: str, method: str) -> None:
    module = graph(name)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        tables = module.tables(2, small_parameters(name, 2, rng))
        compiled = with_tables(template(name, 2), tables)
        evidence = draw_evidence(compiled, 2, rng)
        right = enumerated_jeffrey(tables, module.HIDDEN, compiled.observed, evidence, method)
        posterior = read_evidence(evidence, "jeffrey")
        assert_same_beliefs(filter_beliefs(compiled, posterior, method), right)


@pytest.mark.parametrize("seed", range(20))
def test_random_networks_agree_with_weighting_all_trajectories(seed: int) -> None:
    """Nodes that are parents of one another, are observed jointly, or are hidden themselves."""
    drawn, compiled = random_network(seed)
    evidence = draw_evidence(compiled, 2, np.random.default_rng(seed))
    posterior = read_evidence(evidence, "jeffrey")
    for method in METHODS:
        right = enumerated_jeffrey(drawn.tables, drawn.hidden, compiled.observed, evidence, method)
        assert_same_beliefs(filter_beliefs(compiled, posterior, method), right)


@every_method
@few
@given(seed=seeds)
def test_kernel_and_twin_give_the_same(method: str, seed: int) -> None:
    compiled = any_compiled(seed)
    posterior = read_evidence(draw_evidence(compiled, 60, np.random.default_rng(seed)), "jeffrey")
    right = reference.filter_beliefs(compiled, posterior, method)
    assert_same_beliefs(filter_beliefs(compiled, posterior, method), right, 1e-10)


@every_method
@few
@given(seed=seeds)
def test_certain_evidence_is_the_same_however_it_is_read(method: str, seed: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 20, np.random.default_rng(seed), zeros=0)
    certain = {}
    for key, values in evidence.likelihoods.items():
        flat = values.reshape(len(values), -1)
        row = np.eye(flat.shape[1])[flat.argmax(axis=1)]
        certain[key] = row.reshape(values.shape)
    hard = Evidence(certain, evidence.inputs)
    if any(values[0].size == 1 for values in certain.values()):
        return  # a node of one value: ones are all that can be said
    right = filter_beliefs(compiled, hard, method)
    # Impossible evidence is found at another node of the frame, the flag is the same.
    ours = filter_beliefs(compiled, read_evidence(hard, "jeffrey"), method)
    assert_same_beliefs(ours, right, 1e-8)


def test_the_observed_node_is_afterwards_distributed_as_the_evidence_says() -> None:
    """Lane observed directly: whatever was believed, Lane's belief is the evidence."""
    stay = 0.9 * np.eye(3) + 0.1 / 3
    tables = [
        *prior("Lane", np.full(3, 1 / 3)),
        *dynamics("Lane", [previous("Lane")], stay),
        *within("Seen", ["Lane"], stay),
    ]
    network = declare(tables, ["Lane", "Seen"])
    compiled = compile(network, hidden=["Lane"], observed=["Lane", "Seen"])
    rows = _rng(1).dirichlet(np.ones(3), 10)
    said_of_seen = np.ones((10, 3))  # nothing
    posterior = read_evidence(Evidence({"Lane": rows, "Seen": said_of_seen}), "jeffrey")
    lane = filter_beliefs(compiled, posterior).lane
    np.testing.assert_allclose(lane, rows, rtol=0, atol=1e-12)


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@every_method
def test_evidence_equal_to_the_prediction_changes_nothing(method: str) -> None:
    compiled = template("lane_only", 4)
    start = read_evidence(Evidence({"DetectorOutput": np.array([[0.1, 0.2, 0.6, 0.1]])}), "jeffrey")
    state, _ = step(compiled, None, start, method)
    expected = state.joint @ compiled.transition[0]
    seen = expected @ compiled.groups[0].emission
    as_predicted = read_evidence(Evidence({"DetectorOutput": seen[None]}), "jeffrey")
    _, belief = step(compiled, state, as_predicted, method)
    np.testing.assert_allclose(belief.lane[0], expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(belief.log_evidence[0], np.log(seen @ seen), rtol=0, atol=1e-12)
    as_likelihood = Evidence({"DetectorOutput": seen[None]})
    _, other = step(compiled, state, as_likelihood, method)
    assert np.abs(other.lane[0] - expected).max() > 0.01


def test_a_row_of_ones_says_nothing_and_a_uniform_row_does() -> None:
    compiled = template("lane_only", 4)
    first = [0.97, 0.01, 0.01, 0.01]

    def second(row: list[float]) -> np.ndarray:
        rows = Evidence({"DetectorOutput": np.array([first, row])})
        return filter_beliefs(compiled, read_evidence(rows, "jeffrey")).lane

    silent = second([1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(silent[1], silent[0] @ compiled.transition[0], rtol=0, atol=1e-12)
    uniform = second([0.25, 0.25, 0.25, 0.25])
    assert uniform[1, 0] < silent[1, 0] - 0.1


@every_method
def test_values_that_were_impossible_stay_so_and_are_shared_out(method: str) -> None:
    tables = [
        *prior("Lane", [0.5, 0.5, 0.0]),
        *dynamics("Lane", [previous("Lane")], np.eye(3)),
        *within("Seen", ["Lane"], np.eye(3)),
    ]
    compiled = compile(declare(tables, ["Seen"]), hidden=["Lane"], observed=["Seen"])
    rows = np.array([[0.3, 0.1, 0.6]])
    posterior = read_evidence(Evidence({"Seen": rows}), "jeffrey")
    belief = filter_beliefs(compiled, posterior, method)
    np.testing.assert_allclose(belief.lane[0], [0.75, 0.25, 0.0], rtol=0, atol=1e-12)
    assert not belief.is_impossible[0]
    posterior = read_evidence(Evidence({"Seen": np.array([[0.0, 0.0, 1.0]])}), "jeffrey")
    belief = filter_beliefs(compiled, posterior, method)
    np.testing.assert_allclose(belief.lane[0], [0.5, 0.5, 0.0], rtol=0, atol=1e-12)
    assert belief.is_impossible[0]
    assert belief.log_evidence[0] == 0


@few
@given(seed=seeds)
def test_frame_by_frame_equals_the_whole_sequence_and_scale_does_not_matter(seed: int) -> None:
    compiled = any_compiled(seed)
    evidence = draw_evidence(compiled, 10, np.random.default_rng(seed))
    posterior = read_evidence(evidence, "jeffrey")
    whole = filter_beliefs(compiled, posterior)
    larger = Evidence({k: v * 1.5e308 for k, v in evidence.likelihoods.items()}, evidence.inputs)
    again = filter_beliefs(compiled, read_evidence(larger, "jeffrey"))
    assert_same_beliefs(again, whole, 1e-9)
    state = None
    for t in range(10):
        frame = posterior.take(slice(t, t + 1))
        state, belief = step(compiled, state, frame)
        for name in compiled.hidden:
            np.testing.assert_allclose(
                belief.marginals[name][0], whole.marginals[name][t], rtol=0, atol=1e-12
            )


def test_where_a_likelihood_is_needed_it_is_refused() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 3, _rng(0), zeros=0)
    with pytest.raises(InputError, match="Jeffrey's rule is no likelihood"):
        evidence_blocks(compiled, read_evidence(evidence, "jeffrey"))
