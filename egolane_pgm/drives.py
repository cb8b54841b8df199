"""Drives: recordings read, selected and joined with their ground truth.

A recording yields one drive or several: one per clip of a data set, and one per segment of road
with a constant number of lanes (`n_lanes: map`). Everything that runs, fits or scores takes drives.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.contracts import Reader
from egolane_pgm.experiment import FROM_MAP, Experiment, TunedOn, make_experiment
from egolane_pgm.identity import Marks, compared, marks_of, most_in_sample
from egolane_pgm.loading import IN_MEMORY, existing
from egolane_pgm.maps.road_table import lanes_along, unknown_lanes
from egolane_pgm.maps.road_table import load as load_road
from egolane_pgm.model import Model, compile_model, with_inputs
from egolane_pgm.plugins import load_plugin, plugin_errors
from egolane_pgm.recordings import format_of, read_lines, reader_of
from egolane_pgm.recordings.clock import clock_warning
from egolane_pgm.recordings.ground_truth import read_ground_truth, truth_of
from egolane_pgm.recordings.select import (
    fill_missing,
    frame_range,
    rate_of,
    recording_warnings,
    select_frames,
    sign_warning,
)
from egolane_pgm.recordings.table import lines_of
from egolane_pgm.types import (
    NOT_ANNOTATED,
    BoolArray,
    InputError,
    IntArray,
    LineLog,
    clip_slices,
    problems_in,
)

if TYPE_CHECKING:
    import pandas as pd

#: Keys of `recording` that identify a drive; the others describe how to read it.
DRIVE_KEYS = ("simulate", "seed", "frames")


#: Lines and ground truth of a recording.
Whole = tuple[LineLog, "pd.DataFrame | None"]


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive: T frames of lines, their ground truth, and a model.

    - name: unique among the drives of a recording.
    - log: lines, after frame selection and `missing_frames`.
    - true_lane (T,): 1 (leftmost) to n, NOT_ANNOTATED (0) if unknown.
    - is_crossing (T,): marks frames in which the car changes lanes.
    - whole: lines and ground truth of the whole recording.
    - tags: labels to group drives by.
    """

    name: str
    model: Model
    log: LineLog
    true_lane: IntArray
    is_crossing: BoolArray
    whole: Whole | None = None
    tags: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """The number of annotated frames; of all frames without ground truth."""
        return len(self.rows)

    @property
    def experiment(self) -> Experiment:
        """The experiment of the model."""
        return self.model.experiment

    @property
    def has_truth(self) -> bool:
        """Whether any frame is annotated."""
        return bool((self.true_lane != NOT_ANNOTATED).any())

    @property
    def rows(self) -> IntArray:
        """(K,): the annotated frames; all frames without ground truth."""
        is_annotated = self.true_lane != NOT_ANNOTATED
        return np.flatnonzero(is_annotated | ~is_annotated.any())

    @property
    def is_trusted(self) -> BoolArray:
        """(K,): marks the annotated frames that are not in `fit.untrusted_frames`."""
        frame_id = self.log.frame_id[self.rows]
        trusted = np.ones(len(frame_id), dtype=bool)
        for first, stop in self.experiment.fit.untrusted_frames:
            trusted &= (frame_id < first) | (frame_id >= (np.inf if stop is None else stop))
        return trusted

    def tuned_on(self, frames: slice | IntArray = slice(None)) -> TunedOn:
        """Compare what the model was tuned on with some annotated frames, indices into rows."""
        known: list[TunedOn] = ["not_tuned"]
        for origin in (self.model.experiment.tuned_on, self.model.learned_from):
            if isinstance(origin, str):
                known.append(origin)
            elif origin is not None:
                known += [compared(each, self.marks, self.frame_ids(frames)) for each in origin]
        return most_in_sample(known)

    @cached_property
    def marks(self) -> Marks:
        """The marks of the whole recording."""
        return marks_of(*(self.whole or (self.log, None)))

    def frame_ids(self, frames: slice | IntArray = slice(None)) -> IntArray:
        """The ids of some annotated frames, indices into rows."""
        return self.log.frame_id[self.rows[frames]]

    def mask_labels(self, train: IntArray) -> Drive:
        """The drive without the labels of all annotated frames but `train` (indices into rows).

        Masked frames count as crossing, in lane 1: no fit reads the lane of a crossing frame.
        """
        masked = self.true_lane != NOT_ANNOTATED
        masked[self.rows[train]] = False
        lane = np.where(masked, 1, self.true_lane)
        return replace(self, true_lane=lane, is_crossing=self.is_crossing | masked)


# --- reading -------------------------------------------------------------------------------------


