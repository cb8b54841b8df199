"""Results: one table with a row per frame, its scores and its provenance.

A result directory contains experiment.yaml, run.json, scores.json, beliefs.parquet
(`Result.frames`), lines.parquet and events.csv, and graph.yaml if the graph was in memory. It is
written beside and then exchanged with an older one.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from egolane_pgm.contracts import Graph
from egolane_pgm.drives import Drive, drive_names, with_rate
from egolane_pgm.experiment import Experiment, resolved
from egolane_pgm.identity import content_of, data_files, digest, digest_of, most_in_sample
from egolane_pgm.inference.events import SURE, lane_events
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import Model, compile_model, make_evidence, why_not_causal
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.recordings.columns import COLUMNS as COLUMNS_OF_LINES
from egolane_pgm.recordings.columns import Column, checked
from egolane_pgm.recordings.select import fill_missing
from egolane_pgm.recordings.table import lines_of
from egolane_pgm.scoring import score_all
from egolane_pgm.scoring.events import Reported, event_delays, score_events, stability_scores
from egolane_pgm.tools.files import (
    check_no_link,
    check_place,
    checksum,
    read_parquet,
    replaced_directory,
    to_jsonable,
    write_json,
    write_yaml,
)
from egolane_pgm.tools.provenance import git_state, versions
from egolane_pgm.types import Beliefs, Evidence, FloatArray, InputError, LineLog, lane_truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The columns of `Result.frames`; the index is frame_id. Those marked ? are not always there.
COLUMNS = {
    "time_s": "seconds",
    "NODE_VALUE": "posterior: Lane_1, ..., SensorState_OK, ...",
    "line_crossing_probability?": "probability of straddling the line between two lanes",
    "lateral_offset?": "offset from the lane centre in lane widths, positive to the right",
    "assigned_lane": "the answer; 0 for none (a tie, or less than min_confidence)",
    "detector_LANE?": "the evidence rule's own answer",
    "detector_lane?": "its most probable lane; 0 for none",
    "log_evidence": "natural logarithm",
    "is_impossible": "the model does not allow the frame's evidence",
    "true_lane": "missing if not annotated",
    "is_crossing": "the car is changing lanes; missing if not annotated",
    "drive?": "name of the drive, if there are several",
    "n_lanes?": "lanes of the road, if that differs between drives",
    "block?": "the block that was held out",
    "is_trusted?": "False for labels excluded from fits and held-out scores",
}

#: The prefix of a tag among the keys of a result.
TAG = "tag."


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The output of an experiment, frame by frame.

    - experiment: with the frame rate of its recording.
    - frames: a row per frame, see `COLUMNS`.
    - run: provenance (run.json).
    - scores: the scores (scores.json).
    - lines: the lines of each drive, by name.
    - directory: the result directory; None in memory.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> result
    Result('quickstart': 300 frames, accuracy 0.877, detector 0.558; not tuned, causal)
    >>> result.scores["model"]["frames_scored"]
    260
    >>> result.events[["time_s", "from_lane", "to_lane", "delay_s"]].round(1)
       time_s  from_lane  to_lane  delay_s
    0     3.7          4        3     -0.4
    1    10.5          3        2     -0.6
    >>> result.frames[["time_s", "Lane_1", "SensorState_OK", "true_lane"]].shape
    (300, 4)
    """

    experiment: Experiment
    frames: pd.DataFrame
    run: Mapping[str, Any]
    scores: Mapping[str, Any]
    lines: Mapping[str, LineLog] = field(default_factory=dict)
    directory: Path | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        from egolane_pgm.views.result_text import result_title

        return f"Result({result_title(self)})"

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.experiment.name

    @property
    def n_lanes(self) -> int:
        """Number of lanes of the road; the largest of several drives."""
        return int(self.run["n_lanes"])

    @property
    def frame_rate(self) -> float:
        """Frames per second."""
        return float(self.run["frame_rate"])

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return list(self.run["warnings"])

    @cached_property
    def model(self) -> Model:
        """The evidence rule and the graph, compiled."""
        if self.experiment.road is None:
            return compile_model(self.experiment)
        return compile_model(load_experiment(self.experiment, {"road": None}, n_lanes=self.n_lanes))

    def node(self, name: str) -> FloatArray:
        """(T, k): the posterior of a node."""
        columns = [f"{name}_{value}" for value in self.run["values"][name]]
        found: FloatArray = self.frames[columns].to_numpy(np.float64)
        return found

    @cached_property
    def truth(self) -> pd.DataFrame | None:
        """The annotated frames: true_lane and is_crossing; None without ground truth."""
        return truth_of(self.frames)

    @cached_property
    def events(self) -> pd.DataFrame:
        """The lane changes of each drive; with ground truth, the delay of each (`delay_s`)."""
        tables = []
        for name, frames in by_drive(self.frames):
            events = events_of(frames, self.frame_rate, self.experiment.lag)
            if (truth := truth_of(frames)) is not None:
                events = events.assign(delay_s=event_delays(events, truth, self.frame_rate))
            tables.append(events if name is None else events.assign(drive=name))
        return pd.concat(tables, ignore_index=True)

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence of a single drive, made from its lines."""
        [log] = self.lines.values()
        return make_evidence(self.model, log)[0]

    def to_text(self, *, style: str = "markdown") -> str:
        """The text that `egolane run` prints: scores, confusions and lane changes.

        - style: one of `views.tables.STYLES`.
        """
        from egolane_pgm.views.result_text import result_text

        return result_text(self, style)

    def plot(self, first: int | None = None, last: int | None = None) -> Figure:
        """Draw the posterior over time as strips, and the truth.

        - first, last: frame ids, both included; all by default.

        Raises InputError for a range without frames.
        """
        from egolane_pgm.views.strips import result_strips
        from egolane_pgm.views.style import inline_figure

        return inline_figure(lambda: result_strips(self, first, last))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = False) -> Path:
        """Write the result directory. It is whole, or the older result is; other files stay.

        - figures: also draw the posterior over time, figures/strips.png.

        Raises InputError if the directory holds something else or cannot be written.
        """
        check_writable(Path(directory))
        with replaced_directory(Path(directory), is_of_result) as place:
            self.frames.to_parquet(place / "beliefs.parquet")
            write_yaml(place / "experiment.yaml", self._write_inputs(place))
            self.events.round(6).to_csv(place / "events.csv", index=False)
            write_json(place / "scores.json", self.scores)
            kept = {**self.run, "checksum": checksum(self.run, place, _WITH_CHECKSUM)}
            write_json(place / "run.json", kept)
            if figures:
                from egolane_pgm.views.strips import result_strips
                from egolane_pgm.views.style import write_figure

                write_figure(lambda: result_strips(self), place / "figures" / "strips.png")
        return Path(directory)

    def _write_inputs(self, place: Path) -> dict[str, Any]:
        """Write the lines and a graph in memory, and copy the user's own plugins; return the config
        that names them."""
        config, e = dict(self.run["config"]), self.experiment
        for key, plugin in (("evidence", e.evidence), ("graph", e.graph)):
            # A loaded result has copies of its plugins, which its experiment names.
            if isinstance(plugin, Graph):
                write_yaml(place / "graph.yaml", plugin.keys or {})
                config[key] = "./graph.yaml"
            elif plugin.endswith(OWN_FILES):
                copy = f"{key}_{Path(plugin).name.removeprefix(f'{key}_')}"
                shutil.copyfile(plugin, place / copy)
                config[key] = f"./{copy}"
        if self.lines:
            logs = {n: log.take(~log.is_missing).to_pandas() for n, log in self.lines.items()}
            table = pd.concat(logs, names=["drive"]).reset_index()
            table = table if len(logs) > 1 else table.drop(columns="drive")
            table.to_parquet(place / "lines.parquet", index=False)
        return config


def as_result(given: Any, what: str) -> Result:
    """A Result, or the in-sample result of a Study; `what` is the argument, for the InputError."""
    found = getattr(given, "in_sample", given)
    if not isinstance(found, Result):
        kind = type(given).__name__
        raise InputError(f"{what}: {kind} has no recording; give a result or a study of the model")
    return found


# --- directories ---------------------------------------------------------------------------------


#: The files of a result directory, but copies of plugins.
FILES = (
    "run.json",
    "scores.json",
    "beliefs.parquet",
    "lines.parquet",
    "events.csv",
    "experiment.yaml",
    "graph.yaml",
    "figures",
)

#: The files that the checksum in run.json covers, as it covers run.json itself.
_WITH_CHECKSUM = ("scores.json", "beliefs.parquet", "lines.parquet")


def is_of_result(name: str) -> bool:
    """Whether a file of this name in a result directory belongs to the result."""
    return name in FILES or (name.startswith(("evidence_", "graph_")) and name.endswith(OWN_FILES))


def is_result(directory: str | os.PathLike[str]) -> bool:
    """Whether a directory holds a complete result."""
    return all((Path(directory) / name).is_file() for name in ("run.json", "scores.json"))


def check_writable(directory: Path) -> None:
    """Raise InputError if a result cannot be written there; called before the computation."""
    check_no_link(directory)
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: is a file, not a directory")
    if directory.is_mount() or directory.absolute() == Path.cwd():
        raise InputError(f"{directory}: cannot be replaced; name a folder in it")
    # The first file of a result, which may have been interrupted.
    is_ours = (directory / "beliefs.parquet").exists() or not directory.exists()
    if not is_ours and any(directory.iterdir()):
        raise InputError(f"{directory}: exists and is not a result directory; name another one")
    check_place(directory)


def load_result(directory: str | os.PathLike[str]) -> Result:
    """Read a result directory. Raises InputError if it is incomplete or damaged.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = ego.load_result(result.save(f"{folder}/mine"))
    >>> again.frames.equals(result.frames)
    True
    """
    place = Path(directory)
    while True:
        if not is_result(place):
            raise InputError(f"{place}: is not a result directory (no run.json and scores.json)")
        before = _version(place)
        try:
            found = _read_result(place)
        except InputError:
            if _version(place) == before:
                raise
        else:
            if _version(place) == before:
                return found
        # The directory was replaced meanwhile.


def _version(place: Path) -> tuple[int, int]:
    """A new value for each folder that takes the place: numbers of deleted folders come again."""
    stat = place.stat()
    return stat.st_ino, stat.st_mtime_ns


def _read_result(place: Path) -> Result:
    try:
        run, scores = (json.loads((place / n).read_text()) for n in ("run.json", "scores.json"))
        if not (isinstance(run, dict) and isinstance(scores, dict)):
            raise ValueError("run.json and scores.json need keys and values")
        if "identity" not in run:
            raise InputError(f"{place}: was written by another version; run the experiment again")
        frames = _read_frames(place / "beliefs.parquet", run)
        if len(frames) != run["frames"]:
            raise ValueError(f"beliefs.parquet has {len(frames)} of {run['frames']} frames")
        experiment = load_experiment(place / "experiment.yaml")
        lines = _read_lines(place, experiment)
        # Results of older versions have none.
        if run.pop("checksum", None) not in (None, checksum(run, place, _WITH_CHECKSUM)):
            raise ValueError("its files differ from the checksum in run.json")
        return Result(experiment, frames, run, scores, lines, place)
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, OSError) as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(f"{place}: is damaged ({why}); run the experiment again") from error


def _read_frames(file: Path, run: Mapping[str, Any]) -> pd.DataFrame:
    """The table of frames, with its columns checked."""
    declared = {
        "frame_id": Column("whole", is_needed=True, is_full=True),
        "time_s": Column("time", is_needed=True, is_full=True),
        "assigned_lane": Column("whole", is_needed=True, is_full=True),
        "detector_lane": Column("whole", is_full=True),
        "log_evidence": Column(is_needed=True),
        "is_impossible": Column("flag", is_needed=True, is_full=True),
        "true_lane": Column("whole"),
        "is_crossing": Column("flag"),
        "is_trusted": Column("flag", is_full=True),
    }
    declared |= {f"Lane_{k + 1}": Column(is_needed=True) for k in range(run["n_lanes"])}
    return checked(read_parquet(file), declared, str(file)).set_index("frame_id")


def _read_lines(place: Path, experiment: Experiment) -> dict[str, LineLog]:
    """The lines of each drive; frames that were filled in without lines are not in the file."""
    file, recording = place / "lines.parquet", experiment.recording
    if not file.exists():
        return {}
    table = read_parquet(file)
    if "drive" not in table:
        table["drive"] = experiment.name
    logs = {}
    for name, part in table.groupby("drive", sort=False):
        part = part.drop(columns="drive")
        covariates: Any = {name: name for name in part if name not in COLUMNS_OF_LINES} or None
        log = lines_of(part, frame_rate=recording.frame_rate, path=file, columns=covariates)
        logs[str(name)] = fill_missing(log, recording.missing_frames, recording.frame_rate)
    return logs


def stored(
    experiment: Experiment, directory: Path, tags: Mapping[str, str], n_blocks: int | None = None
) -> Result | None:
    """The complete result in a directory, if experiment, data, tags and blocks are the same."""
    try:
        run = json.loads((directory / "run.json").read_text())
        found = run["identity"], run["tags"], run.get("blocks")
        is_same = found == (digest_of(content_of(experiment)), dict(tags), n_blocks)
        return load_result(directory) if is_same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


# --- the table of frames -------------------------------------------------------------------------


def lanes_of(frames: pd.DataFrame, node: str = "Lane") -> FloatArray:
    """(T, n): the posterior over lanes; with `detector`, the evidence rule's own answer."""
    n_lanes = sum(column.startswith("Lane_") for column in frames)
    columns = [f"{node}_{lane}" for lane in range(1, n_lanes + 1)]
    found: FloatArray = frames[columns].to_numpy(np.float64)
    return found


