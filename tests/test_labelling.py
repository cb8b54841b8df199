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

from egolane_pgm.inference.events import across_lanes
from egolane_pgm.labelling import (
    BELOW,
    CHANGE_WEIGHT,
    NEAR_S,
    Labels,
    crossed_lanes,
    label_input,
    lane_path,
)
from egolane_pgm.loading import experiments_folder
from egolane_pgm.runs import open_input, table_inputs
from egolane_pgm.types import FloatArray, InputError, runs_of
from tests.conftest import needs_compiler
from tests.kits.drives import write_drive


def simulated(**keys: Any) -> Labels:
    return labelled("zero_label", {"recording.frames": [0, 300], **keys})


def labelled(given: Any, overrides: Any = None, *more: float) -> Labels:
    return label_input(open_input(given, overrides=overrides), *more)


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
    marginals = places(position, 3)
    lane, on_line = lane_path(marginals["Lane"]), across_lanes(marginals)[0]
    found = crossed_lanes(lane, np.arange(10) / 10, 3, on_line)
    expected = np.eye(3, dtype=bool)[np.minimum(np.floor(position), 2).astype(int)]
    expected[[4, 5, 6, 7]] = [True, True, False]
    np.testing.assert_array_equal(found, expected)


def test_without_a_place_in_the_lane_a_second_around_the_change_is_crossing() -> None:
    lane = np.repeat([2, 1], [30, 30])
    found = crossed_lanes(lane, np.arange(60) / 10, 2, None)
    assert runs_of(found.all(axis=1)) == [(20, 40)]
    assert NEAR_S == 1.0


def test_a_change_over_two_lanes_may_be_in_either_of_the_three() -> None:
    lane = np.array([1, 1, 3, 3])
    found = crossed_lanes(lane, np.array([0.0, 5, 5.1, 10]), 4, None)
    expected = np.eye(4, dtype=bool)[lane - 1]
    expected[1:3, :3] = True
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("then", [60.0, -60.0])
def test_a_change_while_nothing_was_recorded_has_no_crossing_frames(then: float) -> None:
    lane = np.array([1, 1, 2, 2])
    time_s = np.array([0.0, 0.1, then, then + 0.1])
    found = crossed_lanes(lane, time_s, 2, None)
    np.testing.assert_array_equal(found, np.eye(2, dtype=bool)[lane - 1])


# --- segments ----------------------------------------------------------------------------------


def test_segments_join_frames_below_the_confidence() -> None:
    labels = simulated()
    confidence = np.ones(300)
    confidence[[20, 25, 100, 200]] = [0.9, 0.8, 0.98, BELOW]
    found = replace(labels, frames=labels.frames.assign(confidence=confidence)).segments()
    names = ["first_frame", "last_frame", "frames", "lowest_confidence"]
    assert found[names].to_numpy().tolist() == [[20, 25, 6, 0.8], [100, 100, 1, 0.98]]


def test_while_a_line_is_crossed_both_lanes_are_right() -> None:
    labels = simulated()
    belief, frames = labels.run.node("Lane"), labels.frames
    own = belief[np.arange(300), frames["lane"] - 1]
    assert (frames["confidence"] >= own - 1e-12).all()
    aside = ~frames["is_crossing"]
    np.testing.assert_array_equal(frames["confidence"][aside], own[aside])


# --- whole recordings ----------------------------------------------------------------------------


def test_a_labeller_looks_back() -> None:
    labels = simulated(filter="exact")
    assert labels.run.experiment.filter == "smoothed"
    assert labels.run.model.parameters["lane_width_m"] == "auto"
    np.testing.assert_array_equal(labels.run.frames["assigned_lane"], labels.frames["lane"])
    given = simulated(**{"parameters.lane_width_m": 3.4}).run.model
    assert given.parameters["lane_width_m"] == 3.4


def test_a_graph_without_a_place_in_the_lane_labels_every_frame(tmp_path: Path) -> None:
    labels = labelled(write_drive(tmp_path), {"min_confidence": 0.5})
    assert "RoadPosition" not in labels.run.run["values"]
    assert labels.frames["lane"].min() >= 1
    assert labels.frames["is_crossing"].any()
    assert labels.run.scores["model"]["accuracy"] > 0.5


def test_a_threshold_is_a_probability() -> None:
    for below in (-0.1, 1.1, float("nan")):
        with pytest.raises(InputError, match=r"below: .* is not a probability"):
            labelled("zero_label", None, below)


# --- the paper's recordings ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def real(recordings: Path) -> dict[str, Labels]:
    table = experiments_folder() / "paper" / "recordings.csv"
    given = table_inputs("zero_label", table)
    return {
        each.experiment.name: label_input(each)
        for each in given
        if each.tags["detector"] in ("ml", "mc")
    }


@needs_compiler
def test_labels_that_are_sure_are_right(real: dict[str, Labels]) -> None:
    for name, labels in real.items():
        run, unsure = labels.run, labels.segments()
        frames = run.frames
        is_sure = ~labels.frames["is_crossing"].to_numpy()
        ids, lane = labels.frames.index, labels.frames["lane"].to_numpy()
        for first, last in zip(unsure["first_frame"], unsure["last_frame"], strict=True):
            is_sure &= (ids < first) | (ids > last)
        is_clear = (~frames["is_crossing"]).fillna(False).to_numpy(dtype=bool)
        kept = is_sure & is_clear & (ids < 9577)
        assert (lane == frames["true_lane"].to_numpy())[kept].mean() >= 0.9999, name
        assert unsure["frames"].sum() <= 0.11 * len(ids), name