def read_recording(
    experiment: Experiment, lines: Any = None
) -> tuple[LineLog, pd.DataFrame | None, float | None]:
    """Read the lines of an experiment from memory, pictures, a simulation or a file.

    Returns T frames, of one drive or of several clips; the ground truth of a simulation; and the
    frames per second by time stamps, if there are some.
    """
    r, source = experiment.recording, experiment.source
    if lines is not None:
        log = lines_of(lines, frame_rate=r.frame_rate, columns=r.columns)
    elif r.detector is not None:
        # OpenCV is imported for pictures only.
        from egolane_pgm.vision.detectors.pictures import read_pictures

        log, frame_rate = read_pictures(experiment)
        # With a frame rate in the experiment it has warned of another one in the file.
        return log, None, None if "frame_rate" in r.model_fields_set else frame_rate
    elif r.simulate is not None:
        # Imported for simulations only.
        from egolane_pgm.simulation import simulate

        with problems_in(f"{source}: recording"):
            drive = simulate(r.simulate, seed=r.seed, n_lanes=experiment.n_lanes)
        return drive.log, drive.truth, None
    elif r.path == IN_MEMORY:
        raise InputError(f"{source}: recording.path: pass the lines that are in memory")
    else:
        log = read_file(experiment)
    return log, None, rate_of(log.frame_id, log.time_s)


def read_file(experiment: Experiment) -> LineLog:
    """Read lines from a file or a folder, in a known format or with a user's own `read(path)`."""
    path, reader = check_file(experiment)
    r, where = experiment.recording, f"{experiment.source}: recording.format"
    given = {"camera": r.camera, "topic": r.topic, "frame_rate": r.frame_rate}
    options = {**r.options, **{key: value for key, value in given.items() if value is not None}}
    if reader is None:
        return read_lines(path, format=r.format, columns=r.columns, **options)
    with plugin_errors(reader, where):
        found = reader.read(path, **options)
    with problems_in(where):
        return lines_of(found, frame_rate=r.frame_rate, columns=r.columns, path=path)


def check_sources(experiment: Experiment) -> None:
    """Check, without reading any frame, that all files of an experiment are there."""
    r = experiment.recording
    if r.detector is not None:
        from egolane_pgm.vision.detectors.pictures import open_pictures

        open_pictures(experiment, calibrate=False)
    elif r.simulate is None:
        check_file(experiment)
    else:
        from egolane_pgm.simulation import simulated_road

        with problems_in(f"{experiment.source}: recording"):
            simulated_road(r.simulate, frames=1)
    if experiment.ground_truth is not None:
        existing(experiment, "ground_truth.path")
    if experiment.road is not None:
        existing(experiment, "road")


def check_file(experiment: Experiment) -> tuple[Path, Reader | None]:
    """The file of lines, and the user's own reader of its format, if there is one.

    Raises InputError for a file that is missing and for an unknown format.
    """
    recording, where = experiment.recording, f"{experiment.source}: recording.format"
    format = recording.format or ""
    reader = load_plugin(Reader, format, where) if format.endswith(".py") else None
    path = existing(experiment, "recording.path")
    if recording.camera is not None:
        existing(experiment, "recording.camera")
    if reader is None:
        with problems_in(where):
            reader_of(format or format_of(path))
    return path, reader


# --- from a recording to drives ------------------------------------------------------------------


def read_drives(
    experiment: Experiment,
    lines: Any = None,
    truth: Any = None,
    tags: Mapping[str, str] | None = None,
) -> list[Drive]:
    """Read the recording of an experiment: one drive, or several.

    - lines: a DataFrame or LineLog, for `recording.path: in memory`.
    - truth: a DataFrame with frame_id, lane and crossing, or "none", instead of the experiment's.
    - tags: labels of the drives.

    Raises InputError for files that cannot be used, and warns of oddities.
    """
    # Report errors of the model before a recording is read, which may take long.
    model = None if experiment.n_lanes == FROM_MAP else compile_model(experiment)
    log, known, own_rate = read_recording(
        with_inputs(experiment, model.graph if model else None), lines
    )
    recording, annotated = experiment.recording, experiment.ground_truth
    if truth is not None:
        known = None if isinstance(truth, str) and truth == "none" else truth_of(truth, log)
    elif annotated is not None:
        path = existing(experiment, "ground_truth.path")
        known = read_ground_truth(path, annotated.extra_rows, log)
    if "frame_rate" not in recording.model_fields_set and recording.simulate is None:
        unit = None if recording.detector else (recording.columns or {}).get("time_unit", "s")
        for note in clock_warning(log.source, log.frame_id, log.time_s, unit):
            warnings.warn(note, UserWarning, stacklevel=2)
    if own_rate is not None and "frame_rate" not in recording.model_fields_set:
        experiment = with_rate(experiment, own_rate)
        recording = experiment.recording
    elif own_rate is not None and abs(own_rate / recording.frame_rate - 1) > 0.1:
        note = f"{log.source}: has {own_rate:g} frames per second by its times; delays are counted"
        note += f" with recording.frame_rate, {recording.frame_rate:g}"
        warnings.warn(note, UserWarning, stacklevel=2)
    whole = log, known
    log = select_frames(log, *(recording.frames or (None, None)))
    if known is not None and log.clip is not None:
        raise InputError(f"{log.source}: clips have no ground truth; leave out ground_truth")
    drives: list[Drive] = []
    for frames in [slice(None)] if log.clip is None else clip_slices(log.clip):
        clip = log.take(frames)
        name = experiment.name if clip.clip is None else str(clip.clip[0])
        if recording.missing_frames != "skip":
            clip = fill_missing(clip, recording.missing_frames, recording.frame_rate)
        if model is None:
            drives += cut(name, experiment, clip, known, whole)
        else:
            here = replace(model, experiment=experiment)
            drives.append(make_drive(name, here, clip, known, whole))
    return [replace(drive, tags=dict(tags or {})) for drive in drives]


