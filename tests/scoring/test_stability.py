"""False switches, delay after lane changes, and the summary of all scores."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.inference.events import lane_events
from egolane_pgm.scoring import score_all
from egolane_pgm.scoring.confusion import SMALLEST_PROBABILITY
from egolane_pgm.scoring.events import (
    Reported,
    answer_delays,
    lane_changes,
    score_events,
    stability_scores,
)
from egolane_pgm.types import Beliefs, lane_truth

Drive = tuple[np.ndarray, pd.DataFrame]


def digits(text: str) -> np.ndarray:
    """One lane per character, 0 is Unassigned; spaces only part the stretches."""
    return np.array([int(c) for c in text if c != " "], dtype=np.int64)


def crossing(text: str) -> np.ndarray:
    """One flag per character, x is crossing; spaces only part the stretches."""
    return np.array([c == "x" for c in text if c != " "], dtype=bool)


def truth_of(lanes: str, flags: str, first: int = 100) -> pd.DataFrame:
    """The truth of frames 100, 101, ..."""
    lane = digits(lanes)
    return lane_truth(np.arange(first, first + len(lane)), lane, crossing(flags))


@st.composite
def drives(draw: st.DrawFn) -> Drive:
    """Answers and truth in stretches, so that lanes are held."""
    n = draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = draw(st.integers(0, 80))

    def stretches(low: int, high: int, longest: int) -> np.ndarray:
        lengths = rng.integers(1, longest + 1, 80)
        return np.repeat(rng.integers(low, high + 1, 80), lengths)[:size]

    frame_id = np.cumsum(rng.integers(1, 3, size))
    assigned = stretches(0, n, 9)
    return assigned, lane_truth(frame_id, stretches(1, n, 20), stretches(0, 3, 6) == 0)


def test_the_rate_is_per_minute_of_consecutive_frames() -> None:
    # 600 pairs of frames at 10 per second are one minute; two false switches in it.
    truth = lane_truth(np.arange(601), np.ones(601), np.zeros(601))
    assigned = np.ones(601)
    assigned[300] = 2
    for rate, expected in ((10, 2), (20, 4)):
        found = stability_scores([(assigned, truth)], rate)
        assert found["false_switches_per_minute"] == pytest.approx(expected)
    # A second drive adds its minute; the pair of frames between the drives is not counted.
    found = stability_scores([(assigned, truth), (assigned + 1, truth)], 10)
    assert found["false_switches_per_minute"] == pytest.approx(2)


@pytest.mark.parametrize(
    ("lane", "flags", "assigned", "expected"),
    [
        # From the first frame after the crossing; negative if the lane is held before.
        ("111 112 22222222", "... xxx ........", "111 111 22222222", [0]),
        ("111 112 22222222", "... xxx ........", "111 111 11222222", [2]),
        ("111 112 22222222", "... xxx ........", "111 122 22222222", [-2]),
        # An answer before the crossing begins does not count.
        ("1111111 112 22222222", "....... xxx ........", "2222222 222 22222222", [-3]),
        ("1111111 112 22222222", "....... xxx ........", "2222222 111 11122222", [3]),
        # Fewer than five frames are not held.
        ("11 1 2222222222", ".. x ..........", "11 1 2222122222", [5]),
        ("11 1 2222222222", ".. x ..........", "11 1 2222022222", [5]),
        ("11 1 2222222222", ".. x ..........", "11 1 2222122221", [None]),
        # A change that is not followed before the next one begins is missed.
        ("11 1 222222 2 111111", ".. x ...... x ......", "11 1 112222 2 222111", [None, None]),
        ("11 1 222222 2 111111", ".. x ...... x ......", "11 1 122222 1 111111", [1, -1]),
        # An aborted crossing does not end the search, a crossing at the end of the drive does.
        ("11 1 22 3 222222", ".. x .. x ......", "11 1 11 1 222222", [3]),
        ("11 1 222 22222", ".. x ... xxxxx", "11 1 112 22222", [None]),
    ],
)
def test_the_delay_of_lane_changes(
    lane: str, flags: str, assigned: str, expected: list[float | None]
) -> None:
    truth = truth_of(lane, flags)
    found = answer_delays(digits(assigned), truth, lane_changes(truth))
    assert [None if math.isnan(d) else d for d in found] == expected


def test_median_and_percentile_are_of_the_changes_that_were_not_missed() -> None:
    # Four changes with delays 0, 1, 5 and one missed: median 1, 90th percentile 1 + 0.8 * 4.
    lane = "11 2222222222 1111111111 2222222222 1111111111"
    assigned = digits("11 2222222222 2111111111 1111122222 2222222222")
    truth = truth_of(lane, "." * 42)
    expected = {"median_frames": 1, "p90_frames": 4.2, "share_missed": 0.25, "changes": 4}
    assert stability_scores([(assigned, truth)], 10)["delay"] == pytest.approx(expected)
    two = stability_scores([(assigned, truth)] * 2, 10)["delay"]
    assert (two["changes"], two["share_missed"]) == (8, 0.25)


@given(drives())
def test_both_scores_equal_those_of_plain_loops(drive: Drive) -> None:
    assigned, truth = drive
    lane, flag, ids = truth["true_lane"].tolist(), truth["is_crossing"].tolist(), truth.index
    n = len(lane)
    false, pairs = 0, 0
    for k in range(1, n):
        if not flag[k] and not flag[k - 1] and lane[k] == lane[k - 1]:
            pairs += 1
            false += assigned[k] != assigned[k - 1]
    scores = stability_scores([drive], 25)
    expected_rate = pytest.approx(false / pairs * 25 * 60) if pairs else None
    assert scores["false_switches_per_minute"] == expected_rate

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
    found = answer_delays(assigned, truth, lane_changes(truth))
    np.testing.assert_array_equal(found, np.array(expected, dtype=float))
    caught = [d for d in expected if not math.isnan(d)]
    missed = pytest.approx(1 - len(caught) / len(expected)) if expected else None
    assert scores["delay"]["changes"] == len(expected)
    assert scores["delay"]["share_missed"] == missed
    median = pytest.approx(np.median(caught)) if caught else None
    assert scores["delay"]["median_frames"] == median


def test_the_summary_holds_every_score_of_a_drive_worked_out_by_hand() -> None:
    # Eight frames: three in lane 1 (one wrong), a crossing frame, four in lane 2 (one tie).
    p = [0.9, 0.2, 0.9, 0.5, 0.1, 0.5, 0.1, 0.1]
    belief = np.array([[x, 1 - x] for x in p])
    scores = score_all(belief, truth_of("1111 2222", "...x ...."), 10)
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
    scores = score_all([[0.5, 0.5]] * 3, truth_of("112", "xxx"), 10)
    assert scores["log_loss"] == pytest.approx(math.log(2))
    assert scores["frames_scored"] == 0
    assert scores["brier"] is None
    assert scores["false_switches_per_minute"] is None
    assert scores["delay"]["changes"] == 0
    json.dumps(scores, allow_nan=False)


#: What a lane may have; the last one gets the rest.
SHARES = (0.0, 5e-324, 1e-300, 1e-16, 1.0)


@given(st.integers(2, 5), st.sampled_from([1, 2, 40, 700]), st.integers(0, 2**32 - 1))
def test_sure_beliefs_have_plain_scores(n_lanes: int, n_frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lane = rng.choice(SHARES, (n_frames, n_lanes))
    lane[np.arange(n_frames), rng.integers(n_lanes, size=n_frames)] = 1.0
    lane /= lane.sum(axis=1, keepdims=True)
    # Lanes are held for a while, so that there are changes to be late for.
    true = np.repeat(rng.integers(1, n_lanes + 1, -(-n_frames // 20)), 20)[:n_frames]
    is_crossing = rng.random(n_frames) < 0.2
    ids = np.arange(n_frames)
    truth = lane_truth(ids, true, is_crossing)
    beliefs = Beliefs(ids, {"Lane": lane}, np.zeros(n_frames), np.zeros(n_frames, dtype=bool))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scores = score_all(lane, truth, 10.0)
        reported = Reported(lane_events(beliefs, 10.0), truth)
        events = score_events([reported], 10.0)
    # Neither NaN nor infinity.
    json.dumps([scores, events], allow_nan=False)
    assert 0 <= scores["log_loss"] <= -np.log(SMALLEST_PROBABILITY)
