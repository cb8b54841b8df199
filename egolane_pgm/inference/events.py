"""Lane changes as events, found in beliefs frame by frame.

An event follows from the belief of its frame and those before it; later beliefs do not change it.
So events of causal beliefs are causal, too. The definition:

- A lane is believed once its probability reaches CONFIDENT, and stays so until another lane is. The
  first lane that is believed begins the drive. Each lane that is believed after it is a change,
  reported in the frame in which it is believed first.
- Within FLICKER_S after a change, a change back into the lane that the car left is reported only if
  that lane's probability reaches RETURN_CONFIDENT. Otherwise the change stands; if the old lane is
  still believed when the time is over, the change back is reported then.

The lateral offset, from a node RoadPosition or from the lines alone
(`place_finder`), shows whether the car crosses a line, whichever lane it is in,
and an event is one crossing of one line:

- A lane that is believed while the car stays inside its lane (it is further than BEYOND from the
  line on that side) is another number for the same lane, as where a ramp joins; it is no change.
- Where the mean place is BEYOND a line and no belief told it, a change is told by its direction
  alone, from and to UNASSIGNED, and the lane begins anew; where the lane is believed for the first
  time less than FLICKER_S before, with its lanes. Within FLICKER_S after a change none is.
- Where the place is not known or moves more than a car can (JUMP), and until FLICKER_S later, what
  is believed counts alone.

No constant counts frames, and none was searched:

- CONFIDENT: to report a change that the car does not make costs two errors, that change and the one
  back; to miss one that it makes costs one. So with a belief of p a report pays where
  2 (1 - p) < p, which is p > 2/3.
- FLICKER_S: a lane change takes 5 to 6 s on average (Toledo and Zohar 2007). A car that is back
  after half of that has hardly been there.
- BEYOND: half a car's width is HALF_CAR; less would tell a car that follows the line, and the
  place is known to about a tenth of a lane.
- JUMP: a car needs a second for that. Where the place does it from one frame to the next, it may
  have gone the other way round.
- RETURN_CONFIDENT: a posterior that goes there and back that fast mostly wavers, and its
  probabilities are then too large. So the odds have to be ten times those of CONFIDENT (2 to 1),
  20 to 1.
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

#: The probability from which a lane is believed.
CONFIDENT = 2 / 3

#: How long after a change the way back has to be sure, seconds.
FLICKER_S = 3.0

#: The probability that is sure enough for the way back.
RETURN_CONFIDENT = 20 / 21

#: The probability from which reports call a frame's lane sure.
SURE = 0.95

#: Half the width of a car, in lane widths: about .9 m of 3.6 m.
HALF_CAR = 0.25

#: How far the mean place moves in a frame at most while it is followed, lane widths.
JUMP = 0.25

#: How far beyond a line the car's middle is when a change without lanes is reported, and how far
#: before it at most when one with lanes is, lane widths.
BEYOND = 0.15

#: A mean place inside the lane counts if it is at least this definite (0 anywhere, 1 one cell).
DEFINITE = 0.1

#: Fewer cells in a lane do not show where in it the car is.
FEWEST_CELLS = 4


#: The columns of lane-change events.
COLUMNS = {
    "frame_id": "since when, up to the report, the new lane was more probable than the old one",
    "time_s": "the same in seconds",
    "from_lane": "1 (leftmost) to n; 0 if the lanes are unknown",
    "to_lane": "the same",
    "direction": "-1 to the left, 1 to the right",
    "probability": "of the new lane when it was reported; missing if the lanes are unknown",
    "detected_frame_id": "when the change was reported",
    "detected_time_s": "the same in seconds",
    "late_s": "from time_s to detected_time_s",
}


def lane_events(
    beliefs: Beliefs,
    frame_rate: float,
    *,
    lag: int | None = None,
    time_s: FloatArray | None = None,
    lateral_offset: FloatArray | None = None,
) -> pd.DataFrame:
    """Find the lane changes of a drive: a row each, in the order of their report; see COLUMNS.

    - beliefs: of T frames.
    - frame_rate: frames per second.
    - lag: number of frames by which each belief is later than its frame (filter `fixed_lag`).
    - time_s: (T,) seconds; by default frame id over frame rate.
    - lateral_offset: (T,) offset from the lane centre, lane widths; by default from RoadPosition,
      if the graph has one.

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
    """The state of the search for lane changes after some frames, to go on with later ones. Lanes
    are indices, from 0.

    here: the lane that is believed, -1 before there is one.
    before, calm_s: the lane left last, and until when the way back has to be sure.
    ahead (n,): marks the lanes that are more probable than `here`, ...
    since_id, since_s (n,): ... and since which frame they are so without a break; seconds.
    beyond: where the car was last, lane widths right of the middle of the lane that it is in after
        the changes so far.
    lost_s: when its place was last not known or jumped.
    began_s: when `here` was first believed without a change before it.
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


#: Before the first frame.
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
    """Find the lane changes of T more frames. However a drive is cut, they are the same.

    - lane: (T, n) the posterior over lanes.
    - frame_id, time_s: (T,) of the frames, seconds.
    - lateral_offset: (T,) lane widths; None if unknown.

    Returns the new state, the rows in which changes are reported (E,), and the columns (E,) of the
    changes, see COLUMNS (without `late_s`).
    """
    lane = np.ascontiguousarray(lane)
    place = np.full(len(lane), np.nan) if lateral_offset is None else lateral_offset
    # A frame has two changes at most.
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
    """The state after T more frames, and the number of changes in them.

    whole (5, E), real (2, E): written, of each change its row, since which frame, the lanes from
        and to, from 1, and the direction; since when, and the new lane's probability.
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
                # The lane that the next change leaves leads now: no search goes past this frame.
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
                    # No lane is index -1, and UNASSIGNED.
                    here, before, k, p = -1, -1, -1, np.nan
                # The place tells when such a change was; no lane led before it.
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
    """Since when each lane has been more probable than `here`, after one more frame; lane (n,), the
    last three as in `EventState`."""
    for k in range(len(lane)):
        leads = lane[k] > lane[here]
        if leads and not ahead[k]:
            since_id[k], since_s[k] = frame_id, time_s
        ahead[k] = leads


