"""The number of lanes of the road along a recording, from its road table."""

from __future__ import annotations

import numpy as np

from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import MAX_LANES, FloatArray, InputError, IntArray, LineLog


def lanes_along(table: RoadTable, log: LineLog) -> IntArray:
    """The number of lanes in each of T frames, (T,).

    A frame has the lanes of the last row before it, and where the table does not know them (off the
    map, or a segment without a number) those known last. Frames before the first row that knows
    them have its lanes.

    Raises InputError where the clocks do not overlap, where no row knows the lanes, and for more
    than MAX_LANES.
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
    """The number of lanes at some times, (T,) seconds, which may be after those of the table; see
    `lanes_along`."""
    rows = np.flatnonzero(table.n_lanes > 0)
    if not len(rows):
        raise InputError(f"{table.source}: no row knows how many lanes the road has")
    last = np.maximum(np.searchsorted(table.t_s[rows], time_s, side="right") - 1, 0)
    n_lanes: IntArray = table.n_lanes[rows][last]
    if n_lanes.max() > MAX_LANES:
        row = int(rows[last[n_lanes.argmax()]])
        raise InputError(
            f"{table.source}: row {row}: a road of {int(n_lanes.max())} lanes; at most"
            f" {MAX_LANES} are taken"
        )
    return n_lanes


def unknown_lanes(table: RoadTable, log: LineLog) -> list[str]:
    """Warnings, a line each, for the frames of a log without a number of lanes in the map, guessed
    or not, and for those off the map."""
    row = np.maximum(np.searchsorted(table.t_s, log.time_s, side="right") - 1, 0)
    off, way = table.segment[row] < 0, table.untold[row]
    untold, guessed = ~off & (table.n_lanes[row] == 0), (table.n_lanes[row] > 0) & (way > 0)
    what, goes_on = "the road has no number of lanes in the map", "the number before goes on"
    known = list(dict.fromkeys(way[guessed].tolist()))
    ways = ", ".join(map(str, known[:3])) + (", ..." if len(known) > 3 else "")
    said = (
        (guessed, f"{what} (way {ways}); the number is a guess"),
        (untold, f"{what}; {goes_on}"),
        (off, f"the car is off the map; {goes_on}"),
    )
    return [
        f"{table.source}: in {here.sum()} of {len(log)} frames {what}"
        for here, what in said
        if here.any()
    ]
