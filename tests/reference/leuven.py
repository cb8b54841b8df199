"""The second opinion on map matching: the library Leuven Map Matching on the same map."""

from __future__ import annotations

import logging

import numpy as np
from leuvenmapmatching.map.inmem import InMemMap
from leuvenmapmatching.matcher.distance import DistanceMatcher

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.positions import Positions
from egolane_pgm.types import IntArray


class Leuven:
    """Its map of a lane graph: every straight piece of a segment is an edge."""

    def __init__(self, graph: LaneGraph) -> None:
        logging.getLogger("be.kuleuven.cs.dtai.mapmatching").setLevel(logging.ERROR)
        self.graph = graph
        self.map = InMemMap("map", use_latlon=False, use_rtree=False)
        self.segment: dict[tuple[int, int], int] = {}
        # Where segments meet, the last point of one and the first of the next are one node.
        node = {k: k for k in range(len(graph.point))}

        def node_of(point: int) -> int:
            while node[point] != point:
                point = node[point]
            return point

        for before, after in zip(graph.before, graph.after, strict=True):
            node[node_of(int(graph.first[after]))] = node_of(int(graph.first[before + 1] - 1))
        for point in range(len(graph.point)):
            self.map.add_node(node_of(point), tuple(graph.point[node_of(point)]))
        for segment in range(len(graph)):
            for point in range(graph.first[segment], graph.first[segment + 1] - 1):
                edge = (node_of(point), node_of(point + 1))
                self.map.add_edge(*edge)
                self.segment[edge] = segment

    def match(self, positions: Positions) -> IntArray:
        """The segment of each position, (T,); -1 where it gave up."""
        place = self.graph.plane.metres(positions.latitude, positions.longitude)
        matcher = DistanceMatcher(
            self.map, max_dist=200, max_dist_init=200, obs_noise=6, obs_noise_ne=12, dist_noise=6,
            min_prob_norm=1e-6, non_emitting_states=True, max_lattice_width=10,
        )  # fmt: skip
        matcher.match([tuple(p) for p in place])
        found = np.full(len(positions), -1, dtype=np.int64)
        for state in matcher.lattice_best:
            if state.obs_ne == 0:
                found[state.obs] = self.segment[state.edge_m.l1, state.edge_m.l2]
        return found
