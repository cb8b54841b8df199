"""A drive: the recording of an experiment, selected and joined with its ground truth, and the
experiment's model. Whatever runs, fits or scores begins with one."""

from __future__ import annotations

import hashlib
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import FROM_MAP, Experiment, Overrides, make_experiment, overridden
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.maps.cutting import cut, lanes_along, untold_lanes
from egolane_pgm.maps.road_table import load as load_road
from egolane_pgm.model import Model, RuleOutput, make_evidence, prepare_model, with_parameters
from egolane_pgm.parameters import Value
from egolane_pgm.recordings import check_one_drive
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.recordings.select import (
    clip_lri,
    fill_missing,
    join,
    recording_warnings,
    select_frames,
    sign_warning,
)
from egolane_pgm.recordings.source import IN_MEMORY, LinesFile, Read, Source, find_named
from egolane_pgm.simulation.drives import Simulated
from egolane_pgm.tools.files import file_sha256
from egolane_pgm.types import (
    Beliefs,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    LaneTruth,
    LineLog,
)
from egolane_pgm.vision.detectors.pictures import Pictures

#: The end of a message where clips are not taken.
ONE_DRIVE = "only `egolane run` takes clips; here name the lines of one"

#: How many evidences a drive keeps; `bonus_value`, which is searched, has 10 values.
KEPT_EVIDENCE = 12

#: Keys of a recording that say what is done with its lines, wherever they come from.
_KEPT = frozenset({"frame_rate", "missing_frames", "lri"})


def source_of(experiment: Experiment) -> Source:
    """Where the lines of an experiment come from."""
    recording = experiment.recording
    if recording.simulate is not None:
        return Simulated(experiment)
    return (LinesFile if recording.detector is None else Pictures)(experiment)


# --- the recording -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Recorded:
    """The recording of an experiment, with its ground truth.

    log: T frames, of one drive or of several clips.
    truth: the K annotated frames among them, in order, or None.
    scored (K,): which frames of the log these are.
    files: what was read (a folder of pictures, or a glob, stands for all of them).
    notes: warnings, a line each.
    road_lanes (T,): lanes of the road, of a recording whose clips are where they stay the same
        (`n_lanes: map`).
    frame_rate: frames per second that were counted with; None where nothing was read.
    """

    log: LineLog
    truth: LaneTruth | None
    scored: IntArray
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    road_lanes: IntArray | None = None
    frame_rate: float | None = None

    def take(self, frames: slice) -> Recorded:
        """Frames that follow each other."""
        low, high = np.searchsorted(self.scored, [frames.start, frames.stop])
        truth = None if self.truth is None else self.truth.take(slice(low, high))
        scored = self.scored[low:high] - frames.start
        lanes = None if self.road_lanes is None else self.road_lanes[frames]
        log = self.log.take(frames)
        return replace(self, log=log, truth=truth, scored=scored, road_lanes=lanes)

    def clips(self) -> list[Recorded]:
        """Each clip as a drive of its own; of one drive that."""
        pieces = self.log.pieces()
        return [self] if len(pieces) == 1 else [self.take(piece) for piece in pieces]