def lane_segments(
    lane: FloatArray, events: pd.DataFrame, time_s: FloatArray
) -> list[tuple[int, float, float]]:
    """The lane over time: lane (from 1), and from when to when it was the car's, seconds.

    - lane: (T, n) the posterior over lanes.
    - time_s: (T,) seconds.
    - events: the lane changes of this posterior. A segment ends when the next lane becomes the
      more probable one.

    The first segment begins where a lane is first believed; without such a frame there is none. One
    begins, too, where the belief goes to another lane while the car crosses no line. Lane 0 is a
    stretch in which the lane is not known, after a change without lanes.
    """
    believed = np.flatnonzero(lane.max(axis=1, initial=0) >= CONFIDENT)
    if not len(believed):
        return []
    lanes = lane[believed].argmax(axis=1) + 1
    told = events[["time_s", "to_lane", "detected_time_s"]].values.tolist()
    marks, here, calm, e = dict[float, int](), UNASSIGNED, -np.inf, 0
    for at, k in [*zip(time_s[believed].tolist(), lanes.tolist(), strict=True), (np.inf, 0)]:
        while e < len(told) and told[e][0] <= at:
            began, here, now = told[e][0], int(told[e][1]), told[e][2]
            marks[began] = here
            calm = now + FLICKER_S if here else -np.inf
            e += 1
        if at < np.inf and k != here and at >= calm:
            marks[at] = here = k
    begin = float(time_s[believed[0]])
    borders = [at for at in sorted(marks) if at >= begin]
    ends = [*borders[1:], float(time_s[-1])]
    return [(marks[at], at, end) for at, end in zip(borders, ends, strict=True)]


def across_lanes(
    marginals: Mapping[str, FloatArray], by_lines: FloatArray | None = None
) -> tuple[FloatArray | None, FloatArray | None]:
    """The line crossing probability and the lateral offset, (T,) each, of posteriors by node.

    - by_lines (T,): the offset for graphs without RoadPosition (`place_finder`).

    The line crossing probability is P(RoadPosition at most HALF_CAR from a line between two lanes);
    a cell that is only partly so near counts in part. None without a RoadPosition (cells from left
    to right, the same number in each Lane): a posterior over lanes alone says in which of them the
    car is, never that it is between two. Its motion since half a second before is no substitute:
    with the paper's model it finds the crossing frames of runs 1, 3, 6 and 8 with an AUC of .55 to
    .69.

    The lateral offset from the lane centre is in lane widths, positive to the right, -.5 to .5: the
    circular mean of RoadPosition over all lanes. NaN if it is not definite.
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
    """Fills crossing and place (T,) from RoadPosition (T, n, cells), cells from left to right.
    False where the cells of a lane do not add up to it."""
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
    """The places of a lane's cells as angles."""
    return np.asarray(np.exp(2j * np.pi * (np.arange(n_cells) + 0.5) / n_cells))


@lru_cache(maxsize=8)
def _near_lines(n_lanes: int, n_cells: int) -> FloatArray:
    """How much of each lane's cells is at most half a car's width from a line between lanes."""
    # The places of the cells' borders, in lane widths from the road's left edge.
    border = np.arange(n_lanes * n_cells + 1) / n_cells
    share = np.zeros(n_lanes * n_cells)
    for line in range(1, n_lanes):
        near = np.clip(border, line - HALF_CAR, line + HALF_CAR)
        share += np.diff(near) * n_cells
    return share.reshape(n_lanes, n_cells)
