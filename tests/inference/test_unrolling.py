"""Frames as a pgmpy network: what pgmpy answers is what the exact filter believes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import quiet
from egolane_pgm.inference.compile import Compiled, with_initial_lane, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.inference.unrolling import Unrolled, unrolled
from egolane_pgm.model import compile_model
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import draw_evidence, graph_names, random_network, template
from tests.kits.drives import simulated


def ask(some: Unrolled, node: str) -> np.ndarray:
    with quiet():
        from pgmpy.inference import VariableElimination

        answer: Any = VariableElimination(some.network).query(
            [node], evidence=some.given, show_progress=False
        )
        return np.asarray(answer.values)


def assert_pgmpy_agrees(compiled: Compiled, evidence: Evidence, first: int, last: int) -> None:
    beliefs = filter_beliefs(compiled, evidence, "exact")
    some = unrolled(compiled, evidence, first, last)
    with quiet():
        assert some.network.check_model()
    for name in compiled.hidden:
        right = beliefs.marginals[name][last]
        np.testing.assert_allclose(ask(some, f"{name}@{last}"), right, atol=1e-10, err_msg=name)


SPANS = [(0, 0), (0, 2), (2, 2), (1, 4), (4, 4)]


@pytest.mark.parametrize("seed", range(12))
def test_pgmpy_gives_the_filter_s_belief_on_random_networks(seed: int) -> None:
    _, compiled = random_network(seed)
    evidence = draw_evidence(compiled, 5, np.random.default_rng(seed))
    for first, last in SPANS:
        assert_pgmpy_agrees(compiled, evidence, first, last)


@pytest.mark.parametrize("name", graph_names())
def test_pgmpy_gives_the_filter_s_belief_on_the_package_s_graphs(name: str) -> None:
    compiled = template(name, 3)
    evidence = draw_evidence(compiled, 5, np.random.default_rng(1))
    for first, last in SPANS:
        assert_pgmpy_agrees(compiled, evidence, first, last)


@pytest.mark.parametrize("name", ["sensor_failure", "position_in_lane"])
def test_a_start_lane_is_virtual_evidence_before_the_first_frame(name: str) -> None:
    """And it stays when the numbers of the tables change."""
    plain = template(name, 3)
    compiled = with_initial_lane(with_tables(plain, []), np.array([0.0, 0.3, 0.1]))
    evidence = draw_evidence(compiled, 4, np.random.default_rng(2), zeros=0)
    for first, last in ((0, 0), (0, 2), (1, 3)):
        assert_pgmpy_agrees(compiled, evidence, first, last)
    again = with_tables(compiled, compiled.tables.values())
    np.testing.assert_allclose(again.prior, compiled.prior, atol=1e-15)
    shares = compiled.prior[0] / plain.prior[0]
    lane = compiled.node_value["Lane"]
    np.testing.assert_allclose(shares[lane == 1], 3 * shares[lane == 2][0])
    assert (shares[lane == 0] == 0).all()


def test_an_earlier_frame_is_smoothed() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 6, np.random.default_rng(3), zeros=0)
    right = smooth_beliefs(compiled, evidence.take(slice(0, 5)))
    for first in (0, 2):
        some = unrolled(compiled, evidence, first, 4)
        for node in compiled.hidden:
            for frame in range(first, 5):
                answer = ask(some, f"{node}@{frame}")
                np.testing.assert_allclose(answer, right.marginals[node][frame], atol=1e-10)


def test_what_an_impossible_frame_shows_is_not_given() -> None:
    compiled = template("lane_only", 3)
    likelihood = np.array([[0.2, 0.8, 0.4], [0.0, 0.0, 0.0], [0.1, 0.5, 0.5]])
    evidence = Evidence({"DetectorOutput": likelihood})
    assert unrolled(compiled, evidence, 0, 2).given == {
        "DetectorOutput_ve@0": 1,
        "DetectorOutput_ve@2": 1,
    }
    for first in (0, 1, 2):
        assert_pgmpy_agrees(compiled, evidence, first, 2)


def test_nodes_and_values_have_their_names_and_frames_their_ids() -> None:
    experiment = simulated()
    model = compile_model(experiment)
    rng = np.random.default_rng(0)
    evidence = Evidence({"DetectorOutput": rng.random((4, 4)), "WOR": rng.random((4, 2))})
    # Frame 18 is missing: a step is from one recorded frame to the next.
    some = unrolled(model.compiled, evidence, 17, 19, frame_id=np.array([15, 17, 19, 20]))
    nodes = {"Lane", "SensorState", "DetectorOutput", "WOR", "DetectorOutput_ve", "WOR_ve"}
    past = {"Lane@15", "SensorState@15"}
    assert set(some.network.nodes()) == past | {f"{n}@{t}" for n in nodes for t in (17, 19)}
    assert ("Lane@15", "Lane@17") in some.network.edges()
    assert ("Lane@17", "Lane@19") in some.network.edges()
    assert some.network.get_cpds("Lane@17").state_names["Lane@15"] == ["1", "2", "3", "4"]
    assert some.network.get_cpds("SensorState@19").state_names["SensorState@19"] == ["OK", "BAD"]
    right = filter_beliefs(model.compiled, evidence, "exact").lane[2]
    np.testing.assert_allclose(ask(some, "Lane@19"), right, atol=1e-12)


def test_inputs_are_given_by_the_names_of_their_values() -> None:
    compiled = template("position_in_lane", 2)
    evidence = draw_evidence(compiled, 2, np.random.default_rng(0), zeros=0)
    value = compiled.values["LineMotion"][int(evidence.inputs["LineMotion"][1])]
    assert unrolled(compiled, evidence, 1, 1).given == {
        "LineMotion@1": value,
        "RoadPosition+SensorState_ve@1": 1,
    }


@pytest.mark.parametrize(
    ("first", "last", "message"),
    [
        (0, 7, "frame 7: the evidence has no such frame, its frames are 0 to 3"),
        (-1, 2, "frame -1: the evidence has no such frame"),
        (3, 2, "frames 3 to 2: the first one comes after the last"),
    ],
)
def test_frames_that_there_are_not_are_refused(first: int, last: int, message: str) -> None:
    compiled = template("lane_only", 3)
    evidence = draw_evidence(compiled, 4, np.random.default_rng(0))
    with pytest.raises(InputError, match=message):
        unrolled(compiled, evidence, first, last)
