"""Scores over time: false switches, delays of the answers, reported lane changes, early warnings.

A true **lane change** is a pair of successive non-crossing rows with different lanes: with crossing
rows between them (their labels are ignored), or without (a change that was not flagged). A crossing
that ends in the lane it began in was aborted and does not count, nor does a crossing at the
beginning or the end of a drive, whose other side is unknown. A change lasts from `begin`, its first
crossing frame, to `end`, the first frame in the new lane. Annotators change the label at different
places within it (at the end in the Italian recordings, after two thirds in the Spanish ones).

Scores of the answers, row by row:

- **False switch**: the assigned lane differs between consecutive rows, neither of them crossing,
  while the true lane does not. Frame ids that are missing between them do not separate them.
  Unassigned is an answer like a lane: going from lane 2 to Unassigned is a switch, and so is coming
  back. The rate is per minute of such pairs, one frame period each.
- **Delay** of a change: frames from `end` to the first of the HELD_FRAMES rows that hold the new
  lane, in frame ids. A hold may begin at the first crossing row, so the delay is at least minus the
  length of the crossing, and never negative for an unflagged change. The hold must be complete
  before the next change begins, or the drive ends, or its last crossing begins; otherwise the
  change is missed. An aborted crossing does not end the search. Median and 90th percentile are over
  the changes that were not missed; read them together with the share missed.

Scores of reported lane changes (events):

- **Right**: reported at most a tolerance before `begin` or after `end`, with the true lanes; an
  event without lanes needs the true direction. Each event is matched with at most one change and
  each change with at most one event, as many as possible.
- **Delay**: from `end` to the report, over the events that are right within the largest tolerance;
  negative if reported earlier.
- **False**: an event without a match. Only events in annotated frames between the first and the
  last non-crossing one can be false.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, IntArray

#: The new lane counts as found once it is held for this many frames.
HELD_FRAMES = 5

#: Seconds before and after a true crossing in which an event may be reported.
TOLERANCES_S = (0.5, 1.0, 2.0)


def lane_changes(truth: pd.DataFrame) -> pd.DataFrame:
    """The true lane changes of a drive, a row each; rules in the module.

    Columns: `start` (first crossing row, equal to `end` if no row is flagged), `end` (first row in
    the new lane after the crossing), `until` (end of the search for the new lane, exclusive),
    `from_lane`, `to_lane`. Rows are counted from 0.
    """
    actual = truth["true_lane"].to_numpy()
    scored = np.flatnonzero(~truth["is_crossing"].to_numpy())
    before = scored[:-1]
    after = scored[1:]
    is_change = actual[before] != actual[after]
    before = before[is_change]
    after = after[is_change]
    start = before + 1
    until = np.append(start[1:], scored[-1] + 1) if len(start) else start
    lanes = {"from_lane": actual[before], "to_lane": actual[after]}
    return pd.DataFrame({"start": start, "end": after, "until": until, **lanes})


# --- answers -------------------------------------------------------------------------------------


def stability_scores(
    drives: Sequence[tuple[ArrayLike, pd.DataFrame]],
    frame_rate: float,
) -> dict[str, Any]:
    """False switches and delays in one or more drives; None if a score is undefined.

    - drives: per drive the answers (T,), 0 for Unassigned, and the ground truth of these frames.
    - frame_rate: frames per second.

    Keys: `false_switches_per_minute`, `delay` {`median_frames`, `p90_frames`, `share_missed`,
    `changes`}.
    """
    false = 0
    counted = 0
    delays = [np.zeros(0)]
    for assigned, truth in drives:
        is_false, is_counted = false_switches(assigned, truth["true_lane"], truth["is_crossing"])
        false += int(is_false.sum())
        counted += int(is_counted.sum())
        delays.append(answer_delays(assigned, truth, lane_changes(truth)))
    delay = np.concatenate(delays)
    followed = np.count_nonzero(~np.isnan(delay))
    return {
        "false_switches_per_minute": _ratio(false, counted / (60 * frame_rate)),
        "delay": {
            "median_frames": _percentile(delay, 50),
            "p90_frames": _percentile(delay, 90),
            "share_missed": 1.0 - followed / len(delay) if len(delay) else None,
            "changes": len(delay),
        },
    }


def false_switches(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike
) -> tuple[BoolArray, BoolArray]:
    """(T,) each: marks false switches from the row before, and rows in which one is possible."""
    predicted, actual, crossing = map(np.asarray, (assigned, lane, is_crossing))
    is_counted = np.zeros(len(predicted), dtype=bool)
    is_counted[1:] = ~crossing[1:] & ~crossing[:-1] & (actual[1:] == actual[:-1])
    is_false = is_counted.copy()
    is_false[1:] &= predicted[1:] != predicted[:-1]
    return is_false, is_counted


def answer_delays(assigned: ArrayLike, truth: pd.DataFrame, changes: pd.DataFrame) -> FloatArray:
    """(C,): frames from the end of each change until the new lane is held; NaN if missed.

    - changes: C true ones, see `lane_changes`.
    """
    predicted = np.asarray(assigned)
    ids = truth.index.to_numpy()
    delay = np.full(len(changes), np.nan)
    for c, change in enumerate(changes.itertuples()):
        is_right = predicted[change.start : change.until] == change.to_lane
        so_far = np.concatenate([[0], np.cumsum(is_right)])
        held = np.flatnonzero(so_far[HELD_FRAMES:] - so_far[:-HELD_FRAMES] == HELD_FRAMES)
        if held.size:
            delay[c] = ids[change.start + held[0]] - ids[change.end]
    return delay


# --- reported lane changes -----------------------------------------------------------------------


class Reported(NamedTuple):
    """The lane changes that were reported in a drive, with its ground truth.

    - events: E of them, see `inference.events.lane_events`.
    - truth: K annotated frames, those that count.
    """

    events: pd.DataFrame
    truth: pd.DataFrame


def match_events(
    events: pd.DataFrame, truth: pd.DataFrame, frame_rate: float, tolerance_s: float
) -> IntArray:
    """(E,): the true change that each event matches, an index into `lane_changes`; -1 for none.

    - truth: K annotated frames, those that count.
    - frame_rate: frames per second.
    """
    changes = lane_changes(truth)
    from_lane = changes["from_lane"].to_numpy()
    to_lane = changes["to_lane"].to_numpy()
    reach = tolerance_s * frame_rate
    first = truth.index.to_numpy()[changes["start"]] - reach
    last = truth.index.to_numpy()[changes["end"]] + reach
    found = np.full(len(events), -1, dtype=np.int64)
    is_open = np.ones(len(changes), dtype=bool)
    # Events in order, each taking the open change that closes first: no matching has more pairs
    # (Glover 1967, points and intervals).
    left_lane = events["from_lane"].to_numpy()
    entered_lane = events["to_lane"].to_numpy()
    direction = events["direction"].to_numpy()
    for e, at in enumerate(events["detected_frame_id"].to_numpy()):
        # The changes are in order, so those within reach are neighbours.
        near = slice(*np.searchsorted(last, [at]), *np.searchsorted(first, [at], side="right"))
        left = from_lane[near]
        entered = to_lane[near]
        if left_lane[e] == UNASSIGNED:
            is_right = np.sign(entered - left) == direction[e]
        else:
            is_right = (left == left_lane[e]) & (entered == entered_lane[e])
        fits = is_open[near] & is_right
        if fits.any():
            found[e] = near.start + np.argmax(fits)
            is_open[found[e]] = False
    return found


def event_delays(events: pd.DataFrame, truth: pd.DataFrame, frame_rate: float) -> FloatArray:
    """(E,): seconds from the end of the true crossing to the report of each event.

    NaN for an event that is not right within the largest tolerance.
    """
    matched = match_events(events, truth, frame_rate, max(TOLERANCES_S))
    ends = truth.index.to_numpy()[lane_changes(truth)["end"]]
    delay = np.full(len(events), np.nan)
    is_right = matched >= 0
    at = events["detected_frame_id"].to_numpy()
    delay[is_right] = (at[is_right] - ends[matched[is_right]]) / frame_rate
    return delay


def is_judged(events: pd.DataFrame, truth: pd.DataFrame) -> BoolArray:
    """(E,): whether an event can be false: it is reported in an annotated frame, with non-crossing
    frames before and after."""
    known = truth.index.to_numpy()[~truth["is_crossing"]]
    if not len(known):
        return np.zeros(len(events), dtype=bool)
    at = events["detected_frame_id"].to_numpy()
    return np.asarray(np.isin(at, truth.index.to_numpy()) & (known[0] <= at) & (at <= known[-1]))


def score_events(drives: Sequence[Reported], frame_rate: float) -> dict[str, Any]:
    """The scores of reported lane changes in one or more drives; None if a score is undefined.

    - frame_rate: frames per second.

    Keys: `changes` (true ones), `detected` (events that can be right or false), `hours` (of
    annotated frames), `within` (for each tolerance, by its seconds, "0.5": `right`, `false`,
    `missed`, `precision`, `recall`, `false_per_hour`), `delay_s` {`median`, `p90`}.
    """
    changes = sum(len(lane_changes(truth)) for _, truth in drives)
    hours = sum(len(truth) for _, truth in drives) / frame_rate / 3600
    within: dict[str, dict[str, Any]] = {}
    for tolerance in TOLERANCES_S:
        right = 0
        false = 0
        for events, truth in drives:
            is_right = match_events(events, truth, frame_rate, tolerance) >= 0
            right += int(is_right.sum())
            false += int((is_judged(events, truth) & ~is_right).sum())
        within[f"{tolerance:g}"] = {
            "right": right,
            "false": false,
            "missed": changes - right,
            "precision": _ratio(right, right + false),
            "recall": _ratio(right, changes),
            "false_per_hour": _ratio(false, hours),
        }
    delay = np.concatenate([event_delays(events, truth, frame_rate) for events, truth in drives])
    return {
        "changes": changes,
        "detected": right + false,
        "hours": hours,
        "within": within,
        "delay_s": {"median": _percentile(delay, 50), "p90": _percentile(delay, 90)},
    }


def _ratio(count: float, of: float) -> float | None:
    return count / of if of else None


def _percentile(values: FloatArray, share: float) -> float | None:
    """A percentile of the values that are not NaN; None if all are."""
    known = values[~np.isnan(values)]
    return float(np.percentile(known, share)) if known.size else None
