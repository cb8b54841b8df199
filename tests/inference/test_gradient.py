"""The gradient of the filter's log-loss: against central differences of the plain filter."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.expected_counts import FREE
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.gradient import LogLoss, log_loss_gradient
from egolane_pgm.studies.em import with_learned
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    compiled_graph,
    draw_evidence,
    draw_graph,
    draw_parameters,
    graph,
    seeds,
    template,
)
from tests.conftest import needs_compiler
from tests.reference import inference as reference

STEP = 1e-5


def loss_in_numpy(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, np.ndarray],
    is_first: np.ndarray,
    weight: np.ndarray,
) -> float:
    """The log-loss of one known node by the plain filter, sequence by sequence."""
    [(node, value)] = known.items()
    starts = [*np.flatnonzero(is_first), len(evidence)]
    total = 0.0
    for a, b in pairwise(starts):
        beliefs = reference.filter_beliefs(compiled, evidence.take(slice(a, b)))
        for row, v, w in zip(beliefs.marginals[node], value[a:b], weight[a:b], strict=True):
            total -= w * np.log(max(row[v], 1e-12)) if v != FREE else 0.0
    return total


def moved(compiled: Compiled, node: SliceNode, index: tuple[int, ...], step: float) -> Compiled:
    """The network with one entry of a table times exp(step), the row normalised again."""
    table = compiled.tables[node]
    values = table.values.copy()
    values[index] *= np.exp(step)
    values /= values.sum(axis=-1, keepdims=True)
    return with_learned(compiled, {node: Table(node, table.parents, values)})


def assert_gradient(compiled: Compiled, rng: np.random.Generator, n_frames: int) -> LogLoss:
    """Check some entries of each table, with inputs, sequences, weights and unknown values."""
    evidence = draw_evidence(compiled, n_frames, rng, zeros=0.1)
    node = str(rng.choice(compiled.hidden))
    value = rng.integers(compiled.cardinality[node], size=n_frames)
    known = {node: np.where(rng.random(n_frames) < 0.3, FREE, value)}
    is_first = (rng.random(n_frames) < 0.2) | (np.arange(n_frames) == 0)
    weight = rng.uniform(0, 2, n_frames)
    given = evidence, known, is_first
    found = log_loss_gradient(compiled, *given, weight=weight)
    right = loss_in_numpy(compiled, *given, weight)
    assert found.loss == pytest.approx(right, rel=1e-9, abs=1e-9)
    flags = filter_beliefs(compiled, evidence, is_first=is_first).is_impossible
    np.testing.assert_array_equal(found.is_impossible, flags)
    for of, gradient in found.gradient.items():
        values = compiled.tables[of].values
        assert (gradient[values == 0] == 0).all()
        by_logits = gradient - values * gradient.sum(axis=-1, keepdims=True)
        for index in map(tuple, rng.integers(values.shape, size=(3, values.ndim))):
            sides = [moved(compiled, of, index, step) for step in (STEP, -STEP)]
            high, low = (loss_in_numpy(side, *given, weight) for side in sides)
            slope = (high - low) / (2 * STEP)
            assert by_logits[index] == pytest.approx(slope, rel=1e-5, abs=1e-5), (of, index)
    return found


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_random_networks_agree_with_central_differences(seed: int) -> None:
    """Inputs, functions, joint evidence, observed nodes in the state, impossible frames."""
    rng = np.random.default_rng(seed)
    assert_gradient(draw_graph(rng).compiled(), rng, 12)


@needs_compiler
@pytest.mark.parametrize("n_frames", [40, 1200], ids=["any size", "of its size"])
def test_the_paper_s_graph_agrees_with_central_differences(n_frames: int) -> None:
    rng = np.random.default_rng(1)
    module = graph("sensor_failure")
    values = {**draw_parameters(module.parameters, 3, rng), "sigma1": 0.5, "sigma2": 0.8}
    values |= {"p1": 0.9, "p2": 0.8, "p3": 0.7, "p4": 0.6}
    found = assert_gradient(compiled_graph(module, 3, values), rng, n_frames)
    assert {*found.gradient} == {(n, 1) for n in ("SensorState", "DetectorOutput", "WOR")} | {
        ("Lane", 0),
        ("Lane", 1),
        ("SensorState", 0),
    }


def test_the_gradient_of_several_known_nodes_is_of_their_joint_value() -> None:
    compiled = template("sensor_failure", 3)
    rng = np.random.default_rng(0)
    evidence = draw_evidence(compiled, 30, rng, zeros=0)
    known = {"Lane": rng.integers(3, size=30), "SensorState": rng.integers(2, size=30)}
    found = log_loss_gradient(compiled, evidence, known)
    filtered, *_ = reference.forward(
        compiled, *reference.state_likelihood(compiled, evidence), np.zeros(30, dtype=int), "exact",
        None,
    )  # fmt: skip
    agrees = [known[node][:, None] == compiled.node_value[node] for node in known]
    right = (filtered * np.logical_and(*agrees)).sum(axis=1)
    np.testing.assert_allclose(found.probability, right, rtol=1e-9)


def test_frames_without_known_values_have_no_loss_and_no_gradient() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 30, np.random.default_rng(0))
    found = log_loss_gradient(compiled, evidence, {"Lane": np.full(30, FREE)})
    assert found.loss == 0
    assert all((gradient == 0).all() for gradient in found.gradient.values())


def test_known_values_of_a_node_that_is_not_hidden_are_refused() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(0))
    with pytest.raises(InputError, match="known values of WOR, which is no hidden node"):
        log_loss_gradient(compiled, evidence, {"WOR": np.zeros(3, dtype=int)})
