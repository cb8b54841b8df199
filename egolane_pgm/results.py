"""The layout of a result directory: complete, so that a report can be made from it alone.

- experiment.yaml: the resolved experiment, every default spelled out; `egolane run` takes it.
- run.json: where the numbers come from (`result_schema.Run`).
- scores.json: the scores (`result_schema.RunScores`).
- beliefs.parquet: one row per frame (`result_schema.COLUMNS`).
- lines.parquet: the lines that were believed, a row each, a recording as `recordings.table` reads
  them; selected, and with missing frames put in as the experiment says.
- events.csv: one row per lane change that the beliefs tell of (`LaneEvents`), and `late_s`, from
  time_s to told_time_s.
- clips.csv: of a recording of several clips one row for each: clip, first_frame_id, frames,
  assigned_lane and probability (of the most probable lane) in its last frame, changes (how many are
  told in it), log_evidence (mean).
- figures/: the belief over time, strips.png, and what `plot` drew besides.

`egolane compare --out` writes the same for what was believed held out: beliefs.parquet has the
annotated frames, and the `block` of each; run.json has `fit`, `blocks` and `parameters_per_block`
besides; scores.json has the experiment's part of the comparison under `held_out`.

A directory is written beside its place and renamed at the end: one that has the name is whole. A
new result takes the place of an old one file by file: what else lies there stays (see `OURS`).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from fnmatch import fnmatch
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.experiment import Experiment, config_hash
from egolane_pgm.inference.events import (
    crossing_probability,
    in_tracks,
    lane_events,
    numbered,
    tracks_of,
)
from egolane_pgm.result_schema import SCHEMA_VERSION as SCHEMA_VERSION
from egolane_pgm.result_schema import (
    belief_columns,
    read_beliefs,
    read_run,
    read_scores,
    tentative_columns,
    validated_in_one_line,
)
from egolane_pgm.scoring.events import event_delays
from egolane_pgm.tools.files import (
    arrow_table,
    as_csv,
    atomic_directory,
    check_place,
    code_checksum,
    read_yaml,
    rows_of_parquet,
    write_bytes,
    write_json,
    write_parquet,
    write_text,
    write_yaml,
)
from egolane_pgm.types import (
    UNASSIGNED,
    Beliefs,
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    LaneEvents,
    LaneTruth,
    LineLog,
    pieces_of,
)

#: The files of the beliefs and of the lines.
BELIEFS, LINES = "beliefs.parquet", "lines.parquet"


@dataclass(frozen=True)
class Result:
    """The contents of a result directory.

    experiment, run, scores: the contents of the files of these names.
    frame_id, time_s (T,): seconds.
    marginals: per hidden node (T, k).
    values: per hidden node the names of its k values.
    tentative (T, n): the detector's own answer, or None.
    assigned_lane, detector_lane (T,): 1..n, 0 is Unassigned.
    true_lane (T,): 1..n, 0 where not annotated.
    is_crossing (T,): whether the car is changing lanes.
    log_evidence (T,): natural logarithm.
    is_impossible (T,): marks frames whose evidence the model does not allow.
    block (T,): where a comparison believed each block with what was found without it, the frame's
        block; else None.
    clip (T,): of a recording of several clips the name of each frame's, as in `LineLog`.
    road_lanes, origin (T,): lanes of the road as the map says, and where their numbers begin, see
        `maps.steps.LanesAlong`; None for a road on which lanes do not change.
    lines: of the T frames; None in a directory that was written before lines were kept.
    """

    directory: Path
    experiment: Mapping[str, Any]
    run: Mapping[str, Any]
    scores: Mapping[str, Any]
    frame_id: IntArray
    time_s: FloatArray
    marginals: Mapping[str, FloatArray]
    values: Mapping[str, tuple[str, ...]]
    tentative: FloatArray | None
    assigned_lane: IntArray
    detector_lane: IntArray | None
    true_lane: IntArray
    is_crossing: BoolArray
    log_evidence: FloatArray
    is_impossible: BoolArray
    block: IntArray | None = None
    clip: NDArray[np.str_] | None = None
    road_lanes: IntArray | None = None
    origin: IntArray | None = None
    lines: LineLog | None = None

    @property
    def n_lanes(self) -> int:
        """Number of lanes."""
        return int(self.run["n_lanes"])

    @property
    def beliefs(self) -> Beliefs:
        """The belief over the values of each hidden node, of T frames."""
        return Beliefs(self.frame_id, self.marginals, self.log_evidence, self.is_impossible)

    @property
    def truth(self) -> LaneTruth | None:
        """The ground truth of the annotated frames, or None."""
        known = self.true_lane != UNASSIGNED
        if not known.any():
            return None
        return LaneTruth(self.frame_id[known], self.true_lane[known], self.is_crossing[known])

    @functools.cached_property
    def events(self) -> LaneEvents:
        """The lane changes that the beliefs tell of."""
        rate, truth = float(self.run["frame_rate"]), self.truth
        lag, pieces = self.experiment.get("lag"), pieces_of(self.clip, len(self.frame_id))
        beliefs, origin = self.beliefs, self.origin
        if origin is not None:
            beliefs = in_tracks(beliefs, origin)
        found = [
            lane_events(beliefs.take(piece), rate, lag=lag, time_s=self.time_s[piece])
            for piece in pieces
        ]
        events = LaneEvents.joined(found)
        if truth is not None:
            if origin is not None:
                known = self.true_lane != UNASSIGNED
                truth = replace(truth, lane=truth.lane + tracks_of(origin)[known])
            events = replace(events, delay_s=event_delays(events, truth, rate))
        return events if origin is None else numbered(events, self.frame_id, origin)

    @property
    def crossing(self) -> FloatArray | None:
        """(T,): the probability that the car is on a line between two lanes; None for a graph
        without RoadPosition."""
        return crossing_probability(self.marginals)

    def clip_columns(self) -> dict[str, NDArray[Any]]:
        """The columns of clips.csv, one value for each clip; empty where the recording is one
        drive."""
        if self.clip is None:
            return {}
        pieces = pieces_of(self.clip, len(self.frame_id))
        first = np.array([piece.start for piece in pieces])
        last = np.array([piece.stop - 1 for piece in pieces])
        told = np.searchsorted(self.frame_id[first], self.events.frame_id, side="right") - 1
        return {
            "clip": self.clip[first],
            "first_frame_id": self.frame_id[first],
            "frames": last - first + 1,
            "assigned_lane": self.assigned_lane[last],
            "probability": self.marginals["Lane"][last].max(axis=1),
            "changes": np.bincount(told, minlength=len(pieces)),
            "log_evidence": np.array([self.log_evidence[piece].mean() for piece in pieces]),
        }

    def columns(self) -> dict[str, np.ndarray[Any, Any]]:
        """The columns of beliefs.parquet, (T,) each, in their order; masked arrays have nulls."""
        columns: dict[str, np.ndarray[Any, Any]] = {
            "frame_id": self.frame_id,
            "time_s": self.time_s,
        }
        for node, names in self.values.items():
            for k, name in enumerate(names):
                columns[f"{node}_{name}"] = self.marginals[node][:, k]
        crossing = self.crossing
        if crossing is not None:
            columns["crossing"] = crossing
        columns["assigned_lane"] = self.assigned_lane
        if self.tentative is not None and self.detector_lane is not None:
            for k in range(self.n_lanes):
                columns[f"detector_{k + 1}"] = self.tentative[:, k]
            columns["detector_lane"] = self.detector_lane
        columns["log_evidence"] = self.log_evidence
        columns["is_impossible"] = self.is_impossible
        unknown = self.true_lane == UNASSIGNED
        columns["true_lane"] = np.ma.masked_array(self.true_lane, unknown)
        columns["is_crossing"] = np.ma.masked_array(self.is_crossing, unknown)
        if self.clip is not None:
            columns["clip"] = self.clip
        if self.road_lanes is not None and self.origin is not None:
            columns["road_lanes"] = self.road_lanes
            columns["origin"] = self.origin
        return columns if self.block is None else {**columns, "block": self.block}


def check_writable(directory: Path, kinds: Sequence[Callable[[Path], bool]] = ()) -> None:
    """Raise InputError where a result could not be put there: before anything is computed.

    - kinds: tell of a directory whether it may be replaced; by default `is_result`.
    """
    check_place(directory)
    if directory.is_symlink() and not directory.exists():
        raise InputError(f"{directory}: is a link to nothing; name another directory")
    if directory.exists():
        if not directory.is_dir():
            raise InputError(f"{directory}: is a file, not a directory")
        is_ours = any(is_one(directory) for is_one in kinds or (is_result,))
        if any(directory.iterdir()) and not is_ours:
            raise InputError(
                f"{directory}: exists and is not a result directory; name another one with --out"
            )


def is_result(directory: Path) -> bool:
    """Whether the directory holds a whole result."""
    return all((directory / name).is_file() for name in ("run.json", "scores.json"))


def read_files(directory: Path) -> dict[str, bytes]:
    """The content of all files in a directory but the figures, by their path in it. Raises
    InputError where one cannot be read."""
    found = {}
    for file in sorted(directory.rglob("*")):
        name = file.relative_to(directory)
        if file.is_file() and "figures" not in name.parts:
            try:
                found[name.as_posix()] = file.read_bytes()
            except OSError as error:
                raise InputError(f"{file}: cannot be read: {error.strerror}") from error
    return found


def write_files(directory: Path, files: Mapping[str, bytes]) -> None:
    """Write files, as `read_files` gives them. Raises InputError where one cannot be written."""
    for name, content in files.items():
        write_bytes(directory / name, content, make_folder=True)


@contextlib.contextmanager
def staged(directory: Path, kinds: Sequence[Callable[[Path], bool]] = ()) -> Iterator[Path]:
    """A directory to fill, which takes the place of the result `directory` when the block ends
    well; what is not ours in there stays (see `OURS`).

    Raises InputError where that holds something else (see `check_writable`), or cannot be written.
    """
    check_writable(directory, kinds)
    with atomic_directory(directory) as temporary:
        yield temporary
        if directory.is_dir():
            _keep_others(directory, temporary)


#: The files of a result: a new one replaces them, or removes those that it has not got. All others
#: in the directory, such as notes, are not ours and stay.
OURS = (
    *("experiment.yaml", "run.json", "scores.json", BELIEFS, LINES, "events.csv"),
    *("clips.csv", "labels.txt", "labels.csv", "review.csv", "doubted.csv", "report.html"),
    *(
        f"figures/{name}.{style}"
        for name in ("strips", "confusion", "reliability", "coverage", "review_*")
        for style in ("png", "pdf", "svg")
    ),
)


def _keep_others(old: Path, new: Path) -> None:
    """Put what is in `old` but not ours into `new` too, as a second name of the same file."""
    for file in sorted(old.rglob("*")):
        name = file.relative_to(old)
        kept = new / name
        if file.is_dir() and not file.is_symlink():
            if not any(file.iterdir()):
                kept.mkdir(parents=True, exist_ok=True)
        elif kept.is_dir():
            raise InputError(f"{file}: is in the way of a folder of the result; move it")
        elif not kept.exists() and not any(fnmatch(name.as_posix(), ours) for ours in OURS):
            kept.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(file, kept, follow_symlinks=False)
            except OSError:
                # Not every file system has second names.
                shutil.copy2(file, kept, follow_symlinks=False)


def write_result(directory: Path, result: Result, experiment: Mapping[str, Any]) -> None:
    """Write the files of a result into `directory`.

    - experiment: what experiment.yaml says, see `running.portable`.
    """
    from egolane_pgm.recordings.table import write_table

    write_parquet(directory / BELIEFS, arrow_table(result.columns()))
    if result.lines is not None and len(result.lines):
        write_table(directory / LINES, result.lines)
    if result.clip is not None:
        _write_columns(directory / "clips.csv", result.clip_columns())
    write_summary(directory, experiment, result.events, result.run, result.scores)


def write_summary(
    directory: Path,
    experiment: Mapping[str, Any],
    events: LaneEvents,
    run: Mapping[str, Any],
    scores: Mapping[str, Any],
) -> None:
    """Write the files of a result that have no row for each frame."""
    write_yaml(directory / "experiment.yaml", experiment)
    _write_columns(directory / "events.csv", events.columns())
    version = {"schema_version": SCHEMA_VERSION}
    write_json(directory / "scores.json", {**version, **scores})
    write_json(directory / "run.json", {**version, **run})


def _write_columns(file: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table, numbers to six decimals; NaN is empty."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    cells = [[_cell(value) for value in row] for row in rows]
    write_text(file, as_csv(list(columns), cells))


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return "" if value != value else round(value, 6)


def read_result(directory: str | Path) -> Result:
    """Read a result directory.

    Raises InputError in one line, naming the directory where it is not one, or the file and what
    is wrong in it (see `result_schema`).
    """
    directory = Path(directory)
    if not is_result(directory):
        raise InputError(f"{directory}: is not a result directory (no run.json and scores.json)")
    run, scores = read_run(directory), read_scores(directory)
    experiment = read_yaml(directory / "experiment.yaml", "n_lanes: 4")
    validated_in_one_line(Experiment, experiment, directory / "experiment.yaml")
    column = read_beliefs(directory / BELIEFS, run)
    marginals = {
        node: np.stack([column[name] for name in names], axis=1)
        for node, names in belief_columns(run).items()
    }
    tentative = None
    if "detector_lane" in column:
        tentative = np.stack([column[name] for name in tentative_columns(run)], axis=1)
    result = Result(
        directory,
        experiment,
        run,
        scores,
        column["frame_id"],
        column["time_s"],
        marginals,
        {node: tuple(names) for node, names in run["values"].items()},
        tentative,
        column["assigned_lane"],
        column.get("detector_lane"),
        column["true_lane"],
        column["is_crossing"],
        column["log_evidence"],
        column["is_impossible"],
        column.get("block"),
        column.get("clip"),
        column.get("road_lanes"),
        column.get("origin"),
    )
    return replace(result, lines=_read_lines(result))


def read_said(directory: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """What run.json and scores.json of a result say, without reading a belief.

    Raises InputError as `read_result`, as far as it is told by these and by how many frames the
    end of beliefs.parquet has.
    """
    run, scores = read_run(directory), read_scores(directory)
    file = directory / "beliefs.parquet"
    n_frames = rows_of_parquet(file)
    if n_frames != run["frames"]:
        raise InputError(f"{file}: has {n_frames} frames, run.json says {run['frames']}")
    return run, scores


def _read_lines(result: Result) -> LineLog | None:
    """The lines of a result's directory, None where there are none."""
    from egolane_pgm.recordings.table import read_table

    file = result.directory / LINES
    if not file.exists():
        return None
    log = read_table(file)
    if not np.array_equal(log.frame_id, result.frame_id):
        raise InputError(f"{file}: has other frames than beliefs.parquet; run it again")
    return replace(log, time_s=result.time_s, clip=result.clip)