def load_recording(
    experiment: Experiment,
    parameters: Mapping[str, Any] | None = None,
    *,
    clips: bool = False,
    read: Read | None = None,
) -> Recorded:
    """Read and select the frames of an experiment, and join its ground truth.

    parameters: the model's, where they are resolved already (an evidence rule may declare its own
        `max_lri`); default the experiment's.
    clips: whether the recording may be of several clips.
    read: what is in memory takes the place of what the experiment's source, and its ground truth,
        would read.

    Raises InputError for files that cannot be used. Oddities that do not prevent that are in
    `notes`.
    """
    recording, values = experiment.recording, parameters or experiment.parameters
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = source_of(experiment).read() if read is None else read
        truth, files = found.truth, [*found.files]
        if experiment.ground_truth is not None and (read is None or truth is None):
            files.append(find_named(experiment, "ground_truth.path"))
            truth = read_ground_truth(files[-1], experiment.ground_truth.extra_rows)
    notes = [*found.notes]
    notes += [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    if not clips:
        check_one_drive(found.log, ONE_DRIVE)
    if truth is not None:
        check_one_drive(found.log, "clips are run without ground truth (ground_truth: none)")
    first, stop = recording.frames or (None, None)
    log = select_frames(found.log, first, stop)
    log = fill_missing(log, recording.missing_frames, recording.frame_rate)
    max_lri = float(values.get("max_lri", 10))
    if recording.lri == "clip":
        log = clip_lri(log, max_lri)
    n_lanes, road_lanes = experiment.n_lanes, None
    if n_lanes == FROM_MAP:
        check_one_drive(log, "clips are run without a road table")
        files.append(find_named(experiment, "road"))
        table = load_road(files[-1])
        road_lanes = lanes_along(table, log)
        n_lanes, notes = int(table.n_lanes.max()), [*notes, *untold_lanes(table, log)]
        log = cut(log, road_lanes, experiment.name)
    notes += recording_warnings(log, n_lanes, max_lri, recording.frame_rate)
    none = np.zeros(0, dtype=np.int64)
    rate = recording.frame_rate
    recorded = Recorded(log, None, none, tuple(files), tuple(notes), road_lanes, rate)
    if truth is None:
        return recorded
    truth.check_lanes(n_lanes)
    scored, annotated = join(log, truth)
    notes += sign_warning(log.take(scored), truth.take(annotated))
    if len(scored) < len(log):
        notes.append(
            f"{log.source}: {len(log) - len(scored)} of {len(log)} frames have no ground truth;"
            " filtered, not scored"
        )
    return replace(recorded, truth=truth.take(annotated), scored=scored, notes=tuple(notes))


def check_sources(experiment: Experiment) -> None:
    """Raise InputError, naming the YAML file and key, for a recording or ground truth that is not
    there, or a format or simulation that does not exist. No file is read."""
    source_of(experiment).check()
    for key in ("ground_truth.path", "road"):
        if getattr(experiment, key.partition(".")[0]) is not None:
            find_named(experiment, key)


def with_own_rate(experiment: Experiment, read: Read | None = None) -> Experiment:
    """The experiment with the frame rate of its recording, where that has one (a video, lines with
    times) and the YAML says none.

    read: the recording, where it was read.
    """
    if "frame_rate" in experiment.recording.model_fields_set:
        return experiment
    if read is None:
        return _with_rate(experiment, source_of(experiment).frame_rate())
    return _with_rate(experiment, read.rate)


def _with_rate(experiment: Experiment, rate: float | None) -> Experiment:
    is_said = "frame_rate" in experiment.recording.model_fields_set
    if is_said or rate in (None, experiment.recording.frame_rate):
        return experiment
    content = experiment.model_dump()
    content["recording"]["frame_rate"] = rate
    return make_experiment(content, experiment.folder, experiment.source)


def data_entries(experiment: Experiment, files: Iterable[Path]) -> list[dict[str, Any]]:
    """The `file_entry` of each file that was read."""
    files_in = source_of(experiment).files_in
    return [file_entry(path, files_in) for path in files]


def file_entry(path: Path, files_in: Callable[[Path], Sequence[Path]]) -> dict[str, Any]:
    """Path, sha256 and bytes of a file.

    Of a folder or a glob it is the sha256 of the list of the files' checksums and names, with the
    number of `files`. files_in: gives the files that it stands for.
    """
    if path.is_file():
        return {"path": str(path), "sha256": file_sha256(path), "bytes": path.stat().st_size}
    files = files_in(path)
    lines = "".join(f"{file_sha256(file)}  {file.name}\n" for file in files)
    return {
        "path": str(path),
        "sha256": hashlib.sha256(lines.encode()).hexdigest(),
        "bytes": sum(file.stat().st_size for file in files),
        "files": len(files),
    }


def named_files(experiment: Experiment) -> list[Path]:
    """The YAML of an experiment, and the files that it names in full or that lie beside it."""
    recording, truth = experiment.recording, experiment.ground_truth
    of_truth = truth.path if truth else None
    names = (recording.path, recording.right, recording.camera, of_truth, experiment.road)
    return [Path(experiment.source), *(experiment.folder / name for name in names if name)]


def drive_key(experiment: Experiment) -> str:
    """The same for recordings of one drive: a checksum of the frame ids and labels of its ground
    truth; of one without ground truth that of the source.

    The name of the file does not count: whoever knows the labels of a file knows those of its copy.
    Raises InputError where the ground truth cannot be read.
    """
    if experiment.ground_truth is None:
        return source_of(experiment).key()
    try:
        truth = read_ground_truth(find_file(experiment.ground_truth.path, experiment.folder))
    except InputError as error:
        raise InputError(f"{experiment.source}: ground_truth.path: {error}") from error
    content = hashlib.sha256()
    for values in (truth.frame_id, truth.lane, truth.is_crossing):
        content.update(np.ascontiguousarray(values).tobytes())
    return content.hexdigest()


# --- another recording -------------------------------------------------------------------------


def with_recording(
    experiment: Experiment,
    recording: str | None,
    ground_truth: str | None,
    n_lanes: int | None,
    camera: str | None = None,
    detector: str | None = None,
    overrides: Overrides = (),
) -> Experiment:
    """The experiment on another recording.

    - What belongs to the old recording (frame range, seed, ground truth and its extra rows) does
      not carry over. What was tuned on the old one is `other_frames` on a new one, and stays
      `same_frames` where the file is the old one.
    - Of the keys that say how the old one is read those carry over that hold for the new one too
      (`Source.kept_for`): detector and camera for pictures, format, topic, columns and so on for a
      file with the same extension.

    recording, ground_truth, n_lanes, camera, detector: what replaces the experiment's,
        None for what stays. recording may be `IN_MEMORY`, ground_truth "none"; camera and detector
        are for a video or pictures.
    overrides: keys that were overridden in the experiment: they are meant for the new recording, so
        that of these even the frame range is kept.

    Raises InputError for a folder of recordings, for one that has both pictures and lines where
    nothing says which are meant, for overrides that name a recording as well, and without n_lanes
    in place of a simulated drive, whose lanes say nothing of another road.
    """
    content = experiment.model_dump()
    section = content["recording"]
    if "frame_rate" not in experiment.recording.model_fields_set:
        # A video may tell its own.
        del section["frame_rate"]
    if experiment.recording.simulate is not None and recording is None and ground_truth == "none":
        raise InputError(
            f"{experiment.source}: ground_truth: none: a simulated drive brings its own;"
            " write it to files with `egolane simulate` and run on those"
        )
    if recording is not None:
        is_said = n_lanes is not None or "n_lanes" in overridden({}, overrides)
        simulated = experiment.recording.simulate is not None
        if (simulated or experiment.n_lanes == FROM_MAP) and not is_said:
            whose = "is its simulated drive's" if simulated else "is of its own road"
            raise InputError(
                "n_lanes: is missing: say how many lanes the road of this recording has (the"
                f" {experiment.n_lanes or 'map'} of {experiment.source} {whose})"
            )
        kept = _KEPT | source_of(experiment).kept_for(recording, detector)
        path = recording if recording == IN_MEMORY else str(Path(recording).absolute())
        content["recording"] = {**{k: v for k, v in section.items() if k in kept}, "path": path}
        content |= dict.fromkeys(("ground_truth", "road", "tuning"))
        content["name"] = name_of(recording)
        if experiment.tuned_on == "same_frames" and not _is_own(recording, experiment):
            content["tuned_on"] = "other_frames"
        content = overridden(content, overrides)
        section = content["recording"]
        if section.get("path") != path or section.get("simulate"):
            raise InputError(
                f"{experiment.source}: recording: overrides and recording, or a row of a fleet,"
                " name two of them; leave one out"
            )
    if camera is not None:
        section["camera"] = str(Path(camera).absolute())
    if detector is not None:
        is_own = detector.endswith(".py")
        if detector != section.get("detector"):
            section.pop("detector_parameters", None)
        section["detector"] = str(Path(detector).absolute()) if is_own else detector
    if ground_truth is not None:
        content["ground_truth"] = (
            None if ground_truth == "none" else {"path": str(Path(ground_truth).absolute())}
        )
    if n_lanes is not None:
        content["n_lanes"] = n_lanes
    return make_experiment(content, experiment.folder, experiment.source)


def _is_own(recording: str, experiment: Experiment) -> bool:
    """Whether a recording is the file of the experiment's own."""
    own = experiment.recording.path
    if own is None:
        return False
    try:
        place = find_file(own, experiment.folder, folders=True)
    except InputError:
        return False
    return place.resolve() == Path(recording).resolve()


def name_of(file: str | Path) -> str:
    """The name of an experiment on a recording in a file."""
    return as_name(Path(file).stem)


def as_name(text: str) -> str:
    """A text as the name of an experiment."""
    kept = (c if (c.isascii() and c.isalnum()) or c in "._-" else "_" for c in text)
    return "".join(kept).lstrip("._-") or "recording"


# --- with its model ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """A recording together with an experiment's model, for whatever runs, fits or scores.

    experiment: with the frame rate that was counted with.
    model: the experiment's, with its own parameters.
    recorded: the log of T frames, and the K annotated ones among them.
    never_fit: ranges of frame ids, first to stop (None: to the end), whose labels are not used for
        fitting.
    evidence: cache of `evidence_of`, by the values of the evidence rule's parameters.
    """

    experiment: Experiment
    model: Model
    recorded: Recorded
    never_fit: tuple[tuple[int, int | None], ...] = ()
    evidence: OrderedDict[tuple[Value, ...], Evidence] = field(default_factory=OrderedDict)

    def __len__(self) -> int:
        """The number of frames that blocks are made of: the annotated ones, or all T of a
        recording without ground truth."""
        return len(self.rows)

    @property
    def n_lanes(self) -> int:
        """Lanes of the road."""
        return self.model.n_lanes

    @property
    def truth(self) -> LaneTruth:
        """The ground truth of the K annotated frames; the drive must have one."""
        assert self.recorded.truth is not None
        return self.recorded.truth

    @property
    def rows(self) -> IntArray:
        """(K,): which frames of the log are annotated; all (T,) without ground truth."""
        if self.recorded.truth is None:
            return np.arange(len(self.recorded.log))
        return self.recorded.scored

    @property
    def may_fit(self) -> BoolArray:
        """(K,): marks the frames whose labels may be used for fitting."""
        return may_fit(self.recorded.log.frame_id[self.rows], self.never_fit)

    def only_labels_of(self, train: IntArray) -> Drive:
        """The same drive without the labels of all annotated frames but `train`.

        The other frames are marked as crossing, in lane 1: no fit and no score looks at the lane of
        a crossing frame.
        """
        if self.recorded.truth is None:
            return self
        lane = np.ones_like(self.truth.lane)
        is_crossing = np.ones_like(self.truth.is_crossing)
        lane[train] = self.truth.lane[train]
        is_crossing[train] = self.truth.is_crossing[train]
        truth = replace(self.truth, lane=lane, is_crossing=is_crossing)
        return replace(self, recorded=replace(self.recorded, truth=truth))


def may_fit(frame_id: IntArray, never_fit: Sequence[tuple[int, int | None]]) -> BoolArray:
    """(K,): marks the frames that are in none of the ranges (first, stop or None for the end)."""
    keep = np.ones(len(frame_id), dtype=bool)
    for first, stop in never_fit:
        keep &= ~((frame_id >= first) & (frame_id < (frame_id[-1] + 1 if stop is None else stop)))
    return keep


def open_drive(
    experiment: Experiment,
    *,
    recorded: Recorded | None = None,
    read: Read | None = None,
    clips: bool = False,
    check: Callable[[Experiment], None] = lambda experiment: None,
) -> Drive:
    """Compile an experiment's model and read its recording.

    recorded: the recording, where it was read and joined already.
    read: lines and lanes in memory, see `load_recording` and `recordings.memory.in_memory`.
    clips: whether the recording may be of several clips.
    check: raises InputError for what is not done with the experiment.

    Raises InputError for what is wrong with the experiment or its model, and as `load_recording`
    does.
    """
    check(experiment)
    model = prepare_model(experiment, most_lanes(experiment) if clips else None)
    if recorded is None:
        source = source_of(experiment)
        if read is None and isinstance(source, LinesFile):
            read = source.read()
        experiment = with_own_rate(experiment, read)
        recorded = load_recording(experiment, model.parameters, clips=clips, read=read)
    else:
        experiment = _with_rate(experiment, recorded.frame_rate)
    never_fit = () if experiment.tuning is None else experiment.tuning.never_fit
    return Drive(experiment, model, recorded, never_fit)


def most_lanes(experiment: Experiment) -> int:
    """The number of lanes of an experiment's road; where a map tells it, the most that it has."""
    if experiment.n_lanes != FROM_MAP:
        return experiment.n_lanes
    return max(1, int(load_road(find_named(experiment, "road")).n_lanes.max(initial=1)))


def load_drive(
    experiment: Experiment,
    *,
    needs_truth: str | None,
    recorded: Recorded | None = None,
    read: Read | None = None,
    never_fit: Sequence[tuple[int, int | None]] = (),
) -> Drive:
    """`open_drive` of a drive that is fitted to or scored.

    needs_truth: why ground truth is needed, the end of a message; None where it is not needed.
    recorded, read: as in `open_drive`.
    never_fit: ranges in addition to those of the experiment's own `tuning.never_fit`.

    Raises InputError as `open_drive` does, for an experiment that decodes a path, and, where ground
    truth is needed, for a recording without it or without a frame to score.
    """
    if recorded is not None:
        has_truth = recorded.truth is not None
    else:
        brings = experiment.recording.simulate if read is None else read.truth
        has_truth = experiment.ground_truth is not None or brings is not None

    def check(experiment: Experiment) -> None:
        source = experiment.source
        if experiment.decode != "marginal":
            raise InputError(
                f"{source}: decode: {experiment.decode} is for `egolane run`; here beliefs are"
                " scored (decode: marginal)"
            )
        if needs_truth is not None and not has_truth:
            raise InputError(f"{source}: ground_truth: is missing, {needs_truth}")

    drive = open_drive(experiment, recorded=recorded, read=read, check=check)
    truth = drive.recorded.truth
    if needs_truth is not None and truth is not None and truth.is_crossing.all():
        raise InputError(f"{truth.source}: every frame is a crossing, nothing to score")
    return replace(drive, never_fit=(*drive.never_fit, *never_fit))


def evidence_on(drive: Drive, model: Model) -> RuleOutput:
    """The evidence of all T frames of a drive for a model."""
    return make_evidence(model, drive.recorded.log, drive.experiment.evidence_reading)


def beliefs_of(drive: Drive, model: Model) -> tuple[Beliefs, tuple[str, ...]]:
    """Filter a drive with a model, by the experiment's filter and from the first frame of the log.

    Returns the beliefs of the K annotated frames, and what the evidence rule warned of.
    """
    experiment, log = drive.experiment, drive.recorded.log
    evidence = evidence_on(drive, model)
    beliefs = infer_beliefs(
        model.compiled, evidence.filtered, experiment.filter, experiment.lag, frame_id=log.frame_id
    )
    return beliefs.take(drive.rows), evidence.notes


def evidence_of(drive: Drive, parameters: Mapping[str, Value]) -> Evidence:
    """The evidence of all T frames with other parameters, every one with its value.

    The drive keeps the last few evidences, by the values of the evidence rule's parameters, and
    makes one only for values that are not among them.
    """
    names = [p.name for p in getattr(drive.model.rule, "PARAMETERS", ())]
    key = tuple(parameters[name] for name in names)
    if key in drive.evidence:
        drive.evidence.move_to_end(key)
        return drive.evidence[key]
    evidence = evidence_on(drive, replace(drive.model, parameters=parameters)).filtered
    drive.evidence[key] = evidence
    if len(drive.evidence) > KEPT_EVIDENCE:
        drive.evidence.popitem(last=False)
    return evidence


def belief_of(drive: Drive, parameters: Mapping[str, Value]) -> FloatArray:
    """Filter a drive with other parameters, every one with its value, from its first frame on.

    Returns the belief over lanes in the annotated frames, (K, n).
    """
    compiled = with_parameters(drive.model, parameters).compiled
    belief = filter_beliefs(compiled, evidence_of(drive, parameters), drive.experiment.filter).lane
    return belief if len(drive) == len(belief) else belief[drive.rows]
