"""Lane changes as events, found in posteriors frame by frame.

An event depends on the posterior of its frame and earlier ones only, so events of causal posteriors
are causal. Definition:

- A lane is confident if its probability reaches CONFIDENT. The first confident lane begins the
  drive; each later one that differs is a lane change, reported in the frame in which it becomes
  confident.
- Within FLICKER_S after a change, the change back is reported only if the old lane reaches
  RETURN_CONFIDENT. If the old lane is still confident after that time, it is reported then.

The lateral offset, from a node RoadPosition or estimated from the lines (`place_finder`), shows
whether the car crosses a line. An event is one crossing of one line:

- If another lane becomes confident while the car is further than BEYOND from the line on that side,
  only the lane number changes (e.g. where a ramp joins); no change is reported.
- If the offset passes a line by more than BEYOND while the lane has not switched, a change is
  reported with a direction but without lane numbers, and the lane is reset; with its lanes if the
  lane became confident less than FLICKER_S ago. Within FLICKER_S after a change none is reported.
- If the offset is unknown or moves by more than JUMP, only the lane counts until FLICKER_S later.

The constants do not depend on the frame rate, and none was searched:

- CONFIDENT: a false report costs two errors (the change and the change back), a missed change one,
  so a report pays if 2 (1 - p) < p, that is p > 2/3.
- FLICKER_S: a lane change takes 5 to 6 s on average (Toledo and Zohar 2007); this is half of it.
- BEYOND: half a car's width is HALF_CAR; a smaller value would report a car that follows the line,
  and the offset is accurate to about a tenth of a lane.
- JUMP: a car needs a second for that; after a jump in one frame the direction is unknown.
- RETURN_CONFIDENT: a posterior that returns that fast is usually overconfident, so the odds must be
  ten times those of CONFIDENT: 20 to 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import (
    UNASSIGNED,
    Beliefs,
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
)

if TYPE_CHECKING:
    import pandas as pd

#: The probability from which a lane is confident.
CONFIDENT = 2 / 3

#: The time after a change in which the change back needs RETURN_CONFIDENT, seconds.
FLICKER_S = 3.0

#: The probability from which a fast change back is reported.
RETURN_CONFIDENT = 20 / 21

#: The probability from which a frame is called sure in reports.
SURE = 0.95

#: Half the width of a car, in lane widths: about .9 m of 3.6 m.
HALF_CAR = 0.25

#: The largest change of the offset between frames, lane widths.
JUMP = 0.25

#: The distance beyond a line at which a change without lanes is reported, and the largest distance
#: before a line at which one with lanes is, lane widths.
BEYOND = 0.15

#: The smallest length of the mean vector (0 uniform, 1 one cell) for a lateral offset.
DEFINITE = 0.1

#: The smallest number of cells per lane for a lateral offset.
FEWEST_CELLS = 4


#: The columns of lane-change events.
COLUMNS = {
    "frame_id": "first frame since which the new lane is more probable than the old one",
    "time_s": "its time, seconds",
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
    """Find the lane changes of a drive; return a row per change, see COLUMNS.

    - beliefs: posteriors of T frames.
    - frame_rate: frames per second.
    - lag: look-ahead of the posteriors in frames (filter `fixed_lag`).
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
    """The state of the search after some frames. Lanes are indices, from 0.

    here: the current lane; -1 before the first confident one.
    before, calm_s: the lane before it, and until when a change back needs RETURN_CONFIDENT.
    ahead (n,): lanes that are more probable than `here`.
    since_id, since_s (n,): the frame since which they are, and its time in seconds.
    beyond: the last lateral offset, in lane widths right of the centre of the current lane.
    lost_s: the last time at which the offset was unknown or jumped.
    began_s: the time at which `here` became confident without a change.
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
    """Find the lane changes of T more frames.

    - lane: (T, n) the posterior over lanes.
    - frame_id, time_s: (T,), seconds.
    - lateral_offset: (T,) lane widths; None if unknown.

    Returns the new state, the rows of the reports (E,), and the columns (E,) of the changes, see
    COLUMNS (without `late_s`).
    """
    lane = np.ascontiguousarray(lane)
    place = np.full(len(lane), np.nan) if lateral_offset is None else lateral_offset
    # A frame has at most two changes.
    whole, real = np.empty((5, 2 * len(lane)), dtype=np.int64), np.empty((2, 2 * len(lane)))
    state, n_events = _search(so_far, lane, frame_id, time_s, place, whole, real)
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
    place: FloatArray,
    whole: IntArray,
    real: FloatArray,
) -> tuple[EventState, int]:
    """Return the state after T more frames, and the number of changes.

    Output: whole (5, E), per change its row, frame id, the two lanes (from 1) and direction; real
    (2, E), its time and the probability of the new lane.
    """
    here, before, calm, _, _, _, beyond, lost, begun = so_far
    n_lanes, n_events = lane.shape[1], 0
    ahead, since_id = np.zeros(n_lanes, dtype=np.bool_), np.zeros(n_lanes, dtype=np.int64)
    since_s, n_before = np.zeros(n_lanes), len(so_far.ahead)
    ahead[:n_before], since_id[:n_before] = so_far.ahead, so_far.since_id
    since_s[:n_before] = so_far.since_s
    for t in range(len(lane)):
        now, k = time_s[t], int(lane[t].argmax())
        moved = (place[t] - beyond + 0.5) % 1 - 0.5
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
                _follow(lane[t], frame_id[t], now, here, ahead, since_id, since_s)
                whole[:, n_events] = t, since_id[k], here + 1, k + 1, side
                real[:, n_events] = since_s[k], p
                n_events += 1
                # The new lane leads now, so the next change begins after this frame.
                ahead[:] = False
                before, calm = here, now + FLICKER_S
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
                    here, before, k, p = -1, -1, -1, np.nan
                # The time of such a change is that of the offset.
                whole[:, n_events] = t, frame_id[t], before + 1, k + 1, side
                real[:, n_events] = now, p
                n_events += 1
                ahead[:] = False
        if here >= 0:
            _follow(lane[t], frame_id[t], now, here, ahead, since_id, since_s)
    state = EventState(here, before, calm, ahead, since_id, since_s, beyond, lost, begun)
    return state, n_events


@kernel()
def _follow(
    lane: FloatArray,
    frame_id: int,
    time_s: float,
    here: int,
    ahead: BoolArray,
    since_id: IntArray,
    since_s: FloatArray,
) -> None:
    """Update `ahead`, `since_id` and `since_s` of EventState with a frame's posterior lane (n,)."""
    for k in range(len(lane)):
        leads = lane[k] > lane[here]
        if leads and not ahead[k]:
            since_id[k], since_s[k] = frame_id, time_s
        ahead[k] = leads


