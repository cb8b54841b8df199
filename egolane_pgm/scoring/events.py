"""How right the reported lane changes are, and how early the car is seen to cross a line.

The true changes are those of `stability.lane_changes`: between two successive non-crossing rows
with different lanes. The truth knows each of them as an interval: from `begin`, its first crossing
frame, to `end`, the first frame in the new lane. Where in the interval the label changes is a habit
of the annotator (at the end in the Italian recordings, after two thirds in the Spanish ones).

- **Right**: an event is right within a tolerance if it is reported at most that long before `begin`
  or after `end`. Anywhere inside is exact: the truth does not know it better. Both lanes must be
  the true ones; of an event without lanes, the direction. Each event is matched with at most one
  true change and each change with at most one event, as many as can be.
- **Delay**: from `end`, when the car is in the new lane by anybody's reckoning, to the report;
  negative for a change that is reported before it is over. It is that of the events that are right
  within the largest tolerance.
- **False**: an event that is not matched. It can only be false where the truth speaks: in annotated
  frames, from the first non-crossing one to the last (what came before and after is unknown).
- **Warning**: the probability that the car is on a line is at least WARNED. A warning lasts for
  successive rows. A change is warned of if a warning lasts in one of its rows, from `begin` to
  before `end`; its **lead** is the time from the first row of the first such warning to the row in
  which the label changes. A warning is false if no crossing row is less than the largest tolerance
  from it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.stability import LaneChanges, lane_changes
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, IntArray, runs_of

if TYPE_CHECKING:
    import pandas as pd

#: Seconds before and after a true crossing in which an event may be reported.
TOLERANCES_S = (0.5, 1.0, 2.0)

#: The probability of being on a line from which the car is warned.
WARNED = 0.5


def match_events(
    events: pd.DataFrame, truth: pd.DataFrame, frame_rate: float, tolerance_s: float
) -> IntArray:
    """(E,): the true change that each event matches, an index into `lane_changes`; -1 for none.

    - truth: K annotated frames, those that count.
    - frame_rate: frames per second.
    """
    changes = lane_changes(truth["true_lane"], truth["is_crossing"])
    reach = tolerance_s * frame_rate
    first = truth.index.to_numpy()[changes.start] - reach
    last = truth.index.to_numpy()[changes.end] + reach
    found = np.full(len(events), -1, dtype=np.int64)
    is_open = np.ones(len(changes), dtype=bool)
    # Events in order, each taking the open change that closes first: no matching has more pairs
    # (Glover 1967, points and intervals).
    left_lane, entered_lane = events["from_lane"].to_numpy(), events["to_lane"].to_numpy()
    direction = events["direction"].to_numpy()
    for e, at in enumerate(events["detected_frame_id"].to_numpy()):
        # The changes are in order, so those within reach stand together.
        near = slice(*np.searchsorted(last, [at]), *np.searchsorted(first, [at], side="right"))
        left, entered = changes.from_lane[near], changes.to_lane[near]
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
    """(E,): seconds from the end of the true crossing to the report; NaN for an event that is not
    right within the largest tolerance."""
    matched = match_events(events, truth, frame_rate, max(TOLERANCES_S))
    changes = lane_changes(truth["true_lane"], truth["is_crossing"])
    ends = truth.index.to_numpy()[changes.end]
    delay = np.full(len(events), np.nan)
    is_right = matched >= 0
    delay[is_right] = (
        events["detected_frame_id"].to_numpy()[is_right] - ends[matched[is_right]]
    ) / frame_rate
    return delay


def score_events(
    events: pd.DataFrame,
    truth: pd.DataFrame,
    frame_rate: float,
    crossing: FloatArray | None = None,
) -> dict[str, Any]:
    """The scores of lane-change events, ready for JSON; None where a score is undefined.

    - truth: K annotated frames, those that count.
    - frame_rate: frames per second.
    - crossing (K,): the line crossing probability, see `inference.events.across_lanes`.

    Keys: `changes` (true ones), `detected` (events that can be right or false), `hours` (of
    annotated frames), `within` (for each tolerance, by its seconds, "0.5": `right`, `false`,
    `missed`, `precision`, `recall`, `false_per_hour`), `delay_s` {`median`, `p90`}, `crossing` (see
    `score_crossing`; None without a probability).
    """
    changes = lane_changes(truth["true_lane"], truth["is_crossing"])
    hours = len(truth) / frame_rate / 3600
    within: dict[str, dict[str, Any]] = {}
    for tolerance in TOLERANCES_S:
        is_right = match_events(events, truth, frame_rate, tolerance) >= 0
        right = int(is_right.sum())
        false = int((is_judged(events, truth) & ~is_right).sum())
        within[f"{tolerance:g}"] = {
            "right": right,
            "false": false,
            "missed": len(changes) - right,
            "precision": _ratio(right, right + false),
            "recall": _ratio(right, len(changes)),
            "false_per_hour": _ratio(false, hours),
        }
    delay = event_delays(events, truth, frame_rate)
    return {
        "changes": len(changes),
        "detected": right + false,
        "hours": hours,
        "within": within,
        "delay_s": {"median": _percentile(delay, 50), "p90": _percentile(delay, 90)},
        "crossing": None if crossing is None else score_crossing(crossing, truth, frame_rate),
    }


def score_crossing(crossing: ArrayLike, truth: pd.DataFrame, frame_rate: float) -> dict[str, Any]:
    """The scores of the probability that the car is on a line, (K,), as early warning; ready for
    JSON, None where a score is undefined.

    Keys: `auc` (area under the ROC curve for "this frame is crossing"), `precision`, `recall` (of
    the crossing frames, with a warning from WARNED), `changes` (true ones), `warned` (how many of
    them), `lead_s` {`median`, `p10`}, `warnings`, `false_per_hour`.
    """
    values = np.asarray(crossing, dtype=np.float64)
    is_crossing = truth["is_crossing"].to_numpy()
    is_warned = values >= WARNED
    both = int((is_warned & is_crossing).sum())
    ids = truth.index.to_numpy()
    begin, end = np.array(runs_of(is_warned), dtype=np.int64).reshape(-1, 2).T
    end = end - 1
    changes = lane_changes(truth["true_lane"], truth["is_crossing"])
    lead = _leads(begin, end, changes, truth) / frame_rate
    crossing_id = ids[is_crossing]
    reach = max(TOLERANCES_S) * frame_rate
    # The nearest crossing frame at or after the warning's first row, and the last before it.
    after = np.searchsorted(crossing_id, ids[begin])
    padded = np.concatenate([[-math.inf], crossing_id, [math.inf]])
    is_false = (padded[after + 1] - ids[end] >= reach) & (ids[begin] - padded[after] >= reach)
    auc = roc_auc(values, is_crossing)
    return {
        "auc": None if math.isnan(auc) else auc,
        "precision": _ratio(both, int(is_warned.sum())),
        "recall": _ratio(both, int(is_crossing.sum())),
        "changes": len(changes),
        "warned": int(np.count_nonzero(~np.isnan(lead))),
        "lead_s": {"median": _percentile(lead, 50), "p10": _percentile(lead, 10)},
        "warnings": len(begin),
        "false_per_hour": _ratio(int(is_false.sum()), len(truth) / frame_rate / 3600),
    }


def is_judged(events: pd.DataFrame, truth: pd.DataFrame) -> BoolArray:
    """(E,): whether the truth has the car's lanes before and after, where an event is reported."""
    known = truth.index.to_numpy()[~truth["is_crossing"]]
    if not len(known):
        return np.zeros(len(events), dtype=bool)
    at = events["detected_frame_id"].to_numpy()
    return np.asarray(np.isin(at, truth.index.to_numpy()) & (known[0] <= at) & (at <= known[-1]))


