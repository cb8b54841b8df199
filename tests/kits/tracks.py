"""A recorded drive with GNSS near Rotterdam: github tomdries/gps-lane-changes (BSD-2)."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph, around
from egolane_pgm.maps.positions import Positions, read_positions
from tests.kits.lane_maps import lane_map

ROTTERDAM = "tracks/gps_lane_changes"


def rotterdam_road(data: Path) -> LaneGraph:
    """The route as a map: a segment for each stretch without a gap, lanes unknown."""
    route = pd.read_csv(data / ROTTERDAM / "route 1 mindist10.csv")
    plane = around(route.lat.to_numpy(), route.lon.to_numpy())
    metres = plane.metres(route.lat, route.lon)
    cuts = [0, *np.flatnonzero(route.distance > 150), len(route)]
    parts = [slice(a, b) for a, b in itertools.pairwise(cuts) if b - a > 1]
    lines = [[tuple(p) for p in metres[part]] for part in parts]
    return lane_map(lines, [0] * len(parts), plane=plane)


def rotterdam_receivers(data: Path) -> dict[str, Positions]:
    names = {"t_s": "t", "latitude": "lat_gps", "longitude": "lon_gps"}
    files = sorted((data / ROTTERDAM).glob("01*.csv"))
    return {f.stem.split()[2]: read_positions(f, columns=names) for f in files}
