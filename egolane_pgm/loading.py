"""What an experiment is run on: its recording, selected and joined with its ground truth."""

from __future__ import annotations

import functools
import hashlib
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.camera.model import Camera, read_camera
from egolane_pgm.detectors.runner import (
    Detector,
    check_pair,
    collect,
    detect,
    find_detector,
    own_files,
    start,
)
from egolane_pgm.experiment import (
    INTERCHANGE,
    Experiment,
    Overrides,
    make_experiment,
    overridden,
)
from egolane_pgm.maps.across import Across, across
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.maps.road_table import load as load_road
from egolane_pgm.maps.steps import LanesAlong, check_overlap, lanes_along
from egolane_pgm.plugins import OWN_FILES, load_plugin, plugin_errors
from egolane_pgm.recordings import (
    FORMATS,
    IN_PIXELS,
    check_one_drive,
    files_of,
    format_of,
    iterate_with,
    read_with,
)
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.ground_truth import iterate_ground_truth, read_ground_truth
from egolane_pgm.recordings.select import (
    Oddities,
    clip_lri,
    common_frames,
    fill_after,
    fill_missing,
    in_range,
    join,
    no_frame_in_range,
    nothing_in_common,
    odd_frames,
    recording_warnings,
    select_frames,
    warnings_of,
)
from egolane_pgm.results import file_sha256
from egolane_pgm.tools.files import in_home
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import (
    InputError,
    IntArray,
    LaneTruth,
    LineLog,
    all_problems,
    problems_in,
    suggestion,
    without_passwords,
)

if TYPE_CHECKING:
    # OpenCV is imported only where there are pictures.
    from egolane_pgm.camera.pictures import Source
    from egolane_pgm.simulation.interchange import InterchangeDrive

#: Extensions by which a video is known where no detector is named.
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".m4v", ".webm", ".wmv", ".ts")


#: Frame ids that are missing are put in for so many at a time, and a gap.
FILLED = 2**14

#: What a message about clips says where they are not taken.
ONE_DRIVE = "only `egolane run` takes clips; here name the lines of one"


@dataclass(frozen=True)
class Recorded:
    """The recording of an experiment, with its ground truth.

    log: T frames.
    truth: the K annotated frames among them, in order, or None.
    scored (K,): which frames of the log these are.
    files: what was read (a folder of pictures, or a glob, stands for all of them).
    notes: warnings, a line each.
    road: the lanes of the road in each frame of the log, where a map tells them.
    across: where positions put the car in each frame of the log, where they count (`gnss`).
    """

    log: LineLog
    truth: LaneTruth | None
    scored: IntArray
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    road: LanesAlong | None = None
    across: Across | None = None


