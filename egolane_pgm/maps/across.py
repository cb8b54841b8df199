"""Where positions put a car across its road, in the frames of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import FloatArray, IntArray

#: A position counts in a frame that is at most this many seconds later.
_LATE_S = 0.5


@dataclass(frozen=True)
class Across:
    """Where positions put a car across its road in T frames.

    - metres (T,): from the left edge of its lanes; NaN in frames without a position
    - sigma_m (T,): the receiver's own standard deviation; NaN where it gives none
    """

    metres: FloatArray
    sigma_m: FloatArray


def across(table: RoadTable, time_s: FloatArray, n_lanes: IntArray, lane_width_m: float) -> Across:
    """The positions of a road table, each in the first frame that is not before it.

    - time_s (T,): of the frames, by the table's clock
    - n_lanes (T,): lanes of the road in each frame. Where the map has another number, or does not
      say where its line lies, that is taken to be the middle of the road.
    """
    metres, sigma = np.full(len(time_s), np.nan), np.full(len(time_s), np.nan)
    frame = np.searchsorted(time_s, table.t_s)
    # Of several positions in a frame the last one counts; one of a pause in the lines does not.
    rows = np.flatnonzero((frame < len(time_s)) & np.isfinite(table.offset_m))
    rows = rows[time_s[frame[rows]] - table.t_s[rows] < _LATE_S]
    frame = frame[rows]
    line = table.way_line[rows]
    is_told = np.isfinite(line) & (table.n_lanes[rows] == n_lanes[frame])
    line = np.where(is_told, line, n_lanes[frame] / 2)
    metres[frame] = table.offset_m[rows] + line * lane_width_m
    sigma[frame] = table.sigma_m[rows]
    return Across(metres, sigma)