def _leads(begin: IntArray, end: IntArray, changes: LaneChanges, truth: pd.DataFrame) -> FloatArray:
    """(C,): frames from the first warning of each change to its label; NaN without a warning.

    - begin, end: the first and the last rows of the warnings, in order.
    """
    lead = np.full(len(changes), np.nan)
    for c in range(len(changes)):
        start, stop = changes.start[c], changes.end[c]
        label = start + int(
            np.argmax(truth["true_lane"].to_numpy()[start : stop + 1] == changes.to_lane[c])
        )
        first = int(np.searchsorted(end, start))
        if first < len(begin) and begin[first] < max(stop, start + 1):
            lead[c] = truth.index.to_numpy()[label] - truth.index.to_numpy()[begin[first]]
    return lead


def _ratio(count: float, of: float) -> float | None:
    return count / of if of else None


def _percentile(values: FloatArray, share: float) -> float | None:
    """A percentile of the values that are not NaN; None without any."""
    known = values[~np.isnan(values)]
    return float(np.percentile(known, share)) if known.size else None


def roc_auc(score: ArrayLike, is_positive: ArrayLike) -> float:
    """The area under the ROC curve: the probability that a positive frame has a larger score than
    a negative one, ties counting half (Hanley & McNeil 1982).

    score (T,), is_positive (T,). NaN without a positive or without a negative frame.
    """
    values, positive = np.asarray(score, dtype=np.float64), np.asarray(is_positive)
    n_positive = int(positive.sum())
    n_negative = len(values) - n_positive
    if not n_positive or not n_negative:
        return float("nan")
    _, index, count = np.unique(values, return_inverse=True, return_counts=True)
    # The mean rank of equal scores, counted from 1.
    rank = np.cumsum(count) - (count - 1) / 2
    total = float(rank[index][positive].sum())
    return (total - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative)