def make_drive(
    name: str,
    model: Model,
    log: LineLog,
    truth: pd.DataFrame | None,
    whole: Whole | None = None,
    *,
    most_lanes: int = 0,
) -> Drive:
    """Join a log with its ground truth, and warn of oddities.

    - whole: lines and ground truth of the whole recording.
    - most_lanes: for a segment of a longer road, the lanes of the widest segment. A lane may end
      some metres from its position in the map, so the truth may contain a lane that the segment
      does not have; and a segment may have no annotated frame.
    """
    max_lri = float(model.parameters.get("max_lri", 10))  # type: ignore[arg-type]
    notes = recording_warnings(log, model.n_lanes, max_lri)
    lane = np.full(len(log), NOT_ANNOTATED)
    crossing = np.zeros(len(log), dtype=bool)
    if truth is not None and (not most_lanes or np.isin(log.frame_id, truth.index).any()):
        widest, source = most_lanes or model.n_lanes, truth.attrs.get("source", "ground truth")
        outside = truth[~truth["true_lane"].between(1, widest)]
        if len(outside):
            raise InputError(
                f"{source}: frame {outside.index[0]}: lane {outside['true_lane'].iloc[0]} is"
                f" outside 1..{widest}; is n_lanes right?"
            )
        at = truth.index.get_indexer(log.frame_id)
        rows, known = np.flatnonzero(at >= 0), truth.iloc[at[at >= 0]]
        if not len(rows):
            raise InputError(
                f"no common frames: {log.source} has {frame_range(log.frame_id)},"
                f" {truth.attrs['source']} has {frame_range(truth.index.to_numpy())}"
            )
        lane[rows], crossing[rows] = known["true_lane"], known["is_crossing"]
        notes += sign_warning(log.take(rows), known["true_lane"].to_numpy())
        if missing := len(log) - len(rows):
            unscored = f"{missing} of {len(log)} frames have no ground truth; filtered, not scored"
            notes.append(f"{log.source}: {unscored}")
    for note in notes:
        warnings.warn(note, UserWarning, stacklevel=2)
    return Drive(name, model, log, lane, crossing, whole)


def cut(
    name: str, experiment: Experiment, log: LineLog, truth: pd.DataFrame | None, whole: Whole
) -> list[Drive]:
    """One drive per segment of road with a constant number of lanes; each starts from the prior."""
    road = load_road(existing(experiment, "road"))
    n_lanes = lanes_along(road, log)
    for note in unknown_lanes(road, log):
        warnings.warn(note, UserWarning, stacklevel=2)
    widest = int(n_lanes.max())
    models = {
        n: compile_model(changed(experiment, road=None, n_lanes=n)) for n in set(n_lanes.tolist())
    }
    segments = np.split(np.arange(len(log)), np.flatnonzero(np.diff(n_lanes)) + 1)
    return [
        make_drive(
            f"{name}_{k}", models[n_lanes[at[0]]], log.take(at), truth, whole, most_lanes=widest
        )
        for k, at in enumerate(segments, start=1)
    ]


def changed(experiment: Experiment, **changes: Any) -> Experiment:
    """The experiment with other values, checked; a section keeps its other keys."""
    content = experiment.keys
    for key, value in changes.items():
        content[key] = {**content[key], **value} if isinstance(value, Mapping) else value
    return make_experiment(content, experiment.source)


def with_rate(experiment: Experiment, frame_rate: float) -> Experiment:
    """The experiment with another frame rate, frames per second."""
    if frame_rate == experiment.recording.frame_rate:
        return experiment
    return changed(experiment, recording={"frame_rate": frame_rate})


def drive_names(drives: Iterable[Drive]) -> list[str]:
    """The names of drives; equal ones are numbered."""
    names = [drive.name for drive in drives]
    return [
        f"{name}_{names[:k].count(name) + 1}" if names.count(name) > 1 else name
        for k, name in enumerate(names)
    ]


def drive_key(experiment: Experiment, data: Sequence[Mapping[str, Any]]) -> str:
    """A text that is equal for several recordings of one drive (by several detectors): the checksum
    of the ground truth, else of the recording; or preset and seed of a simulation.

    - data: the digests of the experiment's files.
    """
    recording, truth = experiment.recording, experiment.ground_truth
    if recording.simulate is not None:
        return f"{recording.simulate}, seed {recording.seed}, {experiment.n_lanes} lanes"
    sha256 = {entry["path"]: entry["sha256"] for entry in data}
    path = str(recording.path) if truth is None else truth.path
    return str(sha256.get(path, f"{experiment.name} in memory"))