def truth_of(frames: pd.DataFrame) -> pd.DataFrame | None:
    """The ground truth of the annotated frames; None without one.

    Several drives may share frame ids: their frames are numbered consecutively instead.
    """
    known = frames[["true_lane", "is_crossing"]].dropna()
    if known.empty:
        return None
    is_one_drive = known.index.is_monotonic_increasing and known.index.is_unique
    ids = known.index if is_one_drive else np.arange(len(known))
    return lane_truth(ids, known["true_lane"], known["is_crossing"])


def by_drive(frames: pd.DataFrame) -> list[tuple[Any, pd.DataFrame]]:
    """The frames of each drive by name; None for the name of the only one."""
    return list(frames.groupby("drive", sort=False)) if "drive" in frames else [(None, frames)]


def events_of(frames: pd.DataFrame, frame_rate: float, lag: int | None) -> pd.DataFrame:
    """The lane changes of one drive."""
    flags = frames["log_evidence"].to_numpy(), frames["is_impossible"].to_numpy()
    beliefs = Beliefs(frames.index.to_numpy(), {"Lane": lanes_of(frames)}, *flags)
    offset = frames["lateral_offset"].to_numpy() if "lateral_offset" in frames else None
    time_s = frames["time_s"].to_numpy()
    return lane_events(beliefs, frame_rate, lag=lag, time_s=time_s, lateral_offset=offset)


