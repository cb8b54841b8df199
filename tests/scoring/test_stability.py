"""False switches, delay after lane changes, and the summary of all scores."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.scoring import score_all
from egolane_pgm.scoring.stability import (
    delay_after_lane_change,
    false_switch_frames,
    false_switches_per_minute,
    lane_changes,
)

Drive = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def digits(text: str) -> np.ndarray:
    """One lane per character, 0 is Unassigned; spaces only part the stretches."""
    return np.array([int(c) for c in text if c != " "], dtype=np.int64)


def crossing(text: str) -> np.ndarray:
    """One flag per character, x is crossing; spaces only part the stretches."""
    return np.array([c == "x" for c in text if c != " "], dtype=bool)


@st.composite
def drives(draw: st.DrawFn) -> Drive:
    """assigned, lane, is_crossing, frame_id, made of stretches so that lanes are held."""
    n = draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))

    def stretches(low: int, high: int, longest: int) -> np.ndarray:
        lengths = rng.integers(1, longest + 1, 80)
        return np.repeat(rng.integers(low, high + 1, 80), lengths)[:80]

    frame_id = np.cumsum(rng.integers(1, 3, 80))
    size = draw(st.integers(0, 80))
    everything = (
        stretches(0, n, 9),
        stretches(1, n, 20),
        stretches(0, 3, 6) == 0,
        frame_id,
    )
    return tuple(a[:size] for a in everything)  # type: ignore[return-value]


def test_a_switch_while_the_truth_stays_is_false_and_one_with_the_truth_is_not() -> None:
    #                         rows 2 and 3 switch falsely, row 5 goes with the truth
    switch, counted = false_switch_frames(digits("112112"), digits("111112"), crossing("......"))
    assert np.flatnonzero(switch).tolist() == [2, 3]
    assert np.flatnonzero(counted).tolist() == [1, 2, 3, 4]


def test_switches_in_into_and_out_of_a_crossing_are_not_counted() -> None:
    switch, counted = false_switch_frames(digits("112123"), digits("111111"), crossing("..xx.."))
    assert np.flatnonzero(switch).tolist() == [5]
    assert np.flatnonzero(counted).tolist() == [1, 5]


def test_the_rate_is_per_minute_of_consecutive_frames() -> None:
    # 600 pairs of frames at 10 per second are one minute; two false switches in it.
    lane = np.ones(601, dtype=int)
    assigned = lane.copy()
    assigned[300] = 2
    is_crossing = np.zeros(601, dtype=bool)
    assert false_switches_per_minute(assigned, lane, is_crossing, 10) == pytest.approx(2)
    assert false_switches_per_minute(assigned, lane, is_crossing, 20) == pytest.approx(4)


@pytest.mark.parametrize("flags", ["", ".", "xxx", ".x."])
def test_without_consecutive_frames_there_is_no_rate(flags: str) -> None:
    lane = np.ones(len(flags), dtype=int)
    assert math.isnan(false_switches_per_minute(lane, lane, crossing(flags), 10))


def test_lane_changes_are_found_with_and_without_a_flag_and_aborted_ones_are_not() -> None:
    # A crossing before the first scored row, an aborted one, a change with a crossing (label of it
    # ignored), a change without a flag, a crossing at the end.
    lane = digits("2 11 222 11 33 2 2 3 1")
    flag = crossing("x .. xxx .. xx . . . x")
    changes = lane_changes(lane, flag)
    assert changes.start.tolist() == [8, 12]
    assert changes.end.tolist() == [10, 12]
    assert changes.until.tolist() == [12, 13]
    assert changes.from_lane.tolist() == [1, 2]
    assert changes.to_lane.tolist() == [2, 3]


def delays(assigned: str, lane: str, flag: str) -> list[float | None]:
    """The delay of each change with frame ids 100, 101, ...; None where missed."""
    ids = np.arange(100, 100 + len(digits(assigned)))
    scores = delay_after_lane_change(digits(assigned), digits(lane), crossing(flag), ids)
    return [None if math.isnan(d) else d for d in scores.delay_frames]


def test_the_delay_runs_from_the_first_frame_after_the_crossing() -> None:
    lane, flag = "111 112 22222222", "... xxx ........"
    assert delays("111 111 22222222", lane, flag) == [0]
    assert delays("111 111 11222222", lane, flag) == [2]


def test_the_delay_is_negative_when_the_lane_is_held_before_the_crossing_ends() -> None:
    lane, flag = "111 112 22222222", "... xxx ........"
    assert delays("111 122 22222222", lane, flag) == [-2]


def test_an_answer_before_the_crossing_begins_is_no_foresight() -> None:
    lane, flag = "1111111 112 22222222", "....... xxx ........"
    assert delays("2222222 222 22222222", lane, flag) == [-3]
    assert delays("2222222 111 11122222", lane, flag) == [3]


def test_fewer_than_five_frames_do_not_count_as_held() -> None:
    lane, flag = "11 1 2222222222", ".. x .........."
    assert delays("11 1 2222122222", lane, flag) == [5]
    assert delays("11 1 2222022222", lane, flag) == [5]
    assert delays("11 1 2222122221", lane, flag) == [None]


def test_a_change_that_is_not_followed_before_the_next_begins_is_missed() -> None:
    lane, flag = "11 1 222222 2 111111", ".. x ...... x ......"
    assert delays("11 1 112222 2 222111", lane, flag) == [None, None]
    assert delays("11 1 122222 1 111111", lane, flag) == [1, -1]


def test_an_aborted_crossing_does_not_end_the_search() -> None:
    lane, flag = "11 1 22 3 222222", ".. x .. x ......"
    assert delays("11 1 11 1 222222", lane, flag) == [3]


def test_a_crossing_with_which_the_drive_ends_does_end_the_search() -> None:
    lane, flag = "11 1 222 22222", ".. x ... xxxxx"
    assert delays("11 1 112 22222", lane, flag) == [None]


def test_missing_frame_ids_count_as_the_time_they_are() -> None:
    lane, flag = digits("11 1 2222222"), crossing(".. x .......")
    ids = np.array([1, 2, 3, 4, 15, 16, 17, 18, 19, 20])
    assigned = digits("11 1 1122222")
    assert delay_after_lane_change(assigned, lane, flag, ids).delay_frames.tolist() == [12]


def test_median_and_percentile_are_of_the_changes_that_were_not_missed() -> None:
    # Four changes with delays 0, 1, 5 and one missed: median 1, 90th percentile 1 + 0.8 * 4.
    lane = "11 2222222222 1111111111 2222222222 1111111111"
    assigned = "11 2222222222 2111111111 1111122222 2222222222"
    scores = delay_after_lane_change(
        digits(assigned), digits(lane), np.zeros(42, dtype=bool), np.arange(42)
    )
    assert scores.changes == 4
    assert scores.median_frames == 1
    assert scores.p90_frames == pytest.approx(4.2)
    assert scores.share_missed == 0.25


@pytest.mark.parametrize("text", ["", "1", "1111"])
def test_without_a_lane_change_there_is_no_delay(text: str) -> None:
    flag = np.zeros(len(text), dtype=bool)
    scores = delay_after_lane_change(digits(text), digits(text), flag, np.arange(len(text)))
    assert scores.changes == 0
    assert math.isnan(scores.median_frames)
    assert math.isnan(scores.share_missed)


@given(drives())
def test_both_scores_equal_those_of_plain_loops(drive: Drive) -> None:
    assigned, lane, flag, ids = drive
    n = len(lane)
    false, pairs = 0, 0
    for k in range(1, n):
        if not flag[k] and not flag[k - 1] and lane[k] == lane[k - 1]:
            pairs += 1
            false += assigned[k] != assigned[k - 1]
    rate = false_switches_per_minute(assigned, lane, flag, 25)
    assert rate == pytest.approx(false / pairs * 25 * 60) if pairs else math.isnan(rate)

    changes, last = [], None  # (start, end, new lane)
    for k in range(n):
        if flag[k]:
            continue
        if last is not None and lane[k] != lane[last]:
            changes.append((last + 1, k, lane[k]))
        last = k
    expected = []
    for c, (start, end, new) in enumerate(changes):
        assert last is not None
        until = changes[c + 1][0] if c + 1 < len(changes) else last + 1
        first = next((k for k in range(start, until - 4) if all(assigned[k : k + 5] == new)), None)
        expected.append(math.nan if first is None else ids[first] - ids[end])
    scores = delay_after_lane_change(assigned, lane, flag, ids)
    np.testing.assert_array_equal(scores.delay_frames, np.array(expected, dtype=float))
    caught = [d for d in expected if not math.isnan(d)]
    if caught:
        assert scores.median_frames == pytest.approx(np.median(caught))
        assert scores.share_missed == pytest.approx(1 - len(caught) / len(expected))


@given(drives())
def test_reversing_the_lanes_changes_nothing(drive: Drive) -> None:
    assigned, lane, flag, ids = drive
    mirrored, other = np.where(assigned == 0, 0, 4 - assigned), 4 - lane
    one = delay_after_lane_change(assigned, lane, flag, ids)
    two = delay_after_lane_change(mirrored, other, flag, ids)
    np.testing.assert_array_equal(one.delay_frames, two.delay_frames)
    for a, b in zip(
        false_switch_frames(assigned, lane, flag),
        false_switch_frames(mirrored, other, flag),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_the_summary_holds_every_score_of_a_drive_worked_out_by_hand() -> None:
    # Eight frames: three in lane 1 (one wrong), a crossing frame, four in lane 2 (one tie).
    p = [0.9, 0.2, 0.9, 0.5, 0.1, 0.5, 0.1, 0.1]
    belief = np.array([[x, 1 - x] for x in p])
    lane = [1, 1, 1, 1, 2, 2, 2, 2]
    is_crossing = [False, False, False, True, False, False, False, False]
    scores = score_all(belief, lane, is_crossing, np.arange(8), 10)
    # Assigned 1 2 1 (0) 2 0 2 2.
    assert scores["confusion"] == [[2, 0], [1, 3], [0, 1]]
    assert scores["per_lane"]["precision"] == [1, 0.75]
    assert scores["per_lane"]["recall"] == pytest.approx([2 / 3, 0.75])
    assert scores["per_lane"]["f1"] == pytest.approx([0.8, 0.75])
    assert scores["precision"] == 0.875
    assert scores["recall"] == pytest.approx(17 / 24)
    assert scores["f1"] == pytest.approx(0.775)
    assert scores["accuracy"] == pytest.approx(5 / 7)
    assert scores["coverage"] == pytest.approx(6 / 7)
    assert (scores["frames"], scores["frames_scored"]) == (8, 7)
    # 5 frames give 0.9, 2 give 0.5, 1 gives 0.2 to the annotated lane.
    loss = -(5 * math.log(0.9) + 2 * math.log(0.5) + math.log(0.2)) / 8
    assert scores["log_loss"] == pytest.approx(loss)
    # Scored: 5 times 2 * 0.1^2, once 2 * 0.5^2, once 2 * 0.8^2.
    assert scores["brier"] == pytest.approx((5 * 0.02 + 0.5 + 1.28) / 7)
    # Bins: five at 0.9, right; one at 0.8, wrong; one at 0.5, a tie, wrong.
    assert scores["expected_calibration_error"] == pytest.approx((5 * 0.1 + 0.8 + 0.5) / 7)
    # Five pairs of consecutive frames, 1-2, 2-1, 2-0, 0-2 switch: 4 in 5 / 600 minutes.
    assert scores["false_switches_per_minute"] == pytest.approx(480)
    # Lane 2 is never held for five frames.
    assert scores["delay"] == {
        "median_frames": None,
        "p90_frames": None,
        "share_missed": 1,
        "changes": 1,
    }


def test_the_summary_of_a_drive_that_is_all_crossing_keeps_the_log_loss() -> None:
    scores = score_all([[0.5, 0.5]] * 3, [1, 1, 2], [True] * 3, [1, 2, 3], 10)
    assert scores["log_loss"] == pytest.approx(math.log(2))
    assert scores["frames_scored"] == 0
    assert scores["brier"] is None
    assert scores["false_switches_per_minute"] is None
    assert scores["delay"]["changes"] == 0
    json.dumps(scores, allow_nan=False)
