"""The tracks: made from the paper's recordings, from lane changes that a human annotated near
Rotterdam, and from an entrant's own copy of UAH-DriveSet.

Position in the lane, where nobody measured it, is a process with the spread and the memory of
measured cars. Every drive has a seed of its own, its name, so that each can be made by itself.
"""

from __future__ import annotations

import csv
import hashlib
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path as File

import numpy as np
from scipy.signal import lfilter

from egolane_pgm.benchmark import uah
from egolane_pgm.benchmark.tracks import RATE, write_recording
from egolane_pgm.drive import open_drive
from egolane_pgm.experiment import load_experiment
from egolane_pgm.paper import paper_experiment
from egolane_pgm.simulation.transplanting import Donor, Path, donor_of, transplanted
from egolane_pgm.tools.files import make_directory, read_text
from egolane_pgm.types import FloatArray, InputError, LaneTruth, LineLog

#: The donors by the number of the paper's run: their names, and the width of a lane in the metres
#: of each detector.
DONORS = {
    1: ("italy_ml", 3.9),
    2: ("italy_sl", 3.9),
    3: ("italy_mc", 3.9),
    4: ("italy_sc", 3.9),
    5: ("italy_mld", 2.02),
    6: ("spain_ml", 3.4),
    7: ("spain_sl", 3.4),
    8: ("spain_mc", 3.4),
    9: ("spain_sc", 3.4),
    10: ("spain_mld", 4.06),
}

#: The standard deviation of the place in the lane, lanes, and how much of it is left after 5 s.
_SPREAD, _MEMORY = 0.09, 0.34

#: How long a lane change takes, seconds.
_CHANGE_S = 5.0

#: The most that a stretch reaches before its first lane change and after its last, and the least
#: that a stretch is long, seconds.
_MARGIN_S, _SHORTEST_S = 40.0, 15.0

#: Roads of more lanes than the donors' and one are not made.
_MOST_LANES = 5

#: Checksums of the tracks, each over the names and contents of its files.
CHECKSUMS = File(__file__).with_name("checksums.txt")


#: A lane change: when, seconds, from which lane, to which one.
Change = tuple[float, int, int]


def paper_log(run: int) -> tuple[LineLog, LaneTruth, int]:
    """The annotated frames of one of the paper's runs that can be trusted, renumbered from 0, and
    the number of lanes. Raises InputError where the recording is not there."""
    drive = open_drive(load_experiment(paper_experiment(run)))
    kept = np.flatnonzero(drive.may_fit)
    log, truth = drive.recorded.log.take(drive.rows[kept]), drive.truth.take(kept)
    frame = np.arange(len(log))
    log = replace(log, frame_id=frame, time_s=frame / RATE)
    return log, replace(truth, frame_id=frame), drive.n_lanes


@lru_cache(maxsize=len(DONORS))
def donor(run: int) -> Donor:
    """A run of the paper as a donor of lines."""
    return donor_of(*paper_log(run), DONORS[run][1])


def make_paper(folder: File) -> None:
    """The paper's ten recordings as a track, which is shown and not ranked."""
    for run, (name, _) in DONORS.items():
        log, truth, n_lanes = paper_log(run)
        write_recording(folder, f"{name.split('_')[0]}-n{n_lanes}-{name}", log, truth)


# --- Rotterdam ---------------------------------------------------------------------------------


def make_rotterdam(folder: File) -> None:
    """The annotated lane changes of the first trip near Rotterdam, with the frames of donors."""
    annotations = File(__file__).parent / "rotterdam/annotations.csv"
    for k, (begin_s, end_s, n_lanes, changes) in enumerate(stretches_of(annotations)):
        run = 1 + k % len(DONORS)
        name = f"trip1-{int(begin_s)}-n{n_lanes}-{DONORS[run][0]}"
        at = [(when - begin_s, before, after) for when, before, after in changes]
        path = driven(at, round(RATE * (end_s - begin_s)), n_lanes, _rng(name, "path"))
        _write_transplanted(folder, name, path, run)


