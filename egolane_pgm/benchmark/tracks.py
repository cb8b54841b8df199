"""Tracks of a benchmark: folders with a recording NAME.csv and its lanes NAME.txt for each drive.

A name says what is alike: `24km-d1-normal-0-n4-italy_ml` is a drive of driver d1 on a road of four
lanes, its lines as those of the donor italy_ml. What comes before `-n4` is the drive; several
recordings of it (other lanes, other donors) share its luck and are resampled together.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from egolane_pgm.recordings.ground_truth import read_ground_truth, write_ground_truth
from egolane_pgm.recordings.table import read_table, write_table
from egolane_pgm.types import InputError, LaneTruth, LineLog

#: Frames per second of every track.
RATE = 10.0

#: The number of lanes of tracks whose names do not say it.
_LANES = {"two_lines": 3}

#: Tracks on which nobody is ranked, and from which nothing is learned: everybody looked at them.
SHOWN_ONLY = ("paper",)

#: What the name of a drive begins with that was told the lane at its start.
_TOLD = "start_told-"


@dataclass(frozen=True)
class Recording:
    """A recording of a track, its T frames all annotated.

    - track: its drives are scored together.
    - driver: a driver or a trip. drive: what several recordings share.
    - donor: whose lines these are; empty where they are the drive's own.
    """

    track: str
    name: str
    driver: str
    drive: str
    donor: str
    n_lanes: int
    log: LineLog
    truth: LaneTruth

    def take(self, frames: slice) -> Recording:
        """Some of its frames."""
        return replace(self, log=self.log.take(frames), truth=self.truth.take(frames))


def read_tracks(places: Iterable[str | Path]) -> list[Recording]:
    """The recordings of tracks.

    - places: folders of tracks, or folders of such folders.

    Recordings of one folder are one track; where a drive occurs with several numbers of lanes, a
    track for each number. Raises InputError for a folder without recordings, for lanes without
    lines, a name that does not say the number of lanes, and frames that differ between the two.
    """
    found: list[Recording] = []
    for place in map(Path, places):
        folders = [place, *sorted(place.glob("*/"))]
        read = [_read(file) for folder in folders for file in sorted(folder.glob("*.txt"))]
        if not read:
            raise InputError(f"{place}: has no NAME.csv with its lanes in NAME.txt")
        found += read
    lanes: dict[tuple[str, str], set[int]] = {}
    for each in found:
        lanes.setdefault((each.track, each.drive), set()).add(each.n_lanes)
    several = {track for (track, _), counts in lanes.items() if len(counts) > 1}
    return [
        replace(each, track=f"{each.track}, {each.n_lanes} lanes")
        if each.track in several
        else each
        for each in found
    ]


def _read(file: Path) -> Recording:
    name, lines, track = file.stem, file.with_suffix(".csv"), file.parent.name
    drive, *kind = re.split(r"-n(\d+)\b", name, maxsplit=1)
    if not kind and track not in _LANES:
        raise InputError(f"{file}: its name does not say how many lanes there are: {name}-n3.txt")
    truth, log = read_ground_truth(file), read_table(lines, frame_rate=RATE)
    if not np.array_equal(log.frame_id, truth.frame_id):
        raise InputError(f"{file}: has other frames than {lines.name}")
    n_lanes = int(kind[0]) if kind else _LANES[track]
    truth.check_lanes(n_lanes)
    driver = re.search(r"\b(d|trip)\d+\b", drive)
    return Recording(
        f"{track}, start told" if name.startswith(_TOLD) else track,
        name,
        driver[0] if driver else drive,
        drive.removeprefix(_TOLD),
        kind[1].split("-")[-1] if kind else "",
        n_lanes,
        log,
        truth,
    )


def write_recording(folder: Path, name: str, log: LineLog, truth: LaneTruth) -> None:
    """Write a recording of a track, its offsets in whole millimetres."""
    rounded = replace(log, offset_m=np.round(log.offset_m, 3))
    write_table(folder / f"{name}.csv", rounded)
    write_ground_truth(folder / f"{name}.txt", truth)
