"""From positions and a map to a road table: the segment at each time, and the place on it.

An outlier keeps the last known place.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph, assumed_lanes
from egolane_pgm.maps.matching import match
from egolane_pgm.maps.positions import Positions
from egolane_pgm.maps.road_table import COLUMNS
from egolane_pgm.types import FloatArray, InputError


def locate(graph: LaneGraph, positions: Positions, *, online: bool = False) -> pd.DataFrame:
    """The road table of T positions; see `road_table.COLUMNS`.

    Segments without a number of lanes get an assumed one (`assumed_lanes`).

    - online: each row depends on positions up to its time only.

    Raises InputError if no position is near a road of the map.
    """
    matched = match(graph, positions, online=online)
    if (matched.segment < 0).all():
        raise InputError(
            f"{positions.source}: no position of {len(positions)} is on a road of the map"
            f" ({_span(positions.latitude, positions.longitude)};"
            f" the map: {_span(*graph.plane.degrees(graph.point).T)})"
        )
    # An outlier has the place of the last inlier.
    times = np.arange(len(matched))
    last = np.maximum.accumulate(np.where(matched.is_outlier, 0, times))
    table = matched.iloc[last].reset_index(drop=True).assign(t_s=matched.t_s)
    table["offset_m"] = table.offset_m.where(last == times)
    segment = table.segment.to_numpy()
    on = segment >= 0
    is_unknown = graph.n_lanes[segment] == 0
    table["n_lanes"] = np.where(on, assumed_lanes(graph)[segment], 0)
    table["unknown_way"] = np.where(on & is_unknown, graph.way[segment], 0)
    table.attrs["source"] = positions.source
    return table[[*COLUMNS]]


def _span(latitude: FloatArray, longitude: FloatArray) -> str:
    return (
        f"latitude {latitude.min():.4f} to {latitude.max():.4f},"
        f" longitude {longitude.min():.4f} to {longitude.max():.4f}"
    )
