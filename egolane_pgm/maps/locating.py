"""From positions and a map to a road table: the segment at each time, and the place on it.

Offline, outliers and gaps (tunnels) are bridged along the route at constant speed, with a row each
second. Online, an outlier keeps the last known place.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import dijkstra

from egolane_pgm.maps.lane_graph import LaneGraph, assumed_lanes
from egolane_pgm.maps.matching import OFF, match
from egolane_pgm.maps.positions import Positions
from egolane_pgm.maps.road_table import COLUMNS
from egolane_pgm.types import FloatArray, InputError

#: A longer gap between two positions is not bridged.
LONGEST_GAP_S = 300.0

#: A gap longer than this gets a row each second.
_GAP_S = 1.5

#: A position may lie this far behind the one before on the same segment: noise, not a loop.
_BACK_M = 40.0

#: The fastest way is refused if it is longer than what a car can drive: this speed, and a margin.
_TOP_MPS, _MARGIN_M = 100.0, 200.0


def locate(graph: LaneGraph, positions: Positions, *, online: bool = False) -> pd.DataFrame:
    """The road table of T positions; see `road_table.COLUMNS`.

    It has a row for each position, and offline one each second in gaps that can be bridged.
    Segments without a number of lanes get an assumed one (`assumed_lanes`).

    - online: each row depends on positions up to its time only.

    Raises InputError if no position is near a road of the map.
    """
    matched = match(graph, positions, online=online)
    if (matched.segment < 0).all():
        raise InputError(
            f"{positions.source}: no position of {len(positions)} is on a road of the map"
            f" ({_span(positions.latitude, positions.longitude)};"
            f" the map: {_span(*graph.plane.degrees(graph.point).T)})"
        )
    table = _hold(matched) if online else _bridge(graph, matched)
    segment = table.segment.to_numpy()
    on, is_unknown = segment >= 0, graph.n_lanes[segment] == 0
    table["n_lanes"] = np.where(on, assumed_lanes(graph)[segment], 0)
    table["unknown_way"] = np.where(on & is_unknown, graph.way[segment], 0)
    table.attrs["source"] = positions.source
    return table[[*COLUMNS]]


def _span(latitude: FloatArray, longitude: FloatArray) -> str:
    return (
        f"latitude {latitude.min():.4f} to {latitude.max():.4f},"
        f" longitude {longitude.min():.4f} to {longitude.max():.4f}"
    )


def _hold(matched: pd.DataFrame) -> pd.DataFrame:
    """The rows of T positions; an outlier has the place of the last inlier."""
    t_s, times = matched.t_s.to_numpy(), np.arange(len(matched))
    known = times.copy()
    for t in np.flatnonzero(matched.is_outlier[1:]) + 1:
        last = known[t - 1]
        known[t] = last if t_s[t] - t_s[last] <= LONGEST_GAP_S else t
    offset = np.where(known == times, matched.offset_m, np.nan)
    return matched.iloc[known].reset_index(drop=True).assign(t_s=t_s, offset_m=offset)


def _bridge(graph: LaneGraph, matched: pd.DataFrame) -> pd.DataFrame:
    """The rows of T positions; those between inliers on the map lie along the route."""
    t_s, segment, along, sure = matched[["t_s", "segment", "along_m", "sure"]].to_numpy().T
    used = np.flatnonzero(segment >= 0)
    is_off = (segment == OFF) & ~matched.is_outlier.to_numpy()
    kept = np.ones(len(matched), dtype=np.bool_)
    added = []
    gap = np.diff(t_s[used])
    for k in np.flatnonzero(((np.diff(used) > 1) | (gap > _GAP_S)) & (gap <= LONGEST_GAP_S)):
        a, b = used[k], used[k + 1]
        ends = int(segment[a]), along[a], int(segment[b]), along[b]
        way = None if is_off[a:b].any() else _route(graph, *ends, gap[k])
        if way is None:
            continue
        kept[a + 1 : b] = False
        time = np.union1d(t_s[a + 1 : b], t_s[a] + np.arange(1.0, np.ceil(gap[k])))
        begin = np.cumsum([0.0, *graph.length_m[way[:-1]]])
        total = begin[-1] + along[b] - along[a]
        driven = along[a] + total * (time - t_s[a]) / gap[k]
        nth = np.searchsorted(begin[1:], driven, side="right")
        place = {"segment": np.array(way)[nth], "along_m": driven - begin[nth]}
        added.append(pd.DataFrame({"t_s": time, **place, "sure": min(sure[a], sure[b])}))
    rows = pd.concat([matched[kept], *added])
    return rows.sort_values("t_s", kind="stable", ignore_index=True)


def _route(
    graph: LaneGraph, here: int, from_m: float, there: int, to_m: float, seconds: float
) -> list[int] | None:
    """The segments on the shortest way between two places, both ends included; None if it is
    longer than a car can drive.

    - from_m, to_m: metres along the segments `here` and `there`.
    """
    if here == there and to_m - from_m > -_BACK_M:
        return [here]
    limit = _TOP_MPS * seconds + _MARGIN_M + from_m
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