def provenance(
    name: str, content: Mapping[str, Any], data: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Where numbers come from, for every file that has some.

    content: what was configured, all defaults included. data: an entry for each file that was read,
    as `loading.data_entries` gives them.
    """
    return {
        "name": name,
        "config_hash": config_hash(content),
        "data": list(data),
        "versions": versions(),
        "code": code_checksum(),
        "git": git_state(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def file_sha256(path: Path) -> str:
    """The checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def versions(
    packages: Sequence[str] = (
        "egolane-pgm",
        "numpy",
        "scipy",
        "numba",
        "opencv-python-headless",
        "pgmpy",
        "optuna",
        "cmaes",
        "rosbags",
        "pyarrow",
    ),
) -> dict[str, str]:
    """Versions of Python and of the packages that numbers depend on."""
    return {"python": platform.python_version(), **{name: _version(name) for name in packages}}


@functools.cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


@functools.cache
def git_state() -> dict[str, Any] | None:
    """Commit and whether the package's own checkout is dirty; None where it is no checkout.

    It is looked up once in a process, which runs the code that it found first.
    """
    folder = Path(__file__).parent

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    # An installed package may lie in somebody else's checkout: that commit says nothing of ours.
    if git("ls-files", "--error-unmatch", Path(__file__).name) is None:
        return None
    commit, status = git("rev-parse", "HEAD"), git("status", "--porcelain")
    return {"commit": commit, "dirty": bool(status)} if commit else None
