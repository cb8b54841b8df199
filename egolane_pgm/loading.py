"""Load experiments: a YAML file and changes to it become one checked `Experiment`.

Every path is made absolute here, once: a path in a YAML file is relative to that file, a path in a
table of runs to the table, and any other path to the current folder. A path that does not exist
there is searched for in `$EGOLANE_DATA` and in the download folder.

Two keys of a YAML file are no keys of the experiment: `include: other.yaml` adds the keys of
another file, and `version: 1`, which is optional, is the version of the keys.
"""

from __future__ import annotations

import operator
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from egolane_pgm.experiment import DETECTOR, Experiment, make_experiment, plain
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.recordings import is_pictures
from egolane_pgm.tools.files import read_yaml, without_version
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import InputError, near_word

#: The value of `recording.path` for lines that are passed as a DataFrame or a LineLog.
IN_MEMORY = "in memory"

#: Keys whose values are files.
FILES = {"recording.path", "recording.camera", "recording.right", "ground_truth.path", "road"}

#: Keys whose values are plugins: names, or files with an extension of one.
PLUGINS = {"graph", "evidence", "recording.format", "recording.detector"}

#: Keys of a recording, which other lines do not inherit.
RECORDING_KEYS = ("recording", "ground_truth", "road", "description")

ExperimentLike = Experiment | str | os.PathLike[str] | Mapping[str, Any]
Overrides = Mapping[str, Any] | Sequence[str] | None


def experiments_folder() -> Path:
    """The folder of the shipped experiments.

    >>> import egolane_pgm as ego
    >>> sorted(path.name for path in (ego.experiments_folder() / "paper").glob("run0[12]*"))
    ['run01_italy_ml.yaml', 'run02_italy_sl.yaml']
    """
    installed = Path(__file__).parent / "_experiments"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "experiments"


def experiment_path(given: str | os.PathLike[str]) -> Path:
    """The YAML file of an experiment; a shipped one is found by its name from any folder.

    Raises InputError, with a suggestion, for an unknown name.
    """
    path = Path(given)
    if not path.suffix and not path.exists():
        named = {each.stem: each for each in experiments_folder().rglob("*.yaml")}
        if str(given) in named:
            return named[str(given)]
        meant = near_word(str(given), named)
        raise InputError(f"{given}: no such file, nor experiment (see `egolane show`){meant}")
    if path.parts[:1] == ("experiments",) and not path.exists():
        shipped = experiments_folder().joinpath(*path.parts[1:])
        return shipped if shipped.is_file() else path
    return path


def load_experiment(
    experiment: ExperimentLike,
    overrides: Overrides = None,
    *,
    lines: Any = None,
    n_lanes: int | None = None,
) -> Experiment:
    """Load an experiment; apply all changes, then check the result once.

    - experiment: a YAML file, the name of a shipped experiment, keys and values, or an experiment.
    - overrides: `{"parameters.sigma1": 0.3}`, nested or dotted, or a list of `key=value`. None
      removes a key, `{}` empties a section.
    - lines: another recording, a file or data in memory. Only the model is taken from the
      experiment (evidence, graph, filter, parameters), keys of the recording from `overrides`.
    - n_lanes: number of lanes of the road.

    Raises InputError, naming file and key, for a key or value that does not fit.

    >>> import egolane_pgm as ego
    >>> ego.load_experiment("quickstart", {"parameters.sigma1": 0.3}).parameters["sigma1"]
    0.3
    >>> ego.load_experiment("quickstart", {"filtr": "exact"})
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: ...quickstart.yaml: unknown key 'filtr' (did you mean 'filter'?)
    """
    changes = parse_overrides(overrides)
    if n_lanes is not None:
        changes = merge(changes, {"n_lanes": n_lanes})
    if isinstance(experiment, Experiment) and not changes and lines is None:
        return experiment
    content, source = _read(experiment)
    if lines is not None:
        content = _on_lines(content, lines, changes)
        # The model is usually a shipped one, whose file the user has not seen.
        source = f"{content['recording']['path']} (model {Path(source).stem})"
    content = merge(content, absolute(changes, Path.cwd()))
    return make_experiment(with_camera(content), source)


def _read(experiment: ExperimentLike) -> tuple[dict[str, Any], str]:
    """The keys of an experiment, with absolute paths, and its source for messages."""
    if isinstance(experiment, Experiment):
        return experiment.keys, experiment.source
    if isinstance(experiment, Mapping):
        content = without_version(nest(experiment), "experiment")
        return absolute(content, Path.cwd()), "experiment"
    if not isinstance(experiment, (str, os.PathLike)):
        raise InputError(
            f"{experiment!r:.60} is no experiment; give the path of a YAML file, keys and values,"
            " lines, a result or a study; a graph goes with `graph`"
        )
    path = experiment_path(experiment)
    return absolute(load_yaml(path), path.parent), str(path)