def load_recording(
    experiment: Experiment,
    parameters: Mapping[str, Any] | None = None,
    *,
    clips: bool = False,
) -> Recorded:
    """Read and select the frames of an experiment, and join its ground truth.

    parameters: the model's, where they are resolved already (an evidence rule may declare its own
        `max_lri`); default the experiment's.
    clips: whether the recording may be of several clips.

    Raises InputError for files that cannot be used. Oddities that do not prevent that are in
    `notes`.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        log, truth, files = _read_sources(experiment)
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    if not clips:
        check_one_drive(log, ONE_DRIVE)
    recording = experiment.recording
    first, stop = recording.frames or (None, None)
    log = select_frames(log, first, stop)
    log = fill_missing(log, recording.missing_frames, recording.frame_rate)
    max_lri = float((parameters or experiment.parameters).get("max_lri", 10))
    if recording.lri == "clip":
        log = clip_lri(log, max_lri)
    notes += recording_warnings(log, experiment.n_lanes, max_lri)
    road = seen = None
    if experiment.follows_map or experiment.gnss is not None:
        check_one_drive(log, "clips are run without a road table")
        if experiment.road is not None:
            files.append(_road_file(experiment.road, experiment))
        table = road_of(experiment)
        if experiment.follows_map:
            road = road_along(experiment, table, parameters or experiment.parameters, log)
        if experiment.gnss is not None:
            check_overlap(table, log.time_s, log.source)
            lanes = np.full(len(log), experiment.n_lanes) if road is None else road.n_lanes
            seen = across(table, log.time_s, lanes, experiment.gnss.lane_width_m)
    if truth is None:
        none = np.zeros(0, dtype=np.int64)
        return Recorded(log, None, none, tuple(files), tuple(notes), road, seen)
    check_one_drive(log, "clips are run without ground truth (--ground-truth none)")
    truth.check_lanes(experiment.n_lanes)
    both = join(log, truth)
    if both.log_dropped:
        notes.append(not_annotated(log.source, both.log_dropped, len(log)))
    return Recorded(log, truth.take(both.truth), both.log, tuple(files), tuple(notes), road, seen)


@dataclass(frozen=True)
class Streamed:
    """A recording that is read part after part, with its ground truth.

    parts: a `Recorded` each, without notes: frames that follow those before, selected and joined as
        `load_recording` does.
    files: what is read.
    notes: warnings, a line each; complete when the parts are through.
    """

    parts: Iterator[Recorded]
    files: tuple[Path, ...]
    notes: list[str]


def stream_recording(
    experiment: Experiment, parameters: Mapping[str, Any], size: int, more: int
) -> Streamed:
    """An experiment's recording part after part, so that it may be of any length.

    - parameters: the model's.
    - size: frames of a part; the last one has up to `more` beside.

    Raises InputError, one line, for what is not read so; for what is wrong inside a file when it
    gets there.
    """
    source, recording = experiment.source, experiment.recording
    if recording.path is None or recording.detector is not None:
        key = "simulate" if recording.path is None else "detector"
        raise InputError(
            f"{source}: recording.{key}: is not streamed; `egolane {key.removesuffix('or')}` writes"
            " the lines to a file that is"
        )
    if recording.format is not None and recording.format.endswith(".py"):
        raise InputError(
            f"{source}: recording.format: a reader of one's own reads a whole recording; `egolane"
            " convert` makes a table of it"
        )
    _refuse_video(experiment)
    path = _find(recording.path, experiment, "recording.path", folders=True)
    logs = iterate_with(path, recording.format, _reader_options(experiment))
    files, truths = [path], None
    if experiment.ground_truth is not None:
        file = _find(experiment.ground_truth.path, experiment, "ground_truth.path")
        files.append(file)
        truths = iterate_ground_truth(file, experiment.ground_truth.extra_rows)
    notes: list[str] = []
    selected = _selected(experiment, _noting(logs, notes), parameters)
    parts = _joined(experiment, _of_size(selected, size, more), truths, parameters, notes)
    return Streamed(parts, tuple(files), notes)


def _noting(logs: Iterator[LineLog], notes: list[str]) -> Iterator[LineLog]:
    """The same, with each warning of the reader noted once."""
    log: LineLog | None
    while True:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            log = next(logs, None)
        said = dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning))
        notes += [note for note in said if note not in notes]
        if log is None:
            return
        yield log


def _selected(
    experiment: Experiment, logs: Iterable[LineLog], parameters: Mapping[str, Any]
) -> Iterator[LineLog]:
    """The frames that the experiment takes, with those put in that are missing."""
    recording = experiment.recording
    first, stop = recording.frames or (None, None)
    max_lri = float(parameters.get("max_lri", 10))
    last: LineLog | None = None
    seen: list[int] = []
    for log in logs:
        seen = [*seen[:1], *log.frame_id[[0, -1]].tolist()]
        if last is not None and stop is not None and seen[-2] >= stop:
            break
        taken = log.take(in_range(log.frame_id, first, stop))
        # A frame's gap may be long: few frames are filled up at once.
        borders = np.flatnonzero(np.diff(taken.frame_id // FILLED)) + 1
        for a, b in pairwise([0, *borders.tolist(), len(taken)]):
            if a == b:
                continue
            part = taken.take(slice(a, b))
            filled = fill_after(last, part, recording.missing_frames, recording.frame_rate)
            last = part.take(slice(-1, None))
            yield clip_lri(filled, max_lri) if recording.lri == "clip" else filled
    if last is None:
        raise no_frame_in_range(log.source, first, stop, np.array(seen))


def _of_size(logs: Iterable[LineLog], size: int, more: int) -> Iterator[LineLog]:
    """The same frames, so many at a time, and up to `more` beside in the last part: wherever a
    reader cuts, what follows is cut at the same frames."""
    waiting: list[LineLog] = []
    for log in logs:
        waiting.append(log)
        while sum(map(len, waiting)) > size + more:
            whole = LineLog.joined(waiting)
            yield whole.take(slice(0, size))
            waiting = [whole.take(slice(size, None))]
    yield LineLog.joined(waiting)


def _joined(
    experiment: Experiment,
    logs: Iterable[LineLog],
    truths: Iterator[LaneTruth] | None,
    parameters: Mapping[str, Any],
    notes: list[str],
) -> Iterator[Recorded]:
    """Each log with the ground truth of its frames; what is noted of all of them comes last."""
    n_lanes, max_lri = experiment.n_lanes, float(parameters.get("max_lri", 10))
    none = np.zeros(0, dtype=np.int64)
    waiting = LaneTruth(none, none, none > 0)
    odd, n_annotated = Oddities(), 0
    log_ids: list[int] = []
    truth_ids: list[int] = []
    for log in logs:
        odd = odd_frames(odd, log, n_lanes, max_lri)
        log_ids = [*log_ids[:1], *log.frame_id[[0, -1]]]
        if truths is None:
            yield Recorded(log, None, none, (), ())
            continue
        while not len(waiting) or waiting.frame_id[-1] < log_ids[-1]:
            truth = next(truths, None)
            if truth is None:
                break
            truth.check_lanes(n_lanes)
            truth_ids = [*truth_ids[:1], *truth.frame_id[[0, -1]]]
            waiting = LaneTruth.joined([waiting, truth])
        both = common_frames(log, waiting)
        yield Recorded(log, waiting.take(both.truth), both.log, (), ())
        n_annotated += len(both)
        waiting = waiting.take(waiting.frame_id > log_ids[-1])
    notes += warnings_of(odd, log.source, n_lanes, max_lri)
    if truths is None:
        return
    for truth in truths:
        truth.check_lanes(n_lanes)
        truth_ids = [*truth_ids[:1], *truth.frame_id[[0, -1]]]
    if not n_annotated:
        ids = np.array(log_ids), np.array(truth_ids)
        raise nothing_in_common(log.source, ids[0], waiting.source, ids[1])
    if n_annotated < odd.frames:
        notes.append(not_annotated(log.source, odd.frames - n_annotated, odd.frames))


def not_annotated(source: str, n_dropped: int, n_frames: int) -> str:
    """What is noted of frames without ground truth."""
    return f"{source}: {n_dropped} of {n_frames} frames have no ground truth; filtered, not scored"


def road_of(experiment: Experiment) -> RoadTable:
    """The road table of an experiment that has one. Raises InputError for a file that cannot
    be used."""
    if experiment.road is None:
        return _simulated_interchange(experiment).road
    return load_road(_road_file(experiment.road, experiment))


def _road_file(name: str, experiment: Experiment) -> Path:
    return _find(name, experiment, "road")


def _simulated_interchange(experiment: Experiment) -> InterchangeDrive:
    from egolane_pgm.simulation.interchange import Journey, simulate_interchange

    recording = experiment.recording
    known = {f.name for f in fields(Journey)}
    for key in recording.options:
        if key not in known:
            raise InputError(
                f"{experiment.source}: recording.options: unknown key '{key}'"
                f"{suggestion(key, known)}"
            )
    return simulate_interchange(recording.seed, None, Journey(**recording.options))


def road_along(
    experiment: Experiment, table: RoadTable, parameters: Mapping[str, Any], log: LineLog
) -> LanesAlong:
    """The lanes of the road in each frame of a log, as the experiment's graph is told them.

    - parameters: the model's. Raises InputError as `lanes_along`.
    """
    return lanes_along(
        table,
        log.time_s,
        steps=str(parameters["steps"]),
        n_lanes=experiment.n_lanes,
        place_sigma_m=float(parameters.get("place_sigma_m", 0.0)),
        source=log.source,
    )


def _read_sources(experiment: Experiment) -> tuple[LineLog, LaneTruth | None, list[Path]]:
    recording = experiment.recording
    files: list[Path] = []
    truth = None
    if recording.simulate == INTERCHANGE:
        trip = _simulated_interchange(experiment)
        log, truth = trip.log, trip.truth
    elif recording.simulate is not None:
        from egolane_pgm.simulation import simulate

        with problems_in(f"{experiment.source}: recording"):
            drive = simulate(recording.simulate, seed=recording.seed, n_lanes=experiment.n_lanes)
        log, truth = drive.log, drive.truth
    else:
        assert recording.path is not None
        if recording.detector is not None:
            log, read = _detected(experiment)
            files += read
        else:
            _refuse_video(experiment)
            path = _find(recording.path, experiment, "recording.path", folders=True)
            files.append(path)
            log = _read_log(path, experiment)
            if recording.camera is not None:
                files.append(_find(recording.camera, experiment, "recording.camera"))
    if experiment.ground_truth is not None:
        path = _find(experiment.ground_truth.path, experiment, "ground_truth.path")
        files.append(path)
        truth = read_ground_truth(path, experiment.ground_truth.extra_rows)
    return log, truth, files


def check_sources(experiment: Experiment) -> None:
    """Raise InputError, naming the YAML file and key, for a recording or ground truth that is not
    there, or a format or simulation that does not exist. No file is read."""
    with all_problems() as part:
        with part():
            _check_format(experiment)
        with part():
            _check_recording(experiment)
        if experiment.ground_truth is not None:
            with part():
                _find(experiment.ground_truth.path, experiment, "ground_truth.path")
        if experiment.road is not None:
            with part():
                _road_file(experiment.road, experiment)


def _check_format(experiment: Experiment) -> None:
    format_, where = experiment.recording.format, f"{experiment.source}: recording.format"
    if format_ is not None and format_.endswith(".py"):
        load_plugin("recordings", format_, experiment.folder, where)
    elif format_ is not None and format_ not in FORMATS:
        raise InputError(f"{where}: unknown format '{format_}'{suggestion(format_, FORMATS)}")


def _check_recording(experiment: Experiment) -> None:
    from egolane_pgm.simulation import PRESETS

    recording, source = experiment.recording, experiment.source
    presets = (*PRESETS, INTERCHANGE)
    if recording.simulate is not None and recording.simulate not in presets:
        raise InputError(
            f"{source}: recording.simulate: unknown preset '{recording.simulate}'"
            f"{suggestion(recording.simulate, presets)}"
        )
    if recording.detector is not None:
        _check_detector(experiment)
    elif recording.path is not None:
        _refuse_video(experiment)
        path = _find(recording.path, experiment, "recording.path", folders=True)
        if recording.camera is not None:
            _find(recording.camera, experiment, "recording.camera")
        elif (recording.format or format_of(path)) in IN_PIXELS:
            raise InputError(
                f"{source}: recording.camera: is missing; the lines of {path.name} are in pixels"
            )


def _find(path: str, experiment: Experiment, key: str, *, folders: bool = False) -> Path:
    try:
        is_fetched = key != "recording.camera" and experiment.recording.detector is None
        return find_file(path, experiment.folder, folders=folders, is_fetched=is_fetched)
    except InputError as error:
        raise InputError(f"{experiment.source}: {key}: {error}") from error


def _reader_options(experiment: Experiment) -> dict[str, Any]:
    recording = experiment.recording
    options: dict[str, Any] = {**recording.options, "frame_rate": recording.frame_rate}
    if recording.camera is not None:
        options["camera"] = _find(recording.camera, experiment, "recording.camera")
    if recording.topic is not None:
        options["topic"] = recording.topic
    if recording.frame_id != "way_id":
        options["frame_id"] = recording.frame_id
    if recording.columns:
        options["columns"] = recording.columns
    return options


def _read_log(path: Path, experiment: Experiment) -> LineLog:
    recording = experiment.recording
    options = _reader_options(experiment)
    if recording.format is not None and recording.format.endswith(".py"):
        where = f"{experiment.source}: recording.format"
        reader = load_plugin("recordings", recording.format, experiment.folder, where)
        with plugin_errors(reader, where):
            log: LineLog = reader.read(path, **options)
        return log
    return read_with(path, recording.format, options)


# --- pictures ------------------------------------------------------------------------------------


def with_video_rate(experiment: Experiment) -> Experiment:
    """The experiment with the frame rate of its video, where the YAML says none."""
    recording = experiment.recording
    if recording.detector is None or "frame_rate" in recording.model_fields_set:
        return experiment
    rate = pictures_of(experiment, "path").frame_rate
    if rate is None:
        return experiment
    content = experiment.model_dump()
    content["recording"]["frame_rate"] = rate
    return make_experiment(content, experiment.folder, experiment.source)


def file_entry(path: Path, *, pictures: bool = True) -> dict[str, Any]:
    """Path, sha256 and bytes of a file.

    Of a folder or a glob it is the sha256 of the list of the files' checksums and names, with the
    number of `files`. pictures: whether a folder is one of pictures; else it is a recording of
    lines.
    """
    if path.is_file():
        return {"path": str(path), "sha256": file_sha256(path), "bytes": path.stat().st_size}
    if pictures:
        from egolane_pgm.camera.pictures import open_source

        files = open_source(path).files
    else:
        files = tuple(files_of(path))
    lines = "".join(f"{file_sha256(file)}  {file.name}\n" for file in files)
    return {
        "path": str(path),
        "sha256": hashlib.sha256(lines.encode()).hexdigest(),
        "bytes": sum(file.stat().st_size for file in files),
        "files": len(files),
    }


def data_entries(experiment: Experiment, files: Iterable[Path]) -> list[dict[str, Any]]:
    """The `file_entry` of each file that was read."""
    has_pictures = experiment.recording.detector is not None
    return [file_entry(path, pictures=has_pictures) for path in files]


def named_files(experiment: Experiment) -> list[Path]:
    """The YAML of an experiment, and the files that it names in full or that lie beside it."""
    recording, truth = experiment.recording, experiment.ground_truth
    of_truth = truth.path if truth else None
    names = (recording.path, recording.right, recording.camera, of_truth, experiment.road)
    return [Path(experiment.source), *(experiment.folder / name for name in names if name)]


def files_in_full(section: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """A `recording` or `ground_truth` section whose files are named by their whole path.

    - section: its keys and values.
    - folder: the folder of the YAML. The names of files that do not lie there stay as they are.
    """
    return {name: _in_full(name, value, folder) for name, value in section.items()}


def _in_full(key: str, value: Any, folder: Path) -> Any:
    if key == "detector_parameters":
        return {k: _in_full("detector", v, folder) for k, v in value.items()}
    if not isinstance(value, str):
        return value
    is_plugin = key in ("format", "detector") and value.endswith(OWN_FILES)
    is_path = key in ("path", "camera", "right")
    is_there = any(c in value for c in "*?[") or (folder / value).exists()
    return str((folder / value).absolute()) if is_plugin or (is_path and is_there) else value


def drive_key(experiment: Experiment) -> str:
    """The same for recordings of one drive: a checksum of the frame ids and labels of its ground
    truth, or the simulation; of one without ground truth the file.

    The name of the file does not count: whoever knows the labels of a file knows those of its copy.
    Raises InputError where the ground truth cannot be read.
    """
    if experiment.ground_truth is None:
        recording = experiment.recording
        if recording.path is not None:
            return str(files_in_full({"path": recording.path}, experiment.folder)["path"])
        return repr((recording.simulate, recording.seed, experiment.n_lanes))
    try:
        path = find_file(experiment.ground_truth.path, experiment.folder)
        state = path.stat()
        return _labels_key(path, state.st_mtime_ns, state.st_size)
    except InputError as error:
        raise InputError(f"{experiment.source}: ground_truth.path: {error}") from error


@functools.lru_cache(maxsize=256)
def _labels_key(path: Path, changed_ns: int, size: int) -> str:
    """A checksum of the labels in a file. changed_ns, size: keep the checksum of an older version
    of the file from being used."""
    truth = read_ground_truth(path)
    content = hashlib.sha256()
    for values in (truth.frame_id, truth.lane, truth.is_crossing):
        content.update(np.ascontiguousarray(values).tobytes())
    return content.hexdigest()


def _detected(experiment: Experiment) -> tuple[LineLog, list[Path]]:
    """The lines that the experiment's detector sees in its pictures, and the files it looked at."""
    from egolane_pgm.camera.pictures import camera_of_pictures, read_pictures

    recording = experiment.recording
    detector, camera, left, right = _check_detector(experiment)
    camera = camera_of_pictures(camera, left)
    pictures = bar(
        read_pictures(left, camera, right, recording.frames),
        desc=detector.name,
        unit="frame",
        total=left.n_frames if recording.frames is None else None,
    )
    is_told = "frame_rate" in recording.model_fields_set
    rate = recording.frame_rate if is_told else left.frame_rate
    found = detect(detector, camera, pictures, rate)
    done = collect(found, recording.frame_rate, left.path)
    if isinstance(done.stopped, InputError) and done.log is not None:
        raise InputError(f"{done.stopped}; `egolane detect` writes the lines of the frames before")
    if done.stopped is not None:
        raise done.stopped
    if left.frame_rate is not None and left.frame_rate != recording.frame_rate:
        warnings.warn(
            f"{left.path}: the video has {left.frame_rate:g} frames per second,"
            f" recording.frame_rate is {recording.frame_rate:g}; times and delays are counted with"
            " the latter",
            UserWarning,
            stacklevel=2,
        )
    assert done.log is not None
    files = [Path(left.path), *([Path(right.path)] if right else [])]
    assert recording.camera is not None
    files.append(_find(recording.camera, experiment, "recording.camera"))
    if detector.name.endswith(".py"):
        files.append((experiment.folder / detector.name).resolve())
    return done.log, files + own_files(detector)


