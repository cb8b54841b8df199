"""From positions and a map to a road table: the segment at each time, and the place on it.

Offline, outliers and gaps (tunnels) are bridged along the route at constant speed, with a row each
second. Online, an outlier keeps the last known place.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from egolane_pgm.maps.lane_graph import LaneGraph, assumed_lanes
from egolane_pgm.maps.matching import OFF, Matched, match
from egolane_pgm.maps.positions import Positions
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import FloatArray, InputError, IntArray

#: A longer gap between two positions is not bridged.
LONGEST_GAP_S = 300.0

#: A gap longer than this gets a row each second.
_GAP_S = 1.5

#: A position may lie this far behind the one before on the same segment: noise, not a loop.
_BACK_M = 40.0

#: The fastest way is refused if it is longer than what a car can drive: this speed, and a margin.
_TOP_MPS, _MARGIN_M = 100.0, 200.0

#: Times (N,) of the rows, with segment, metres along it, its probability, and the offset.
_Rows = tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]


def locate(
    graph: LaneGraph,
    positions: Positions,
    *,
    online: bool = False,
    matched: Matched | None = None,
) -> RoadTable:
    """A row for each position, and offline one each second in gaps that can be bridged.

    - online: each row depends on positions up to its time only.
    - matched: the road of each position, by default from `matching.match`.

    Segments without a number of lanes get an assumed one (`assumed_lanes`).

    Raises InputError if no position is near a road of the map.
    """
    matched = match(graph, positions, online=online) if matched is None else matched
    used = np.flatnonzero(matched.segment >= 0)
    if not len(used):
        raise InputError(
            f"{positions.source}: no position of {len(positions)} is on a road of the map"
            f" ({_span(positions.latitude, positions.longitude)};"
            f" the map: {_span(*graph.plane.degrees(graph.point).T)})"
        )
    rows = _hold(positions.t_s, matched) if online else _bridge(graph, positions.t_s, matched, used)
    time, segment, along, sure, offset = rows
    on, unknown = segment >= 0, graph.n_lanes == 0
    return RoadTable(
        t_s=time,
        segment=segment,
        along_m=along,
        offset_m=offset,
        sure=sure,
        n_lanes=np.where(on, assumed_lanes(graph)[segment], 0),
        unknown_way=np.where(on & unknown[segment], graph.way[segment], 0),
        source=positions.source,
    )


def _span(latitude: FloatArray, longitude: FloatArray) -> str:
    return (
        f"latitude {latitude.min():.4f} to {latitude.max():.4f},"
        f" longitude {longitude.min():.4f} to {longitude.max():.4f}"
    )


def _hold(t_s: FloatArray, matched: Matched) -> _Rows:
    """The rows of T positions; an outlier has the place of the last inlier."""
    times = np.arange(len(t_s))
    known = times.copy()
    for t in np.flatnonzero(matched.is_outlier[1:]) + 1:
        last = known[t - 1]
        known[t] = last if t_s[t] - t_s[last] <= LONGEST_GAP_S else t
    offset = np.where(known == times, matched.offset_m, np.nan)
    return t_s, matched.segment[known], matched.along_m[known], matched.sure[known], offset


def _bridge(graph: LaneGraph, t_s: FloatArray, matched: Matched, used: IntArray) -> _Rows:
    """The rows of T positions; those between used ones lie along the route."""
    is_off = (matched.segment == OFF) & ~matched.is_outlier
    kept = np.ones(len(t_s), dtype=np.bool_)
    added: list[_Rows] = []
    gap = np.diff(t_s[used])
    for k in np.flatnonzero(((np.diff(used) > 1) | (gap > _GAP_S)) & (gap <= LONGEST_GAP_S)):
        a, b = used[k], used[k + 1]
        way = None if is_off[a:b].any() else _route(graph, matched, a, b, gap[k])
        if way is None:
            continue
        kept[a + 1 : b] = False
        time = np.union1d(t_s[a + 1 : b], t_s[a] + np.arange(1.0, np.ceil(gap[k])))
        begin = np.cumsum([0.0, *graph.length_m[way[:-1]]])
        total = begin[-1] + matched.along_m[b] - matched.along_m[a]
        driven = matched.along_m[a] + total * (time - t_s[a]) / gap[k]
        nth = np.searchsorted(begin[1:], driven, side="right")
        sure = np.full(len(time), min(matched.sure[a], matched.sure[b]))
        unknown = np.full(len(time), np.nan)
        added.append((time, np.array(way)[nth], driven - begin[nth], sure, unknown))
    found = (t_s, matched.segment, matched.along_m, matched.sure, matched.offset_m)
    parts = [tuple(column[kept] for column in found), *added]
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    time, segment, along, sure, offset = (column[order] for column in columns)
    return time, segment, along, sure, offset


def _route(graph: LaneGraph, matched: Matched, a: int, b: int, seconds: float) -> list[int] | None:
    """The segments on the shortest way from position a to position b, both ends included; None if
    it is longer than a car can drive."""
    here, there = int(matched.segment[a]), int(matched.segment[b])
    if here == there and matched.along_m[b] - matched.along_m[a] > -_BACK_M:
        return [here]
    limit = _TOP_MPS * seconds + _MARGIN_M + matched.along_m[a]
    metres, previous = dijkstra(graph.joins, indices=here, limit=limit, return_predecessors=True)
    # The way ends with a join, because on a ring it may lead back to the segment where it starts.
    before = graph.before[graph.after == there]
    ends = metres[before] + graph.length_m[before]
    if not len(before) or not ends.min() <= limit:
        return None
    way = [there, int(before[ends.argmin()])]
    while way[-1] != here:
        way.append(int(previous[way[-1]]))
    return way[::-1]
