"""Where lines come from: what every source can do, and the simplest one, a file of lines.

The other sources stand beside their own kind: `detectors.pictures` (a detector looks at pictures)
and `simulation.drives` (simulated drives, one of them over a map). `drive.source_of` finds the one
of an experiment.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from egolane_pgm.experiment import Experiment
from egolane_pgm.plugins import OWN_FILES, load_plugin, plugin_errors, plugin_names
from egolane_pgm.recordings import FORMATS, IN_PIXELS, files_of, format_of, read_with
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.types import InputError, LaneTruth, LineLog, suggestion

#: Extensions by which a video is known where no detector is named.
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".m4v", ".webm", ".wmv", ".ts")

#: The `recording.path` of lines that are no file, see `recordings.memory`.
IN_MEMORY = "in memory"

#: The keys of a recording that say how lines are read.
READING = frozenset({"format", "topic", "options", "columns"})


@dataclass(frozen=True)
class Read:
    """What a source read.

    - log: T frames, of one drive or of several clips.
    - truth: the lanes, where the source knows them itself.
    - files: what was read (a folder or a glob stands for all files in it).
    - rate: frames per second, where the recording itself says them.
    - notes: warnings, a line each.
    """

    log: LineLog
    truth: LaneTruth | None = None
    files: tuple[Path, ...] = ()
    rate: float | None = None
    notes: tuple[str, ...] = ()


class Source(Protocol):
    """A recording, as an experiment names it. All but `check` raise InputError, naming the YAML
    file and key, for what cannot be used."""

    def check(self) -> None:
        """Raise InputError for all that is wrong with the names in the YAML. No line is read."""

    def read(self) -> Read:
        """The lines."""

    def key(self) -> str:
        """The same for two experiments on the same recording."""

    def files_in(self, place: Path) -> Sequence[Path]:
        """The files that a folder or a glob among `Read.files` stands for."""
        return []

    def frame_rate(self) -> float | None:
        """Frames per second, where the recording itself says them."""
        return None

    def kept_for(self, recording: str, detector: str | None) -> frozenset[str]:
        """The keys of `recording` that also hold for another recording.

        - detector: the one that was asked for together with it.
        """
        # What a simulation does not read is meant for the other recording.
        return READING


def find_named(experiment: Experiment, key: str, *, folders: bool = False) -> Path:
    """The file or folder that a key of an experiment names, such as `recording.path`. Raises
    InputError, naming the key, where it is not there.

    - folders: whether it may be a folder.
    """
    name: Any = experiment
    for part in key.split("."):
        name = getattr(name, part)
    is_fetched = key != "recording.camera" and experiment.recording.detector is None
    try:
        return find_file(name, experiment.folder, folders=folders, is_fetched=is_fetched)
    except InputError as error:
        raise InputError(f"{experiment.source}: {key}: {error}") from error


@dataclass(frozen=True)
class LinesFile(Source):
    """Lines in a file or a folder, in a format of this or another package or of a user's own."""

    experiment: Experiment

    def check(self) -> None:
        experiment, recording = self.experiment, self.experiment.recording
        self._check_format()
        path = self._path()
        if recording.camera is not None:
            find_named(experiment, "recording.camera")
        elif self._format(path) in IN_PIXELS:
            raise InputError(
                f"{experiment.source}: recording.camera: is missing; the lines of"
                f" {path.name} are in pixels"
            )

    def _check_format(self) -> None:
        format_, where = self.experiment.recording.format, self._where("format")
        if self._is_own_format():
            load_plugin("recordings", str(format_), self.experiment.folder, where)
        elif format_ is not None and format_ not in FORMATS:
            known = [*FORMATS, *plugin_names("recordings")]
            raise InputError(f"{where}: unknown format '{format_}'{suggestion(format_, known)}")

    def _format(self, path: Path) -> str:
        recording = self.experiment.recording
        return recording.format or format_of(path)

    def _is_own_format(self) -> bool:
        name = self.experiment.recording.format or "table"
        return name not in FORMATS and (name.endswith(".py") or name in plugin_names("recordings"))

    def _where(self, key: str) -> str:
        return f"{self.experiment.source}: recording.{key}"

    def _path(self) -> Path:
        recording = self.experiment.recording
        # Clearer than that the format of a video is not known.
        if recording.format is None and Path(str(recording.path)).suffix.lower() in VIDEOS:
            raise InputError(
                f"{self._where('path')}: {recording.path} is a video: say which detector looks at"
                " it (recording.detector, e.g. ml) and with which camera (recording.camera)"
            )
        return find_named(self.experiment, "recording.path", folders=True)

    def read(self) -> Read:
        path, recording = self._path(), self.experiment.recording
        options: dict[str, Any] = {**recording.options, "frame_rate": recording.frame_rate}
        files = [path]
        if recording.topic is not None:
            options["topic"] = recording.topic
        if recording.camera is not None:
            options["camera"] = find_named(self.experiment, "recording.camera")
            files.append(options["camera"])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            if self._is_own_format():
                log, is_timed = self._read_own(path, options)
            else:
                said = {} if recording.columns is None else {"columns": recording.columns}
                log = read_with(path, recording.format, {**options, **said})
                # The stamps of a bag that nobody described are no rate.
                is_timed = bool(said) or self._format(path) == "table"
        rate = rate_of(log.frame_id, log.time_s) if is_timed else None
        notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
        return Read(log, None, tuple(files), rate, tuple(notes))

    def _read_own(self, path: Path, options: dict[str, Any]) -> tuple[LineLog, bool]:
        """The lines that a user's own reader gives, and whether they are a table with times."""
        recording, where = self.experiment.recording, self._where("format")
        reader = load_plugin("recordings", str(recording.format), self.experiment.folder, where)
        with plugin_errors(reader, where):
            found = reader.read(path, **options)
        if isinstance(found, LineLog):
            return found, False
        if not hasattr(found, "reset_index"):
            raise InputError(
                f"{where}: read gives {found!r:.60}; a LineLog or a DataFrame is needed"
            )
        from egolane_pgm.recordings.table import lines_of_frame

        return lines_of_frame(found, path, recording.frame_rate, recording.columns), True

    def key(self) -> str:
        return whole_path(self.experiment)

    def files_in(self, place: Path) -> Sequence[Path]:
        return files_of(place)

    def frame_rate(self) -> float | None:
        return self.read().rate

    def kept_for(self, recording: str, detector: str | None) -> frozenset[str]:
        # All that says how to read, where the extension is the same.
        own = str(self.experiment.recording.path)
        is_alike = Path(recording).suffix == Path(own).suffix
        return READING | {"camera"} if is_alike else frozenset()


def whole_path(experiment: Experiment) -> str:
    """The path of an experiment's recording from the root on, where it lies beside the YAML."""
    recording = experiment.recording
    return str(files_in_full({"path": recording.path}, experiment.folder)["path"])


def files_in_full(section: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A `recording` or `ground_truth` section whose files are named by their whole path.

    - section: its keys and values.
    - folder: the folder of the YAML. The names of files that do not lie there stay as they are.
    """
    return {name: _in_full(name, value, folder) for name, value in section.items()}


#: Parameters of detectors that name a network: one that comes along has no ending, but a folder.
_NETWORKS = ("network", "on_road")


def _in_full(key: str, value: Any, folder: Path) -> Any:
    if key == "detector_parameters":
        return {
            k: _in_full(k if k in _NETWORKS else "detector", v, folder) for k, v in value.items()
        }
    if not isinstance(value, str):
        return value
    is_plugin = key in ("format", "detector") and value.endswith(OWN_FILES)
    is_plugin |= key in _NETWORKS and value != "none"
    is_path = key in ("path", "camera", "right")
    is_there = any(c in value for c in "*?[") or (folder / value).exists()
    return str((folder / value).absolute()) if is_plugin or (is_path and is_there) else value