# --- scores --------------------------------------------------------------------------------------


def score(frames: pd.DataFrame, frame_rate: float, lag: int | None = None) -> dict[str, Any]:
    """The scores of a table of frames, of one drive or of several together.

    Frames of untrusted labels are left out; `model_all_frames` has the scores with them.
    """
    impossible = frames["is_impossible"].to_numpy()
    lane = lanes_of(frames)
    events = {name: events_of(part, frame_rate, lag) for name, part in by_drive(frames)}
    scores: dict[str, Any] = {
        "frames": len(frames),
        "frames_scored": 0,
        "mean_log_evidence": frames["log_evidence"][~impossible].mean(),
        "impossible_frames": int(impossible.sum()),
        "sure": float((lane.max(axis=1) >= SURE).mean()) if len(lane) else None,
        "events": {"detected": sum(map(len, events.values()))},
    }
    every = frames.dropna(subset=["true_lane"])
    kept = every[every["is_trusted"]] if "is_trusted" in every else every
    if kept.empty:
        return scores
    scores["frames_scored"] = int((~kept["is_crossing"]).sum())
    sides = {
        "detector": (kept, "detector", "detector_lane"),
        "model": (kept, "Lane", "assigned_lane"),
    }
    if len(kept) < len(every):
        sides["model_all_frames"] = (every, "Lane", "assigned_lane")
    for side, (rows, node, column) in sides.items():
        if column in rows:
            scores[side] = score_all(lanes_of(rows, node), truth_of(rows), frame_rate, rows[column])
            if "drive" in rows:
                drives = [(part[column], truth_of(part)) for _, part in by_drive(rows)]
                scores[side] |= stability_scores(drives, frame_rate)
    reported = [Reported(events[name], truth_of(part)) for name, part in by_drive(kept)]
    scores["events"] = score_events(reported, frame_rate)
    return scores


