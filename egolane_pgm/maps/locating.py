"""From positions and a map to a road table: which segment, and how far along it.

The matched positions become metres driven along the route, which a Kalman filter with constant
speed smooths (offline forward and backward, Rauch, Tung and Striebel 1965; online forward only).
Outliers and gaps, as a tunnel leaves them, are bridged along the route, with a row a second.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from egolane_pgm.maps.index import RoadIndex
from egolane_pgm.maps.lane_graph import LaneGraph, joins_from, with_guesses
from egolane_pgm.maps.matching import Matched, match
from egolane_pgm.maps.positions import Positions
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

#: A longer gap between two positions is not bridged.
LONGEST_GAP_S = 300.0

#: A gap longer than this gets a row each second.
_GAP_S = 1.5

#: The change of a car's speed, (m/s) per square root of a second, and the standard deviation of a
#: position along the road, metres, where the receiver does not give it.
_SPEED_WALK, _SIGMA_ALONG_M = 1.0, 4.0

#: A position may lie this far behind the one before it on the same segment: noise, not a way round.
_BACK_M = 40.0


@dataclass(frozen=True)
class Route:
    """The R segments that a drive takes one after the other, all runs behind each other. A run ends
    where the car leaves the map, or where no way leads on.

    - segment (R,)
    - begin_m, end_m (R,): metres from the start of the first run
    - run (R,): number of the run
    """

    segment: IntArray
    begin_m: FloatArray
    end_m: FloatArray
    run: IntArray


def locate(
    graph: LaneGraph,
    index: RoadIndex,
    positions: Positions,
    *,
    online: bool = False,
    matched: Matched | None = None,
) -> RoadTable:
    """A row for each position, and one each second in gaps that can be bridged.

    - online: each row knows the positions up to its time only.
    - matched: the road of each position, by default that of `matching.match`

    Where the map tells no number of lanes, it is a guess (`with_guesses`).

    Raises InputError where no position is near a road of the map.
    """
    matched = match(graph, index, positions, online=online) if matched is None else matched
    untold, graph = graph.n_lanes == 0, with_guesses(graph)
    used = np.flatnonzero(matched.segment >= 0)
    if not len(used):
        raise InputError(
            f"{positions.source}: none of {len(positions)} positions is on a road of the map"
            f" ({_span(positions.latitude, positions.longitude)};"
            f" the map: {_span(*graph.point.T)})"
        )
    route, entry = _route(graph, positions, matched, used)
    driven = route.begin_m[entry] + matched.along_m[used]
    sigma = np.fmax(np.nan_to_num(positions.sigma_m[used], nan=_SIGMA_ALONG_M), 1.0)
    smooth, speed = np.empty(len(used)), np.empty(len(used))
    _smooth(positions.t_s[used], driven, sigma, route.run[entry], online, smooth, speed)
    # Online the route is known as far as the segment of the time; a run begins and ends on it.
    last = entry if online else np.searchsorted(route.run, route.run[entry], side="right") - 1
    begin = route.begin_m[np.searchsorted(route.run, route.run[entry])]
    smooth = np.clip(smooth, begin, route.end_m[last] - 1e-6)

    time, row, is_position = _times(positions, matched, used, route.run[entry], online)
    at = np.full(len(time), np.nan)
    on = row >= 0
    at[on] = _bridged(time[on], row[on], positions.t_s[used], smooth, speed, online)
    sure = np.where(is_position >= 0, matched.sure[np.maximum(is_position, 0)], 0.0)
    bridged = on & ((is_position < 0) | matched.is_outlier[np.maximum(is_position, 0)])
    after = np.minimum(row + (not online), len(used) - 1)
    sure[bridged] = np.minimum(matched.sure[used][row], matched.sure[used][after])[bridged]

    segment = np.full(len(time), -1, dtype=np.int64)
    along = np.full(len(time), np.nan)
    place = np.full(len(time), -1, dtype=np.int64)
    # A place between two runs is on the one that the row belongs to.
    low = np.searchsorted(route.run, route.run[entry[row[on]]])
    high = np.searchsorted(route.run, route.run[entry[row[on]]], side="right") - 1
    here = np.searchsorted(route.begin_m, at[on], side="right") - 1
    place[on] = np.clip(here, low, entry[row[on]] if online else high)
    segment[on] = route.segment[place[on]]
    along[on] = at[on] - route.begin_m[place[on]]
    if online:
        _go_on(graph, segment, along, sure, on)
    here = np.maximum(segment, 0)
    offset = np.where(is_position >= 0, matched.offset_m[np.maximum(is_position, 0)], np.nan)
    return RoadTable(
        t_s=time,
        segment=segment,
        along_m=along,
        offset_m=np.where(on, offset, np.nan),
        sure=sure,
        n_lanes=np.where(on, graph.n_lanes[here], 0),
        source=positions.source,
        untold=np.where(on & untold[here], graph.way[here], 0),
    )


def _span(latitude: FloatArray, longitude: FloatArray) -> str:
    return (
        f"latitude {latitude.min():.4f} to {latitude.max():.4f},"
        f" longitude {longitude.min():.4f} to {longitude.max():.4f}"
    )


# --- the route -------------------------------------------------------------------------------


def _route(
    graph: LaneGraph, positions: Positions, matched: Matched, used: IntArray
) -> tuple[Route, IntArray]:
    """The route of the used positions, and the entry of it that each is on, (U,)."""
    joins = joins_from(graph)
    segment, along = matched.segment[used], matched.along_m[used]
    stays = (np.diff(segment) == 0) & (np.diff(along) > -_BACK_M)
    is_off = (matched.segment < 0) & ~matched.is_outlier
    n_off = np.concatenate([[0], np.cumsum(is_off)])
    parted = (n_off[used[1:]] != n_off[used[:-1]]) | (np.diff(positions.t_s[used]) > LONGEST_GAP_S)
    step = np.zeros(len(used), dtype=np.int64)
    passed, run = [int(segment[0])], [0]
    for k in np.flatnonzero(~stays | parted):
        way = None
        if not parted[k]:
            here, there = used[k], used[k + 1]
            limit = 100.0 * (positions.t_s[there] - positions.t_s[here]) + 200.0
            rest = float(graph.length_m[segment[k]] - along[k])
            way = _way(graph, joins, int(segment[k]), int(segment[k + 1]), rest, limit)
        more = [int(segment[k + 1])] if way is None else way
        run += [run[-1] + (way is None)] * len(more)
        passed += more
        step[k + 1] = len(more)
    length = graph.length_m[passed]
    end = np.cumsum(length)
    return Route(np.array(passed), end - length, end, np.array(run)), np.cumsum(step)


def _way(
    graph: LaneGraph, joins: IntArray, here: int, there: int, rest: float, limit: float
) -> list[int] | None:
    """The segments after `here` on the shortest way to `there`, or None where it is longer than the
    limit (Dijkstra). rest: metres to the end of `here`."""
    heap = [(rest, -1, here)]
    came: dict[int, int] = {}
    while heap:
        metres, before, segment = heapq.heappop(heap)
        if segment in came or metres > limit:
            continue
        if before >= 0:
            came[segment] = before
            if segment == there:
                way = [there]
                while came[way[0]] != here:
                    way.insert(0, came[way[0]])
                return way
            metres += float(graph.length_m[segment])
        for row in range(joins[segment], joins[segment + 1]):
            heapq.heappush(heap, (metres, segment, int(graph.after[row])))
    return None


# --- along the route -------------------------------------------------------------------------


@kernel()
def _smooth(
    t_s: FloatArray,
    driven: FloatArray,
    sigma: FloatArray,
    run: IntArray,
    online: bool,
    out: FloatArray,
    speed: FloatArray,
) -> None:
    """Fills out and speed (U,): metres driven and metres per second, filtered (online) or smoothed
    within each run."""
    n = len(t_s)
    mean, cov = np.empty((n, 2)), np.empty((n, 2, 2))
    for k in range(n):
        if k == 0 or run[k] != run[k - 1]:
            mean[k, 0], mean[k, 1] = driven[k], 15.0
            cov[k, 0, 0], cov[k, 1, 1] = sigma[k] ** 2, 15.0**2
            cov[k, 0, 1] = cov[k, 1, 0] = 0.0
            continue
        dt = t_s[k] - t_s[k - 1]
        q = _SPEED_WALK**2
        x = mean[k - 1, 0] + dt * mean[k - 1, 1]
        v = mean[k - 1, 1]
        old = cov[k - 1]
        p00 = old[0, 0] + 2 * dt * old[0, 1] + dt * dt * old[1, 1] + q * dt**3 / 3
        p01 = old[0, 1] + dt * old[1, 1] + q * dt * dt / 2
        p11 = old[1, 1] + q * dt
        total = p00 + sigma[k] ** 2
        gain0, gain1 = p00 / total, p01 / total
        off = driven[k] - x
        mean[k, 0], mean[k, 1] = x + gain0 * off, v + gain1 * off
        cov[k, 0, 0] = (1 - gain0) * p00
        cov[k, 0, 1] = cov[k, 1, 0] = (1 - gain0) * p01
        cov[k, 1, 1] = p11 - gain1 * p01
    if not online:
        for k in range(n - 2, -1, -1):
            if run[k] != run[k + 1]:
                continue
            # The smoothed covariance is not needed; the gain takes the filtered one.
            dt = t_s[k + 1] - t_s[k]
            q = _SPEED_WALK**2
            old = cov[k]
            c00 = old[0, 0] + dt * old[0, 1]
            c10 = old[0, 1] + dt * old[1, 1]
            p00 = c00 + dt * c10 + q * dt**3 / 3
            p01 = c10 + q * dt * dt / 2
            p11 = old[1, 1] + q * dt
            det = p00 * p11 - p01 * p01
            dx = mean[k + 1, 0] - mean[k, 0] - dt * mean[k, 1]
            dv = mean[k + 1, 1] - mean[k, 1]
            a, b = (p11 * dx - p01 * dv) / det, (p00 * dv - p01 * dx) / det
            mean[k, 0] += c00 * a + old[0, 1] * b
            mean[k, 1] += c10 * a + old[1, 1] * b
    out[:] = mean[:, 0]
    speed[:] = mean[:, 1]


def _times(
    positions: Positions, matched: Matched, used: IntArray, run: IntArray, online: bool
) -> tuple[FloatArray, IntArray, IntArray]:
    """The times of the rows; for each the last used position, from which its place follows, -1 off
    the map; and the position at its very time, -1 in gaps."""
    t_s = positions.t_s
    gap = np.diff(t_s[used])
    bridges = np.diff(run) == 0
    inside = [
        t_s[used[k]] + np.arange(1, np.ceil(gap[k]))
        for k in np.flatnonzero((gap > _GAP_S) & (gap <= LONGEST_GAP_S) & (bridges | online))
    ]
    more = np.setdiff1d(np.concatenate(inside) if inside else [], t_s)
    time = np.concatenate([t_s, more])
    which = np.concatenate([np.arange(len(t_s)), np.full(len(more), -1)])
    order = np.argsort(time, kind="stable")
    time, which = time[order], which[order]
    row = np.searchsorted(t_s[used], time, side="right") - 1
    is_off = (matched.segment < 0) & ~matched.is_outlier
    # Between two used positions that no route joins, and before and after all, nothing is known.
    lost = np.append(~bridges, True)
    exact = (row >= 0) & (t_s[used][row] == time)
    known = (row >= 0) & (exact | ~lost[row])
    if online:
        # Whether the route goes on is not known yet.
        known = (row >= 0) & (time - t_s[used][row] <= LONGEST_GAP_S)
        gone = np.searchsorted(t_s[is_off], time, side="right")
        known &= gone == np.searchsorted(t_s[is_off], t_s[used][row], side="right")
    return time, np.where(known, row, -1), which


def _bridged(
    time: FloatArray,
    row: IntArray,
    t_s: FloatArray,
    driven: FloatArray,
    speed: FloatArray,
    online: bool,
) -> FloatArray:
    """Metres driven at each time, (N,): between two used positions the cubic that has their places
    and speeds, never going back; online what the last speed leads to."""
    dt = time - t_s[row]
    if online:
        return driven[row] + np.maximum(speed[row], 0.0) * dt
    after = np.minimum(row + 1, len(t_s) - 1)
    span = np.where(after > row, t_s[after] - t_s[row], 1.0)
    s = dt / span
    a, b = driven[row], driven[after]
    cubic = (
        (2 * s**3 - 3 * s**2 + 1) * a
        + (s**3 - 2 * s**2 + s) * span * speed[row]
        + (3 * s**2 - 2 * s**3) * b
        + (s**3 - s**2) * span * speed[after]
    )
    between = np.clip(cubic, np.minimum(a, b), np.maximum(a, b))
    return np.where(dt == 0, a, between)


# --- behind the last position ------------------------------------------------------------------


def _go_on(
    graph: LaneGraph, segment: IntArray, along: FloatArray, sure: FloatArray, on: BoolArray
) -> None:
    """Moves the places (N,) that lie behind the end of their segment along the road, in place.
    Where it splits, each branch is as likely."""
    joins = joins_from(graph)
    for k in np.flatnonzero(on & (along > graph.length_m[np.maximum(segment, 0)])):
        while along[k] > graph.length_m[segment[k]]:
            rows = range(joins[segment[k]], joins[segment[k] + 1])
            if not rows:
                along[k] = graph.length_m[segment[k]]
                break
            sure[k] /= len(rows)
            along[k] -= graph.length_m[segment[k]]
            segment[k] = graph.after[_onward(graph, int(segment[k]), rows)]


def _onward(graph: LaneGraph, segment: int, rows: range) -> int:
    """The join by which the road goes on: onto a segment of the same kind and name, if there is
    one.

    - rows: the joins that leave the segment.
    """
    return max(
        rows,
        key=lambda row: (
            graph.kind[graph.after[row]] == graph.kind[segment],
            graph.name[graph.after[row]] == graph.name[segment],
        ),
    )