def lane_segments(
    lane: FloatArray, events: pd.DataFrame, time_s: FloatArray
) -> list[tuple[int, float, float]]:
    """Return the segments of a drive in one lane: lane (from 1), begin and end in seconds.

    - lane: (T, n) the posterior over lanes.
    - events: the lane changes of this posterior; a segment ends at `time_s` of the next one.
    - time_s: (T,) seconds.

    The first segment begins at the first confident lane. One also begins if another lane becomes
    confident without a crossing. Lane 0 is unknown, after a change without lanes.
    """
    confident = np.flatnonzero(lane.max(axis=1, initial=0) >= CONFIDENT)
    if not len(confident):
        return []
    lanes = lane[confident].argmax(axis=1) + 1
    changes = events[["time_s", "to_lane", "detected_time_s"]].values.tolist()
    marks, here, calm, e = dict[float, int](), UNASSIGNED, -np.inf, 0
    for at, k in [*zip(time_s[confident].tolist(), lanes.tolist(), strict=True), (np.inf, 0)]:
        while e < len(changes) and changes[e][0] <= at:
            began, here, now = changes[e][0], int(changes[e][1]), changes[e][2]
            marks[began] = here
            calm = now + FLICKER_S if here else -np.inf
            e += 1
        if at < np.inf and k != here and at >= calm:
            marks[at] = here = k
    begin = float(time_s[confident[0]])
    borders = [at for at in sorted(marks) if at >= begin]
    ends = [*borders[1:], float(time_s[-1])]
    return [(marks[at], at, end) for at, end in zip(borders, ends, strict=True)]


