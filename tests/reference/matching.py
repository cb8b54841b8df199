"""Plain twins of map matching: every segment tried, every path enumerated."""

from __future__ import annotations

from itertools import product

import numpy as np

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.types import FloatArray, IntArray


def nearest_by_hand(
    graph: LaneGraph, place: FloatArray, radius_m: float
) -> dict[int, tuple[float, float]]:
    """Segment: (metres along it, distance) of its place that is nearest, for those in a radius."""
    found = {}
    for segment in range(len(graph)):
        rows = range(graph.first[segment], graph.first[segment + 1] - 1)
        options = []
        for row in rows:
            a, b = graph.point[row], graph.point[row + 1]
            share = float(np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1))
            along = graph.along_m[row] * (1 - share) + graph.along_m[row + 1] * share
            options.append((float(np.linalg.norm(place - a - share * (b - a))), float(along)))
        distance, along = min(options)
        if distance <= radius_m:
            found[segment] = (along, distance)
    return found


def enumerated(
    size: IntArray, emission: FloatArray, transition: FloatArray
) -> tuple[FloatArray, FloatArray, list[int]]:
    """Filtered and smoothed beliefs (M,), and the best path, by all paths."""
    first = np.concatenate([[0], np.cumsum(size)])

    def weight(path: tuple[int, ...]) -> float:
        total, at = 0.0, 0
        for t, state in enumerate(path):
            total += emission[first[t] + state]
            if t:
                total += transition[at + path[t - 1] * size[t] + state]
                at += size[t - 1] * size[t]
        return float(total)

    def belief(last: int, t: int) -> FloatArray:
        share = np.zeros(size[t])
        for path in product(*map(range, size[: last + 1])):
            share[path[t]] += np.exp(weight(path))
        return share / share.sum()

    n = len(size)
    filtered = np.concatenate([belief(t, t) for t in range(n)])
    smoothed = np.concatenate([belief(n - 1, t) for t in range(n)])
    return filtered, smoothed, list(max(product(*map(range, size)), key=weight))
