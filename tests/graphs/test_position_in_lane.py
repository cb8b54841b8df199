"""The graph with a hidden position inside the lane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.graphs import position_in_lane as graph
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import filter_beliefs, step
from egolane_pgm.inference.kernels.banded import find_band
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence
from tests.conformance.networks import (
    METHODS,
    assert_same_beliefs,
    brute_force,
    compiled_graph,
    draw_evidence,
    draw_parameters,
)
from tests.reference import inference as reference

JOINT = ("RoadPosition", "SensorState")
SMALL = {"cells": 3, "motion_bins": 3}


def resolved(n_lanes: int, **given: object) -> Parameters:
    return resolve_parameters(graph.PARAMETERS, given, n_lanes)


def compiled(n_lanes: int, parameters: Parameters) -> Compiled:
    return compiled_graph(graph, n_lanes, parameters)


def silent(network: Compiled, motion: list[int]) -> Evidence:
    """Frames whose lines say nothing, so that only the motion acts."""
    n_positions = network.cardinality["RoadPosition"]
    return Evidence(
        {JOINT: np.ones((len(motion), n_positions, 2))}, {"LineMotion": np.array(motion)}
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_small_road_agrees_with_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = draw_parameters(graph.PARAMETERS, 2, rng)
    parameters = {**drawn, **resolved(2, **SMALL), "p1": drawn["p1"], "p2": drawn["p2"]}
    network = compiled(2, parameters)
    evidence = draw_evidence(network, 3, rng)
    for method in METHODS:
        right = brute_force(graph.tables(2, parameters), graph.HIDDEN, evidence, method)
        assert_same_beliefs(filter_beliefs(network, evidence, method), right)


def test_lane_is_the_lane_of_the_cell() -> None:
    network = compiled(3, resolved(3, **SMALL))
    beliefs = filter_beliefs(network, draw_evidence(network, 20, np.random.default_rng(1)), "exact")
    position = beliefs.marginals["RoadPosition"].reshape(20, 3, 3)
    np.testing.assert_allclose(beliefs.lane, position.sum(axis=2), atol=1e-12)


@pytest.mark.parametrize("cells", [8, 16])
@pytest.mark.parametrize("method", METHODS)
def test_the_banded_kernel_equals_the_plain_recursion(cells: int, method: str) -> None:
    rng = np.random.default_rng(cells)
    network = compiled(4, resolved(4, cells=cells, motion_bins=7))
    assert find_band(network) is not None
    evidence = draw_evidence(network, 60, rng)
    # Every input, and likelihoods at the ends of what can be represented.
    evidence.inputs["LineMotion"][:16] = np.arange(16)
    evidence.likelihoods[JOINT][20] = 1e-300 * rng.random(evidence.likelihoods[JOINT][20].shape)
    evidence.likelihoods[JOINT][21] = 1e300 * rng.random(evidence.likelihoods[JOINT][21].shape)
    right = reference.filter_beliefs(network, evidence, method)
    assert right.is_impossible.any()
    assert_same_beliefs(filter_beliefs(network, evidence, method), right, 1e-12)
    state, answers = None, []
    for t in range(len(evidence)):
        state, now = step(network, state, evidence.take(slice(t, t + 1)), method)
        answers.append(now.lane[0])
    np.testing.assert_allclose(np.stack(answers), right.lane, rtol=0, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_lanes=st.integers(1, 4))
def test_every_parameter_gives_rows_that_sum_to_one(seed: int, n_lanes: int) -> None:
    parameters = draw_parameters(graph.PARAMETERS, n_lanes, np.random.default_rng(seed))
    for table in graph.tables(n_lanes, parameters):
        np.testing.assert_allclose(table.values.sum(axis=-1), 1, atol=1e-12)


def test_lines_that_drift_to_the_left_carry_the_vehicle_into_the_lane_to_the_right() -> None:
    parameters = resolved(3)
    network = compiled(3, parameters)
    start = np.full((1, 48, 2), 1e-9)
    start[0, 8] = 1.0  # the middle of lane 1
    bins = int(parameters["motion_bins"])  # type: ignore[arg-type]
    displacement = np.full(10, -0.11)  # lane widths per frame; gain .9: one lane in ten frames
    ones, others = np.ones(10, dtype=int), np.zeros(10, dtype=bool)
    motion = graph.motion_index(displacement, ones, np.zeros(10), others, parameters)
    assert (motion < bins // 2).all()
    evidence = silent(network, [bins // 2, *motion.tolist()])
    evidence.likelihoods[JOINT][0] = start
    lane = filter_beliefs(network, evidence, "exact").lane
    assert lane[0].argmax() == 0
    assert lane[-1].argmax() == 1
    assert lane[-1, 1] > 0.9


@pytest.mark.parametrize("shows_own", [True, False])
@pytest.mark.parametrize("velocity", [-0.05, -0.02, 0.0, 0.03])
@pytest.mark.parametrize("missing", [1, 2, 5, 7, 9, 11, 15, 23])
def test_a_vehicle_goes_on_over_absent_frames_as_it_does_over_frames_without_lines(
    missing: int, velocity: float, shows_own: bool
) -> None:
    """Up to the width of the intervals of LineMotion."""
    parameters = resolved(5)
    network = compiled(5, parameters)
    start = np.zeros((80, 2))
    start[37 if velocity < 0 else 42] = 1
    left = velocity * graph.KEPT_VELOCITY ** np.arange(missing + 1)
    lanes = []
    for ticks, before in (
        (np.array([1, missing + 1]), np.array([0.0, velocity])),
        (np.ones(missing + 2, dtype=int), np.array([0.0, *left])),
    ):
        unknown, shown = np.full(len(ticks), np.nan), np.full(len(ticks), shows_own)
        motion = graph.motion_index(unknown, ticks, before, shown, parameters)
        evidence = silent(network, motion.tolist())
        evidence.likelihoods[JOINT][0] = start
        lanes.append(filter_beliefs(network, evidence, "exact").lane[-1])
    np.testing.assert_allclose(lanes[0], lanes[1], atol=0.12)


def test_a_frame_without_a_tick_changes_nothing() -> None:
    network = compiled(3, resolved(3))
    evidence = silent(network, [0, 98, 98])
    evidence.likelihoods[JOINT][0] = np.random.default_rng(0).random((48, 2))
    found = filter_beliefs(network, evidence, "exact").lane
    np.testing.assert_allclose(found[1:], found[[0, 0]], atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_value_of_the_motion_is_that_of_its_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parameters = resolve_parameters(graph.PARAMETERS, {}, 3)
    n_bins, reach = int(parameters["motion_bins"]), graph.MOTION_RANGE
    displacement = rng.normal(0, reach, 40)
    displacement[rng.random(40) < 0.2] = np.nan
    velocity = rng.choice([0.05, 0.01, -0.03, 0.09, -1.0], 40) * rng.choice([1, rng.random()], 40)
    ticks = rng.choice([0, 1, 1, 1, 2, 5, 11, 60, 300], 40)
    shows_own = rng.random(40) < 0.5
    known = np.abs(displacement) < reach
    share = (np.where(known, displacement, 0) / reach + 1) / 2
    seen = np.minimum((share * n_bins).astype(np.int64), n_bins - 1) + n_bins * (ticks > 1)
    passed = np.abs(np.log(np.maximum(ticks, 1)[:, None] / graph.TICKS)).argmin(axis=1)
    way = [(1 - graph.KEPT_VELOCITY ** np.array(k)) for k in (ticks, np.array(graph.TICKS)[passed])]
    middle, most = len(graph.COASTING) // 2, graph.COASTING[-1]
    coasting = np.rint(np.clip(velocity * way[0] / way[1] / most, -1, 1) * middle) + middle
    passed += np.where(shows_own, 0, len(graph.TICKS))
    unseen = 2 * n_bins + 1 + passed * len(graph.COASTING) + coasting.astype(np.int64)
    expected = np.select([ticks == 0, known], [2 * n_bins, seen], unseen)
    found = graph.motion_index(displacement, ticks, velocity, shows_own, parameters)
    np.testing.assert_array_equal(found, expected)
    assert found.max() < graph.motion_values(parameters)
