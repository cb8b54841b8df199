"""Small lane graphs for the tests, drawn in metres, and trips over any graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph, Plane
from egolane_pgm.maps.positions import Positions
from egolane_pgm.types import FloatArray, IntArray

#: Where the drawn roads are.
PLANE = Plane(50.0, 11.5)


def lane_map(
    lines: Sequence[Sequence[tuple[float, float]]],
    n_lanes: Sequence[int],
    joins: Sequence[tuple[int, int]] = (),
    plane: Plane = PLANE,
) -> LaneGraph:
    """A graph of segments along lines in metres, east and north of the plane's centre.

    - joins: the segments that each leads from and to.
    """
    points = [np.array(line, dtype=float) for line in lines]
    n = len(lines)
    before, after = np.array(sorted(joins), dtype=np.int64).reshape(-1, 2).T
    return LaneGraph(
        way=np.arange(n) + 100,
        kind=np.full(n, "motorway"),
        name=np.array([f"A {k}" for k in range(n)], dtype=object),
        n_lanes=np.array(n_lanes),
        plane=plane,
        point=np.concatenate(points),
        first=np.concatenate([[0], np.cumsum([len(p) for p in points])]),
        before=before,
        after=after,
    )


def interchange() -> LaneGraph:
    """Two carriageways of 6 km, 15 m apart. On the eastward one a third lane begins after 2 km (at
    the right), an exit leaves after 3 km and comes back after 5 km."""
    return lane_map(
        [
            [(0, 0), (2000, 0)],
            [(2000, 0), (3000, 0)],
            [(3000, 0), (5000, 0)],
            [(5000, 0), (6000, 0)],
            [(3000, 0), (3200, -20), (3500, -60), (4500, -60), (4800, -20), (5000, 0)],
            [(6000, 15), (0, 15)],
        ],
        [2, 3, 2, 2, 1, 2],
        [(0, 1), (1, 2), (1, 4), (2, 3), (4, 3)],
    )


def random_trip(
    graph: LaneGraph,
    rng: np.random.Generator,
    *,
    longest_m: float = 30_000.0,
) -> tuple[Positions, IntArray]:
    """Positions once a second, at 30 m/s, on a random way along the joins, and the segment of each.

    The noise (3 m) is half white and half slow, as a receiver's; the standard deviation of the
    lane's offset from the way's line is 3 m.
    """
    joins = graph.join_start
    way = [int(rng.choice(len(graph), p=graph.length_m / graph.length_m.sum()))]
    while graph.length_m[way].sum() < longest_m and joins[way[-1]] < joins[way[-1] + 1]:
        row = rng.integers(joins[way[-1]], joins[way[-1] + 1])
        way.append(int(graph.after[row]))
    start = np.concatenate([[0.0], np.cumsum(graph.length_m[way])])
    driven = np.arange(rng.uniform(0.0, start[1]), start[-1], 30.0)
    at = np.minimum(np.searchsorted(start, driven, side="right") - 1, len(way) - 1)
    segment = np.array(way)[at]
    place = np.stack(
        [_place(graph, s, d) for s, d in zip(segment, driven - start[at], strict=True)]
    )
    heading = np.gradient(place, axis=0) if len(place) > 1 else np.ones_like(place)
    right = np.stack([heading[:, 1], -heading[:, 0]], axis=1)
    right /= np.linalg.norm(right, axis=1, keepdims=True) + 1e-9
    place += right * slow(rng, len(place), 60)[:, None] * 3.0
    drift = np.stack([slow(rng, len(place), 30) for _ in range(2)], axis=1)
    place += 3.0 * np.sqrt(0.5) * (drift + rng.normal(size=place.shape))
    latitude, longitude = graph.plane.degrees(place).T
    return Positions.make(np.arange(len(place)) * 1.0, latitude, longitude), segment


def _place(graph: LaneGraph, segment: int, along: float) -> FloatArray:
    rows = slice(graph.first[segment], graph.first[segment + 1])
    return np.array(
        [np.interp(along, graph.along_m[rows], graph.point[rows, axis]) for axis in (0, 1)]
    )


def slow(rng: np.random.Generator, n: int, seconds: float) -> FloatArray:
    """A Gauss-Markov process of standard deviation 1, (n,), with this correlation time."""
    kept = np.exp(-1 / seconds)
    value, values = rng.normal(), []
    for step in rng.normal(size=n):
        values.append(value)
        value = kept * value + np.sqrt(1 - kept**2) * step
    return np.array(values)


def road_rows(
    n_lanes: Sequence[int],
    first_s: float = 0.0,
    *,
    off: Sequence[int] = (),
    unknown_way: Mapping[int, int] | None = None,
) -> pd.DataFrame:
    """A road table with a row a second.

    - off: rows that are off the map.
    - unknown_way: rows whose way tells no number of lanes, and that way.
    """
    n = len(n_lanes)
    segment, way = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    segment[list(off)] = -1
    for row, number in (unknown_way or {}).items():
        way[row] = number
    table = pd.DataFrame({"t_s": first_s + np.arange(n), "segment": segment, "unknown_way": way})
    table.attrs["source"] = "road table"
    return table.assign(along_m=0.0, offset_m=0.0, sure=1.0, n_lanes=n_lanes)
