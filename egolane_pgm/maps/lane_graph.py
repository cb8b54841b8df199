"""A road map as a graph: segments with a number of lanes, and joins between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.extras import needed
from egolane_pgm.types import FloatArray, IntArray


@dataclass(frozen=True)
class Plane:
    """A plane around a centre (transverse Mercator, WGS 84); latitude and longitude in degrees.

    Distances are 0.11 % too long 300 km east or west of the centre: good for one country.
    """

    latitude: float
    longitude: float

    @cached_property
    def _projection(self) -> Any:
        with needed("a position on a map", "maps"):
            import pyproj
        return pyproj.Proj(
            proj="tmerc", ellps="WGS84", lat_0=self.latitude, lon_0=self.longitude, units="m"
        )

    def metres(self, latitude: Any, longitude: Any) -> FloatArray:
        """Return N places in degrees as metres east and north of the centre, (N, 2)."""
        return np.stack(self._projection(np.asarray(longitude), np.asarray(latitude)), axis=-1)

    def degrees(self, metres: FloatArray) -> FloatArray:
        """Return N places in metres as latitude and longitude, (N, 2), degrees."""
        longitude, latitude = self._projection(metres[:, 0], metres[:, 1], inverse=True)
        return np.stack([latitude, longitude], axis=-1)


def around(latitude: FloatArray, longitude: FloatArray) -> Plane:
    """The plane centred on N places, (N,) each, in degrees."""
    return Plane(*((float(v.min()) + float(v.max())) / 2 for v in (latitude, longitude)))


@dataclass(frozen=True)
class LaneGraph:
    """S segments and J joins.

    A segment is a directed carriageway with constant tags: ways of the map are joined if their tags
    are equal. A road for both directions is two segments.

    - way (S,): OpenStreetMap's id of the first way.
    - kind (S,): its tag `highway`, such as "motorway" or "motorway_link".
    - name (S,): the road's number (tag `ref`) or name, Python strings; "" if unknown.
    - n_lanes (S,): 0 if unknown.
    - plane: the origin of the metres.
    - point (P, 2): metres east and north, in the direction of travel.
    - first (S + 1,): the points of segment k are `point[first[k]:first[k + 1]]`, at least two.
    - before, after (J,): the segments that a join leads from and to, sorted by before, then after.
    """

    way: IntArray
    kind: NDArray[np.str_]
    name: NDArray[np.object_]
    n_lanes: IntArray
    plane: Plane
    point: FloatArray
    first: IntArray
    before: IntArray
    after: IntArray

    def __len__(self) -> int:
        return len(self.way)

    @cached_property
    def along_m(self) -> FloatArray:
        """Metres from the start of its segment to each point, (P,)."""
        metres = np.hypot(*np.diff(self.point, axis=0, prepend=self.point[:1]).T)
        metres[self.first[:-1]] = 0.0
        total = np.cumsum(metres)
        along: FloatArray = total - np.repeat(total[self.first[:-1]], np.diff(self.first))
        return along

    @cached_property
    def length_m(self) -> FloatArray:
        """The length of each segment, (S,), metres."""
        return self.along_m[self.first[1:] - 1]

    @cached_property
    def join_start(self) -> IntArray:
        """(S + 1,): the joins that leave segment k are the rows `join_start[k]:join_start[k + 1]`
        of `before` and `after`."""
        return np.searchsorted(self.before, np.arange(len(self) + 1)).astype(np.int64)

    @cached_property
    def lines(self) -> Any:
        """The segments as shapely lines, (S,)."""
        with needed("a map", "maps"):
            from shapely import linestrings
        return linestrings(self.point, indices=np.repeat(np.arange(len(self)), np.diff(self.first)))

    @cached_property
    def tree(self) -> Any:
        """A spatial index of the lines."""
        from shapely import STRtree

        return STRtree(self.lines)


def assumed_lanes(graph: LaneGraph) -> IntArray:
    """The number of lanes of each segment, (S,), assumed if it is not in the map.

    The assumed number comes from the segment of the same kind before (the widest of several), else
    from the segment after, else it is the most frequent one of the kind, by length. 0 stays if no
    segment of the kind has a number.
    """
    along = graph.kind[graph.before] == graph.kind[graph.after]
    before = graph.before[along]
    after = graph.after[along]
    n_lanes = graph.n_lanes.copy()
    for here, there in ((before, after), (after, before)):
        is_new = True
        # A number spreads by one segment each time.
        while is_new:
            found = np.zeros(len(graph), dtype=np.int64)
            np.maximum.at(found, there, n_lanes[here])
            new = (n_lanes == 0) & (found > 0)
            n_lanes[new] = found[new]
            is_new = bool(new.any())
    for kind in np.unique(graph.kind[n_lanes == 0]):
        known = (graph.kind == kind) & (graph.n_lanes > 0)
        if known.any():
            usual = np.bincount(graph.n_lanes[known], weights=graph.length_m[known]).argmax()
            n_lanes[(graph.kind == kind) & (n_lanes == 0)] = usual
    return n_lanes


@dataclass(frozen=True)
class Near:
    """The segments near each of T places, N in all.

    - start (T + 1,): the segments of place t are the rows `start[t]:start[t + 1]`.
    - segment (N,): row of the lane graph.
    - along_m (N,): metres from the segment's start to its point nearest to the place.
    - offset_m (N,): distance of the place from that point, positive to the right of the line.
    - heading (N,): direction of travel there, radians, counter-clockwise from east.
    """

    start: IntArray
    segment: IntArray
    along_m: FloatArray
    offset_m: FloatArray
    heading: FloatArray


def near(graph: LaneGraph, place: FloatArray, radius_m: float) -> Near:
    """The segments within a radius of T places, (T, 2), metres on the graph's plane."""
    from shapely import (
        distance,
        get_coordinates,
        line_interpolate_point,
        line_locate_point,
        points,
    )

    point = points(place)
    row, segment = graph.tree.query(point, predicate="dwithin", distance=radius_m)
    order = np.lexsort((segment, row))
    row = row[order]
    segment = segment[order].astype(np.int64)
    line = graph.lines[segment]
    along = line_locate_point(line, point[row])
    # The direction of a metre of the line.
    ends = np.maximum(along - 0.5, 0.0), along + 0.5
    begin, end = (get_coordinates(line_interpolate_point(line, at)) for at in ends)
    ux, uy = (end - begin).T
    vx, vy = (place[row] - begin).T
    offset = distance(line, point[row])
    return Near(
        np.searchsorted(row, np.arange(len(place) + 1)).astype(np.int64),
        segment,
        along,
        np.where(ux * vy - uy * vx <= 0.0, offset, -offset),
        np.arctan2(uy, ux),
    )
