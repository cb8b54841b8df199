"""A recorded drive with GNSS near Rotterdam: github tomdries/gps-lane-changes (BSD-2)."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.maps.index import RoadIndex, index_of
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.local import around
from egolane_pgm.maps.positions import Positions, read_positions
from tests.kits.lane_maps import lane_map

ROTTERDAM = "tracks/gps_lane_changes"


def rotterdam_road(data: Path) -> tuple[LaneGraph, RoadIndex]:
    """The route as a map: a segment for each stretch without a gap, lanes unknown."""
    route = pd.read_csv(data / ROTTERDAM / "route 1 mindist10.csv")
    metres = around(route.lat.to_numpy(), route.lon.to_numpy()).metres(route.lat, route.lon)
    cuts = [0, *np.flatnonzero(route.distance > 150), len(route)]
    parts = [slice(a, b) for a, b in itertools.pairwise(cuts) if b - a > 1]
    drawn = lane_map([[tuple(p) for p in metres[part]] for part in parts], [0] * len(parts))
    places = np.concatenate([route[["lat", "lon"]].to_numpy()[part] for part in parts])
    graph = LaneGraph(**(vars(drawn) | {"point": places}))
    return graph, index_of(graph)


def rotterdam_receivers(data: Path) -> dict[str, Positions]:
    names = {"t_s": "t", "latitude": "lat_gps", "longitude": "lon_gps"}
    files = sorted((data / ROTTERDAM).glob("01*.csv"))
    return {f.stem.split()[2]: read_positions(f, columns=names) for f in files}
