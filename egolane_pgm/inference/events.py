"""Lane changes as events, found in the posterior frame by frame.

An event depends on the posterior of its frame and those before it, so events of causal posteriors
are causal too:

- A lane is held once its probability reaches CONFIDENT, until another lane reaches it. The first
  lane that is held begins the drive; each later one is a change, reported in that frame.
- Within FLICKER_S after a change, the change back is reported only if its lane reaches
  RETURN_CONFIDENT. If that lane is still held after this time, the change back is reported then.

The lateral offset, from a node RoadPosition or from the lines alone (`place_finder`), shows whether
the car crosses a line. An event is then one crossing of one line:

- A new lane is no change if the car is further than BEYOND from the line on that side. The lane has
  another number then, for example after a ramp.
- If the car is BEYOND a line while the lane has not changed, the event has a direction but no lane
  numbers (UNASSIGNED), and the lane is reset. It has lane numbers if the first lane was held less
  than FLICKER_S ago. There is no such event within FLICKER_S after a change.
- If the offset is unknown or moves further than JUMP, and until FLICKER_S later, only the posterior
  counts.

All constants are times, probabilities or lane widths; no search has moved them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import UNASSIGNED, Beliefs, BoolArray, FloatArray, InputError, IntArray

if TYPE_CHECKING:
    import pandas as pd

#: The least probability of a lane that is held. A false change costs two errors, itself and the
#: change back; a missed one costs one. So reporting pays if 2 (1 - p) < p, which is p > 2/3.
CONFIDENT = 2 / 3

#: The time after a change in which the change back needs RETURN_CONFIDENT, seconds. A lane change
#: takes 5 to 6 s on average (Toledo and Zohar 2007), so a quicker return is rarely a real one.
FLICKER_S = 3.0

#: The probability for a change back: ten times the odds of CONFIDENT, because a posterior that
#: returns so quickly mostly wavers and its probabilities are too large.
RETURN_CONFIDENT = 20 / 21

#: The least probability of a frame that reports call sure.
SURE = 0.95

#: Half the width of a car, in lane widths: about .9 m of 3.6 m.
HALF_CAR = 0.25

#: The largest move of the offset in one frame, lane widths. A car needs a second for it; after a
#: larger move the direction is unknown.
JUMP = 0.25

#: The distance of the car's centre beyond a line for a change without lanes, and before it at most
#: for one with lanes, lane widths. With less, a car that follows a line would change lane.
BEYOND = 0.15

#: An offset from RoadPosition is defined if the mean is at least this long (0 uniform, 1 one cell).
DEFINITE = 0.1

#: The least number of cells in a lane for an offset.
FEWEST_CELLS = 4

#: The columns of lane-change events.
COLUMNS = {
    "frame_id": "first frame from which the new lane stayed more probable than the old one",
    "time_s": "the same in seconds",
    "from_lane": "1 (leftmost) to n; 0 if the lanes are unknown",
    "to_lane": "as from_lane",
    "direction": "-1 to the left, 1 to the right",
    "probability": "of the new lane in the report; missing if the lanes are unknown",
    "detected_frame_id": "frame of the report",
    "detected_time_s": "its time, seconds",
    "late_s": "detected_time_s minus time_s",
}


def lane_events(
    beliefs: Beliefs,
    frame_rate: float,
    *,
    lag: int | None = None,
    time_s: FloatArray | None = None,
    lateral_offset: FloatArray | None = None,
) -> pd.DataFrame:
    """Find the lane changes of a drive, a row each, in order of their report; see COLUMNS.

    - beliefs: posteriors of T frames.
    - frame_rate: frames per second.
    - lag: number of frames by which the belief of a frame is delayed (filter `fixed_lag`).
    - time_s: (T,) seconds; by default frame id over frame rate.
    - lateral_offset: (T,) offset from the lane centre, lane widths; by default from RoadPosition.

    Raises InputError for a frame rate that is not positive.

    >>> import numpy as np
    >>> import egolane_pgm as ego
    >>> lane = np.array([[0.9, 0.1], [0.4, 0.6], [0.2, 0.8]])
    >>> beliefs = ego.Beliefs(np.array([7, 8, 9]), {"Lane": lane}, np.zeros(3), np.zeros(3, bool))
    >>> ego.lane_events(beliefs, frame_rate=10)[["time_s", "from_lane", "to_lane"]]
       time_s  from_lane  to_lane
    0     0.8          1        2
    """
    # pandas is imported for tables only.
    import pandas as pd

    if not frame_rate > 0:
        raise InputError(f"frame_rate: {frame_rate} must be greater than 0 (frames per second)")
    frame_id = beliefs.frame_id
    when = frame_id / frame_rate if time_s is None else time_s
    if lateral_offset is None:
        lateral_offset = across_lanes(beliefs.marginals)[1]
    _, rows, events = next_events(NO_EVENTS, beliefs.lane, frame_id, when, lateral_offset)
    if lag:
        known = np.minimum(rows + lag, max(len(frame_id) - 1, 0))
        events |= {"detected_frame_id": frame_id[known], "detected_time_s": when[known]}
    late_s = events["detected_time_s"] - events["time_s"]
    return pd.DataFrame({**events, "late_s": late_s})[list(COLUMNS)]


class EventState(NamedTuple):
    """The state of the search for lane changes between two frames. Lanes are indices, from 0.

    here: the lane that is held, -1 before the first one.
    before, calm_s: the lane before it, and until when a change back needs RETURN_CONFIDENT.
    ahead (n,): True for lanes that are more probable than `here`.
    since_id, since_s (n,): the frame id and time since which it is, without a break.
    beyond: lateral offset of the car, lane widths from the centre of its lane after all changes.
    lost_s: when the offset was last unknown or jumped.
    began_s: when `here` was first held without a change before it.
    """

    here: int
    before: int
    calm_s: float
    ahead: BoolArray
    since_id: IntArray
    since_s: FloatArray
    beyond: float = 0.0
    lost_s: float = -np.inf
    began_s: float = -np.inf


#: The state before the first frame.
NO_EVENTS = EventState(
    -1, -1, -np.inf, np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64), np.zeros(0)
)


def next_events(
    so_far: EventState,
    lane: FloatArray,
    frame_id: IntArray,
    time_s: FloatArray,
    lateral_offset: FloatArray | None,
) -> tuple[EventState, IntArray, dict[str, NDArray[Any]]]:
    """Find the lane changes of T more frames; chunks of a drive give the same result as the whole.

    - lane: (T, n) the posterior over lanes.
    - frame_id, time_s: (T,), seconds.
    - lateral_offset: (T,) lane widths; None if unknown.

    Returns the new state, the rows of the reports (E,), and the columns (E,) of the changes, see
    COLUMNS (without `late_s`).
    """
    offset = np.full(len(lane), np.nan) if lateral_offset is None else lateral_offset
    # A frame has two changes at most.
    whole = np.empty((5, 2 * len(lane)), dtype=np.int64)
    real = np.empty((2, 2 * len(lane)))
    lane = np.ascontiguousarray(lane)
    # The search changes the arrays of the state; before the first frame they are empty.
    more = np.zeros(lane.shape[1] - len(so_far.ahead), dtype=np.int64)
    begin = so_far._replace(
        ahead=np.concatenate([so_far.ahead, more.astype(bool)]),
        since_id=np.concatenate([so_far.since_id, more]),
        since_s=np.concatenate([so_far.since_s, more]),
    )
    state, n_events = _search(begin, lane, frame_id, time_s, offset, whole, real)
    rows, began_id, from_lane, to_lane, direction = whole[:, :n_events].copy()
    began_s, probability = real[:, :n_events].copy()
    events = {
        "frame_id": began_id,
        "time_s": began_s,
        "from_lane": from_lane,
        "to_lane": to_lane,
        "direction": direction,
        "probability": probability,
        "detected_frame_id": frame_id[rows],
        "detected_time_s": time_s[rows],
    }
    return state, rows, events


@kernel()
def _search(
    so_far: EventState,
    lane: FloatArray,
    frame_id: IntArray,
    time_s: FloatArray,
    offset: FloatArray,
    whole: IntArray,
    real: FloatArray,
) -> tuple[EventState, int]:
    """Return the state after T more frames, and the number E of changes in them.

    whole (5, E), real (2, E): output: of each change the row, the frame id of its begin, the lanes
        from and to (from 1) and the direction; the time of its begin and the probability.
    """
    here, before, calm, ahead, since_id, since_s, beyond, lost, begun = so_far
    n_lanes = lane.shape[1]
    n_events = 0
    for t in range(len(lane)):
        now = time_s[t]
        n_before = n_events
        k = 0
        for other in range(1, n_lanes):
            if lane[t, other] > lane[t, k]:
                k = other
        moved = (offset[t] - beyond + 0.5) % 1 - 0.5
        if not np.isnan(moved):
            beyond += moved
        if not abs(moved) <= JUMP:
            lost = now
        p = lane[t, k]
        is_known = p >= CONFIDENT
        if is_known and k != here and not (k == before and now < calm and p < RETURN_CONFIDENT):
            side = 1 if k > here else -1
            is_near = side * beyond >= 0.5 - BEYOND
            if here < 0:
                begun = now
            elif is_near or now < lost + FLICKER_S:
                began_id = since_id[k] if ahead[k] else frame_id[t]
                began_s = since_s[k] if ahead[k] else now
                _write_event(whole, n_events, t, began_id, here, k, side)
                real[0, n_events] = began_s
                real[1, n_events] = p
                n_events += 1
                before = here
                calm = now + FLICKER_S
                beyond -= side if is_near else round(beyond)
            here = k
        if abs(beyond) > 0.5 + BEYOND:
            side = 1 if beyond > 0 else -1
            beyond -= side
            if now >= calm:
                calm = now + FLICKER_S
                if is_known and now < begun + FLICKER_S and 0 <= k - side < n_lanes:
                    before = k - side
                else:
                    # Index -1 becomes UNASSIGNED.
                    here = -1
                    before = -1
                    k = -1
                    p = np.nan
                _write_event(whole, n_events, t, frame_id[t], before, k, side)
                real[0, n_events] = now
                real[1, n_events] = p
                n_events += 1
        if n_events > n_before:
            # A lane that was left leads from now on, if at all.
            for other in range(n_lanes):
                ahead[other] = False
        if here >= 0:
            for other in range(n_lanes):
                leads = lane[t, other] > lane[t, here]
                if leads and not ahead[other]:
                    since_id[other] = frame_id[t]
                    since_s[other] = now
                ahead[other] = leads
    state = EventState(here, before, calm, ahead, since_id, since_s, beyond, lost, begun)
    return state, n_events


@kernel(no_cpython_wrapper=True)
def _write_event(
    whole: IntArray, e: int, row: int, began_id: int, from_lane: int, to_lane: int, side: int
) -> None:
    """Fill column e of the output of `_search`; the lanes are indices."""
    whole[0, e] = row
    whole[1, e] = began_id
    whole[2, e] = from_lane + 1
    whole[3, e] = to_lane + 1
    whole[4, e] = side


def lane_segments(
    lane: FloatArray, events: pd.DataFrame, time_s: FloatArray
) -> list[tuple[int, float, float]]:
    """Return the segments of a drive in one lane: lane (from 1), begin and end, seconds.

    - lane: (T, n) the posterior over lanes.
    - events: the lane changes of this posterior. A segment ends when the next lane becomes more
      probable.
    - time_s: (T,) seconds.

    The first segment begins when a lane is first held. A segment also begins when the posterior
    goes to another lane without an event. Lane 0 is unknown, after a change without lanes.
    """
    held = np.flatnonzero(lane.max(axis=1, initial=0) >= CONFIDENT)
    if not len(held):
        return []
    lanes = lane[held].argmax(axis=1) + 1
    changes = events[["time_s", "to_lane", "detected_time_s"]].values.tolist()
    marks = dict[float, int]()
    here = UNASSIGNED
    calm = -np.inf
    e = 0
    for at, k in [*zip(time_s[held].tolist(), lanes.tolist(), strict=True), (np.inf, 0)]:
        while e < len(changes) and changes[e][0] <= at:
            began = changes[e][0]
            here = int(changes[e][1])
            now = changes[e][2]
            marks[began] = here
            calm = now + FLICKER_S if here else -np.inf
            e += 1
        if at < np.inf and k != here and at >= calm:
            marks[at] = here = k
    begin = float(time_s[held[0]])
    borders = [at for at in sorted(marks) if at >= begin]
    ends = [*borders[1:], float(time_s[-1])]
    return [(marks[at], at, end) for at, end in zip(borders, ends, strict=True)]


def across_lanes(
    marginals: Mapping[str, FloatArray], by_lines: FloatArray | None = None
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the line crossing probability and the lateral offset, (T,) each.

    - marginals: the posteriors by node.
    - by_lines (T,): the offset for graphs without RoadPosition (`place_finder`).

    The line crossing probability is P(RoadPosition at most HALF_CAR from a line between two lanes);
    a cell counts by its share. It is None without a RoadPosition (cells from left to right, the
    same number in each lane): the posterior over lanes alone does not show a crossing. Its motion
    within half a second finds the crossing frames of runs 1, 3, 6 and 8 with an AUC of only .55 to
    .69.

    The lateral offset from the lane centre is in lane widths, positive to the right, -.5 to .5: the
    circular mean of RoadPosition over all lanes, NaN if it is not DEFINITE.
    """
    lane = marginals["Lane"]
    position = marginals.get("RoadPosition")
    n_frames, n_lanes = lane.shape
    if position is None or position.shape[1] % n_lanes:
        return None, by_lines
    cells = np.ascontiguousarray(position).reshape(n_frames, n_lanes, -1)
    if not (np.abs(cells.sum(axis=2) - lane) <= 1e-4).all():
        return None, by_lines
    angles, near = _cell_tables(n_lanes, cells.shape[2])
    crossing = np.clip((cells * near).sum(axis=(1, 2)), 0.0, 1.0)
    mean = -(cells.sum(axis=1) * angles).sum(axis=1)
    is_definite = (np.abs(mean) >= DEFINITE) & (cells.shape[2] >= FEWEST_CELLS)
    return crossing, np.where(is_definite, np.angle(mean) / (2 * np.pi), np.nan)


@lru_cache(maxsize=8)
def _cell_tables(n_lanes: int, n_cells: int) -> tuple[NDArray[np.complex128], FloatArray]:
    """Return the cells of a lane as points on the unit circle (cells,), and the share of each cell
    that is at most HALF_CAR from a line between lanes (n, cells)."""
    angles = np.exp(2j * np.pi * (np.arange(n_cells) + 0.5) / n_cells)
    edges = np.arange(n_lanes * n_cells + 1) / n_cells
    near = np.zeros(n_lanes * n_cells)
    for line in range(1, n_lanes):
        near += np.diff(np.clip(edges, line - HALF_CAR, line + HALF_CAR)) * n_cells
    return angles, near.reshape(n_lanes, n_cells)
