"""What answers for a recording: a folder of answers, a command, or an experiment.

An answer is two tables with semicolons. Beliefs: `frame_id;p1;p2;...`, a row per frame, none where
the entry is silent. Lane changes: `told_frame;from;to`, in the frame in which each was reported.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.benchmark.tracks import RATE, Recording
from egolane_pgm.drive import Drive, open_drive, with_recording
from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.events import lane_events
from egolane_pgm.learning.tables import with_found
from egolane_pgm.parameters import Value
from egolane_pgm.recordings.source import IN_MEMORY, Read
from egolane_pgm.recordings.table import write_table
from egolane_pgm.running import believe
from egolane_pgm.tools.files import temporary_folder
from egolane_pgm.types import BoolArray, FloatArray, InputError, LaneEvents

#: The words of a command that stand for its files and the number of lanes (0: unknown).
WORDS = ("lines", "n", "beliefs", "events")


@dataclass(frozen=True)
class Answer:
    """What an entry says of T frames.

    - belief (T, n): rows that sum to 1, or zeros where it is silent. Of an entry that finds n
      itself, of as many lanes as it finds.
    - told: the reported lane changes; None of an entry that reports none.
    - seconds: how long it took.
    """

    belief: FloatArray
    told: LaneEvents | None = None
    seconds: float | None = None


#: Answers for a recording. `n_lanes` of the recording is 0 where the entry has to find it.
Answering = Callable[[Recording], Answer]


# --- an experiment -----------------------------------------------------------------------------


def drive_on(experiment: Experiment, recording: Recording, with_truth: bool = False) -> Drive:
    """An experiment on a recording, with its lanes only where they may be learned from."""
    if not recording.n_lanes:
        raise InputError(f"{experiment.source}: finds no number of lanes; give a command instead")
    truth = recording.truth if with_truth else None
    chosen = with_recording(experiment, IN_MEMORY, "none", recording.n_lanes)
    return open_drive(chosen, read=Read(recording.log, truth))


def by_experiment(
    experiment: Experiment,
    recording: Recording,
    *,
    found: Mapping[int, Mapping[str, Value]] | None = None,
) -> Answer:
    """The beliefs of an experiment, and its lane changes by the rules of every result.

    - found: for roads of n lanes what was learned of them; the others keep what the YAML says.
    """
    begun = time.perf_counter()
    drive = drive_on(experiment, recording)
    if found and recording.n_lanes in found:
        learned = with_found(drive.model, found[recording.n_lanes], drive.experiment)
        drive = replace(drive, model=learned)
    believed = believe(drive)
    told = lane_events(
        believed.beliefs,
        RATE,
        lag=drive.experiment.lag,
        time_s=drive.recorded.log.time_s,
        places=believed.place_in_lane,
    )
    return Answer(believed.beliefs.lane, told, time.perf_counter() - begun)


# --- a folder ----------------------------------------------------------------------------------


def by_folder(folder: Path, recording: Recording) -> Answer:
    """The answer in FOLDER/NAME.csv and FOLDER/NAME.events.csv (which may be missing)."""
    return read_answer(
        folder / f"{recording.name}.csv", folder / f"{recording.name}.events.csv", recording
    )


def read_answer(beliefs: Path, events: Path, recording: Recording) -> Answer:
    """The answer in two files. Raises InputError, naming file and frame, for columns that are not
    asked for, frames that the recording does not have, and for what is no belief."""
    columns, rows = _table(beliefs)
    n_columns = recording.n_lanes or len(columns) - 1
    wanted = ["frame_id", *(f"p{k}" for k in range(1, n_columns + 1))]
    if columns != wanted:
        raise InputError(f"{beliefs}: its columns are {';'.join(columns)}, not {';'.join(wanted)}")
    frame, belief = rows[:, 0], rows[:, 1:]
    _check_rows(beliefs, frame, np.isin(frame, recording.log.frame_id), "is not in the recording")
    _check_rows(beliefs, frame, np.diff(frame, prepend=-np.inf) > 0, "does not come in order")
    sums = belief.sum(axis=1)
    fits = (belief >= 0).all(axis=1) & ((np.abs(sums - 1) < 1e-3) | (sums == 0))
    _check_rows(beliefs, frame, fits, "has numbers that do not sum to 1 (or are all 0: silent)")
    whole = np.zeros((len(recording.log), n_columns))
    whole[np.searchsorted(recording.log.frame_id, frame)] = (
        belief / np.where(sums, sums, 1)[:, None]
    )
    return Answer(whole, _read_events(events, recording) if events.is_file() else None)


def _read_events(file: Path, recording: Recording) -> LaneEvents:
    columns, rows = _table(file)
    if columns != ["told_frame", "from", "to"]:
        raise InputError(f"{file}: its columns are {';'.join(columns)}, not told_frame;from;to")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    told, before, after = rows.T.astype(np.int64)
    _check_rows(file, told, np.isin(told, recording.log.frame_id), "is not in the recording")
    when = told / RATE
    way, sure = np.sign(after - before), np.ones(len(told))
    return LaneEvents(told, when, told, when, before, after, way, sure)


def _table(file: Path) -> tuple[list[str], FloatArray]:
    import pandas as pd

    try:
        frame = pd.read_csv(file, sep=";", dtype=np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: is no table of numbers with semicolons: {error}") from error
    return [str(name) for name in frame.columns], frame.to_numpy()


def _check_rows(file: Path, frame: Any, fits: BoolArray, why: str) -> None:
    if not fits.all():
        raise InputError(f"{file}: frame {frame[int(np.argmin(fits))]:.0f} {why}")


# --- a command ---------------------------------------------------------------------------------


def by_command(words: Sequence[str], recording: Recording) -> Answer:
    """What a command answers that is run on a recording.

    - words: of the command; `{lines}`, `{n}`, `{beliefs}` and `{events}` in them stand for the
      file that it reads, the number of lanes (0: unknown) and the files that it writes.

    Raises InputError, with its last line, for a command that fails, and as `read_answer`.
    """
    with temporary_folder() as folder:
        files = {word: folder / f"{word}.csv" for word in WORDS if word != "n"}
        write_table(files["lines"], recording.log)
        values = {word: str(file) for word, file in files.items()} | {"n": str(recording.n_lanes)}
        given = [_filled(word, values) for word in words]
        begun = time.perf_counter()
        try:
            done = subprocess.run(given, capture_output=True, text=True)
        except OSError as error:
            raise InputError(f"{words[0]}: cannot be run: {error.strerror}") from error
        seconds = time.perf_counter() - begun
        if done.returncode:
            last = (done.stderr.strip() or "without a word").splitlines()[-1]
            raise InputError(f"{shlex.join(words)}: {recording.name}: fails: {last}")
        return replace(read_answer(files["beliefs"], files["events"], recording), seconds=seconds)


def _filled(word: str, values: Mapping[str, str]) -> str:
    for name, value in values.items():
        word = word.replace(f"{{{name}}}", value)
    return word


def command_words(entry: str) -> list[str] | None:
    """The words of a command, or of a Python file that is one; None for anything else."""
    if entry.endswith(".py"):
        return [sys.executable, entry, *(f"{{{word}}}" for word in WORDS)]
    return shlex.split(entry) if "{lines}" in entry else None
