"""The baseline of map matching: the nearest road of each position, as in the paper."""

from __future__ import annotations

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.matching import headings, near
from egolane_pgm.maps.positions import Positions

#: Search radii, metres, tried one after the other.
RADII_M = (20.0, 100.0, 200.0)

#: Standard deviation of the distance, metres.
SIGMA_M = 1.0

#: Standard deviation of the heading, radians.
SIGMA_RAD = 0.15


def lock_on_road(graph: LaneGraph, positions: Positions) -> pd.DataFrame:
    """The segment of each position (-1 if none is near) and the offset from it, metres, found
    independently (`ira_open_street_map`).

    Segments within 20 m, else 100 m, else 200 m are scored by distance and, if known, heading,
    normal both.
    """
    place = graph.plane.metres(positions.latitude, positions.longitude)
    heading, _ = headings(positions, place, np.arange(len(place)))
    segment = np.full(len(place), -1)
    offset_m = np.full(len(place), np.nan)
    left = np.arange(len(place))
    for radius in RADII_M:
        found = near(graph, place[left], radius)
        count = np.diff(found.start)
        turn = found.heading - np.repeat(heading[left], count)
        turn = np.nan_to_num((turn + np.pi) % (2 * np.pi) - np.pi)
        score = -0.5 * ((found.offset_m / SIGMA_M) ** 2 + (turn / SIGMA_RAD) ** 2)
        for k in np.flatnonzero(count):
            best = found.start[k] + score[found.start[k] : found.start[k + 1]].argmax()
            segment[left[k]] = found.segment[best]
            offset_m[left[k]] = found.offset_m[best]
        left = left[count == 0]
    return pd.DataFrame({"segment": segment, "offset_m": offset_m})