def _on_lines(content: Mapping[str, Any], lines: Any, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The model keys of an experiment, on another recording."""
    path, name, recording = IN_MEMORY, "in_memory", content.get("recording") or {}
    if isinstance(lines, (str, os.PathLike)):
        path = find(os.fspath(lines), Path.cwd())
        name = safe_name(Path(path).stem)
    if "n_lanes" not in changes and (recording.get("simulate") or content.get("road")):
        raise InputError(f"n_lanes: is missing: give the number of lanes of the road of {path}")
    kept = {key: value for key, value in content.items() if key not in RECORDING_KEYS}
    if isinstance(kept.get("tuned_on"), str) and path != recording.get("path"):
        kept["tuned_on"] = on_other_lines(kept["tuned_on"])
    if DETECTOR in (kept.get("parameters") or {}):
        kept["parameters"] = {k: v for k, v in kept["parameters"].items() if k != DETECTOR}
    return {**kept, "name": name, "recording": {"path": path}}


def with_camera(content: dict[str, Any]) -> dict[str, Any]:
    """The keys of an experiment; a video or pictures without detector get the detector ml, and
    without camera the file `camera_beside` them, which the first run calibrates."""
    given: Any = content.get("recording")
    if not isinstance(given, Mapping) or "format" in given:
        return content
    path = given.get("path")
    if not isinstance(path, str) or not is_pictures(path):
        return content
    recording = {"detector": "ml", "camera": camera_beside(path), **given}
    return {**content, "recording": recording}


def camera_beside(path: str) -> str:
    """The YAML of the camera that took a video or the pictures in a folder, by their path."""
    place = Path(path)
    return f"{place if place.exists() else place.parent}.camera.yaml"


def on_other_lines(tuned_on: Any) -> Any:
    """What `tuned_on` of an experiment is on other lines, which may be a copy of its own."""
    return tuned_on if tuned_on == "not_tuned" else "unknown"


def safe_name(text: str) -> str:
    """Replace characters that are not allowed in the name of an experiment."""
    return re.sub(r"[^a-zA-Z0-9._-]", "_", text).lstrip("._-") or "recording"


# --- YAML files ----------------------------------------------------------------------------------


def load_yaml(path: Path, included_by: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The keys of a YAML file and of the file that it includes.

    The file's own keys replace included ones; sections are merged, `{}` empties one. Paths in the
    included file are relative to the including one.

    - included_by: the files that include this one, directly or not.
    """
    content = read_yaml(path, "n_lanes: 4")
    if (name := content.pop("include", None)) is None:
        return content
    file = path.parent / str(name)
    above = (*included_by, path)
    if not file.is_file() or any(map(file.samefile, above)):
        raise InputError(f"{path}: include: {name!r} is not the name of another file")
    return merge(load_yaml(file, above), content)


# --- paths ---------------------------------------------------------------------------------------


def find(name: str, folder: Path) -> str:
    """The absolute path of a file; if it does not exist, the path below `folder`."""
    path = Path(name).expanduser()
    place = folder / path
    if not path.is_absolute() and not place.exists():
        # platformdirs is imported for missing files only.
        from egolane_pgm.recordings.catalog import data_folders

        place = next((data / path for data in data_folders() if (data / path).exists()), place)
    return str(place.absolute())


def absolute(content: Mapping[str, Any], folder: Path, prefix: str = "") -> dict[str, Any]:
    """The keys and values, with absolute paths of all files."""
    found = dict(content)
    for key, value in content.items():
        name = f"{prefix}{key}"
        is_plugin = name in PLUGINS or name.startswith("parameters.detector.")
        is_file = is_plugin and str(value).endswith((*OWN_FILES, ".onnx"))
        if isinstance(value, Mapping):
            found[key] = absolute(value, folder, f"{name}.")
        elif isinstance(value, (str, os.PathLike)) and value != IN_MEMORY:
            found[key] = find(os.fspath(value), folder) if is_file or name in FILES else value
    return found


def existing(experiment: Experiment, key: str) -> Path:
    """The file or folder of a key such as `recording.path`. Raises InputError if it is missing."""
    path = Path(str(operator.attrgetter(key)(experiment)))
    if not path.exists():
        raise InputError(
            f"{experiment.source}: {key}: {path}: no such file; run `egolane data fetch` for the"
            " paper's recordings, or set EGOLANE_DATA to the folder that has it"
        )
    return path


# --- overrides -----------------------------------------------------------------------------------


def parse_overrides(overrides: Overrides, name: str = "overrides") -> dict[str, Any]:
    """Overrides as nested keys and values. Raises InputError, naming the argument.

    - overrides: a dict, or a list of `key=value`, whose values are YAML.
    """
    if isinstance(overrides, str) or not isinstance(overrides, (Iterable, type(None))):
        raise InputError(f"{name}: {overrides!r}: needs a dict, or a list of key=value")
    if not overrides:
        return {}
    if isinstance(overrides, Mapping):
        return nest(overrides)
    found = {}
    for override in overrides:
        key, equals, text = str(override).partition("=")
        if not equals or not all(key.strip().split(".")):
            raise InputError(f"{name}: {override}: write it as key=value, e.g. n_lanes=3")
        found[key.strip()] = parse_yaml(text, f"{name}: {override}")
    return nest(found)


def nest(flat: Mapping[str, Any]) -> dict[str, Any]:
    """`{"a.b": 1}` as `{"a": {"b": 1}}`; numbers of NumPy and paths become plain values."""
    nested: dict[str, Any] = {}
    for key, value in flat.items():
        if not isinstance(key, str) or not all(key.split(".")):
            raise InputError(f"{key!r} is not the name of a key, e.g. parameters.sigma1")
        section = nest(value) if isinstance(value, Mapping) else plain(value)
        for part in reversed(key.split(".")):
            section = {part: section}
        nested = merge(nested, section)
    return nested


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of both, section by section; None removes a key, `{}` empties a section."""
    merged = dict(base)
    for key, value in over.items():
        if value is None and key in base:
            del merged[key]
        elif value and isinstance(value, Mapping) and isinstance(base.get(key), Mapping):
            merged[key] = merge(base[key], value)
        else:
            merged[key] = value
    return merged
