"""What an experiment is run on: its recording, selected and joined with its ground truth."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.plugins import load_plugin, plugin_errors
from egolane_pgm.recordings import FORMATS, read_lines
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.recordings.select import (
    clip_lri,
    fill_missing,
    join,
    recording_warnings,
    select_frames,
)
from egolane_pgm.types import InputError, IntArray, LaneTruth, LineLog, suggestion


@dataclass(frozen=True)
class Recorded:
    """What an experiment is run on.

    log: T frames. truth: the annotated frames among them, in order, or None. scored (K,): which
    frames of the log those are. files: what was read. notes: what is odd about it, a line each.
    """

    log: LineLog
    truth: LaneTruth | None
    scored: IntArray
    files: tuple[Path, ...]
    notes: tuple[str, ...]


def load_recording(experiment: Experiment, parameters: Mapping[str, Any] | None = None) -> Recorded:
    """Read and select the frames of an experiment, and join its ground truth.

    parameters: the model's, where they are resolved already (an evidence rule may declare its own
    `max_lri`); default the experiment's.

    Raises InputError for files that cannot be used. What is odd but usable is in `notes`.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        log, truth, files = _read_sources(experiment)
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    recording = experiment.recording
    first, stop = recording.frames or (None, None)
    log = select_frames(log, first, stop)
    log = fill_missing(log, recording.missing_frames, recording.frame_rate)
    max_lri = float((parameters or experiment.parameters).get("max_lri", 10))
    if recording.lri == "clip":
        log = clip_lri(log, max_lri)
    notes += recording_warnings(log, experiment.n_lanes, max_lri)
    if truth is None:
        return Recorded(log, None, np.zeros(0, dtype=np.int64), tuple(files), tuple(notes))
    truth.check_lanes(experiment.n_lanes)
    both = join(log, truth)
    if both.log_dropped:
        notes.append(
            f"{log.source}: {both.log_dropped} of {len(log)} frames have no ground truth;"
            " filtered, not scored"
        )
    return Recorded(log, truth.take(both.truth), both.log, tuple(files), tuple(notes))


def _read_sources(experiment: Experiment) -> tuple[LineLog, LaneTruth | None, list[Path]]:
    recording = experiment.recording
    files: list[Path] = []
    truth = None
    if recording.simulate is not None:
        from egolane_pgm.simulation import simulate

        drive = simulate(recording.simulate, seed=recording.seed, n_lanes=experiment.n_lanes)
        log, truth = drive.log, drive.truth
    else:
        assert recording.path is not None
        path = _find(recording.path, experiment, "recording.path")
        files.append(path)
        log = _read_log(path, experiment)
    if experiment.ground_truth is not None:
        path = _find(experiment.ground_truth.path, experiment, "ground_truth.path")
        files.append(path)
        truth = read_ground_truth(path, experiment.ground_truth.extra_rows)
    return log, truth, files


def check_sources(experiment: Experiment) -> None:
    """Raise InputError, naming the YAML file and key, where the recording or its ground truth are
    not there, or its format or simulation does not exist; nothing is read."""
    from egolane_pgm.simulation import PRESETS

    recording, source = experiment.recording, experiment.source
    if recording.simulate is not None and recording.simulate not in PRESETS:
        raise InputError(
            f"{source}: recording.simulate: unknown preset '{recording.simulate}'"
            f"{suggestion(recording.simulate, PRESETS)}"
        )
    if recording.format is not None and recording.format.endswith(".py"):
        where = f"{source}: recording.format"
        load_plugin("recordings", recording.format, experiment.folder, where)
    elif recording.format is not None and recording.format not in FORMATS:
        raise InputError(
            f"{source}: recording.format: unknown format '{recording.format}'"
            f"{suggestion(recording.format, FORMATS)}"
        )
    if recording.path is not None:
        _find(recording.path, experiment, "recording.path")
    if experiment.ground_truth is not None:
        _find(experiment.ground_truth.path, experiment, "ground_truth.path")


def _find(path: str, experiment: Experiment, key: str) -> Path:
    try:
        return find_file(path, experiment.folder)
    except InputError as error:
        raise InputError(f"{experiment.source}: {key}: {error}") from error


def _read_log(path: Path, experiment: Experiment) -> LineLog:
    recording = experiment.recording
    options: dict[str, Any] = {"frame_rate": recording.frame_rate}
    if recording.topic is not None:
        options["topic"] = recording.topic
    if recording.frame_id != "way_id":
        options["frame_id"] = recording.frame_id
    if recording.format is not None and recording.format.endswith(".py"):
        where = f"{experiment.source}: recording.format"
        reader = load_plugin("recordings", recording.format, experiment.folder, where)
        with plugin_errors(reader, where):
            log: LineLog = reader.read(path, **options)
        return log
    return read_lines(path, recording.format, **options)