def _check_detector(experiment: Experiment) -> tuple[Detector, Camera, Source, Source | None]:
    """The detector, its camera and its pictures (left, and right or None). Raises InputError,
    naming the YAML key, for what is not there or does not fit together."""
    recording, source = experiment.recording, experiment.source
    assert recording.detector is not None
    if recording.path is None or recording.format is not None:
        wrong = "simulate" if recording.path is None else "format"
        raise InputError(
            f"{source}: recording.{wrong}: does not go with a detector, which looks at a video or"
            " pictures (recording.path)"
        )
    detector = find_detector(
        recording.detector,
        recording.detector_parameters,
        experiment.folder,
        f"{source}: recording.detector",
    )
    if recording.camera is None:
        raise InputError(
            f"{source}: recording.camera: is missing; the detector needs the camera's YAML file"
            " (`egolane calibrate` makes one)"
        )
    camera = read_camera(_find(recording.camera, experiment, "recording.camera"))
    check_pair(detector, camera, recording.right is not None, f"{source}: recording.right")
    left = pictures_of(experiment, "path")
    right = pictures_of(experiment, "right") if recording.right is not None else None
    # Only to refuse early a camera that does not see the road.
    start(detector, camera)
    return detector, camera, left, right


def pictures_of(experiment: Experiment, key: str) -> Source:
    """The pictures at recording.path, or those of the second camera (key: "right"). Raises
    InputError, naming the key, where there are none."""
    from egolane_pgm.camera.pictures import is_pattern, open_source

    path = getattr(experiment.recording, key)
    if not is_pattern(path):
        return open_source(_find(path, experiment, f"recording.{key}", folders=True))
    try:
        return open_source(str(experiment.folder / in_home(path)))
    except InputError as error:
        raise InputError(f"{experiment.source}: recording.{key}: {error}") from error


