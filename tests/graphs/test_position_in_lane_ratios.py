"""A frame that repeats is no evidence: lanes that predict the same lines keep their shares, apart
from what the prior mixes."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence.line_geometry.model import line_model, without_flags
from egolane_pgm.graphs.position_in_lane import moved
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import Model, compile_model, make_evidence
from egolane_pgm.types import Evidence, FloatArray, LineLog

JOINT = ("RoadPosition", "SensorState")
CELLS = 16
W = 3.6


@functools.cache
def model(n_lanes: int, start_lane: int | None = None) -> Model:
    start = {} if start_lane is None else {"start_lane": start_lane}
    return compile_model(load_experiment("zero_label", {"n_lanes": n_lanes, **start}))


def repeated(n_lanes: int, place: float, doubt: float, motion: list[int]) -> Evidence:
    """Frames whose lines show the place in the lane (0 to 1) and nothing of the lane.

    doubt: the likelihood of the other places.
    """
    away = (np.arange(CELLS) + 0.5) / CELLS - place
    away -= np.round(away)
    seen = np.tile(doubt + np.exp(-0.5 * (away / 0.1) ** 2), n_lanes)
    likelihood = np.broadcast_to(seen[:, None], (len(motion), len(seen), 2)).copy()
    return Evidence({JOINT: likelihood}, {"LineMotion": np.array(motion)})


def lanes(evidence: Evidence, n_lanes: int, start_lane: int | None = None) -> FloatArray:
    return filter_beliefs(model(n_lanes, start_lane).compiled, evidence).lane


@settings(max_examples=25, deadline=None)
@given(n_lanes=st.integers(2, 6), place=st.floats(0.3, 0.7), doubt=st.floats(0.3, 0.5))
@example(n_lanes=3, place=0.3, doubt=0.3)
def test_lanes_that_predict_the_same_lines_keep_their_ratios(
    n_lanes: int, place: float, doubt: float
) -> None:
    found = lanes(repeated(n_lanes, place, doubt, [24] * 3000), n_lanes)
    assert np.ptp(np.log(found), axis=1).max() < 0.2


@settings(max_examples=25, deadline=None)
@given(n_lanes=st.integers(3, 6), place=st.floats(0.0, 1.0), doubt=st.floats(0.3, 0.5))
@example(n_lanes=3, place=0.12, doubt=0.3)
def test_a_car_near_a_line_is_no_evidence_of_an_outer_lane(
    n_lanes: int, place: float, doubt: float
) -> None:
    """The outer lane whose edge is near may lose, as the car is rarely beyond the edge."""
    found = lanes(repeated(n_lanes, place, doubt, [24] * 3000), n_lanes)
    assert (found.max(axis=1) < 1 / n_lanes + 0.25).all()
    assert (found[:, [0, -1]] < 1 / (n_lanes - 1) + 0.05).all()


@settings(max_examples=15, deadline=None)
@given(n_lanes=st.integers(3, 5), lane=st.integers(1, 5), place=st.floats(0.25, 0.75))
@example(n_lanes=3, lane=2, place=0.27)
def test_the_lane_of_the_start_is_left_for_no_other(n_lanes: int, lane: int, place: float) -> None:
    lane = min(lane, n_lanes)
    found = lanes(repeated(n_lanes, place, 0.3, [24] * 3000), n_lanes, lane)
    assert (np.delete(found, lane - 1, axis=1) < 1 / n_lanes + 0.25).all()


@settings(max_examples=20, deadline=None)
@given(n_lanes=st.integers(1, 4), seed=st.integers(0, 2**32 - 1))
def test_a_mirrored_road_gives_the_mirrored_belief(n_lanes: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = rng.integers(0, 49, 40)
    evidence = Evidence(
        {JOINT: rng.random((40, n_lanes * CELLS, 2)) + 1e-3}, {"LineMotion": motion}
    )
    mirrored = Evidence(
        {JOINT: evidence.likelihoods[JOINT][:, ::-1].copy()}, {"LineMotion": 48 - motion}
    )
    found, other = lanes(evidence, n_lanes), lanes(mirrored, n_lanes)
    np.testing.assert_allclose(found, other[:, ::-1], rtol=0, atol=1e-9)


def drive(offsets: list[float], n_frames: int) -> LineLog:
    """The same lines in every frame, of a detector without flags."""
    offset_m = np.tile(np.array(offsets), (n_frames, 1))
    frame, valid = np.arange(n_frames), np.ones(offset_m.shape, dtype=bool)
    return LineLog(frame, frame / 10, offset_m, valid, ~valid, np.full(offset_m.shape, np.nan))


@pytest.mark.filterwarnings("ignore:line log")
@pytest.mark.parametrize("start_lane", [None, 2])
@pytest.mark.parametrize("off_m", [0.0, 0.8, 1.6])
def test_a_jam_is_no_evidence(off_m: float, start_lane: int | None) -> None:
    """Both own lines, for five minutes; the car is left of its lane's middle."""
    known = model(3, start_lane)
    log = drive([off_m - W / 2, off_m + W / 2], 3000)
    found = filter_beliefs(known.compiled, make_evidence(known, log)[0]).lane
    others = found if start_lane is None else np.delete(found, start_lane - 1, axis=1)
    assert (others < 1 / 3 + 0.25).all()


def test_smoothed_the_moves_off_the_road_are_left_out() -> None:
    """Rows sum to one, and a cell without a move on the road keeps its car."""
    parameters = {**model(2).parameters, "edges": "left_out"}
    found = moved(0.2, 2 * CELLS, CELLS, parameters)
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-12)
    # To the left by up to half a lane: from the first cell no move is on the road but to stay.
    assert found[0].argmax() == 0
    smoothed = load_experiment("zero_label", {"filter": "smoothed", "n_lanes": 2})
    assert compile_model(smoothed).parameters["edges"] == "left_out"


@pytest.mark.filterwarnings("ignore:line log")
def test_lanes_that_look_alike_to_a_camera_of_four_slots_keep_their_shares() -> None:
    five = model(5)
    evidence = make_evidence(five, drive([-1.5 * W, -W / 2, W / 2, 1.5 * W], 3000))[0]
    found = filter_beliefs(five.compiled, evidence).lane[-1]
    assert found[[0, 4]].max() < 0.01
    assert found[1:4].min() > 0.2


def test_without_flags_all_lines_look_alike() -> None:
    shares = without_flags(line_model(4, model(4).parameters)).class_shares
    assert (shares[:, 0] == 0).all()
    np.testing.assert_allclose(shares, np.broadcast_to(shares[0], shares.shape), rtol=1e-12)
