"""Tracks: folders with a recording NAME.csv and its lanes NAME.txt for each drive.

`24km-d1-normal-0-n4-italy_ml` is a drive of driver d1 on a road of four lanes, with lines of the
donor italy_ml. Recordings with the same text before `-n4` are one drive. The name is the seed.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path as File

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from egolane_pgm.drives import read_drives
from egolane_pgm.loading import load_experiment
from egolane_pgm.paper import paper_experiment
from egolane_pgm.recordings.ground_truth import read_ground_truth, write_ground_truth
from egolane_pgm.recordings.table import read_table, write_table
from egolane_pgm.types import InputError, LineLog, lane_truth
from makers.benchmark.transplanting import RATE, Donor, Path, donor_of, transplanted

HERE = File(__file__).parent
ANNOTATIONS = HERE / "rotterdam/annotations.csv"

#: The donors by the number of the paper's run: their names, and the width of a lane in the metres
#: of each detector.
DONORS = {row.run: (row.name, row.lane_m) for row in pd.read_csv(HERE / "donors.csv").itertuples()}

#: The standard deviation of the place in the lane, lanes, and how much of it is left after 5 s (of
#: measured cars); how long a lane change takes, seconds.
_SPREAD, _MEMORY, _CHANGE_S = 0.09, 0.34, 5.0

#: The most that a stretch reaches before its first lane change and after its last, and its least
#: length, seconds; roads of more lanes are not made.
_MARGIN_S, _SHORTEST_S, _MOST_LANES = 40.0, 15.0, 5

#: Lanes of the motorway of UAH-DriveSet (A-2 near Alcala), the state of its lane detection in which
#: numbers count, and how near a listed change X jumps, seconds, and how far, lanes.
UAH_LANES, _RUNNING, _WITHIN_S, _JUMP = 3, 2, 4.0, 0.5

#: A lane change: when, seconds, from which lane, to which one.
Change = tuple[float, int, int]


@dataclass(frozen=True)
class Recording:
    """A recording of a track, its T frames all annotated.

    - track: its drives are scored together.
    - driver: a driver or a trip. drive: what several recordings share.
    - donor: whose lines these are; empty if they are the drive's own.
    """

    track: str
    name: str
    driver: str
    drive: str
    donor: str
    n_lanes: int
    log: LineLog
    truth: pd.DataFrame


def read_tracks(folders: Iterable[File]) -> list[Recording]:
    """The recordings of folders, each a track; motion is a track for each number of lanes."""
    return [_read(file) for folder in folders for file in sorted(folder.glob("*.txt"))]


def _read(file: File) -> Recording:
    drive, *kind = re.split(r"-n(\d+)\b", file.stem, maxsplit=1)
    n_lanes, driver = int(kind[0]) if kind else UAH_LANES, re.search(r"\b(d|trip)\d+\b", drive)
    told = ", start told" if drive.startswith("start_told-") else ""
    return Recording(
        f"motion, {n_lanes} lanes" if file.parent.name == "motion" else file.parent.name + told,
        file.stem,
        driver[0] if driver else drive,
        drive.removeprefix("start_told-"),
        kind[1].split("-")[-1] if kind else "",
        n_lanes,
        read_table(file.with_suffix(".csv"), frame_rate=RATE),
        read_ground_truth(file),
    )


def paper_log(run: int) -> tuple[LineLog, pd.DataFrame, int]:
    """The annotated frames of one of the paper's runs that can be trusted, renumbered from 0, and
    the number of lanes. Raises InputError if the recording is missing."""
    [drive] = read_drives(load_experiment(paper_experiment(run)))
    rows = drive.rows[drive.is_trusted]
    frame = np.arange(len(rows))
    log = replace(drive.log.take(rows), frame_id=frame, time_s=frame / RATE)
    truth = lane_truth(frame, drive.true_lane[rows], drive.is_crossing[rows])
    return log, truth, drive.model.n_lanes


@lru_cache(maxsize=len(DONORS))
def donor(run: int) -> Donor:
    """A run of the paper as a donor of lines."""
    return donor_of(*paper_log(run), DONORS[run][1])


def stretches_of(annotations: File) -> list[tuple[float, float, int, list[Change]]]:
    """The stretches of a trip: lane changes that follow on one another, on a road of one number of
    lanes: begin and end, seconds, the number of lanes, and the changes.

    They end midway between two lane changes that do not, and 40 s from one at most.
    """
    table = pd.read_csv(annotations, converters={"t_lc": float})
    columns = (table[name].tolist() for name in ("t_lc", "from lane", "to lane"))
    changes = list(zip(*columns, strict=True))
    lanes, after = table["total lanes"].fillna(0).astype(int), table["to lane"].shift()
    starts = np.flatnonzero((table["from lane"] != after) | (lanes != lanes.shift()))
    middle = [-np.inf, *((a[0] + b[0]) / 2 for a, b in pairwise(changes)), np.inf]
    found = []
    for first, stop in pairwise([*starts.tolist(), len(table)]):
        begin = max(middle[first], changes[first][0] - _MARGIN_S)
        end = min(middle[stop], changes[stop - 1][0] + _MARGIN_S)
        if 0 < lanes[first] <= _MOST_LANES and end - begin >= _SHORTEST_S:
            found.append((begin, end, int(lanes[first]), changes[first:stop]))
    return found


def driven(
    changes: Sequence[Change], n_frames: int, n_lanes: int, rng: np.random.Generator
) -> Path:
    """The path of a car that makes these lane changes, the first frame at 0 s; its place in the
    lane is an autoregressive process."""
    time_s = np.arange(n_frames) / RATE
    kept = _MEMORY ** (1 / (5 * RATE))
    noise = rng.normal(0, _SPREAD * np.sqrt(1 - kept**2), n_frames)
    noise[0] = rng.normal(0, _SPREAD)
    across = changes[0][1] - 0.5 + lfilter([1], [1, -kept], noise)
    for when, before, after in changes:
        # The car is halfway when it is annotated to change.
        done = np.clip((time_s - when) / _CHANGE_S + 0.5, 0, 1)
        across += (after - before) * (1 - np.cos(np.pi * done)) / 2
    return Path(np.clip(across, 0.0, n_lanes - 1e-6), n_lanes)


def uah_drives(copy: File) -> dict[str, tuple[LineLog, Path]]:
    """The lines and the path of each drive of UAH-DriveSet (Romera, Bergasa and Arroyo 2016) on the
    motorway. The data set may not be handed on, changed or not.

    A drive is a folder `20151111123124-24km-D1-NORMAL-MOTORWAY` with PROC_LANE_DETECTION.txt
    (seconds, X: metres from the middle of the lane, angle, W: the lane's width, state) and
    EVENTS_LIST_LANE_CHANGES.txt (seconds, type: positive to the right). It begins in the rightmost
    lane; the list changes it. A drive is taken if X jumps by a lane at each listed change, or at
    all but one. Raises InputError if there is none.
    """
    found: dict[str, tuple[LineLog, Path]] = {}
    for file in sorted(copy.glob("**/*MOTORWAY/PROC_LANE_DETECTION.txt")):
        [name] = re.findall(r"(\d+km-D\d+-[A-Z]+?)\d*-MOTORWAY$", file.parent.name)
        changes = np.loadtxt(file.with_name("EVENTS_LIST_LANE_CHANGES.txt"), ndmin=2)
        drive, name = _uah_drive(np.loadtxt(file, ndmin=2), changes), name.lower()
        if drive is not None:
            found[f"{name}-{sum(each.startswith(name) for each in found)}"] = drive
    if not found:
        raise InputError(f"{copy}: no folder *MOTORWAY with a list of changes that X confirms")
    return found


def _uah_drive(lines: np.ndarray, changes: np.ndarray) -> tuple[LineLog, Path] | None:
    """The drive of two tables; None if X does not confirm the list of lane changes."""
    time_s = np.arange(lines[0, 0], lines[-1, 0], 1 / RATE)
    # Ten frames a second of thirty: the last one before each time.
    rows = np.searchsorted(lines[:, 0], time_s, side="right") - 1
    offset, width = lines[rows, 1], lines[rows, 3]
    running = (lines[rows, 4] == _RUNNING) & (width > 0)
    place = offset / np.where(running, width, 1)
    lane, n_lanes, confirmed = np.full(len(time_s), float(UAH_LANES)), UAH_LANES, 0
    for when, kind in changes[:, :2]:
        near = np.flatnonzero((np.abs(time_s - when) < _WITHIN_S) & running)
        step, at = np.diff(place[near]), int(np.searchsorted(time_s, when))
        if np.abs(step).max(initial=0.0) >= _JUMP:
            # A car that goes right passes the right line, which is then its left one.
            k = int(np.abs(step).argmax())
            at, confirmed = int(near[k + 1]), confirmed + (-np.sign(step[k]) == np.sign(kind))
        lane[at:] += np.sign(kind)
    if lane.min() < 1 or lane.max() > n_lanes or len(changes) - confirmed > 1:
        return None
    inside = np.clip(np.where(running, place, 0.0), -0.5, 0.5)
    path = Path(np.clip(lane - 0.5 + inside, 0, n_lanes - 1e-6), n_lanes)
    seen, frame = np.repeat(running[:, None], 2, axis=1), np.arange(len(time_s))
    sides = np.where(seen, np.stack([-width / 2 - offset, width / 2 - offset], axis=1), np.nan)
    unknown = np.full(seen.shape, np.nan)
    return LineLog(frame, frame / RATE, sides, seen, np.zeros_like(seen), unknown), path


def make_tracks(out: File, copy: File | None = None) -> None:
    """Make the tracks in new folders of `out`; two_lines and motion of a copy of UAH-DriveSet.
    Raises InputError for recordings that are missing."""
    for name in ("paper", "rotterdam", *(("two_lines", "motion") if copy else ())):
        (out / name).mkdir(parents=True)
    for run, (name, _) in DONORS.items():
        log, truth, n_lanes = paper_log(run)
        write_recording(out / "paper" / f"{name.split('_')[0]}-n{n_lanes}-{name}", log, truth)
    made: list[tuple[File, Path, int]] = []
    for k, (begin, end, n_lanes, changes) in enumerate(stretches_of(ANNOTATIONS)):
        run = 1 + k % len(DONORS)
        name = f"trip1-{int(begin)}-n{n_lanes}-{DONORS[run][0]}"
        at = [(when - begin, before, after) for when, before, after in changes]
        path = driven(at, round(RATE * (end - begin)), n_lanes, rng_of(name, "path"))
        made.append((out / "rotterdam" / name, path, run))
    for number, (drive, (log, path)) in enumerate(uah_drives(copy).items() if copy else ()):
        write_recording(out / "two_lines" / f"{drive}-n{path.n_lanes}", log, path.truth())
        for k, n_lanes in enumerate((3, 3, 3, 4, 5)):
            run = 1 + (3 * number + k) % len(DONORS)
            place = out / "motion" / f"{drive}-n{n_lanes}-{DONORS[run][0]}"
            made.append((place, Path(path.across, n_lanes), run))
    for place, path, run in made:
        log = transplanted(donor(run), path, rng_of(place.name, "lines"))
        write_recording(place, log, path.truth())


def rng_of(*words: str) -> np.random.Generator:
    """Random numbers whose seed are the words."""
    return np.random.default_rng([zlib.crc32(word.encode()) for word in words])


def write_recording(place: File, log: LineLog, truth: pd.DataFrame) -> None:
    """Write PLACE.csv, its offsets in whole millimetres, and PLACE.txt."""
    rounded = replace(log, offset_m=np.round(log.offset_m, 3))
    write_table(place.with_name(f"{place.name}.csv"), rounded)
    write_ground_truth(place.with_name(f"{place.name}.txt"), truth)
