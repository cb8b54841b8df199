"""Lanes that begin, end, merge and split: the graph against the paper's, pgmpy and brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from egolane_pgm.graphs import changing_lanes, sensor_failure
from egolane_pgm.graphs.cpds import Table, lane_normals
from egolane_pgm.graphs.lane_steps import HOLD, PLACES, Step, passing, read_steps, survivors
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence, FloatArray, InputError
from tests.conformance.networks import METHODS, assert_filters_agree, brute_force
from tests.reference.oracle import oracle_assumed_density, oracle_filter

EXACT = {"map_wrong": 0.0, "place_sigma_m": 0.0}


def parameters(n_lanes: int, **given: object) -> Parameters:
    return resolve_parameters(changing_lanes.PARAMETERS, given, n_lanes)


def compiled(n_lanes: int, given: Parameters) -> Compiled:
    return compile(
        changing_lanes.build(n_lanes, given),
        hidden=changing_lanes.HIDDEN,
        observed=changing_lanes.OBSERVED,
        inputs=changing_lanes.INPUTS,
    )


def evidence(
    n_lanes: int, output: FloatArray, wor: FloatArray, step: list[int], **more: FloatArray
) -> Evidence:
    """Evidence that tells nothing of the number of lanes."""
    joint = np.repeat(output[:, :, None], n_lanes, axis=2)
    lane = more.get("lane", np.ones((len(output), n_lanes)))
    return Evidence(
        {("DetectorOutput", "Lanes"): joint, "WOR": wor, "Lane": lane}, {"Step": np.array(step)}
    )


def lane_table(given: Parameters, n_lanes: int) -> FloatArray:
    found: Table = next(t for t in changing_lanes.tables(n_lanes, given) if t.node == ("Lane", 1))
    return found.values


@pytest.mark.parametrize("normal", ["density", "integral"])
@pytest.mark.parametrize(("n", "n_lanes"), [(1, 1), (1, 3), (2, 5), (4, 4), (4, 6)])
def test_a_road_that_does_not_change_has_the_papers_table(
    n: int, n_lanes: int, normal: str
) -> None:
    given = parameters(n_lanes, steps=str(n), normal=normal, **EXACT)
    table = lane_table(given, n_lanes)[0, 0, 0, n - 1, n - 1]
    paper = lane_normals(given["sigma1"], n, normal)  # type: ignore[arg-type]
    np.testing.assert_allclose(table[:n, :n], paper, rtol=0, atol=1e-12)
    assert not table[:n, n:].any()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("n", "n_lanes"), [(1, 2), (3, 3), (3, 5), (4, 5)])
def test_on_a_road_that_does_not_change_the_belief_is_the_papers(
    n: int, n_lanes: int, method: str
) -> None:
    rng = np.random.default_rng(n)
    given = parameters(n_lanes, steps=str(n), **EXACT)
    output, wor = rng.random((40, n)), rng.random((40, 2))
    ours = filter_beliefs(
        compiled(n_lanes, given),
        evidence(n_lanes, np.pad(output, ((0, 0), (0, n_lanes - n))), wor, [0] * 40),
        method,
    )
    short = resolve_parameters(sensor_failure.PARAMETERS, {}, n)
    paper = compile(
        sensor_failure.build(n, short),
        hidden=sensor_failure.HIDDEN,
        observed=sensor_failure.OBSERVED,
    )
    right = filter_beliefs(paper, Evidence({"DetectorOutput": output, "WOR": wor}), method)
    np.testing.assert_allclose(ours.lane[:, :n], right.lane, rtol=0, atol=1e-12)
    assert not ours.lane[:, n:].any()
    sensor = right.marginals["SensorState"]
    np.testing.assert_allclose(ours.marginals["SensorState"], sensor, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.log_evidence, right.log_evidence, rtol=0, atol=1e-12)


CASES = {
    "a lane begins at the right": ("2 2>3+0 3", [0, 1, 2], 3),
    "a lane begins at the left": ("2 2>3+1 3", [0, 1, 2], 3),
    "a lane ends at the left": ("3 3>2-1 2", [0, 1, 2], 3),
    "an unknown side": ("3 3>2? 2", [0, 1, 2], 3),
    "an uncertain place": ("2 2>3+0@8 hold 2>3+0@9 3", [0, 1, 2, 3], 3),
    "a merge": ("1 1>3+2 3", [0, 1, 2], 3),
    "a guess of the same number": ("2 2>2?~ 2~ 2>2?", [0, 1, 2, 3], 3),
    "a change to a guess, and from it": ("2 2>3+1~ 3~ 3>2+0", [0, 1, 2, 3], 3),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("map_wrong", [0.0, 0.3])
def test_both_filters_agree_with_pgmpy_unrolled(case: str, map_wrong: float) -> None:
    steps, drive, n_lanes = CASES[case]
    rng = np.random.default_rng(len(case))
    given = parameters(n_lanes, steps=steps, map_wrong=map_wrong, map_stays=0.8)
    n_frames = len(drive)
    seen = Evidence(
        {
            ("DetectorOutput", "Lanes"): rng.random((n_frames, n_lanes, n_lanes)),
            "WOR": rng.random((n_frames, 2)),
            "Lane": rng.random((n_frames, n_lanes)),
        },
        {"Step": np.array(drive)},
    )
    network = changing_lanes.build(n_lanes, given)
    roles = (changing_lanes.HIDDEN, changing_lanes.OBSERVED, seen, changing_lanes.INPUTS)
    right = {
        "exact": oracle_filter(network, *roles),
        "assumed_density": oracle_assumed_density(network, *roles),
    }
    assert_filters_agree(compiled(n_lanes, given), seen, right)


@pytest.mark.parametrize("steps", ["1 1>2+1", "2 2>1?", "1 1>2+0@9"])
def test_the_exact_filter_agrees_with_brute_force(steps: str) -> None:
    rng = np.random.default_rng(len(steps))
    given = parameters(2, steps=steps, map_wrong=0.4, map_stays=0.7)
    seen = Evidence(
        {
            ("DetectorOutput", "Lanes"): rng.random((2, 2, 2)),
            "WOR": rng.random((2, 2)),
            "Lane": rng.random((2, 2)),
        },
        {"Step": np.array([0, 1])},
    )
    right = brute_force(changing_lanes.tables(2, given), changing_lanes.HIDDEN, seen, "exact")
    assert_filters_agree(compiled(2, given), seen, {"exact": right})


def test_a_step_maps_the_survivors_and_then_moves_as_the_paper() -> None:
    """P(Lane'=j | i) = sum over m of M[i, m] F_n'(N(m, sigma1))[j], written out."""
    n_lanes = 5
    for before, after in itertools.product(range(1, 5), repeat=2):
        for shift in {0, after - before, before, -before}:
            given = parameters(n_lanes, steps=f"{before}>{after}{shift:+d}", **EXACT)
            if before == after and shift == 0:
                given = parameters(n_lanes, steps=str(before), **EXACT)
            table = lane_table(given, n_lanes)[0, 0, 0, before - 1, after - 1]
            normals = lane_normals(0.4, after)
            for lane in range(1, before + 1):
                goes_on_as = min(max(lane + shift, 1), after)
                np.testing.assert_allclose(
                    table[lane - 1, :after], normals[goes_on_as - 1], rtol=0, atol=1e-15
                )
                assert not table[lane - 1, after:].any()


def test_a_lane_that_begins_is_empty_until_it_is_entered() -> None:
    given = parameters(3, steps="2 2>3+0 3", sigma1=0.1, sigma2=1.0, **EXACT)
    silent = evidence(3, np.ones((4, 3)), np.ones((4, 2)), [0, 1, 2, 2])
    belief = filter_beliefs(compiled(3, given), silent, "exact")
    np.testing.assert_allclose(belief.lane[1:], [[0.5, 0.5, 0]] * 3, atol=1e-12)
    there = np.array([[1, 1, 1]] * 2 + [[0.001, 0.001, 1]] * 8)
    given = parameters(3, steps="2 2>3+0 3", **EXACT)
    entered = evidence(3, there, np.tile([1.0, 0.1], (10, 1)), [0, 1] + [2] * 8)
    assert filter_beliefs(compiled(3, given), entered, "exact").lane[-1].argmax() == 2


def test_at_a_place_that_is_uncertain_both_roads_are_believed_by_their_chances() -> None:
    places = " ".join(f"2>3+0@{k}" for k in range(1, len(PLACES) + 1))
    given = parameters(3, steps=f"2 {places} hold 3", map_wrong=0.0)
    order = [0]
    for k in range(1, len(PLACES) + 1):
        order += [k, len(PLACES) + 1]
    order.append(len(PLACES) + 2)
    silent = evidence(3, np.ones((len(order), 3)), np.ones((len(order), 2)), order)
    belief = filter_beliefs(compiled(3, given), silent, "exact")
    changed = belief.marginals["Lanes"][:, 2]
    mass = np.exp(-0.5 * np.square(PLACES))
    np.testing.assert_allclose(changed[1:-1:2], mass.cumsum() / mass.sum(), atol=1e-12)
    np.testing.assert_allclose(changed[2:-1:2], changed[1:-1:2], atol=1e-12)
    assert changed[-1] == pytest.approx(1.0, abs=1e-12)
    assert passing()[-1] == pytest.approx(1.0)


def test_a_map_that_is_wrong_by_a_lane_is_found_and_stays_wrong_behind_a_change() -> None:
    given = parameters(5, steps="3 3>4+0 4", map_wrong=0.1, sigma2=0.5)
    n_frames = 60
    # The lines say 4 lanes where the map has 3, and then 5 where it has 4.
    joint = np.ones((n_frames, 5, 5))
    joint[:30, :, 3] *= 1.5
    joint[30:, :, 4] *= 1.5
    seen = Evidence(
        {
            ("DetectorOutput", "Lanes"): joint,
            "WOR": np.ones((n_frames, 2)),
            "Lane": np.ones((n_frames, 5)),
        },
        {"Step": np.array([0] * 30 + [1] + [2] * 29)},
    )
    lanes = filter_beliefs(compiled(5, given), seen, "exact").marginals["Lanes"]
    np.testing.assert_allclose(lanes[0], np.array([0, 0.05, 0.9, 0.075, 0]) / 1.025, atol=1e-12)
    assert lanes[29, 3] > 0.9
    assert lanes[-1, 4] > 0.9


def test_a_drive_that_begins_on_a_ramp_knows_its_lane_behind_the_merge() -> None:
    given = parameters(3, steps="1 1>3+2 3", sigma1=0.1, **EXACT)
    silent = evidence(3, np.ones((3, 3)), np.ones((3, 2)), [0, 1, 2])
    belief = filter_beliefs(compiled(3, given), silent, "exact")
    np.testing.assert_allclose(belief.lane, [[1, 0, 0], [0, 0, 1], [0, 0, 1]], atol=1e-12)


def test_a_number_that_is_a_guess_is_doubted_until_the_map_tells_one() -> None:
    steps = "3 3>3?~ 3~ 3>3?"
    order = [0, 0, 1, 2, 2, 3, 0]
    silent = evidence(4, np.ones((7, 4)), np.ones((7, 2)), order)
    given = parameters(4, steps=steps, guess_wrong=0.2, map_stays=1.0)
    lanes = filter_beliefs(compiled(4, given), silent, "exact").marginals["Lanes"]
    right = [[0, 0, 1, 0]] * 2 + [[0, 0.1, 0.8, 0.1]] * 3 + [[0, 0, 1, 0]] * 2
    np.testing.assert_allclose(lanes, right, atol=1e-12)
    assert changing_lanes.most_lanes(3, given) == 4
    assert changing_lanes.most_lanes(3, parameters(4, steps="3")) == 3


def test_the_lanes_of_a_belief_are_mirrored_with_the_road() -> None:
    rng = np.random.default_rng(3)
    roads = {1: "3 3>4+0 4 4>2-1 2", -1: "3 3>4+1 4 4>2-1 2"}
    drive, counts = [0, 0, 1, 2, 3, 4], [3, 3, 4, 4, 2, 2]
    output = rng.random((6, 4))
    flipped = np.zeros_like(output)
    for t, n in enumerate(counts):
        output[t, n:] = 0
        flipped[t, :n] = output[t, :n][::-1]
    wor = rng.random((6, 2))
    found = {}
    for side, seen in ((1, output), (-1, flipped)):
        given = parameters(4, steps=roads[side], **EXACT)
        found[side] = filter_beliefs(
            compiled(4, given), evidence(4, seen, wor, drive), "exact"
        ).lane
    for t, n in enumerate(counts):
        np.testing.assert_allclose(found[-1][t, :n], found[1][t, :n][::-1], atol=1e-12)


def test_lanes_that_do_not_serve_the_branch_that_was_taken_are_left() -> None:
    given = parameters(4, steps="4 4>2-2 2", **EXACT)
    served = np.ones((4, 4))
    served[1] = [0.02, 0.02, 0.98, 0.98]
    seen = evidence(4, np.ones((4, 4)), np.ones((4, 2)), [0, 0, 1, 2], lane=served)
    belief = filter_beliefs(compiled(4, given), seen, "exact")
    np.testing.assert_allclose(belief.lane[1, 2:].sum(), 0.98, atol=0.02)
    assert not belief.lane[2, 2:].any()


@pytest.mark.parametrize(
    "step",
    [
        Step(3, 3),
        Step(3, 4),
        Step(4, 3, -1),
        Step(2, 4, None),
        Step(2, 3, 1, 4),
        HOLD,
        Step(3, 3, is_guess=True),
        Step(3, 3, None, is_guess=True),
        Step(2, 3, 1, 4, is_guess=True),
    ],
)
def test_steps_are_written_as_they_are_read(step: Step) -> None:
    assert read_steps(str(step), 4) == (step,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3 x", "'x' is no step such as 3, 3>4"),
        ("3>4", "'3>4' is no step"),
        ("3>6+0", "lanes are outside 1..5"),
        ("0", "lanes are outside 1..5"),
        ("3>4+0@10", "'3>4+0@10' is no step"),
    ],
)
def test_what_is_no_step_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("+", r"\+")):
        read_steps(text, 5)


def test_survivors_are_ones_in_rows() -> None:
    np.testing.assert_array_equal(survivors(3, 2, -1), [[1, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(survivors(2, 4, 2), [[0, 0, 1, 0], [0, 0, 0, 1]])
