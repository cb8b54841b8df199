"""Position in lane where lanes begin, end, merge and split: against the graph of a fixed road,
pgmpy and the plain recursion."""

from __future__ import annotations

import numpy as np
import pytest

from egolane_pgm.graphs import position_in_changing_lanes as graph
from egolane_pgm.graphs import position_in_lane as fixed
from egolane_pgm.graphs.lane_steps import survivors
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.kernels.banded import find_band
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence, FloatArray, InputError
from tests.conformance.networks import (
    METHODS,
    assert_filters_agree,
    assert_same_beliefs,
    compiled_graph,
    draw_evidence,
)
from tests.reference import inference as reference
from tests.reference.oracle import oracle_assumed_density, oracle_filter

JOINT = ("RoadPosition", "SensorState")
SMALL = {"cells": 2, "motion_bins": 3}
N_MOTIONS = 3 + len(fixed.STEPS) * len(fixed.COASTING)


def resolved(n_lanes: int, **given: object) -> Parameters:
    return resolve_parameters(graph.PARAMETERS, given, n_lanes)


def compiled(n_lanes: int, parameters: Parameters) -> Compiled:
    return compiled_graph(graph, n_lanes, parameters)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("n", "n_lanes"), [(1, 2), (2, 4), (3, 3)])
def test_on_a_road_that_does_not_change_the_belief_is_that_of_position_in_lane(
    n: int, n_lanes: int, method: str
) -> None:
    given = resolved(n_lanes, steps=str(n), motion_bins=7)
    short = resolve_parameters(fixed.PARAMETERS, {"motion_bins": 7}, n)
    paper = compiled_graph(fixed, n, short)
    seen = draw_evidence(paper, 60, np.random.default_rng(n), zeros=0.0)
    motion = seen.inputs["LineMotion"]
    wide = np.pad(seen.likelihoods[JOINT], ((0, 0), (0, 16 * (n_lanes - n)), (0, 0)))
    step = graph.step_index(np.zeros(60, dtype=int), motion, n_lanes, given)
    ours = filter_beliefs(compiled(n_lanes, given), Evidence({JOINT: wide}, {"Step": step}), method)
    right = filter_beliefs(paper, seen, method)
    position = ours.marginals["RoadPosition"]
    np.testing.assert_allclose(
        position[:, : 16 * n], right.marginals["RoadPosition"], rtol=0, atol=1e-12
    )
    assert not position[:, 16 * n :].any()
    sensor = right.marginals["SensorState"]
    np.testing.assert_allclose(ours.marginals["SensorState"], sensor, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.log_evidence, right.log_evidence, rtol=0, atol=1e-9)


CASES = {
    "a lane begins at the right": ("1 1>2+0 2", [0, 1, 2], 2),
    "a lane begins at the left": ("1 1>2+1 2", [0, 1, 2], 2),
    "a lane ends at the left": ("2 2>1-1 1", [0, 1, 2], 2),
    "an unknown side": ("3 3>2? 2", [0, 1, 2], 3),
    "a merge": ("1 1>3+2 3", [0, 1, 2], 3),
    "a guess with a lane less, and more": ("2 2>2?~ 2~ 2>2?", [1, 2, 2, 3], 3),
}

#: How many lanes more there are than a guess says.
OFF = {"a guess with a lane less, and more": [0, -1, 1, 0]}


@pytest.mark.parametrize("case", CASES)
def test_both_filters_agree_with_pgmpy_unrolled(case: str) -> None:
    steps, told, n_lanes = CASES[case]
    rng = np.random.default_rng(len(case))
    given = resolved(n_lanes, steps=steps, jump=0.1, motion_sigma=0.4, **SMALL)
    network = compiled(n_lanes, given)
    seen = draw_evidence(network, len(told), rng, zeros=0.0)
    motion = rng.integers(N_MOTIONS, size=len(told))
    off = np.array(OFF.get(case, [0] * len(told)))
    seen.inputs["Step"][:] = graph.step_index(np.array(told), motion, n_lanes, given, off)
    roles = (graph.HIDDEN, graph.OBSERVED, seen, graph.INPUTS)
    declared = graph.build(n_lanes, given)
    right = {
        "exact": oracle_filter(declared, *roles),
        "assumed_density": oracle_assumed_density(declared, *roles),
    }
    assert_filters_agree(network, seen, right)