# --- from drives to a result ---------------------------------------------------------------------


def make_result(
    experiment: Experiment,
    drives: Sequence[Drive],
    frames: pd.DataFrame,
    notes: Sequence[str] = (),
    *,
    begin: float | None = None,
    **more: Any,
) -> Result:
    """The result of an experiment.

    - drives: of one recording, or of several recordings with the same model.
    - frames: the rows of the drives, in order.
    - notes: warnings, a line each.
    - begin: `time.perf_counter()` at the start.
    - more: further keys of run.json.
    """
    first, model = drives[0], drives[0].model
    rate = model.experiment.recording.frame_rate
    e = with_rate(experiment, rate)
    notes = list(dict.fromkeys(notes))
    if impossible := int(frames["is_impossible"].sum()):
        notes.append(
            f"{first.log.source}: the evidence of {impossible} frame(s) has joint likelihood zero;"
            " they keep their prediction"
        )
    data = [digest(path) for path in data_files(experiment)]
    widest = max(drives, key=lambda drive: drive.model.n_lanes).model
    reasons = why_not_causal(model)
    run = {
        "name": e.name,
        "config": resolved(e, model.parameters),
        "identity": digest_of(content_of(experiment, data=data)),
        "data": data,
        "versions": versions(),
        "git": git_state(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "frame_rate": rate,
        "n_lanes": widest.n_lanes,
        "values": widest.values,
        "observed": [str(key) for key in model.compiled.observed],
        "of_rule": [spec.name for spec in model.rule.parameters],
        "free_parameters": model.free_parameters,
        "frames": len(frames),
        "tuned_on": most_in_sample(drive.tuned_on() for drive in drives),
        "is_causal": not reasons,
        "why_not_causal": reasons,
        "tags": dict(first.tags),
        "warnings": notes,
        **more,
    }
    if begin is not None:
        run["seconds"] = round(time.perf_counter() - begin, 3)
    lines = dict(zip(drive_names(drives), (drive.log for drive in drives), strict=True))
    return Result(e, frames, to_jsonable(run), to_jsonable(score(frames, rate, e.lag)), lines)
