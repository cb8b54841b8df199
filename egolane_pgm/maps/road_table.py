"""A road table: the place of a car on the map, row by row in time, as one Parquet table.

`egolane locate` writes it, and an experiment with `n_lanes: map` reads it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.tools.files import read_parquet, write_parquet
from egolane_pgm.types import FloatArray, InputError, IntArray


@dataclass(frozen=True)
class RoadTable:
    """T rows in the order of time.

    - t_s (T,): seconds, strictly increasing, by the clock of the positions.
    - segment (T,): the row of the lane graph; -1 off the map.
    - along_m (T,): metres from the segment's start; NaN off the map.
    - offset_m (T,): metres of the position from the way's line, negative to its left; NaN off the
      map and in rows without a position.
    - sure (T,): the probability of the segment, 0 to 1.
    - n_lanes (T,): lanes of the segment, a guess where the way is `untold`; 0 unknown.
    - untold (T,): the way of a segment whose number of lanes is not in the map; 0 where it is, and
      off the map.
    - source: the file, for messages.
    """

    t_s: FloatArray
    segment: IntArray
    along_m: FloatArray
    offset_m: FloatArray
    sure: FloatArray
    n_lanes: IntArray
    untold: IntArray
    source: str = "road table"

    def __len__(self) -> int:
        return len(self.t_s)


COLUMNS = tuple(f.name for f in fields(RoadTable) if f.name != "source")


def save(table: RoadTable, path: str | Path) -> None:
    """Write a road table. Raises InputError where it cannot be written."""
    frame = pd.DataFrame({name: getattr(table, name) for name in COLUMNS})
    frame.attrs["attribution"] = "© OpenStreetMap contributors, ODbL"
    write_parquet(Path(path), frame)


def load(path: str | Path) -> RoadTable:
    """Read a road table. Raises InputError for a file that is not one."""
    table = read_parquet(Path(path))
    missing = [name for name in COLUMNS if name not in table]
    if missing:
        raise InputError(
            f"{path}: is not a road table, it has no column {missing[0]};"
            f" `egolane locate MAP POSITIONS -o {path}` writes one"
        )
    road = RoadTable(**{name: table[name].to_numpy() for name in COLUMNS}, source=str(path))
    if not len(road) or not (np.diff(road.t_s) > 0).all():
        raise InputError(f"{path}: t_s does not increase from row to row")
    return road