@pytest.mark.parametrize("method", METHODS)
def test_the_banded_kernel_equals_the_plain_recursion(method: str) -> None:
    given = resolved(3, steps="2 3 2>3+1 3>2+0 3>2-1 2>3?", motion_bins=5, cells=8)
    network = compiled(3, given)
    band = find_band(network)
    assert band is not None
    stays = N_MOTIONS + 2
    assert band.half[[*range(5), *range(stays, stays + 5)]].max() <= 4
    seen = draw_evidence(network, 80, np.random.default_rng(5), zeros=0.0)
    changes = np.arange(2 * stays, len(network.transition))
    seen.inputs["Step"][1:57:2] = changes
    right = reference.filter_beliefs(network, seen, method)
    assert_same_beliefs(filter_beliefs(network, seen, method), right, 1e-12)


@pytest.mark.parametrize(
    ("before", "after", "shift"), [(2, 3, 0), (2, 3, 1), (3, 2, -1), (4, 1, 0)]
)
def test_a_position_keeps_its_place_inside_the_lane_and_then_moves(
    before: int, after: int, shift: int
) -> None:
    given = resolved(4, steps=f"{before}>{after}{shift:+d}", cells=4)
    table = next(t for t in graph.tables(4, given) if t.node == ("RoadPosition", 1)).values
    for k, velocity in enumerate(fixed.COASTING):
        moved = fixed.moved(velocity, after * 4, 4, given)
        for lane, place in np.ndindex(before, 4):
            goes_on = int(np.clip(lane + shift, 0, after - 1)) * 4 + place
            row = table[lane * 4 + place, k]
            np.testing.assert_allclose(row[: after * 4], moved[goes_on], rtol=0, atol=1e-15)
            assert not row[after * 4 :].any()
    np.testing.assert_allclose(table.sum(axis=-1), 1, atol=1e-12)


def test_a_lane_that_begins_is_empty_until_it_is_entered() -> None:
    given = resolved(3, steps="2 2>3+0 3", jump=0.0)
    network = compiled(3, given)
    straight = int(given["motion_bins"]) // 2  # type: ignore[call-overload]
    told, motion = np.array([0, 0, 1, 2]), np.full(4, straight)
    likelihood = np.ones((4, 48, 2))
    likelihood[0] = 0.0
    likelihood[0, 16 + 8] = 1.0  # the middle of lane 2
    step = graph.step_index(told, motion, 3, given)
    lane = filter_beliefs(network, Evidence({JOINT: likelihood}, {"Step": step}), "exact").lane
    assert lane[2:, 2].max() < 0.01
    aside = np.concatenate([[straight] * 4, np.zeros(6, dtype=int)])  # the lines move to the left
    told = np.concatenate([told, np.full(6, 2)])
    likelihood = np.concatenate([likelihood, np.ones((6, 48, 2))])
    step = graph.step_index(told, aside, 3, given)
    lane = filter_beliefs(network, Evidence({JOINT: likelihood}, {"Step": step}), "exact").lane
    assert lane[-1].argmax() == 2


def test_beliefs_are_mirrored_with_the_road() -> None:
    rng = np.random.default_rng(3)
    roads = {1: "2 2>3+0 3 3>2+0", -1: "2 2>3+1 3 3>2-1"}
    told, counts = [0, 0, 1, 2, 2, 3, 0], [2, 2, 3, 3, 3, 2, 2]
    bins = 9
    motion = rng.integers(bins, size=len(told))
    likelihood = rng.random((len(told), 48, 2))
    flipped = np.zeros_like(likelihood)
    for t, n in enumerate(counts):
        likelihood[t, 16 * n :] = 0
        flipped[t, : 16 * n] = likelihood[t, : 16 * n][::-1]
    found = {}
    for side, seen, moves in ((1, likelihood, motion), (-1, flipped, bins - 1 - motion)):
        given = resolved(3, steps=roads[side], motion_bins=bins)
        step = graph.step_index(np.array(told), moves, 3, given)
        beliefs = filter_beliefs(compiled(3, given), Evidence({JOINT: seen}, {"Step": step}))
        found[side] = beliefs.marginals["RoadPosition"]
    for t, n in enumerate(counts):
        np.testing.assert_allclose(
            found[-1][t, : 16 * n], found[1][t, : 16 * n][::-1], rtol=0, atol=1e-12
        )


