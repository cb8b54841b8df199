"""Which segments of a map are near a place: the map's points in metres, and a tree of its segments.

Distances and offsets are taken from the segments' lines on a plane (`maps.local`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.local import Plane, around
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import FloatArray, InputError, IntArray


@dataclass(frozen=True)
class RoadIndex:
    """The S segments of a lane graph on a plane.

    - plane: where the metres are counted from
    - point (P, 2): metres east and north
    - along_m (P,): distance of each point from its segment's start; the last one of a segment is
      its length on the ellipsoid
    - first (S + 1,): where each segment's points begin
    - tree: shapely's STRtree of the segments' boxes
    """

    plane: Plane
    point: FloatArray
    along_m: FloatArray
    first: IntArray
    tree: Any


@dataclass(frozen=True)
class Near:
    """The segments near each of T places, N in all; of each segment its place that is nearest.

    - start (T + 1,): where each place's segments begin
    - segment (N,)
    - along_m (N,): from the segment's start
    - offset_m (N,): of the place to the right of the segment's line; its size is the distance
    - heading (N,): direction of travel there, radians, counter-clockwise from east
    """

    start: IntArray
    segment: IntArray
    along_m: FloatArray
    offset_m: FloatArray
    heading: FloatArray


def index_of(graph: LaneGraph) -> RoadIndex:
    """Index a lane graph.

    Raises InputError for a graph without segments, for a point that is no place on Earth, and where
    the libraries of the extra `maps` are not installed.
    """
    with needed("an index of a map", "maps"):
        from shapely import STRtree, box
    if not len(graph):
        raise InputError("the map has no road")
    plane = around(*graph.point.T)
    point = plane.metres(*graph.point.T)
    bad = ~np.isfinite(point).all(axis=1)
    if bad.any():
        segment = int(np.searchsorted(graph.first, np.argmax(bad), side="right")) - 1
        raise InputError(f"way {int(graph.way[segment])}: has a point that is no place on Earth")
    along = np.empty(len(point))
    _measure(point, graph.first, graph.length_m, along)
    begin = graph.first[:-1]
    low = np.minimum.reduceat(point, begin)
    high = np.maximum.reduceat(point, begin)
    tree = STRtree(box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
    return RoadIndex(plane, point, along, graph.first, tree)


def near(index: RoadIndex, place: FloatArray, radius_m: float, most: int = 32) -> Near:
    """The segments within a radius of T places, (T, 2), metres on the index's plane.

    - most: of each place that has more, its nearest are kept
    """
    from shapely import box

    around_it = box(*(place - radius_m).T, *(place + radius_m).T)
    row, segment = index.tree.query(around_it)
    order = np.argsort(row, kind="stable")
    row, segment = row[order], segment[order].astype(np.int64)
    along, offset, heading = (np.empty(len(row)) for _ in range(3))
    _project(index.point, index.along_m, index.first, place, row, segment, along, offset, heading)
    distance = np.abs(offset)
    # Rank of each segment among those of its place.
    by_distance = np.lexsort((distance, row))
    start = np.searchsorted(row, np.arange(len(place) + 1))
    rank = np.empty(len(row), dtype=np.int64)
    rank[by_distance] = np.arange(len(row)) - start[row]
    kept = (distance <= radius_m) & (rank < most)
    return Near(
        np.searchsorted(row[kept], np.arange(len(place) + 1)).astype(np.int64),
        segment[kept],
        along[kept],
        offset[kept],
        heading[kept],
    )


@kernel()
def _measure(point: FloatArray, first: IntArray, length_m: FloatArray, along: FloatArray) -> None:
    """Fills along (P,), scaled so that each segment's last value is its length."""
    for s in range(len(first) - 1):
        a, b = first[s], first[s + 1]
        along[a] = 0.0
        for k in range(a + 1, b):
            dx, dy = point[k, 0] - point[k - 1, 0], point[k, 1] - point[k - 1, 1]
            along[k] = along[k - 1] + np.sqrt(dx * dx + dy * dy)
        total = along[b - 1]
        for k in range(a + 1, b):
            along[k] = along[k] * length_m[s] / total if total > 0.0 else 0.0


@kernel()
def _project(
    point: FloatArray,
    along_m: FloatArray,
    first: IntArray,
    place: FloatArray,
    row: IntArray,
    segment: IntArray,
    along: FloatArray,
    offset: FloatArray,
    heading: FloatArray,
) -> None:
    """Fills along, offset and heading (N,): the place of segment[k] that is nearest to
    place[row[k]]."""
    for k in range(len(row)):
        x, y = place[row[k], 0], place[row[k], 1]
        best = np.inf
        for p in range(first[segment[k]], first[segment[k] + 1] - 1):
            ux, uy = point[p + 1, 0] - point[p, 0], point[p + 1, 1] - point[p, 1]
            vx, vy = x - point[p, 0], y - point[p, 1]
            square = ux * ux + uy * uy
            share = (ux * vx + uy * vy) / square if square > 0.0 else 0.0
            share = min(max(share, 0.0), 1.0)
            dx, dy = vx - share * ux, vy - share * uy
            distance = dx * dx + dy * dy
            if distance < best:
                best = distance
                along[k] = along_m[p] + share * (along_m[p + 1] - along_m[p])
                heading[k] = np.arctan2(uy, ux)
                side = 1.0 if ux * vy - uy * vx <= 0.0 else -1.0
                offset[k] = side * np.sqrt(distance)