def _refuse_video(experiment: Experiment) -> None:
    """Raise InputError for a video without a detector, which is clearer than an unknown format."""
    path, format_ = experiment.recording.path, experiment.recording.format
    if format_ is None and path is not None and Path(path).suffix.lower() in VIDEOS:
        raise InputError(
            f"{experiment.source}: recording.path: {path} is a video: say which detector looks at"
            " it (recording.detector, e.g. ml) and with which camera (recording.camera)"
        )


def with_recording(
    experiment: Experiment,
    recording: str | None,
    ground_truth: str | None,
    n_lanes: int | None,
    frame_id: str | None = None,
    camera: str | None = None,
    detector: str | None = None,
    overrides: Overrides = (),
) -> Experiment:
    """The experiment on another recording.

    - What belongs to the old recording (frame range, seed, ground truth and its extra rows) does
      not carry over. What was tuned on the old one is `other_frames` on a new one, and stays
      `same_frames` where the file is the old one.
    - `format`, `topic`, `frame_id`, `options`, `columns` and `camera` carry over where the
      extension of the file is the same; all but the camera from a simulated drive too, which has no
      use for them.
    - `detector`, its parameters and its camera carry over to a video and to pictures (a folder, a
      glob, one file), and to nothing else.

    recording, ground_truth, n_lanes, frame_id, camera, detector: what replaces the experiment's,
        None for what stays. ground_truth may be "none"; camera and detector are for a video or
        pictures.
    overrides: keys that were overridden in the experiment: they are meant for the new recording, so
        that of these even the frame range is kept.

    Raises InputError for a folder of recordings, for one that has both pictures and lines where
    nothing says which are meant, and for overrides that name a recording as well.
    """
    content = experiment.model_dump()
    if "frame_rate" not in experiment.recording.model_fields_set:
        # A video may tell its own.
        del content["recording"]["frame_rate"]
    if experiment.recording.simulate is not None and recording is None and ground_truth == "none":
        raise InputError(
            f"{experiment.source}: --ground-truth none: a simulated drive brings its own;"
            " write it to files with `egolane simulate` and run on those"
        )
    if recording is not None:
        kept = {"frame_rate", "missing_frames", "lri"}
        old = experiment.recording
        if old.detector is not None and _is_of_pictures(recording, old.path, detector):
            kept |= {"camera", "detector", "detector_parameters"}
        elif old.path is None:
            # A simulated drive has no reader: these are meant for the recording that is named.
            kept |= {"format", "topic", "frame_id", "options", "columns"}
        elif old.detector is None and Path(recording).suffix == Path(old.path).suffix:
            kept |= {"format", "topic", "frame_id", "options", "columns", "camera"}
        content["recording"] = {k: v for k, v in content["recording"].items() if k in kept}
        content["recording"]["path"] = str(Path(recording).absolute())
        content["ground_truth"] = None
        content["road"] = content["gnss"] = None
        content["tuning"] = None
        content["name"] = name_of(recording)
        if experiment.tuned_on == "same_frames" and not _is_own(recording, experiment):
            content["tuned_on"] = "other_frames"
        path = content["recording"]["path"]
        content = overridden(content, overrides)
        if content["recording"].get("path") != path or content["recording"].get("simulate"):
            raise InputError(
                f"{experiment.source}: recording: --set and --recording, or a row of a fleet, name"
                " two of them; leave one away"
            )
    if frame_id is not None:
        content["recording"]["frame_id"] = frame_id
    if camera is not None:
        content["recording"]["camera"] = str(Path(camera).absolute())
    if detector is not None:
        is_own = detector.endswith(".py")
        if detector != content["recording"].get("detector"):
            content["recording"].pop("detector_parameters", None)
        content["recording"]["detector"] = str(Path(detector).absolute()) if is_own else detector
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


