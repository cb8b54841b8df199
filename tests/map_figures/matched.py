"""How often the right segment is found, on trips over the two real maps and their mirror images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from egolane_pgm.maps.index import index_of
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.lock_on_road import lock_on_road
from egolane_pgm.types import IntArray
from tests.kits.lane_maps import random_trip
from tests.map_figures._drives import real_maps, share, text

N_TRIPS = 40

#: A wrong second is near a join of both segments if it is at most so far from it, metres.
NEAR_M = 10.0


def measure() -> Iterator[str]:
    """Lines of a table."""
    yield "| map | positions | offline | online | nearest road | wrong offline, no join near |"
    yield "|---|---:|---:|---:|---:|---:|"
    for name, graph in real_maps().items():
        index = index_of(graph)
        rng = np.random.default_rng(0)
        right: dict[str, list[int]] = {"offline": [], "online": [], "nearest": []}
        frames, far = [], 0
        for _ in range(N_TRIPS):
            positions, segment = random_trip(graph, index, rng)
            offline = locate(graph, index, positions)
            online = locate(graph, index, positions, online=True).segment
            nearest = lock_on_road(index, positions).segment
            for key, found in zip(right, (offline.segment, online, nearest), strict=True):
                right[key].append(int((found == segment).sum()))
            frames.append(len(segment))
            far += _far(graph, offline.segment, offline.along_m, segment)
        cells = " | ".join(text(share(hits, frames)) for hits in right.values())
        yield f"| {name} | {sum(frames)} | {cells} | {far} |"


def _far(graph: LaneGraph, found: IntArray, along_m: np.ndarray, segment: IntArray) -> int:
    """Wrong seconds that are no matter of some metres along one road: the right segment neither
    ends nor begins near the place that was found."""
    joins = set(zip(graph.before.tolist(), graph.after.tolist(), strict=True))
    wrong = np.flatnonzero(found != segment)
    near = 0
    for k in wrong:
        here, there, along = int(found[k]), int(segment[k]), float(along_m[k])
        ahead = (here, there) in joins and graph.length_m[here] - along < NEAR_M
        near += ahead or ((there, here) in joins and along < NEAR_M)
    return len(wrong) - near
