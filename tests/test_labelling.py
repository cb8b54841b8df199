"""Labels: the path through the beliefs, crossing frames, and the segments that are not sure."""

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
    label_experiment,
    lane_path,
)
from egolane_pgm.types import BoolArray, FloatArray, InputError, joined, runs_of
from tests.conftest import needs_compiler
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


# --- segments ----------------------------------------------------------------------------------


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


def segments(labels: Labels) -> list[tuple[int, int, int, float]]:
    names = ["first_frame", "last_frame", "frames", "lowest_confidence"]
    return list(labels.segments()[names].itertuples(index=False, name=None))


def test_segments_are_of_frames_whose_label_is_not_sure_but_for_lane_changes() -> None:
    labels = simulated()
    sure = np.eye(3)[labels.lane - 1]
    assert segments(with_belief(labels, sure)) == []
    belief = sure.copy()
    aside = np.flatnonzero(~labels.is_crossing)
    aside = aside[(aside > 10) & (aside < 290)]
    hard = [int(aside[0]), int(aside[-1])]
    belief[hard] *= 0.9
    belief[hard, labels.lane[hard] % 3] += 0.1
    # The two lanes of a lane change share the belief.
    crossing = np.flatnonzero(labels.is_crossing)
    belief[crossing] = labels.possible[crossing] / 2
    ids = labels.frame_id[hard].tolist()
    found = segments(with_belief(labels, belief))
    assert found == [(k, k, 1, pytest.approx(0.9)) for k in ids]


def test_a_frame_that_is_just_sure_enough_is_in_no_segment() -> None:
    labels = simulated()
    belief = np.eye(3)[labels.lane - 1] * (BELOW - 0.005) + 0.005
    assert not segments(with_belief(labels, belief / belief.sum(axis=1, keepdims=True)))
    found = with_belief(replace(labels, below=0.995), belief).segments()
    assert found["frames"].sum() >= np.count_nonzero(~labels.is_crossing)


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
    assert labels.run.scores["model"]["accuracy"] > 0.5


@pytest.mark.parametrize("n_lanes", [1, 3])
def test_a_recording_of_one_frame_is_labelled(n_lanes: int) -> None:
    labels = simulated(**{"recording.frames": [7, 8], "n_lanes": n_lanes})
    assert labels.frame_id.tolist() == [7]
    assert 1 <= labels.lane[0] <= n_lanes
    assert not labels.is_crossing.any()
    assert len(labels.segments()) <= 1


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


@pytest.mark.parametrize("below", [-0.1, 1.1, float("nan")])
def test_a_threshold_that_is_no_probability_is_refused(below: float) -> None:
    with pytest.raises(InputError, match=r"below: .* is not a probability"):
        label_experiment(load_experiment(ZERO_LABEL), below)


# --- the paper's recordings ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def real(recordings: Path) -> dict[str, Labels]:
    names = [f"{road}_{kind}" for road in ("italy", "spain") for kind in ("ml", "sl", "mc", "sc")]
    return {
        name: label_experiment(load_experiment(BEYOND / f"geometry_{name}.yaml")) for name in names
    }


@needs_compiler
def test_labels_that_are_sure_are_right(real: dict[str, Labels]) -> None:
    for name, labels in real.items():
        run, unsure = labels.run, labels.segments()
        assert run.truth is not None
        is_sure = ~labels.is_crossing
        for first, last in zip(unsure["first_frame"], unsure["last_frame"], strict=True):
            is_sure &= (labels.frame_id < first) | (labels.frame_id > last)
        is_right = labels.lane[run.scored] == run.truth.lane
        kept = is_sure[run.scored] & ~run.truth.is_crossing & (run.truth.frame_id < 9577)
        assert is_right[kept].mean() >= 0.9999, name
        assert unsure["frames"].sum() <= 0.1 * len(labels), name
