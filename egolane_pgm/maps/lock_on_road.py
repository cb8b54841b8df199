"""The baseline: the road that is nearest, as the paper's authors lock on it.

Segments within 20 m of a position are looked at, else those within 100 m, else 200 m. Each is
scored by its distance and its heading, normal both (`ira_open_street_map`). Each position stands
alone: which road the car was on before does not count, nor whether a way leads there.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.maps.index import near
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.matching import Matched, headings, no_match
from egolane_pgm.maps.positions import Positions

#: How far a segment may be, metres: the first that has one counts.
RADII_M = (20.0, 100.0, 200.0)

#: Standard deviations of the distance, metres, and of the heading, radians.
SIGMA_M, SIGMA_RAD = 1.0, 0.15


def lock_on_road(graph: LaneGraph, positions: Positions) -> Matched:
    """The road at each of T positions. `sure` is the segment's share of the score of all that are
    within the radius. A position whose heading is not known is scored by distance."""
    place = graph.plane.metres(positions.latitude, positions.longitude)
    heading, _ = headings(positions, place)
    matched = no_match(len(positions), np.zeros(len(positions), dtype=np.bool_))
    matched.sure[:] = 1.0
    left = np.arange(len(positions))
    for radius in RADII_M:
        found = near(graph, place[left], radius)
        count = np.diff(found.start)
        turn = found.heading - np.repeat(heading[left], count)
        turn = np.nan_to_num((turn + np.pi) % (2 * np.pi) - np.pi)
        score = -0.5 * ((found.offset_m / SIGMA_M) ** 2 + (turn / SIGMA_RAD) ** 2)
        for k in np.flatnonzero(count):
            rows = slice(found.start[k], found.start[k + 1])
            share = np.exp(score[rows] - score[rows].max())
            best, t = int(found.start[k] + score[rows].argmax()), left[k]
            matched.segment[t] = found.segment[best]
            matched.along_m[t] = found.along_m[best]
            matched.offset_m[t] = found.offset_m[best]
            matched.sure[t] = 1 / share.sum()
        left = left[count == 0]
    return matched
