"""A road table: where on the map a car was, row by row in time.

It is one Parquet table with the columns of `RoadTable`. Matching writes it, and an experiment with
`n_lanes: map` reads it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from egolane_pgm.maps.stored import check_path, marks, read_stored
from egolane_pgm.tools.files import arrow_table, write_parquet
from egolane_pgm.types import FloatArray, InputError, IntArray

#: The version of the stored table. It changes where a column gets another meaning.
VERSION = "2"


@dataclass(frozen=True)
class RoadTable:
    """T rows, in the order of time.

    - t_s (T,): seconds, strictly increasing, by the clock of the positions.
    - segment (T,): the row of the lane graph; -1 off the map.
    - along_m (T,): metres from the segment's start; NaN off the map.
    - offset_m (T,): metres of the position from the way's line, negative to its left; NaN off the
      map and in rows without a position.
    - sure (T,): the probability of the segment, 0 to 1.
    - n_lanes (T,): lanes of the segment, a guess where the way is `untold`; 0 unknown.
    - untold (T,): the way of a segment whose number of lanes the map does not tell; 0 where it
      does, and off the map. A table that was written without this column has zeros.

    Raises InputError for columns of different lengths and for times that do not increase.
    """

    t_s: FloatArray
    segment: IntArray
    along_m: FloatArray
    offset_m: FloatArray
    sure: FloatArray
    n_lanes: IntArray
    source: str = "road table"
    untold: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if not len(self.untold):
            object.__setattr__(self, "untold", np.zeros(len(self), dtype=np.int64))
        for name in COLUMNS:
            rows = len(getattr(self, name))
            if rows != len(self):
                raise InputError(f"{self.source}: {name} has {rows} rows, t_s has {len(self)}")
        if not np.isfinite(self.t_s).all() or (np.diff(self.t_s) <= 0).any():
            row = int(np.argmax(~np.isfinite(self.t_s) | (np.diff(self.t_s, prepend=-np.inf) <= 0)))
            raise InputError(f"{self.source}: row {row}: t_s does not increase")

    def __len__(self) -> int:
        return len(self.t_s)


COLUMNS = tuple(f.name for f in fields(RoadTable) if f.name != "source")


def save(table: RoadTable, path: str | Path) -> None:
    """Write a road table. Raises InputError for a name that does not end in .parquet, and where it
    cannot be written."""
    check_path(path, "road table")
    columns = {name: getattr(table, name) for name in COLUMNS}
    made = arrow_table(columns).replace_schema_metadata(marks("road table", VERSION))
    write_parquet(Path(path), made)


def load(path: str | Path) -> RoadTable:
    """Read a road table.

    Raises InputError as `read_stored` and `RoadTable` do.
    """
    table = read_stored(path, "road table", VERSION, "egolane locate MAP POSITIONS")
    known = [name for name in COLUMNS if name != "untold" or name in table.column_names]
    columns = {name: table[name].to_numpy() for name in known}
    return RoadTable(**columns, source=str(path))
