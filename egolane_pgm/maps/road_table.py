"""A road table: the place of a car on the map over time, and the number of lanes there.

`egolane locate` writes it; an experiment with `n_lanes: map` reads it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.recordings.columns import Column, checked
from egolane_pgm.tools.files import read_parquet, write_parquet
from egolane_pgm.types import FloatArray, InputError, IntArray, LineLog

#: The columns of a road table, a DataFrame with T rows; its attribute `source` is the file.
COLUMNS = {
    "t_s": "seconds, strictly increasing, by the clock of the positions",
    "segment": "the row of the lane graph; -1 off the map",
    "along_m": "metres from the segment's start; NaN off the map",
    "offset_m": "metres of the position from the way's line, negative to its left; NaN off the map"
    " and for outliers",
    "sure": "the probability of the segment, 0 to 1",
    "n_lanes": "lanes of the segment, assumed if `unknown_way` is set; 0 unknown",
    "unknown_way": "the way of a segment without a number of lanes in the map; 0 for other segments"
    " and off the map",
}


_DECLARED = {
    name: Column(kind, is_needed=True, is_full=name not in ("along_m", "offset_m"))
    for name, kind in zip(
        COLUMNS, ("time", "whole", "number", "number", "number", "whole", "whole"), strict=True
    )
}


def save(table: pd.DataFrame, path: str | Path) -> None:
    """Write a road table. Raises InputError if it cannot be written."""
    frame = table[[*COLUMNS]].copy()
    frame.attrs = {"attribution": "© OpenStreetMap contributors, ODbL"}
    write_parquet(Path(path), frame)


def load(path: str | Path) -> pd.DataFrame:
    """Read a road table. Raises InputError for another file."""
    try:
        table = checked(read_parquet(Path(path)), _DECLARED, str(path))
    except InputError as error:
        raise InputError(
            f"{error}; not a road table, which `egolane locate MAP POSITIONS -o {path}` writes"
        ) from None
    table.attrs["source"] = str(path)
    return table


# --- the number of lanes along a recording -------------------------------------------------------


def lanes_along(table: pd.DataFrame, log: LineLog) -> IntArray:
    """The number of lanes in each of T frames, (T,); see `lanes_at`.

    Raises InputError if the clocks do not overlap, and as `lanes_at`.
    """
    time_s = log.time_s
    n_lanes = lanes_at(table, time_s)
    first = table.t_s.iloc[0]
    last = table.t_s.iloc[-1]
    if time_s[-1] < first or time_s[0] > last:
        raise InputError(
            f"{table.attrs['source']}: has the times {first:g} to {last:g} s, and {log.source} has"
            f" {time_s[0]:g} to {time_s[-1]:g} s: they do not overlap"
        )
    return n_lanes


def lanes_at(table: pd.DataFrame, time_s: FloatArray) -> IntArray:
    """The number of lanes at T times, (T,), in seconds: the last known one, before any the first.

    Raises InputError if no row has a number.
    """
    source = table.attrs["source"]
    known = table[table.n_lanes > 0]
    if known.empty:
        raise InputError(f"{source}: no row has a number of lanes")
    last = np.maximum(np.searchsorted(known.t_s, time_s, side="right") - 1, 0)
    n_lanes: IntArray = known.n_lanes.to_numpy()[last]
    return n_lanes


def unknown_lanes(table: pd.DataFrame, log: LineLog) -> list[str]:
    """A warning of frames whose number of lanes is not in the map, if there are any."""
    row = np.maximum(np.searchsorted(table.t_s, log.time_s, side="right") - 1, 0)
    way, n_lanes = table.iloc[row][["unknown_way", "n_lanes"]].to_numpy().T
    is_unknown = (way != 0) | (n_lanes == 0)
    if not is_unknown.any():
        return []
    ways = ", ".join(map(str, pd.unique(way[way != 0])[:3])) or "none"
    return [
        f"{table.attrs['source']}: in {is_unknown.sum()} of {len(log)} frames the number of lanes"
        f" is not in the map (first such ways: {ways}); it is assumed, or the number before"
        " is kept"
    ]
