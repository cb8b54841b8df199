"""The segments of a map near a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.types import FloatArray, IntArray


@dataclass(frozen=True)
class Near:
    """The segments near each of T places, N in all, each with its place that is nearest.

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


def near(graph: LaneGraph, place: FloatArray, radius_m: float) -> Near:
    """The segments within a radius of T places, (T, 2), metres on the graph's plane."""
    from shapely import line_locate_point, points

    point = points(place)
    row, segment = graph.tree.query(point, predicate="dwithin", distance=radius_m)
    order = np.lexsort((segment, row))
    row, segment = row[order], segment[order].astype(np.int64)
    along = line_locate_point(graph.lines[segment], point[row])
    # All segments laid one behind the other, so that one search finds the piece of each line.
    begin = np.cumsum(graph.length_m) - graph.length_m
    laid = graph.along_m + np.repeat(begin, np.diff(graph.first))
    piece = np.searchsorted(laid, begin[segment] + along) - 1
    piece = np.clip(piece, graph.first[segment], graph.first[segment + 1] - 2)
    (ux, uy), (vx, vy) = (
        (graph.point[piece + 1] - graph.point[piece]).T,
        (place[row] - graph.point[piece]).T,
    )
    length = np.maximum(np.hypot(ux, uy), 1e-9)
    share = np.clip((along - graph.along_m[piece]) / length, 0.0, 1.0)
    distance = np.hypot(vx - share * ux, vy - share * uy)
    return Near(
        np.searchsorted(row, np.arange(len(place) + 1)).astype(np.int64),
        segment,
        along,
        np.where(ux * vy - uy * vx <= 0.0, distance, -distance),
        np.arctan2(uy, ux),
    )
