"""Scores over time: false switches, and the delay with which a lane change is followed.

Rows are the joined frames in order. Where the definitions leave room, this is what is done:

- Consecutive rows are neighbours, neither of them crossing. Frame ids that are missing between them
  do not separate them: nothing was answered in between.
- Unassigned is an answer like a lane. Going from lane 2 to Unassigned is a switch, and so is coming
  back, because whoever uses the lane loses it and gets it again. Coverage tells how often.
- Minutes count the pairs of rows in which a false switch is possible (consecutive, true lane
  unchanged), one frame period each.
- A lane change is a pair of successive non-crossing rows with different true lanes: with crossing
  rows between them (the labels of these are not looked at), or without (a change that was not
  flagged). A crossing that ends in the lane it began in was aborted and is no lane change; nor is
  one at the beginning or the end of the drive, whose other side is unknown.
- The delay is counted from the first row after the crossing to the first of the HELD_FRAMES rows
  that hold the new lane, in frame ids, so that missing ids count as the time that they are. Someone
  who answers the new lane throughout the first rows after the crossing has delay 0.
- A hold may begin at the first crossing row (an answer before that was an error about the old lane,
  not foresight). So the delay is at least minus the length of the crossing, and never negative for
  an unflagged change.
- The hold must be complete before the next lane change begins (its first crossing row), or the
  drive, or a crossing with which the drive ends; else the change is missed. An aborted crossing
  does not end the search.
- Median and 90th percentile (linear interpolation) are those of the changes that were not missed;
  read them together with the share missed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: The new lane counts as found once it is held for this many frames.
HELD_FRAMES = 5


@dataclass(frozen=True)
class LaneChanges:
    """The C lane changes of a drive, in order; row indices into the joined frames.

    start (C,): first crossing row (equal to `end` where no row is flagged). end (C,): first row in
    the new lane after the crossing. until (C,): where the search for the new lane ends, exclusive.
    from_lane, to_lane (C,): 1..n.
    """

    start: IntArray
    end: IntArray
    until: IntArray
    from_lane: IntArray
    to_lane: IntArray

    def __len__(self) -> int:
        return len(self.start)


@dataclass(frozen=True)
class DelayScores:
    """How late lane changes are followed, frames (of the frame id).

    delay_frames (C,): per lane change, NaN where it was missed. median_frames, p90_frames: over
    those that were not missed, NaN if there are none. share_missed: 0 to 1, NaN without changes.
    changes: C.
    """

    delay_frames: FloatArray
    median_frames: float
    p90_frames: float
    share_missed: float
    changes: int


def false_switch_frames(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike
) -> tuple[BoolArray, BoolArray]:
    """Per row: whether it switches falsely against the row before, and whether it could.

    assigned (T,), 0 for Unassigned; lane (T,); is_crossing (T,). Returns is_false_switch (T,) and
    is_counted (T,); the first row is never counted. The sums of the two give the rate, also over
    resampled frames.
    """
    predicted, actual, crossing = map(np.asarray, (assigned, lane, is_crossing))
    is_counted = np.zeros(len(predicted), dtype=bool)
    is_counted[1:] = ~crossing[1:] & ~crossing[:-1] & (actual[1:] == actual[:-1])
    is_false_switch = is_counted.copy()
    is_false_switch[1:] &= predicted[1:] != predicted[:-1]
    return is_false_switch, is_counted


def false_switches_per_minute(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, frame_rate: float
) -> float:
    """False switches per minute: the assigned lane changes between consecutive frames, truth not.

    Arguments as `false_switch_frames`; frame_rate in frames per second. NaN where no two
    consecutive non-crossing frames share a true lane.
    """
    is_false, is_counted = false_switch_frames(assigned, lane, is_crossing)
    counted = int(is_counted.sum())
    return int(is_false.sum()) / (counted / (60.0 * frame_rate)) if counted else float("nan")


def lane_changes(lane: ArrayLike, is_crossing: ArrayLike) -> LaneChanges:
    """The lane changes in a ground truth: lane (T,), is_crossing (T,); rules in the module."""
    actual = np.asarray(lane)
    scored = np.flatnonzero(~np.asarray(is_crossing))
    before, after = scored[:-1], scored[1:]
    is_change = actual[before] != actual[after]
    before, after = before[is_change], after[is_change]
    start = before + 1
    drive_end = scored[-1:] + 1
    until = np.concatenate([start[1:], drive_end]) if len(start) else start
    return LaneChanges(start, after, until, actual[before], actual[after])


def delay_after_lane_change(
    assigned: ArrayLike,
    lane: ArrayLike,
    is_crossing: ArrayLike,
    frame_id: ArrayLike,
    held_frames: int = HELD_FRAMES,
) -> DelayScores:
    """Frames from the end of each crossing until the new lane is first held for `held_frames`.

    assigned (T,), lane (T,), is_crossing (T,), frame_id (T,) strictly increasing; rules in the
    module.
    """
    predicted, ids = np.asarray(assigned), np.asarray(frame_id)
    changes = lane_changes(lane, is_crossing)
    delay = np.full(len(changes), np.nan)
    for c in range(len(changes)):
        start, end, until = changes.start[c], changes.end[c], changes.until[c]
        is_right = predicted[start:until] == changes.to_lane[c]
        so_far = np.concatenate([[0], np.cumsum(is_right)])
        held = np.flatnonzero(so_far[held_frames:] - so_far[:-held_frames] == held_frames)
        if held.size:
            delay[c] = ids[start + held[0]] - ids[end]
    found = delay[~np.isnan(delay)]
    nan = float("nan")
    return DelayScores(
        delay_frames=delay,
        median_frames=float(np.median(found)) if found.size else nan,
        p90_frames=float(np.percentile(found, 90)) if found.size else nan,
        share_missed=1.0 - found.size / delay.size if delay.size else nan,
        changes=len(changes),
    )