def _is_of_pictures(recording: str, old: str | None, detector: str | None) -> bool:
    """Whether a recording is a video or pictures. detector: the one that was asked for together
    with the recording, which means that pictures are meant."""
    from egolane_pgm.camera.pictures import PICTURES, is_pattern

    path = in_home(recording)
    if path.is_dir():
        return _is_folder_of_pictures(path, detector)
    ending = path.suffix.lower()
    lines = {ending for extensions, _, _ in FORMATS.values() for ending in extensions}
    if is_pattern(recording) or ending in (*PICTURES, *VIDEOS):
        return True
    return ending not in lines and ending == Path(old or "").suffix.lower()


def _is_folder_of_pictures(folder: Path, detector: str | None) -> bool:
    from egolane_pgm.camera.pictures import PICTURES

    try:
        endings = {path.suffix.lower() for path in folder.iterdir() if path.is_file()}
    except OSError as error:
        raise InputError(f"--recording {folder}: cannot be read: {error.strerror}") from None
    has_pictures = not endings.isdisjoint(PICTURES)
    try:
        format_of(folder)
        has_lines = True
    except InputError:
        has_lines = False
    if has_pictures and has_lines and detector is None:
        raise InputError(
            f"--recording {folder}: has pictures and lines ({files_of(folder)[0].name}, ...); say"
            " which: --detector NAME looks at the pictures, --set recording.detector=null reads"
            " the lines"
        )
    drives = (*VIDEOS, ".bag", ".csv", ".parquet", ".jsonl")
    if not has_pictures and not has_lines and not endings.isdisjoint(drives):
        raise InputError(
            f"--recording {folder}: is a folder of recordings; name one of them, or several, each"
            " with a --recording of its own"
        )
    return has_pictures or not has_lines or detector is not None


def name_of(file: str | Path) -> str:
    """The name of an experiment on a recording in a file."""
    return as_name(Path(without_passwords(file)).stem)


def as_name(text: str) -> str:
    """A text as the name of an experiment."""
    stem = without_passwords(text)
    kept = (c if (c.isascii() and c.isalnum()) or c in "._-" else "_" for c in stem)
    name = "".join(kept).lstrip("._-")
    return name or "recording"
