"""Scores on a road whose lanes begin and end."""

from __future__ import annotations

import numpy as np
import pytest

from egolane_pgm.scoring.road import road_scores
from egolane_pgm.types import LaneTruth


def test_frames_behind_a_change_are_scored_apart_and_lanes_are_counted_from_the_right() -> None:
    frames = np.arange(40)
    lane = np.full(40, 2)
    crossing = frames == 39
    n_lanes = np.where(frames < 20, 2, 3)
    assigned = np.where(frames < 10, 1, 2)
    assigned[25] = 0
    scores = road_scores(
        assigned,
        LaneTruth(frames, lane, crossing),
        n_lanes,
        np.array([20]),
        log_frames=frames,
        frame_rate=1.0,
    )
    assert scores["changes"] == 1
    assert scores["behind"] == {"frames": 10, "accuracy": 0.9}
    assert scores["elsewhere"] == {"frames": 29, "accuracy": pytest.approx(19 / 29)}
    assert scores["by_lanes"]["2"] == {"frames": 20, "accuracy": 0.5}
    # Rows: Lane 1 to 3 from the right, then Unassigned; columns: what is true.
    assert scores["from_right"] == [[10, 0, 0], [10, 18, 0], [0, 0, 0], [0, 1, 0]]


def test_a_drive_without_a_change_has_no_accuracy_behind_one() -> None:
    frames = np.arange(3)
    truth = LaneTruth(frames, np.ones(3, dtype=int), np.zeros(3, dtype=bool))
    scores = road_scores(
        np.ones(3, dtype=int),
        truth,
        np.full(3, 2),
        np.zeros(0, dtype=int),
        log_frames=frames,
        frame_rate=10.0,
    )
    assert scores["behind"] == {"frames": 0, "accuracy": None}
    assert scores["elsewhere"]["accuracy"] == 1.0
