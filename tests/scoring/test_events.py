"""How right lane changes are detected: against every possible matching, and by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.scoring.events import (
    TOLERANCES_S,
    Reported,
    event_delays,
    lane_changes,
    match_events,
    score_events,
)
from egolane_pgm.types import lane_truth


def events_at(*detected: tuple[int, int, int]) -> pd.DataFrame:
    """Events (frame in which it is reported, lane left, lane entered)."""
    frame, left, entered = np.array(detected, dtype=np.int64).reshape(-1, 3).T
    return pd.DataFrame(
        {
            "frame_id": frame,
            "time_s": frame / 10,
            "from_lane": left,
            "to_lane": entered,
            "direction": np.sign(entered - left),
            "detected_frame_id": frame,
            "detected_time_s": frame / 10,
        }
    )


def truth_of(lanes: str, crossing: str, first: int = 0) -> pd.DataFrame:
    """A character per frame: the lane, and x where it is crossing."""
    frame_id = np.arange(first, first + len(lanes))
    lane, flag = np.array([int(c) for c in lanes]), np.array([c == "x" for c in crossing])
    return lane_truth(frame_id, lane, flag)


#: Crossing in frames 100 to 119, the label changes in frame 110; lane 2 from frame 120 on.
ONE = truth_of("1" * 110 + "2" * 90, "." * 100 + "x" * 20 + "." * 80)


def scored(events: pd.DataFrame, truth: pd.DataFrame = ONE) -> dict[str, Any]:
    return score_events([Reported(events, truth)], 10.0)


@pytest.mark.parametrize(
    ("frame", "right"),
    [
        (79, (0, 0, 0)),
        (80, (0, 0, 1)),
        (89, (0, 0, 1)),
        (90, (0, 1, 1)),
        (95, (1, 1, 1)),
        (100, (1, 1, 1)),
        (120, (1, 1, 1)),
        (125, (1, 1, 1)),
        (126, (0, 1, 1)),
        (140, (0, 0, 1)),
        (141, (0, 0, 0)),
    ],
)
def test_an_event_is_right_inside_the_crossing_and_a_tolerance_around_it(
    frame: int, right: tuple[int, ...]
) -> None:
    scores = scored(events_at((frame, 1, 2)))
    assert tuple(found["right"] for found in scores["within"].values()) == right
    assert list(scores["within"]) == ["0.5", "1", "2"]


def test_the_delay_is_counted_from_the_end_of_the_crossing() -> None:
    assert event_delays(events_at((110, 1, 2)), ONE, 10.0).tolist() == [-1.0]
    assert event_delays(events_at((123, 1, 2)), ONE, 10.0).tolist() == [0.3]
    assert np.isnan(event_delays(events_at((150, 1, 2)), ONE, 10.0)).all()


def test_several_drives_are_scored_as_one_with_their_counts_added() -> None:
    other = truth_of("2" * 50, "." * 50)
    drives = [
        Reported(events_at((110, 1, 2)), ONE),
        Reported(events_at((10, 2, 1)), other),
    ]
    both, alone = score_events(drives, 10.0), score_events(drives[:1], 10.0)
    assert both["delay_s"] == alone["delay_s"]
    assert both["hours"] == pytest.approx(250 / 10 / 3600)
    found = both["within"]["1"]
    assert (found["right"], found["false"], found["missed"]) == (1, 1, 0)


def test_an_event_takes_the_change_that_leaves_the_other_to_the_next_event() -> None:
    # 1 to 2 in frames 10 and 20: the first event could be either, the second the later one only.
    truth = truth_of("1" * 10 + "2" * 5 + "1" * 5 + "2" * 40, "." * 60)
    found = match_events(events_at((15, 1, 2), (36, 1, 2)), truth, 10.0, 2.0)
    assert found.tolist() == [0, 2]


ABORTED = truth_of("1" * 50, "." * 20 + "x" * 5 + "." * 25)

#: Frames before 1000 are not annotated; the truth begins and ends in a crossing.
INSIDE = truth_of("1" * 40, "x" * 10 + "." * 20 + "x" * 10, first=1000)


@pytest.mark.parametrize(
    ("truth", "events", "right", "false", "missed"),
    [
        # Both lanes must be the true ones.
        (ONE, [(110, 2, 1)], 0, 1, 1),
        (ONE, [(110, 1, 3)], 0, 1, 1),
        (ONE, [(110, 3, 2)], 0, 1, 1),
        # A change there and back that the car does not make; two events for one change.
        (ONE, [(30, 1, 2), (50, 2, 1), (118, 1, 2)], 1, 2, 0),
        (ONE, [(105, 1, 2), (115, 1, 2)], 1, 1, 0),
        # An aborted crossing is no change.
        (ABORTED, [(22, 1, 2), (24, 2, 1)], 0, 2, 0),
        # Only between the first and the last non-crossing frame, in annotated frames.
        (INSIDE, [(5, 1, 2), (1004, 2, 1), (1035, 1, 2)], 0, 0, 0),
        (INSIDE, [(1015, 1, 2)], 0, 1, 0),
        (ONE.take(np.r_[0:20, 60:200]), [(40, 1, 2), (70, 1, 2)], 0, 1, 1),
        (truth_of("111", "xxx"), [(1, 1, 2)], 0, 0, 0),
    ],
)
def test_right_false_and_missed(
    truth: pd.DataFrame, events: list[Any], right: int, false: int, missed: int
) -> None:
    scores = scored(events_at(*events), truth)
    found = scores["within"]["2"]
    assert (found["right"], found["false"], found["missed"]) == (right, false, missed)
    detected, changes = right + false, right + missed
    assert (scores["detected"], scores["changes"]) == (detected, changes)
    assert found["precision"] == (pytest.approx(right / detected) if detected else None)
    assert found["recall"] == (pytest.approx(right / changes) if changes else None)
    hours = len(truth) / 10 / 3600
    assert found["false_per_hour"] == pytest.approx(false / hours)


@st.composite
def drives(draw: st.DrawFn) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A truth of a few changes, flagged or not, and a few events near them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_lanes = draw(st.integers(1, 3))
    size = draw(st.integers(0, 60))
    longest = draw(st.integers(3, 20))
    lane = np.repeat(rng.integers(1, n_lanes + 1, 60), rng.integers(2, longest, 60))[:size]
    crossing = np.repeat(rng.random(60) < 0.4, rng.integers(1, 6, 60))[:size]
    frame_id = np.cumsum(rng.integers(1, 3, size))
    detected = np.sort(rng.choice(130, draw(st.integers(0, 6)), replace=False))
    lanes = [(int(f), *map(int, rng.permutation(max(n_lanes, 2))[:2] + 1)) for f in detected]
    return events_at(*lanes), lane_truth(frame_id, lane, crossing)


def most_pairs(fits: list[list[bool]]) -> int:
    """The most pairs of any matching: each row with one column or none."""
    if not fits:
        return 0
    first, *others = fits
    ways = [most_pairs(others)]
    for j in np.flatnonzero(first):
        rest = [[fit and k != j for k, fit in enumerate(row)] for row in others]
        ways.append(1 + most_pairs(rest))
    return max(ways)


@settings(deadline=None)
@given(drives(), st.sampled_from([*TOLERANCES_S, 0.0]), st.sampled_from([5.0, 10.0]))
def test_no_other_matching_has_more_pairs(
    drive: tuple[pd.DataFrame, pd.DataFrame], tolerance: float, rate: float
) -> None:
    events, truth = drive
    changes = lane_changes(truth)
    ids = truth.index.to_numpy()
    fits = [
        [
            bool(
                ids[changes.start[c]] - tolerance * rate
                <= events["detected_frame_id"][e]
                <= ids[changes.end[c]] + tolerance * rate
                and events.from_lane[e] == changes.from_lane[c]
                and events.to_lane[e] == changes.to_lane[c]
            )
            for c in range(len(changes))
        ]
        for e in range(len(events))
    ]
    found = match_events(events, truth, rate, tolerance)
    pairs = [(e, c) for e, c in enumerate(found.tolist()) if c >= 0]
    assert all(fits[e][c] for e, c in pairs)
    assert len({c for _, c in pairs}) == len(pairs) == most_pairs(fits)