def across_lanes(
    marginals: Mapping[str, FloatArray], by_lines: FloatArray | None = None
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the line crossing probability and the lateral offset (T,) from posteriors by node.

    - by_lines (T,): the offset for graphs without RoadPosition (`place_finder`).

    The line crossing probability is P(RoadPosition at most HALF_CAR from a line between two lanes),
    with cells that are partly so near counted in part. It is None without a RoadPosition (cells
    from left to right, the same number in each lane). The motion of the lane posterior is no
    substitute: with the paper's model it finds crossing frames with an AUC of .55 to .69.

    The lateral offset from the lane centre, in lane widths, positive to the right, -.5 to .5, is
    the circular mean of RoadPosition over all lanes; NaN if it is not definite.
    """
    lane, position = np.ascontiguousarray(marginals["Lane"]), marginals.get("RoadPosition")
    (n_frames, n_lanes), offset = lane.shape, np.empty(len(lane))
    if position is None or position.shape[1] % n_lanes:
        return None, by_lines
    cells = np.ascontiguousarray(position).reshape(n_frames, n_lanes, -1)
    crossing = np.empty(n_frames)
    angles, near = _angles(cells.shape[2]), _near_lines(n_lanes, cells.shape[2])
    if not _read_cells(cells, lane, angles, near, crossing, offset):
        return None, by_lines
    return crossing, offset


@kernel()
def _read_cells(
    cells: FloatArray,
    lane: FloatArray,
    angles: NDArray[np.complex128],
    near: FloatArray,
    crossing: FloatArray,
    place: FloatArray,
) -> bool:
    """Fill crossing and place (T,) from RoadPosition (T, n, cells), cells from left to right.

    Returns False if the cells of a lane do not add up to its probability.
    """
    n_frames, n_lanes, n_cells = cells.shape
    for t in range(n_frames):
        crosses = 0.0
        mean = 0j
        for k in range(n_lanes):
            total = 0.0
            for c in range(n_cells):
                total += cells[t, k, c]
                crosses += cells[t, k, c] * near[k, c]
                mean -= cells[t, k, c] * angles[c]
            if not abs(total - lane[t, k]) <= 1e-4:
                return False
        crossing[t] = min(max(crosses, 0.0), 1.0)
        is_definite = abs(mean) >= DEFINITE and n_cells >= FEWEST_CELLS
        place[t] = np.angle(mean) / (2 * np.pi) if is_definite else np.nan
    return True


@lru_cache(maxsize=8)
def _angles(n_cells: int) -> NDArray[np.complex128]:
    """Return the positions of a lane's cells as unit vectors."""
    return np.asarray(np.exp(2j * np.pi * (np.arange(n_cells) + 0.5) / n_cells))


@lru_cache(maxsize=8)
def _near_lines(n_lanes: int, n_cells: int) -> FloatArray:
    """Return the share of each lane's cells that is within HALF_CAR of a line between lanes."""
    # The borders of the cells, in lane widths from the left edge of the road.
    border = np.arange(n_lanes * n_cells + 1) / n_cells
    share = np.zeros(n_lanes * n_cells)
    for line in range(1, n_lanes):
        near = np.clip(border, line - HALF_CAR, line + HALF_CAR)
        share += np.diff(near) * n_cells
    return share.reshape(n_lanes, n_cells)