def stretches_of(annotations: File) -> list[tuple[float, float, int, list[Change]]]:
    """The stretches of a trip: lane changes that follow on one another, on a road of one number of
    lanes: begin and end, seconds, the number of lanes, and the changes.

    They end midway between two lane changes that do not, and 40 s from one at most.
    """
    rows = list(csv.DictReader(read_text(annotations).splitlines()))
    changes = [(float(r["t_lc"]), int(r["from lane"]), int(r["to lane"])) for r in rows]
    lanes = [row["total lanes"] for row in rows]
    middle = [-np.inf, *((a[0] + b[0]) / 2 for a, b in pairwise(changes)), np.inf]
    starts = [
        k
        for k in range(len(rows))
        if not k or changes[k - 1][2] != changes[k][1] or lanes[k - 1] != lanes[k]
    ]
    found = []
    for first, stop in pairwise([*starts, len(rows)]):
        begin = max(middle[first], changes[first][0] - _MARGIN_S)
        end = min(middle[stop], changes[stop - 1][0] + _MARGIN_S)
        n_lanes = int(lanes[first] or 0)
        if 0 < n_lanes <= _MOST_LANES and end - begin >= _SHORTEST_S:
            found.append((begin, end, n_lanes, changes[first:stop]))
    return found


def driven(
    changes: Sequence[Change], n_frames: int, n_lanes: int, rng: np.random.Generator
) -> Path:
    """Where a car drives that makes these lane changes, the first frame at 0 s."""
    time_s = np.arange(n_frames) / RATE
    across = changes[0][1] - 0.5 + _wandering(n_frames, rng)
    for when, before, after in changes:
        # The car is halfway when it is annotated to change.
        done = np.clip((time_s - when) / _CHANGE_S + 0.5, 0, 1)
        across += (after - before) * (1 - np.cos(np.pi * done)) / 2
    return Path(np.clip(across, 0.0, n_lanes - 1e-6), n_lanes)


def _wandering(n_frames: int, rng: np.random.Generator) -> FloatArray:
    """(T,): the place in the lane, lanes from its middle: an autoregressive process."""
    kept = _MEMORY ** (1 / (5 * RATE))
    noise = rng.normal(0, _SPREAD * np.sqrt(1 - kept**2), n_frames)
    noise[0] = rng.normal(0, _SPREAD)
    return np.asarray(lfilter([1], [1, -kept], noise))


def _write_transplanted(folder: File, name: str, path: Path, run: int) -> None:
    write_recording(folder, name, transplanted(donor(run), path, _rng(name, "lines")), path.truth())


def _rng(*words: str) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(word.encode()) for word in words])


# --- UAH-DriveSet ------------------------------------------------------------------------------


def make_uah(copy: File, two_lines: File, motion: File) -> None:
    """The two tracks of an entrant's own copy of UAH-DriveSet: the two lines that its camera gave,
    and the motion of its cars with the frames of donors, on roads of 3, 4 and 5 lanes."""
    runs = list(DONORS)
    for number, (drive, (log, path)) in enumerate(uah.drives_of(copy).items()):
        write_recording(two_lines, f"{drive}-n{path.n_lanes}", log, path.truth())
        for k, n_lanes in enumerate((3, 3, 3, 4, 5)):
            run = runs[(3 * number + k) % len(runs)]
            name = f"{drive}-n{n_lanes}-{DONORS[run][0]}"
            _write_transplanted(motion, name, Path(path.across, n_lanes), run)


# --- what was made -----------------------------------------------------------------------------


def checksum(folder: File) -> str:
    """The sha256 of the names and contents of a track's files."""
    found = hashlib.sha256()
    for file in sorted(folder.iterdir()):
        found.update(file.name.encode() + b"\0" + file.read_bytes())
    return found.hexdigest()


def make_tracks(out: File, copy: File | None) -> list[str]:
    """Make the tracks that can be made here, and compare what was made with the checksums.

    - copy: of UAH-DriveSet.

    Returns a line for each track. Raises InputError for recordings that are not there.
    """
    names = ["paper", "rotterdam", *(["two_lines", "motion"] if copy is not None else [])]
    folders = {name: out / name for name in names}
    for folder in folders.values():
        make_directory(folder)
        if any(folder.iterdir()):
            raise InputError(f"{folder}: is not empty; tracks are made in a new folder")
    make_paper(folders["paper"])
    make_rotterdam(folders["rotterdam"])
    if copy is not None:
        make_uah(copy, folders["two_lines"], folders["motion"])
    known = {name: digest for digest, name in map(str.split, read_text(CHECKSUMS).splitlines())}
    said = []
    for name, folder in folders.items():
        found = checksum(folder)
        same = "as published" if known.get(name) == found else "NOT as published"
        told = same if name in known else "none is published"
        said.append(
            f"{name}: {len(list(folder.glob('*.txt')))} recordings, sha256 {found} ({told})"
        )
    return said
