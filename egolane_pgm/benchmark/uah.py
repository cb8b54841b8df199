"""UAH-DriveSet (Romera, Bergasa and Arroyo 2016): what its lane detection gave on the motorway,
from an entrant's own copy. The data set may not be handed on, changed or not.

Of each drive a folder, such as `D1/20151110175712-16km-D1-NORMAL1-SECONDARY`, with two files of
numbers between blanks: PROC_LANE_DETECTION.txt (seconds, X: metres from the middle of the lane,
the car's angle, W: the lane's width, state: 2 while it runs), and EVENTS_LIST_LANE_CHANGES.txt
(seconds, type: positive to the right, ...).

The truth is inferred: a drive begins in the rightmost of three lanes, where it merges, and the list
changes it. Only drives are taken whose X confirms the list: at each change it jumps by a lane.
"""

from __future__ import annotations

import re
from pathlib import Path as File

import numpy as np

from egolane_pgm.benchmark.tracks import RATE
from egolane_pgm.simulation.transplanting import Path
from egolane_pgm.types import BoolArray, FloatArray, InputError, LineLog

#: Lanes of the motorway (A-2 near Alcala).
N_LANES = 3

_LINES, _CHANGES = "PROC_LANE_DETECTION.txt", "EVENTS_LIST_LANE_CHANGES.txt"

#: The state of the detection in which its numbers count.
_RUNNING = 2

#: Seconds from a listed change within which X jumps, and how far, lanes.
_WITHIN_S, _JUMP = 4.0, 0.5


def drives_of(copy: File) -> dict[str, tuple[LineLog, Path]]:
    """The drives on the motorway that confirm their list of lane changes, but for one at most: by
    name the two lines of the car's own lane, T frames, and where it was.

    Raises InputError for a folder without any, and for files that are no tables of numbers.
    """
    found: dict[str, tuple[LineLog, Path]] = {}
    for file in sorted(copy.glob(f"**/*MOTORWAY/{_LINES}")):
        drive, name = _read(file.parent), _name(file.parent)
        if drive is not None:
            found[f"{name}-{sum(each.startswith(name) for each in found)}"] = drive
    if not found:
        raise InputError(f"{copy}: no folder *MOTORWAY with {_LINES} and a list it confirms")
    return found


def _read(folder: File) -> tuple[LineLog, Path] | None:
    """The drive in a folder; None where X does not confirm the list of lane changes."""
    lines, changes = _table(folder / _LINES, 5), _table(folder / _CHANGES, 2)
    time_s = np.arange(lines[0, 0], lines[-1, 0], 1 / RATE)
    # Ten frames a second of thirty: the last one that is known.
    rows = np.searchsorted(lines[:, 0], time_s, side="right") - 1
    offset, width, running = lines[rows, 1], lines[rows, 3], lines[rows, 4] == _RUNNING
    running &= width > 0
    lane = N_LANES + np.zeros(len(time_s))
    confirmed = 0
    for when, kind in changes[:, :2]:
        at, way = _jump(time_s, offset / np.where(running, width, 1), running, when)
        confirmed += way == np.sign(kind)
        lane[at:] += np.sign(kind)
    if lane.min() < 1 or lane.max() > N_LANES or len(changes) - confirmed > 1:
        return None
    place = np.where(running, offset / np.where(running, width, 1), 0.0)
    path = Path(np.clip(lane - 0.5 + np.clip(place, -0.5, 0.5), 0, N_LANES - 1e-6), N_LANES)
    sides = np.stack([-width / 2 - offset, width / 2 - offset], axis=1)
    seen = np.repeat(running[:, None], 2, axis=1)
    frame = np.arange(len(time_s))
    log = LineLog(
        frame,
        frame / RATE,
        np.where(seen, sides, np.nan),
        seen,
        np.zeros_like(seen),
        np.full(seen.shape, np.nan),
        source=str(folder),
    )
    return log, path


def _jump(
    time_s: FloatArray, place: FloatArray, running: BoolArray, when: float
) -> tuple[int, float]:
    """Where X jumps near a listed change, and which way the car went: 1 right, -1 left, 0: nowhere.

    A car that goes right comes to the right line and is then beside the left one.
    """
    near = np.flatnonzero((np.abs(time_s - when) < _WITHIN_S) & running)
    step = np.diff(place[near])
    if not len(step) or np.abs(step).max() < _JUMP:
        return int(np.searchsorted(time_s, when)), 0.0
    k = int(np.abs(step).argmax())
    return int(near[k + 1]), float(-np.sign(step[k]))


def _name(folder: File) -> str:
    """`24km-d1-aggressive` of `20151111123124-24km-D1-AGGRESSIVE-MOTORWAY`."""
    match = re.search(r"(\d+km-D\d+-[A-Z]+?)\d*-MOTORWAY$", folder.name)
    if match is None:
        raise InputError(f"{folder}: is not called like 20151111123124-24km-D1-NORMAL-MOTORWAY")
    return match[1].lower()


def _table(file: File, columns: int) -> FloatArray:
    try:
        rows = np.loadtxt(file, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: is no table of numbers: {error}") from error
    if not rows.size:
        return np.zeros((0, columns))
    if rows.shape[1] < columns:
        raise InputError(f"{file}: has {rows.shape[1]} columns, not {columns}")
    return rows
