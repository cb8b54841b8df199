"""Labels: the path through the beliefs, crossing frames, the review list, and their scores."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm import paper
from egolane_pgm.experiment import load_experiment
from egolane_pgm.labelling import (
    BELOW,
    BESIDE_S,
    CHANGE_WEIGHT,
    JOIN_S,
    Labels,
    crossed_lanes,
    doubted,
    label_experiment,
    label_scores,
    lane_path,
    note_of_holes,
)
from egolane_pgm.types import BoolArray, FloatArray, InputError, joined, runs_of
from tests.conftest import needs_compiler
from tests.evidence.line_geometry.test_rule import line_log
from tests.kits.drives import write_drive

ZERO_LABEL = paper.experiments_folder() / "zero_label.yaml"
BEYOND = paper.experiments_folder() / "beyond"


def simulated(**keys: Any) -> Labels:
    return label_experiment(load_experiment(ZERO_LABEL, {"recording.frames": [0, 300], **keys}))


def belief_of(shape: tuple[int, int], seed: int) -> FloatArray:
    return np.random.default_rng(seed).dirichlet(np.full(shape[1], 0.5), shape[0])


# --- the path ------------------------------------------------------------------------------------


@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 10_000))
def test_the_path_is_the_best_of_all_paths(n_frames: int, n_lanes: int, seed: int) -> None:
    belief = belief_of((n_frames, n_lanes), seed)

    def weight(path: tuple[int, ...]) -> float:
        steps = np.abs(np.diff(path)).sum()
        return float(np.log(belief[np.arange(n_frames), path]).sum()) + steps * np.log(
            CHANGE_WEIGHT
        )

    found = tuple(lane_path(belief) - 1)
    assert weight(found) == pytest.approx(
        max(map(weight, product(range(n_lanes), repeat=n_frames)))
    )


def test_a_belief_that_hovers_about_a_half_changes_lane_once() -> None:
    left = np.array([0.99, 0.98, 0.45, 0.55, 0.48, 0.6, 0.02, 0.01])
    belief = np.stack([left, 1 - left], axis=1)
    assert np.count_nonzero(np.diff(belief.argmax(axis=1))) == 5
    assert lane_path(belief).tolist() == [1, 1, 1, 1, 1, 1, 2, 2]


def test_a_lane_that_is_impossible_in_a_frame_is_left_there() -> None:
    belief = np.array([[1.0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, 1]])
    assert lane_path(belief).tolist() == [1, 1, 3, 3]


# --- crossing ------------------------------------------------------------------------------------


def places(position: list[float], n_lanes: int, cells: int = 8) -> dict[str, FloatArray]:
    """A belief that is sure of the car's place, lane widths from the road's left edge."""
    cell = np.minimum((np.array(position) * cells).astype(int), n_lanes * cells - 1)
    sure = np.eye(n_lanes * cells)[cell]
    lane = sure.reshape(len(cell), n_lanes, cells).sum(axis=2)
    return {"RoadPosition": sure, "Lane": lane}


def test_the_car_crosses_while_it_is_on_the_line_that_it_changes_over() -> None:
    # It comes near the line between lanes 2 and 3 without a change, and crosses that of 1 and 2.
    position = [1.5, 1.9, 1.5, 1.3, 1.2, 1.05, 0.95, 0.8, 0.7, 0.5]
    found = crossed_lanes(
        lane_path(places(position, 3)["Lane"]), np.arange(10) / 10, places(position, 3)
    )
    lane = np.minimum(np.floor(np.array(position)), 2).astype(int)
    expected = np.eye(3, dtype=bool)[lane]
    expected[[4, 5, 6, 7]] = [True, True, False]
    np.testing.assert_array_equal(found, expected)


def test_without_a_place_in_the_lane_a_second_around_the_change_is_crossing() -> None:
    lane = np.repeat([2, 1], [30, 30])
    belief = np.eye(2)[lane - 1]
    found = crossed_lanes(lane, np.arange(60) / 10, {"Lane": belief})
    assert runs_of(found.all(axis=1)) == [(20, 40)]
    assert BESIDE_S == 1.0


def test_a_change_over_two_lanes_may_be_in_either_of_the_three() -> None:
    lane = np.array([1, 1, 3, 3])
    found = crossed_lanes(lane, np.array([0.0, 5, 5.1, 10]), {"Lane": np.eye(4)[lane - 1]})
    expected = np.eye(4, dtype=bool)[lane - 1]
    expected[1:3, :3] = True
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("then", [60.0, -60.0])
def test_a_change_while_nothing_was_recorded_has_no_crossing_frames(then: float) -> None:
    lane = np.array([1, 1, 2, 2])
    time_s = np.array([0.0, 0.1, then, then + 0.1])
    found = crossed_lanes(lane, time_s, {"Lane": np.eye(2)[lane - 1]})
    np.testing.assert_array_equal(found, np.eye(2, dtype=bool)[lane - 1])


# --- the review list -----------------------------------------------------------------------------


def stretches_by_brute_force(marked: BoolArray, time_s: FloatArray) -> list[tuple[int, int]]:
    """Put every marked frame with the one before it if that is near enough, or next to it."""
    groups: list[list[int]] = []
    for k in np.flatnonzero(marked):
        is_next = groups and k == groups[-1][-1] + 1
        if is_next or (groups and 0 <= time_s[k] - time_s[groups[-1][-1]] <= JOIN_S):
            groups[-1].append(int(k))
        else:
            groups.append([int(k)])
    return [(group[0], group[-1] + 1) for group in groups]


@given(st.lists(st.tuples(st.booleans(), st.sampled_from([0.1, 0.6, 1.5, -9.0])), max_size=40))
def test_stretches_are_those_that_brute_force_finds(frames: list[tuple[bool, float]]) -> None:
    marked = np.array([is_marked for is_marked, _ in frames], dtype=bool)
    time_s = np.cumsum([step for _, step in frames])
    assert joined(marked, time_s, JOIN_S) == stretches_by_brute_force(marked, time_s)


def with_belief(labels: Labels, belief: FloatArray) -> Labels:
    marginals = {**labels.run.marginals, "Lane": belief}
    return replace(labels, run=replace(labels.run, marginals=marginals))


def test_frames_whose_label_is_not_sure_are_reviewed_but_for_lane_changes() -> None:
    labels = simulated()
    sure = np.eye(3)[labels.lane - 1]
    assert with_belief(labels, sure).review == ()
    belief = sure.copy()
    aside = np.flatnonzero(~labels.is_crossing)
    aside = aside[(aside > 10) & (aside < 290)]
    hard = [int(aside[0]), int(aside[-1])]
    other = labels.lane[hard] % 3
    belief[hard] *= 0.9
    belief[hard, other] += 0.1
    # The two lanes of a lane change share the belief.
    crossing = np.flatnonzero(labels.is_crossing)
    belief[crossing] = labels.possible[crossing] / 2
    found = with_belief(labels, belief).review
    assert [(each.start, each.stop) for each in found] == [(k, k + 1) for k in hard]
    for each, k, second in zip(found, hard, other, strict=True):
        assert (each.first, each.last) == (labels.frame_id[k],) * 2
        assert each.lanes == tuple(sorted((int(labels.lane[k]), int(second) + 1)))
        assert each.lowest == pytest.approx(0.9)
        assert each.expected_wrong == pytest.approx(0.1)


def test_a_frame_that_is_just_sure_enough_is_not_reviewed() -> None:
    labels = simulated()
    belief = np.eye(3)[labels.lane - 1] * (BELOW - 0.005) + 0.005
    assert not with_belief(labels, belief / belief.sum(axis=1, keepdims=True)).review
    found = with_belief(replace(labels, below=0.995), belief).review
    assert sum(map(len, found)) >= np.count_nonzero(~labels.is_crossing)


def test_the_review_says_what_makes_frames_hard() -> None:
    labels = simulated()
    log = labels.run.lines
    blind = log.is_valid.copy()
    blind[100:110] = False
    changed = replace(labels, run=replace(labels.run, lines=replace(log, is_valid=blind)))
    assert "no valid line in 100% of the frames" in changed.stretch(100, 110).why
    assert "no valid line" not in changed.stretch(110, 120).why or (~blind[110:120].any(1)).any()
    assert labels.stretch(0, 5).why.startswith("the recording begins")
    assert labels.stretch(295, 300).why.startswith("the recording ends")
    story = labels.story.copy()
    story[100:110] = labels.lane[100:110] % 3 + 1
    said = replace(labels, story=story).stretch(100, 110).why
    assert "the most probable single story is in lane" in said
    assert "for 10 frames" in said


# --- whole recordings ----------------------------------------------------------------------------


def test_a_labeller_looks_back() -> None:
    labels = simulated(filter="exact")
    assert labels.run.experiment.filter == "smoothed"
    assert labels.run.model.parameters["lane_width_m"] == "auto"
    np.testing.assert_array_equal(labels.run.assigned_lane, labels.lane)
    given = simulated(**{"parameters.lane_width_m": 3.4}).run.model
    assert given.parameters["lane_width_m"] == 3.4


@pytest.mark.parametrize("filter", [{"filter": "fixed_lag", "lag": 5}, {"unassigned_below": 0.5}])
def test_every_frame_gets_a_label(filter: dict[str, Any]) -> None:
    np.testing.assert_array_equal(simulated(**filter).lane, simulated().lane)


def test_a_graph_without_a_place_in_the_lane_labels_too(tmp_path: Path) -> None:
    labels = label_experiment(load_experiment(write_drive(tmp_path)))
    assert "RoadPosition" not in labels.run.beliefs.marginals
    assert labels.lane.min() >= 1
    assert labels.is_crossing.any()
    assert label_scores(labels)["surest"]["1"] > 0.5


@pytest.mark.parametrize("n_lanes", [1, 3])
def test_a_recording_of_one_frame_is_labelled(n_lanes: int) -> None:
    labels = simulated(**{"recording.frames": [7, 8], "n_lanes": n_lanes})
    assert labels.frame_id.tolist() == [7]
    assert 1 <= labels.lane[0] <= n_lanes
    assert not labels.is_crossing.any()
    assert len(labels.review) <= 1


@pytest.mark.parametrize("missing", ["skip", "hold", "predict"])
def test_missing_frames_are_labelled_where_they_are_put_in(missing: str, tmp_path: Path) -> None:
    path = write_drive(tmp_path, recording__missing_frames=missing)
    lines = (tmp_path / "lines.csv").read_text().splitlines()
    gone = tuple(f"{frame}," for frame in range(40, 60))
    kept = [line for line in lines if not line.startswith(gone)]
    assert len(kept) < len(lines)
    (tmp_path / "lines.csv").write_text("\n".join(kept) + "\n")
    labels = label_experiment(
        load_experiment(path, {"evidence": "line_geometry", "graph": "position_in_lane"})
    )
    is_there = np.isin(np.arange(40, 60), labels.frame_id)
    assert is_there.all() if missing != "skip" else not is_there.any()
    around = np.flatnonzero((labels.frame_id >= 38) & (labels.frame_id < 62))
    why = labels.stretch(int(around[0]), int(around[-1]) + 1).why
    # Frames that are held look like recorded ones.
    assert ("20 frames were not recorded" in why) == (missing != "hold")


@pytest.mark.parametrize("below", [-0.1, 1.1, float("nan")])
def test_a_threshold_that_is_no_probability_is_refused(below: float) -> None:
    with pytest.raises(InputError, match=r"below: .* is not a probability"):
        label_experiment(load_experiment(ZERO_LABEL), below)


def test_a_detector_that_misses_lines_of_its_own_lane_is_noted() -> None:
    places = np.array([-5.25, -1.75, 1.75, 5.25]) * np.ones((100, 1))
    places[:40, 1] = np.nan
    log = replace(line_log(places), source="drive.csv")
    said = note_of_holes(log)
    assert said is not None
    assert said.startswith("note: drive.csv: in 40% of the frames a line of the own lane is miss")
    assert note_of_holes(log.take(slice(20, 100))) is None
    # Of a camera of two lines none is seen beside the missing one.
    own = replace(log, is_valid=log.is_valid & (np.abs(places) < 3))
    assert note_of_holes(own) is None


# --- scores --------------------------------------------------------------------------------------


def test_scores_are_those_that_one_counts_by_hand() -> None:
    labels = simulated()
    truth = labels.run.truth
    assert truth is not None
    # Every seventh annotation is another lane than the label.
    lane = np.where(np.arange(300) % 7 == 0, labels.lane % 3 + 1, labels.lane)
    assert len(truth) == 300
    labels = replace(labels, run=replace(labels.run, true_lane=lane))
    keep = np.flatnonzero(~truth.is_crossing)
    order = keep[np.argsort(-labels.confidence[keep], kind="stable")]
    found = label_scores(labels)
    assert found["frames_scored"] == len(keep)
    for share, right in found["surest"].items():
        count = int(np.ceil(float(share) * len(keep)))
        while (
            count < len(keep)
            and labels.confidence[order[count]] == labels.confidence[order[count - 1]]
        ):
            count += 1
        assert right == pytest.approx(np.mean(lane[order[:count]] == labels.lane[order[:count]]))
    both = labels.is_crossing & truth.is_crossing
    assert found["crossing_precision"] == both.sum() / labels.is_crossing.sum()
    assert found["crossing_recall"] == both.sum() / truth.is_crossing.sum()
    alone = ~truth.is_crossing & ~labels.is_crossing & ~labels.is_reviewed
    assert found["unreviewed"] == pytest.approx(np.mean((lane == labels.lane)[alone]))
    assert found["wrong_unreviewed"] == np.count_nonzero((lane != labels.lane)[alone])
    suspect = doubted(labels)
    wrong = (lane != labels.lane) & ~truth.is_crossing & ~labels.is_crossing
    np.testing.assert_array_equal(suspect, wrong & (labels.confidence >= BELOW))
    assert suspect.any()


def test_without_ground_truth_there_are_no_scores(tmp_path: Path) -> None:
    labels = label_experiment(load_experiment(write_drive(tmp_path, ground_truth=None)))
    assert label_scores(labels) == {}
    assert not doubted(labels).any()


# --- the paper's recordings ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def real(recordings: Path) -> dict[str, Labels]:
    names = [f"{road}_{kind}" for road in ("italy", "spain") for kind in ("ml", "sl", "mc", "sc")]
    return {
        name: label_experiment(load_experiment(BEYOND / f"geometry_{name}.yaml")) for name in names
    }


@needs_compiler
def test_the_98_percent_that_are_surest_are_right(real: dict[str, Labels]) -> None:
    for name, labels in real.items():
        scores = label_scores(labels)
        assert scores["surest"]["0.98"] >= 0.9995, name
        assert scores["unreviewed"] >= 0.9999, name
        assert scores["reviewed"] <= 0.09, name


@needs_compiler
def test_only_the_italian_multi_lane_detector_is_noted(real: dict[str, Labels]) -> None:
    mark = "a line of the own lane is missing"
    assert not any(mark in note for labels in real.values() for note in labels.notes)
    labels = label_experiment(load_experiment(BEYOND / "geometry_italy_mld.yaml"))
    [said] = [note for note in labels.notes if mark in note]
    assert said in labels.document["warnings"]


@needs_compiler
def test_spain_s_annotation_is_doubted_where_its_label_jumps(real: dict[str, Labels]) -> None:
    for name, labels in real.items():
        suspect = labels.frame_id[doubted(labels)]
        if name.startswith("spain"):
            assert len(suspect) >= 10
            assert suspect.min() == 9577
        else:
            assert len(suspect) <= 3
