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
    motion = graph.motion_index(displacement, np.ones(10, dtype=int), np.zeros(10), parameters)
    assert (motion < bins // 2).all()
    evidence = silent(network, [bins // 2, *motion.tolist()])
    evidence.likelihoods[JOINT][0] = start
    lane = filter_beliefs(network, evidence, "exact").lane
    assert lane[0].argmax() == 0
    assert lane[-1].argmax() == 1
    assert lane[-1, 1] > 0.9


def gap_and_frames(
    network: Compiled, missing: int, velocity: float, parameters: Parameters
) -> tuple[Evidence, Evidence]:
    """Two frames with a gap between them, and the same with the frames of the gap, in which the
    lines go on."""
    steps = np.array([1, missing + 1])
    before = np.array([0.0, velocity])
    gap = graph.motion_index(np.array([np.nan, 0.05]), steps, before, parameters)
    left = velocity * 0.98 ** np.arange(missing + 1)
    unknown = np.full(missing + 2, np.nan)
    ones = np.ones(missing + 2, dtype=int)
    frames = graph.motion_index(unknown, ones, np.array([0.0, *left]), parameters)
    return silent(network, gap.tolist()), silent(network, frames.tolist())


@pytest.mark.parametrize("velocity", [-0.06, -0.04, -0.02, 0.02, 0.04, 0.06])
@pytest.mark.parametrize("missing", [1, 2, 5, 7, 9, 11, 15, 23])
def test_a_vehicle_goes_on_over_a_gap_as_it_does_over_frames_without_lines(
    missing: int, velocity: float
) -> None:
    """Up to the width of the intervals of LineMotion."""
    parameters = resolved(5)
    network = compiled(5, parameters)
    start = np.zeros((80, 2))
    start[8 if velocity < 0 else 72] = 1
    lanes = []
    for evidence in gap_and_frames(network, missing, velocity, parameters):
        evidence.likelihoods[JOINT][0] = start
        lanes.append(filter_beliefs(network, evidence, "exact").lane[-1])
    np.testing.assert_allclose(lanes[0], lanes[1], atol=0.06)


def test_the_value_of_line_motion() -> None:
    parameters = resolved(3, motion_bins=4)
    values = [
        # Displacement, steps, velocity and value.
        (-0.19, 1, 0.0, 0),
        (-0.01, 1, 0.19, 1),
        (0.01, 1, -0.19, 2),
        (0.19, 1, 0.0, 3),
        # Out of range or unknown: as of late.
        (0.2, 1, -0.01, 1),
        (np.nan, 1, 0.01, 2),
        (np.nan, 1, -0.15, 0),
        (np.nan, 1, 0.9, 3),
        # After a gap: how many frames, and how the lines moved.
        (0.01, 2, 0.0, 4 + 3),
        (np.nan, 2, -0.06, 4),
        (np.nan, 2, -9.0, 4),
        (np.nan, 2, 0.06, 4 + 6),
        (np.nan, 3, -0.021, 4 + 7 + 2),
        (np.nan, 5, 0.0, 4 + 7 * graph.STEPS.index(6) + 3),
        (np.nan, 10_000, 0.039, 4 + 7 * (len(graph.STEPS) - 1) + 5),
    ]
    displacement, steps, velocity, value = (
        np.array(column) for column in zip(*values, strict=True)
    )
    index = graph.motion_index(displacement, steps, velocity, parameters)
    assert index.tolist() == value.tolist()
    assert graph.motion_values(parameters) == 4 + 7 * len(graph.STEPS)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_value_of_the_motion_is_that_of_its_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parameters = resolve_parameters(graph.PARAMETERS, {}, 3)
    n_bins, reach = int(parameters["motion_bins"]), graph.MOTION_RANGE
    displacement = rng.normal(0, reach, 40)
    displacement[rng.random(40) < 0.2] = np.nan
    velocity = rng.choice([0.05, 0.01, -0.03, 0.09, -1.0], 40) * rng.choice([1, rng.random()], 40)
    steps = rng.choice([1, 1, 1, 2, 5, 11, 64, 300], 40)
    moved = np.where(np.abs(displacement) < reach, displacement, velocity)
    index = ((np.clip(moved, -reach, reach) / reach + 1) / 2 * n_bins).astype(np.int64)
    passed = np.minimum(np.searchsorted(graph.STEPS, steps), len(graph.STEPS) - 1)
    middle, most = len(graph.COASTING) // 2, graph.COASTING[-1]
    coasting = np.rint(np.clip(velocity / most, -1, 1) * middle).astype(np.int64) + middle
    after_gap = n_bins + passed * len(graph.COASTING) + coasting
    expected = np.where(steps == 1, np.minimum(index, n_bins - 1), after_gap)
    found = graph.motion_index(displacement, steps, velocity, parameters)
    np.testing.assert_array_equal(found, expected)
