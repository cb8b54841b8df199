"""A road table: the place of a car on the map over time, and the number of lanes there.

`egolane locate` writes it; an experiment with `n_lanes: map` reads it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.tools.files import read_parquet, write_parquet
from egolane_pgm.types import MAX_LANES, FloatArray, InputError, IntArray, LineLog


@dataclass(frozen=True)
class RoadTable:
    """T rows in the order of time.

    - t_s (T,): seconds, strictly increasing, by the clock of the positions.
    - segment (T,): the row of the lane graph; -1 off the map.
    - along_m (T,): metres from the segment's start; NaN off the map.
    - offset_m (T,): metres of the position from the way's line, negative to its left; NaN off the
      map and in rows without a position.
    - sure (T,): the probability of the segment, 0 to 1.
    - n_lanes (T,): lanes of the segment, assumed if `unknown_way` is set; 0 unknown.
    - unknown_way (T,): the way of a segment without a number of lanes in the map; 0 for other
      segments, and off the map.
    - source: the file, for messages.
    """

    t_s: FloatArray
    segment: IntArray
    along_m: FloatArray
    offset_m: FloatArray
    sure: FloatArray
    n_lanes: IntArray
    unknown_way: IntArray
    source: str = "road table"

    def __len__(self) -> int:
        return len(self.t_s)


COLUMNS = tuple(f.name for f in fields(RoadTable) if f.name != "source")


def save(table: RoadTable, path: str | Path) -> None:
    """Write a road table. Raises InputError if it cannot be written."""
    frame = pd.DataFrame({name: getattr(table, name) for name in COLUMNS})
    frame.attrs["attribution"] = "© OpenStreetMap contributors, ODbL"
    write_parquet(Path(path), frame)


def load(path: str | Path) -> RoadTable:
    """Read a road table. Raises InputError for another file."""
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


# --- the number of lanes along a recording -------------------------------------------------------


def lanes_along(table: RoadTable, log: LineLog) -> IntArray:
    """The number of lanes in each of T frames, (T,); see `lanes_at`.

    Raises InputError if the clocks do not overlap, and as `lanes_at`.
    """
    time_s = log.time_s
    if not len(log) or time_s[-1] < table.t_s[0] or time_s[0] > table.t_s[-1]:
        span = f"{time_s[0]:g} to {time_s[-1]:g} s" if len(log) else "no frames"
        raise InputError(
            f"{table.source}: has the times {table.t_s[0]:g} to {table.t_s[-1]:g} s, and"
            f" {log.source} has {span}: they do not overlap"
        )
    return lanes_at(table, time_s)


def lanes_at(table: RoadTable, time_s: FloatArray) -> IntArray:
    """The number of lanes at T times, (T,), in seconds: the last known one, before any the first.

    Raises InputError if no row has a number, and for more than MAX_LANES.
    """
    rows = np.flatnonzero(table.n_lanes > 0)
    if not len(rows):
        raise InputError(f"{table.source}: no row has a number of lanes")
    last = np.maximum(np.searchsorted(table.t_s[rows], time_s, side="right") - 1, 0)
    n_lanes: IntArray = table.n_lanes[rows][last]
    if n_lanes.max() > MAX_LANES:
        row = int(rows[last[n_lanes.argmax()]])
        raise InputError(
            f"{table.source}: row {row}: a road of {int(n_lanes.max())} lanes; at most"
            f" {MAX_LANES} are supported"
        )
    return n_lanes


def unknown_lanes(table: RoadTable, log: LineLog) -> list[str]:
    """Warnings, a line each, for frames with an assumed number of lanes, without one, and off the
    map."""
    row = np.maximum(np.searchsorted(table.t_s, log.time_s, side="right") - 1, 0)
    off, way, n_lanes = table.segment[row] < 0, table.unknown_way[row], table.n_lanes[row]
    assumed = (n_lanes > 0) & (way > 0)
    known = list(dict.fromkeys(way[assumed].tolist()))
    ways = ", ".join(map(str, known[:3])) + (", ..." if len(known) > 3 else "")
    lacks = "the road has no number of lanes in the map"
    kinds = (
        (assumed, f"{lacks} (way {ways}); the number is assumed"),
        (~off & (n_lanes == 0), f"{lacks}; the number before is kept"),
        (off, "the car is off the map; the number before is kept"),
    )
    return [
        f"{table.source}: in {marked.sum()} of {len(log)} frames {what}"
        for marked, what in kinds
        if marked.any()
    ]