def test_each_frame_has_the_value_of_its_step_and_motion() -> None:
    given = resolved(3, steps="2 2>3+0 3", motion_bins=5)  # bins from -.2 to .2, .08 wide
    stays = fixed.motion_values(given)
    motion = np.array([0, 4, 2, 5 + 6, stays - 1, 3])
    told = np.array([0, 2, 1, 1, 1, 1])
    changes = stays + np.array([3, 6, 6, 6])
    np.testing.assert_array_equal(
        graph.step_index(told, motion, 3, given), [0, stays + 7 + 4, *changes]
    )


def test_a_guess_has_the_steps_of_a_lane_less_and_more_and_a_told_number_its_own() -> None:
    steps = "3 3>3?~ 3~ 3>3? 3>2-1 2"
    given = resolved(4, steps=steps, change_at_right=0.9, jump=0.0, **SMALL)
    tables = graph.tables(4, given)
    table = next(t for t in tables if t.node == ("RoadPosition", 1)).values
    np.testing.assert_allclose(table.sum(axis=-1), 1, atol=1e-12)
    as_told = {n: resolved(4, steps=str(n), jump=0.0, **SMALL) for n in (2, 3, 4)}
    plain = {
        n: next(t for t in graph.tables(4, p) if t.node == ("RoadPosition", 1)).values[:, 1]
        for n, p in as_told.items()
    }

    def moves(word: int, before: int, now: int) -> FloatArray:
        told, off = np.array([2, word]), np.array([before, now])
        return table[:, graph.step_index(told, np.array([1, 1]), 4, given, off)[1]]

    # The begin of a stretch, the guess, a lane less and more.
    for n, found in ((3, moves(1, 0, 0)), (3, moves(2, 0, 0)), (2, moves(2, -1, -1))):
        np.testing.assert_array_equal(found, plain[n])
    np.testing.assert_array_equal(moves(2, 1, 1), plain[4])
    # A lane that was not there is empty until it is entered; one that is not there any more is
    # the last one.
    wider = 0.9 * plain[4][:6] + 0.1 * plain[4][2:]
    np.testing.assert_allclose(moves(2, 0, 1)[:6], wider, atol=1e-12)
    np.testing.assert_allclose(moves(3, 1, 0)[6:], plain[3][4:6], atol=1e-12)
    # The map's side holds whatever the number.
    np.testing.assert_allclose(moves(4, 0, 0)[2:6], plain[2][:4], atol=1e-12)
    np.testing.assert_allclose(moves(4, 1, 0)[2:8], plain[2][[0, 1, 2, 3, 2, 3], :], atol=1e-12)
    np.testing.assert_allclose(moves(4, -1, 0)[:4], plain[2][[0, 1, 0, 1]], atol=1e-12)
    assert graph.most_lanes(3, given) == 4
    assert graph.most_lanes(4, given) == 4
    assert graph.most_lanes(3, resolved(3, steps="3")) == 3
    exact = resolved(3, steps="3 3>2-1 2", **SMALL)
    assert len(_motion(exact)) == 2 * N_MOTIONS + len(fixed.COASTING)


def _motion(given: Parameters) -> FloatArray:
    return next(t for t in graph.tables(3, given) if t.node == ("Step", 0)).values


@pytest.mark.parametrize("word", ["2>3+0@4", "hold"])
def test_places_around_a_change_are_refused(word: str) -> None:
    with pytest.raises(InputError, match="this graph takes the map's places for exact"):
        graph.tables(3, resolved(3, steps=f"2 {word}"))


def test_an_unknown_side_is_a_mixture() -> None:
    np.testing.assert_allclose(survivors(2, 1, None, 0.7), [[1.0], [1.0]])
    np.testing.assert_allclose(survivors(1, 2, None, 0.7), [[0.7, 0.3]])
