"""How often the right segment is found, on trips over the two real maps and their mirror images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from egolane_pgm.maps.index import index_of
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.lock_on_road import lock_on_road
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import IntArray
from makers.maps._drives import real_maps, share, text
from tests.kits.lane_maps import random_trip

#: Trips are made up to so many positions on each map.
N_POSITIONS = 4000

#: A wrong second is near a join of both segments if it is at most so far from it, metres; and the
#: answer is unsure if it has at most this probability.
NEAR_M, UNSURE = 10.0, 0.6


def measure() -> Iterator[str]:
    """Lines of a table."""
    yield (
        "| map | positions | offline | online | nearest road | wrong offline | no join near"
        " | and sure |"
    )
    yield "|---|---:|---:|---:|---:|---:|---:|---:|"
    for name, graph in real_maps().items():
        index = index_of(graph)
        rng = np.random.default_rng(0)
        right: dict[str, list[int]] = {"offline": [], "online": [], "nearest": []}
        frames: list[int] = []
        kinds = np.zeros(3, dtype=int)
        while sum(frames) < N_POSITIONS:
            positions, segment = random_trip(graph, index, rng)
            offline = locate(graph, index, positions)
            online = locate(graph, index, positions, online=True).segment
            nearest = lock_on_road(index, positions).segment
            for key, found in zip(right, (offline.segment, online, nearest), strict=True):
                right[key].append(int((found == segment).sum()))
            frames.append(len(segment))
            kinds += _wrong(graph, offline, segment)
        cells = " | ".join(text(share(hits, frames)) for hits in right.values())
        yield f"| {name} | {sum(frames)} | {cells} | {' | '.join(map(str, kinds))} |"


def _wrong(graph: LaneGraph, found: RoadTable, segment: IntArray) -> tuple[int, int, int]:
    """How many rows are wrong; how many of them have no join to the right segment near the place
    that was found; and how many of those are sure."""
    joins = set(zip(graph.before.tolist(), graph.after.tolist(), strict=True))
    wrong = np.flatnonzero(found.segment != segment)
    far = []
    for k in wrong:
        here, there, along = int(found.segment[k]), int(segment[k]), float(found.along_m[k])
        ahead = (here, there) in joins and graph.length_m[here] - along < NEAR_M
        if not ahead and not ((there, here) in joins and along < NEAR_M):
            far.append(float(found.sure[k]))
    return len(wrong), len(far), sum(sure > UNSURE for sure in far)
