"""The tables of a benchmark's board: who is where, and all scores of a track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.views.tables import Table, with_interval

#: The columns of the table of a track: a score, its title, and its format.
_SCORES = (
    ("frames_right", "right", ".3f"),
    ("log_loss", "log-loss", ".3f"),
    ("sure", "sure", ".3f"),
    ("right_if_sure", "right if sure", ".3f"),
    ("first_minute", "first 60 s", ".3f"),
    ("precision", "changes: precision", ".2f"),
    ("recall", "recall", ".2f"),
    ("false_per_hour", "false/h", ".1f"),
    ("delay_s", "delay s", ".1f"),
    ("late_s", "90 %", ".1f"),
    ("wrong_s", "longest wrong s", ".0f"),
    ("ms_per_frame", "ms/frame", ".3f"),
)

#: What the columns mean.
ABOUT = (
    "Balanced accuracy: the mean over the lanes of each drive; 95 % intervals by resampling"
    " drivers or trips, then drives. In parentheses the rank: as many entries less one are better"
    " by a paired difference whose interval leaves out 0."
)

#: A balanced accuracy, its interval, and the rank.
Place = tuple[float, tuple[float, float] | None, int | None]


def places_table(tracks: Sequence[str], rows: Mapping[str, Sequence[Place | None]]) -> Table:
    """A row per entry, by its title, with its place on each track; None where it has none."""
    return Table(
        ["entry", *tracks], [[title, *map(_place, places)] for title, places in rows.items()]
    )


def _place(place: Place | None) -> str:
    if place is None:
        return "-"
    accuracy, interval, rank = place
    return with_interval(accuracy, interval) + ("" if rank is None else f" ({rank})")


def track_table(rows: Mapping[str, Mapping[str, Any]]) -> Table:
    """A row per entry, by its title, with its scores on a track."""
    cells = [
        [title, *("-" if said[s] is None else f"{said[s]:{form}}" for s, _, form in _SCORES)]
        for title, said in rows.items()
    ]
    return Table(["entry", *(head for _, head, _ in _SCORES)], cells)
