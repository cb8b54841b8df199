"""What an experiment believed: `Result`, and the directory that it is stored in.

A directory is complete, so that a report can be made from it alone:

- experiment.yaml: the resolved experiment, every default spelled out; `egolane run` takes it.
- run.json: where the numbers come from (`Run`).
- scores.json: the scores (`RunScores`).
- beliefs.parquet: one row per frame (`COLUMNS`).
- lines.parquet: the lines that were believed, a row each, a recording as `recordings.table` reads
  them; selected, and with missing frames put in as the experiment says.
- events.csv: one row per reported lane change (`LaneEvents`), and `late_s`, from time_s to
  told_time_s.
- clips.csv: of a recording of several clips one row for each: clip, first_frame_id, frames,
  assigned_lane and probability (of the most probable lane) in its last frame, changes (their
  number), log_evidence (mean); with n_lanes: map n_lanes; with ground truth frames_scored and
  accuracy.
- figures/: the belief over time, strips.png, and what `plot` drew.

What was believed held out (`held_out.run_held_out`) is written so too: beliefs.parquet has the
annotated frames, and the `block` of each; run.json has `fit`, `blocks`, `parameters_per_block` and
more of how they were found.

A directory is made beside its place and moved there at the end. run.json is removed first and comes
last, so that a directory that has it is whole. Files that are not ours are left alone (see `OURS`).
"""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import shutil
import subprocess
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic_core import from_json

from egolane_pgm.experiment import Experiment, config_hash, make_experiment, validated
from egolane_pgm.inference.events import (
    lane_events,
)
from egolane_pgm.inference.unrolling import Unrolled, unrolled
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.recordings.source import IN_MEMORY, files_in_full
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.document import Count, Events, Finite, Scores, Share, Stored
from egolane_pgm.scoring.events import event_delays
from egolane_pgm.tools import files
from egolane_pgm.types import (
    MAX_LANES,
    UNASSIGNED,
    Beliefs,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    LaneEvents,
    LaneTruth,
    LineLog,
    pieces_of,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from pgmpy.models import DynamicBayesianNetwork

#: The version of the keys of run.json, scores.json and comparison.json.
SCHEMA_VERSION = 1

#: The files of the beliefs and of the lines.
BELIEFS, LINES = "beliefs.parquet", "lines.parquet"

_AGAIN = "; run the experiment again"


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """What an experiment believed, frame by frame: what `ego.run` returns, a result directory
    stores, and tables and figures read.

    - directory: where it was read, or was written in parts; before, the YAML that was run.
    - experiment: with the frame rate that was counted with.
    - config: the experiment with every default spelled out.
    - run, scores: what run.json and scores.json say.
    - frame_id, time_s (T,): seconds.
    - marginals: per hidden node (T, k); of a run that was written in parts Lane only.
    - values: per hidden node the names of its k values.
    - tentative (T, n): the evidence rule's own answer, or None.
    - assigned_lane (T,): the lane that is answered, 1..n, 0 is Unassigned.
    - true_lane (T,): 1..n, 0 where not annotated.
    - is_crossing (T,): whether the car is changing lanes.
    - log_evidence (T,): natural logarithm.
    - is_impossible (T,): marks frames whose evidence the model does not allow.
    - crossing (T,): the probability that the car is on a line between two lanes; None for a graph
      without RoadPosition.
    - place_in_lane (T,): lane widths right of the middle of the lane, whichever it is, -.5 to .5;
      NaN where that is not known. Of a graph without RoadPosition it is that of the lines
      (`line_geometry.place`).
    - block (T,): the held-out block of each frame; None of a result that held out none.
    - clip (T,): the name of each frame's clip, where there are several, as in `LineLog`.
    - road_lanes (T,): lanes of the road as the map says, with n_lanes: map; clips are then where
      they stay the same, and lanes beyond have probability 0.
    - lines: of the T frames; None in a directory that was written before lines were kept.
    - evidence: what was filtered; None where the result was read.
    - learned: what was learned from the whole recording, of a result of `ego.learn`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> run
    Result('quickstart': 300 frames, accuracy 0.877, detector 0.558; not tuned, causal)
    >>> run.scores["model"]["frames_scored"]
    260
    >>> run.events.to_pandas()[["time_s", "from_lane", "to_lane", "delay_s"]].round(1)
       time_s  from_lane  to_lane  delay_s
    0     3.7          4        3     -0.4
    1    10.5          3        2     -0.6
    >>> run.to_pandas()[["time_s", "Lane=1", "SensorState=OK", "true_lane"]].shape
    (300, 4)
    """

    directory: Path
    experiment: Experiment
    config: Mapping[str, Any]
    run: Mapping[str, Any]
    scores: Mapping[str, Any]
    frame_id: IntArray
    time_s: FloatArray
    marginals: Mapping[str, FloatArray]
    values: Mapping[str, tuple[str, ...]]
    tentative: FloatArray | None
    assigned_lane: IntArray
    true_lane: IntArray
    is_crossing: BoolArray
    log_evidence: FloatArray
    is_impossible: BoolArray
    crossing: FloatArray | None = None
    place_in_lane: FloatArray | None = None
    block: IntArray | None = None
    clip: NDArray[np.str_] | None = None
    road_lanes: IntArray | None = None
    lines: LineLog | None = None
    evidence: Evidence | None = None
    compiled: Model | None = None
    learned: Any = None

    def __len__(self) -> int:
        return len(self.frame_id)

    def __repr__(self) -> str:
        from egolane_pgm.views.shown import result_title

        return f"Result({result_title(self)})"

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return str(self.run["name"])

    @property
    def n_lanes(self) -> int:
        """Number of lanes."""
        return int(self.run["n_lanes"])

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return list(self.run["warnings"])

    @functools.cached_property
    def model(self) -> Model:
        """The graph and the evidence rule, compiled."""
        return self.compiled or prepare_model(self.experiment, self.n_lanes)

    @functools.cached_property
    def beliefs(self) -> Beliefs:
        """The belief over the values of each hidden node, of T frames."""
        return Beliefs(
            self.frame_id, self.marginals, self.log_evidence, self.is_impossible, self.values
        )

    @property
    def detector_lane(self) -> IntArray | None:
        """(T,): the most probable lane of the evidence rule's own answer, 0 is Unassigned."""
        return None if self.tentative is None else assigned_lane(self.tentative)

    @functools.cached_property
    def scored(self) -> IntArray:
        """(K,): the annotated frames."""
        return np.flatnonzero(self.true_lane != UNASSIGNED)

    @functools.cached_property
    def truth(self) -> LaneTruth | None:
        """The ground truth of the annotated frames, or None."""
        k = self.scored
        if not len(k):
            return None
        return LaneTruth(self.frame_id[k], self.true_lane[k], self.is_crossing[k])

    @functools.cached_property
    def told(self) -> LaneEvents:
        """The lane changes that the beliefs show."""
        rate, lag = float(self.run["frame_rate"]), self.config.get("lag")
        pieces = pieces_of(self.clip, len(self))
        found = [
            lane_events(
                self.beliefs.take(piece),
                rate,
                lag=lag,
                time_s=self.time_s[piece],
                places=None if self.place_in_lane is None else self.place_in_lane[piece],
            )
            for piece in pieces
        ]
        return LaneEvents.joined(found)

    @functools.cached_property
    def events(self) -> LaneEvents:
        """The lane changes that the beliefs show, see `egolane_pgm.inference.events`; with
        ground truth, the delay of each."""
        truth = self.truth
        if truth is None:
            return self.told
        truth = replace(truth, lane=truth.lane + self.renumbered[self.scored])
        same = self.with_same_lanes(self.told)
        return replace(self.told, delay_s=event_delays(same, truth, float(self.run["frame_rate"])))

    @functools.cached_property
    def renumbered(self) -> IntArray:
        """(T,): what to add to lanes so that the true one keeps its number from clip to clip of a
        road from a map: lanes that begin at the left are no change of lane."""
        added, last = np.zeros(len(self), dtype=np.int64), None
        for piece in [] if self.road_lanes is None else pieces_of(self.clip, len(self)):
            lanes = self.true_lane[piece]
            known = lanes[(lanes != UNASSIGNED) & ~self.is_crossing[piece]]
            if len(known):
                added[piece] = 0 if last is None else last - known[0]
                last = known[-1] + added[piece.start]
        return np.asarray(added - added.min(initial=0))

    def with_same_lanes(self, events: LaneEvents) -> LaneEvents:
        """Events of this result, with lanes that are `renumbered`."""
        added = self.renumbered[np.searchsorted(self.frame_id, events.told_frame_id)]
        added[events.from_lane == UNASSIGNED] = 0
        return replace(events, from_lane=events.from_lane + added, to_lane=events.to_lane + added)

    def take(self, frames: slice | IntArray | BoolArray) -> Result:
        """The result of some frames, in order."""
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        taken: dict[str, Any] = {
            name: part[frames] for name, part in parts.items() if isinstance(part, np.ndarray)
        }
        taken["marginals"] = {node: belief[frames] for node, belief in self.marginals.items()}
        taken["lines"] = None if self.lines is None else self.lines.take(frames)
        return replace(self, **taken)

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of beliefs.parquet, (T,) each, in their order; masked arrays have nulls."""
        columns: dict[str, NDArray[Any]] = {}
        for column in COLUMNS:
            values = column.values(self) if column.values else getattr(self, column.name)
            if isinstance(values, Mapping):
                columns |= values
            elif values is not None:
                columns[column.name] = values
        return columns

    def clip_columns(self) -> dict[str, NDArray[Any]]:
        """The columns of clips.csv, one value for each clip; empty where the recording is one
        drive."""
        if self.clip is None:
            return {}
        pieces = pieces_of(self.clip, len(self.frame_id))
        first = np.array([piece.start for piece in pieces])
        last = np.array([piece.stop - 1 for piece in pieces])
        told = np.searchsorted(self.frame_id[first], self.events.frame_id, side="right") - 1
        is_scored = (self.true_lane != UNASSIGNED) & ~self.is_crossing
        is_right = is_scored & (self.assigned_lane == self.true_lane)
        n_scored, n_right = (np.add.reduceat(each, first) for each in (is_scored, is_right))
        of_road = {} if self.road_lanes is None else {"n_lanes": self.road_lanes[first]}
        of_truth = {"frames_scored": n_scored, "accuracy": n_right / np.maximum(n_scored, 1)}
        return {
            "clip": self.clip[first],
            "first_frame_id": self.frame_id[first],
            "frames": last - first + 1,
            "assigned_lane": self.assigned_lane[last],
            "probability": self.marginals["Lane"][last].max(axis=1),
            "changes": np.bincount(told, minlength=len(pieces)),
            "log_evidence": np.array([self.log_evidence[piece].mean() for piece in pieces]),
            **of_road,
            **(of_truth if n_scored.any() else {}),
        }

    # --- shown; pandas, matplotlib and the page are imported when they are asked for ----

    def _repr_html_(self) -> str:
        from egolane_pgm.views.shown import result_html

        return result_html(self)

    @property
    def document(self) -> Mapping[str, Any]:
        """What scores.json says."""
        return self.scores

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """What `egolane run` prints: scores, confusions and lane changes.

        - style: one of `report.tables.STYLES`.
        - wide: whether tables are whole; else none is wider than the terminal.
        """
        from egolane_pgm.views.shown import result_text

        return result_text(self, style, wide)

    def to_pandas(self) -> pd.DataFrame:
        """A row per frame; the index is `frame_id`.

        Columns: `time_s`, `assigned_lane` (0: no answer), `true_lane` and `is_crossing` (missing
        where nobody annotated the frame), `Lane=1`, ...; then `crossing` (the probability that the
        car is on a line between two lanes, of graphs that have a RoadPosition), the evidence rule's
        own answer (`detector=1`, ..., `detector_lane`) where it has one, `log_evidence`,
        `is_impossible`, and the beliefs in the other hidden nodes (`SensorState=OK`, ...).
        """
        import pandas as pd

        names = {
            f"{node}_{value}": f"{node}={value}"
            for node, values in self.values.items()
            for value in values
        }
        names |= {f"detector_{k}": f"detector={k}" for k in range(1, self.n_lanes + 1)}
        columns: dict[str, Any] = {}
        for name, column in self.columns().items():
            if isinstance(column, np.ma.MaskedArray):
                kind = "boolean" if column.dtype == bool else "Int64"
                values = pd.array(column.data, dtype=kind)
                values[np.ma.getmaskarray(column)] = pd.NA
                columns[name] = values
            else:
                columns[names.get(name, name)] = column
        first = ["frame_id", "time_s", "assigned_lane", "true_lane", "is_crossing"]
        first += [name for name in columns if name.startswith("Lane=")]
        others = [name for name in columns if name not in first]
        # The many columns of another node would hide what is looked at.
        order = [*first, *sorted(others, key=lambda name: name.partition("=")[0] in self.values)]
        return pd.DataFrame(columns)[order].set_index("frame_id")

    def network(
        self, *, evidence: bool = False, first: int | None = None, last: int | None = None
    ) -> DynamicBayesianNetwork | Unrolled:
        """The graph in pgmpy: by itself, or some frames of it with their evidence.

        - evidence: False for the declared network of two slices, whose virtual-evidence tables
          (`WOR_ve`) are placeholders; True for frames in which they hold the run's evidence, as
          `unrolled` makes them, together with what pgmpy's queries are given.
        - first, last: with evidence: frame ids of one clip, both included; all by default. pgmpy
          takes seconds for hundreds of frames.

        Raises InputError for frames that there are not, and where the evidence was not kept (in a
        result that was read).
        """
        if not evidence:
            if first is not None or last is not None:
                raise InputError("first, last: choose frames of network(evidence=True)")
            return self.model.network
        if self.evidence is None:
            raise InputError(f"{self.directory}: a stored result has no evidence{_AGAIN}")
        first = int(self.frame_id[0]) if first is None else first
        last = int(self.frame_id[-1]) if last is None else last
        clips = pieces_of(self.clip, len(self))
        part = next((clip for clip in clips if first in self.frame_id[clip]), clips[0])
        seen, ids = self.evidence.take(part), self.frame_id[part]
        return unrolled(self.model, seen, first, last, frame_id=ids)

    def plot(self, first: int | None = None, last: int | None = None) -> Figure:
        """Draw the beliefs over time as strips, the truth below.

        - first, last: frame ids, both included; the whole drive by default.

        Raises InputError for a range without frames.
        """
        from egolane_pgm.views.strips import strips_figure
        from egolane_pgm.views.style import inline_figure

        return inline_figure(lambda: strips_figure(self, first, last))

    def report(self, file: str | os.PathLike[str]) -> Path:
        """Write the page of `egolane plot --out x.html`: one HTML file, with a timeline.

        - file: its name; its folder is made.

        Raises InputError where it cannot be written. What the page lacks is warned of.

        >>> import tempfile
        >>> import egolane_pgm as ego
        >>> place = ego.experiments_folder() / "quickstart.yaml"
        >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     run.report(f"{folder}/page.html").name
        'page.html'
        """
        # The page is a wing: it is found by name, so that nothing here needs it.
        page = import_module("egolane_pgm.page.document")
        for line in page.write_page([self], Path(file)):
            warnings.warn(line, UserWarning, stacklevel=2)
        return Path(file)

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the result directory that `egolane run --out` writes; `load_result` reads it.

        - figures: whether the belief over time is drawn in it; `egolane plot` draws more.

        An older result of that name is replaced; other files are left alone. Raises
        InputError where the directory holds anything else, or cannot be written. Where only the
        figures cannot be drawn it raises InputError too, and the result is kept without them.
        """
        place, undrawn = Path(directory), ""
        with staged(place) as folder:
            write_result(folder, self)
            try:
                if figures:
                    from egolane_pgm.views.strips import draw_strips

                    draw_strips(self, folder / "figures" / "strips.png")
            except InputError as error:
                shutil.rmtree(folder / "figures", ignore_errors=True)
                undrawn = str(error).replace(str(folder), str(place))
        if undrawn:
            raise InputError(f"{undrawn}; the result without figures is in {place}")
        return place


# --- beliefs.parquet ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A column of beliefs.parquet.

    - name: with NODE_VALUE for each value of each hidden node, detector_LANE for each lane.
    - needed: whether it has to be there: "always"; "sometimes"; or the name of another column,
      which it goes with.
    - values: takes a result, gives the column, or those of several names; by default the result's
      attribute of that name, None where it has no such column.
    """

    name: str
    kind: str
    needed: str
    meaning: str
    values: Callable[[Result], Any] | None = None


def _known(name: str) -> Callable[[Result], Any]:
    """The values of an attribute in annotated frames; null in others."""
    return lambda result: np.ma.masked_array(getattr(result, name), result.true_lane == UNASSIGNED)


def _beliefs(result: Result) -> dict[str, FloatArray]:
    """The columns of the beliefs: Lane_1, ..., SensorState_OK, ..."""
    return {
        f"{node}_{name}": result.marginals[node][:, k]
        for node, names in result.values.items()
        for k, name in enumerate(names)
    }


def _tentative(result: Result) -> dict[str, FloatArray]:
    """The columns of the evidence rule's own answer, none where it has none."""
    if result.tentative is None:
        return {}
    return {f"detector_{k}": column for k, column in enumerate(result.tentative.T, start=1)}


#: The columns of beliefs.parquet in their order.
COLUMNS = (
    Column("frame_id", "int64", "always", "increases from row to row"),
    Column("time_s", "float64", "always", "seconds"),
    Column("NODE_VALUE", "float64", "always", "belief: Lane_1, ..., SensorState_OK, ...", _beliefs),
    Column(
        "crossing",
        "float64",
        "sometimes",
        "probability that the car is on a line between two lanes, of graphs with RoadPosition",
    ),
    Column(
        "place_in_lane",
        "float64",
        "sometimes",
        "mean place in the lane, whichever it is: lane widths right of its middle; NaN if unknown;"
        " without RoadPosition that of the lines",
    ),
    Column("assigned_lane", "int64", "always", "the answer; 0 for none (a tie, unassigned_below)"),
    Column(
        "detector_LANE", "float64", "detector_lane", "the evidence rule's own answer", _tentative
    ),
    Column("detector_lane", "int64", "sometimes", "its most probable lane; 0 for none"),
    Column("log_evidence", "float64", "always", "natural logarithm"),
    Column("is_impossible", "bool", "always", "the model does not allow the frame's evidence"),
    Column("true_lane", "int64", "always", "null where not annotated", _known("true_lane")),
    Column(
        "is_crossing",
        "bool",
        "always",
        "the car is changing lanes; null where not annotated",
        _known("is_crossing"),
    ),
    Column("clip", "string", "sometimes", "name of the clip, where several"),
    Column("road_lanes", "int64", "sometimes", "lanes of the road, with n_lanes: map"),
    Column("block", "int64", "sometimes", "the block that was held out"),
)


def _read_beliefs(file: Path, run: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a `Result` that beliefs.parquet holds. In frames that are not annotated
    `true_lane` is 0 and `is_crossing` false.

    - run: the content of run.json, which names the hidden nodes and their values.
    """
    table = files.read_parquet(file)
    if len(table) != run["frames"]:
        raise InputError(f"{file}: has {len(table)} frames, run.json says {run['frames']}")

    def column(name: str, kind: str = "float64") -> NDArray[Any]:
        cells = table[name]
        if name in ("true_lane", "is_crossing"):
            cells = cells.fill_null(False if kind == "bool" else 0)
        values = np.asarray(cells.to_numpy(zero_copy_only=False))
        return values.astype(np.str_ if kind == "string" else kind, copy=False)

    def stacked(prefix: str, names: Iterable[Any]) -> FloatArray:
        return np.stack([column(f"{prefix}_{name}") for name in names], axis=1)

    marginals = {node: stacked(node, names) for node, names in run["values"].items()}
    kept = [each for each in COLUMNS if each.name in table.column_names]
    found: dict[str, Any] = {each.name: column(each.name, each.kind) for each in kept}
    has_detector = found.pop("detector_lane", None) is not None
    lanes = range(1, run["n_lanes"] + 1)
    return {
        **found,
        "marginals": marginals,
        "tentative": stacked("detector", lanes) if has_detector else None,
    }


# --- run.json and scores.json ------------------------------------------------------------------


class Causal(Stored):
    """Whether a belief about a frame knows that frame and earlier ones only."""

    filter: bool = Field(description="whether the filter looks at the frame and earlier ones only")
    evidence: bool = Field(
        description="the same of the evidence rule, which may take a lane width from the whole"
        " recording"
    )


class Data(Stored):
    """A file that was read."""

    path: str = Field(description="where it was")
    sha256: str = Field(
        description="its checksum; of a folder, that of the list of its files' checksums"
    )
    bytes: Count = Field(description="its size")


class Summary(Stored):
    """What run.json and scores.json both say."""

    schema_version: int = Field(
        description="version of these keys; another program may refuse another one"
    )
    name: str = Field(description="name of the experiment")
    tuned_on: Literal["same_frames", "other_frames", "not_tuned", "unknown"] = Field(
        description="what the parameters have seen, as in the experiment"
    )
    is_causal: bool = Field(description="false: a belief about a frame uses later frames too")
    causal: Causal = Field(description="the same of filter and evidence apart")
    why_not_causal: list[str] = Field(description="a line for each that is not")
    n_lanes: int = Field(
        ge=1, le=MAX_LANES, description="lanes of the road; the most of them where they change"
    )
    frames: Count = Field(description="frames that were filtered")
    frames_scored: Count = Field(
        description="annotated frames that are not crossing; 0 without ground truth"
    )
    mean_log_evidence: Finite | None = Field(description="natural logarithm, mean over the frames")
    impossible_frames: Count = Field(
        description="frames whose evidence the model does not allow; they keep their prediction"
    )
    warnings: list[str] = Field(description="what was odd, a line each")


class Run(Summary):
    """run.json: where the numbers come from."""

    config_hash: str = Field(
        description="sha256 of the resolved experiment, whatever the order of its keys"
    )
    data: list[Data] = Field(description="the files that were read")
    versions: dict[str, str] = Field(
        description="of Python and of the packages that numbers depend on"
    )
    git: dict[str, Any] | None = Field(
        description="commit, and whether the checkout is dirty; null where the package is installed"
    )
    created: str = Field(description="time, UTC")
    seconds: Finite | None = Field(
        default=None, description="that reading, filtering and scoring took"
    )
    frame_rate: float = Field(gt=0, allow_inf_nan=False, description="frames per second")
    values: dict[str, Annotated[list[str], Field(min_length=1)]] = Field(
        description="names of each hidden node's values"
    )


class RunScores(Summary):
    """scores.json of a run. `model` and `detector` are there with ground truth."""

    model: Scores | None = Field(default=None, description="scores of the belief")
    detector: Scores | None = Field(
        default=None, description="scores of the evidence rule's own answer"
    )
    sure: Share | None = Field(
        description="share of frames whose lane has a belief of at least .9; null without frames"
    )
    lanes: list[Annotated[list[Finite], Field(min_length=3, max_length=3)]] = Field(
        description="the lane over time: [lane, from second, to second]; of several clips none"
    )
    events: Events = Field(description="the lane changes")


def read_json(file: Path) -> dict[str, Any]:
    """The content of a JSON file that this package wrote. Raises InputError for anything else."""
    try:
        content = from_json(files.read_text(file), allow_inf_nan=False)
    except ValueError as error:
        raise InputError(f"{file}: is not JSON ({error})") from None
    if not isinstance(content, dict):
        raise InputError(f"{file}: needs keys and values")
    version = content.get("schema_version", SCHEMA_VERSION)
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{file}: has schema_version {str(version)[:20]}, this program reads {SCHEMA_VERSION}"
        )
    return content


@contextlib.contextmanager
def refusing_damage(place: Path, again: str = _AGAIN) -> Iterator[None]:
    """Say in one line what is wrong with files that this package wrote.

    - again: what to do, the end of the message.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{error}{again}") from None
    except Exception as error:
        # The files were not written by hand: how exactly they are damaged helps nobody.
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{place}: is damaged ({why[:200]}){again}") from error


def _read_run(file: Path) -> dict[str, Any]:
    """The content of run.json, checked as far as a `Result` needs it."""
    run = read_json(file)
    validated(Run, run, str(file))
    return run


# --- the directory -----------------------------------------------------------------------------


def is_result(directory: Path) -> bool:
    """Whether the directory holds a whole result."""
    return all((directory / name).is_file() for name in ("run.json", "scores.json"))


def check_writable(directory: Path, is_ours: Callable[[Path], bool] = is_result) -> None:
    """Raise InputError where a result could not be put there: before anything is computed.

    - is_ours: tells of a directory whether it may be replaced.
    """
    files.check_place(directory)
    if directory.is_symlink() and not directory.exists():
        raise InputError(f"{directory}: is a link to nothing; name another directory")
    if directory.exists():
        if not directory.is_dir():
            raise InputError(f"{directory}: is a file, not a directory")
        if any(directory.iterdir()) and not is_ours(directory):
            raise InputError(f"{directory}: exists and is not a result directory; name another one")


#: Files owned by a result directory. Saving replaces or deletes them; other files are left alone.
OURS = (
    *("experiment.yaml", "run.json", "scores.json", BELIEFS, LINES, "events.csv"),
    *("clips.csv", "labels.txt", "segments.csv"),
    *(
        f"figures/{name}.{style}"
        for name in ("strips", "confusion", "reliability", "coverage")
        for style in ("png", "pdf", "svg")
    ),
)

#: The files that make a directory whole: removed first and written last.
_LAST = ("run.json", "comparison.json", "study.json")


@contextlib.contextmanager
def staged(directory: Path, is_ours: Callable[[Path], bool] = is_result) -> Iterator[Path]:
    """A directory to fill; when the block ends well, its files take the place of those in the
    result `directory`, see `OURS`.

    Raises InputError where that holds something else (see `check_writable`), or cannot be written.
    """
    check_writable(directory, is_ours)
    with files.staged_directory(directory, OURS, _LAST) as temporary:
        yield temporary


def write_result(directory: Path, result: Result) -> None:
    """Write the files of a result into `directory`."""
    with files.parquet_writer(directory / BELIEFS) as write:
        write(files.arrow_table(result.columns()))
    write_rest(directory, result)


def write_rest(directory: Path, result: Result) -> None:
    """Write all files of a result but the beliefs. Raises InputError for one whose beliefs are in
    another directory only."""
    from egolane_pgm.recordings.table import write_table

    if result.lines is not None and len(result.lines):
        write_table(directory / LINES, result.lines)
    if result.clip is not None:
        _write_columns(directory / "clips.csv", result.clip_columns())
    files.write_yaml(directory / "experiment.yaml", _portable(result, directory))
    _write_columns(directory / "events.csv", result.events.columns())
    version = {"schema_version": SCHEMA_VERSION}
    files.write_json(directory / "scores.json", {**version, **result.scores})
    files.write_json(directory / "run.json", {**version, **result.run})


def _portable(result: Result, directory: Path) -> dict[str, Any]:
    """The config of a result in a form that can be run from its directory: the user's own plugin
    files are copied into it, recordings and other files that lie beside the YAML are named by their
    whole path."""
    content, folder = {**result.config}, result.experiment.folder
    for key in ("evidence", "graph"):
        if str(content[key]).endswith(OWN_FILES):
            own = folder / content[key]
            copy = f"{key}_{own.name.removeprefix(f'{key}_')}"
            shutil.copyfile(own, directory / copy)
            content[key] = f"./{copy}"
    for key in ("recording", "ground_truth"):
        if content[key]:
            content[key] = files_in_full(content[key], folder)
    if content["recording"].get("path") == IN_MEMORY and result.lines is not None:
        own = {"path": f"./{LINES}", "frames": None, "missing_frames": "skip"}
        content["recording"] = {**content["recording"], **own}
    if content.get("road"):
        content["road"] = str((folder / content["road"]).absolute())
    return content


def _write_columns(file: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table, numbers to six decimals; NaN is empty."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    cells = [[_cell(value) for value in row] for row in rows]
    files.write_text(file, files.as_csv(list(columns), cells))


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return "" if value != value else round(value, 6)


def read_result(directory: str | Path) -> Result:
    """Read a result directory.

    Raises InputError in one line, naming the directory where it is not one, or the file and what
    is wrong in it.
    """
    directory = Path(directory)
    if not is_result(directory):
        raise InputError(f"{directory}: is not a result directory (no run.json and scores.json)")
    with refusing_damage(directory):
        run, file = _read_run(directory / "run.json"), directory / "experiment.yaml"
        config = files.read_yaml(file, "n_lanes: 4")
        result = Result(
            directory=directory,
            experiment=make_experiment(config, directory, str(file)),
            config=config,
            run=run,
            scores=read_json(directory / "scores.json"),
            values={node: tuple(names) for node, names in run["values"].items()},
            **_read_beliefs(directory / BELIEFS, run),
        )
        return replace(result, lines=_read_lines(directory / LINES, result))


def read_said(directory: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The content of run.json and scores.json, without reading a belief.

    Raises InputError as `read_result`, and where beliefs.parquet has another number of frames.
    """
    with refusing_damage(directory):
        run, scores = _read_run(directory / "run.json"), read_json(directory / "scores.json")
        file = directory / BELIEFS
        with files.open_parquet(file) as beliefs:
            n_frames = beliefs.metadata.num_rows
        if n_frames != run["frames"]:
            raise InputError(f"{file}: has {n_frames} frames, run.json says {run['frames']}")
    return run, scores


def _read_lines(file: Path, result: Result) -> LineLog | None:
    """The lines of a result's directory, None where there are none."""
    from egolane_pgm.recordings.table import read_table

    if not file.exists():
        return None
    log = read_table(file)
    if not np.array_equal(log.frame_id, result.frame_id):
        raise InputError(f"{file}: has other frames than beliefs.parquet")
    return replace(log, time_s=result.time_s, clip=result.clip)


# --- where numbers come from -------------------------------------------------------------------


def provenance(
    name: str, content: Mapping[str, Any], data: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Where numbers come from, for every file that has some.

    content: what was configured, all defaults included. data: an entry for each file that was read,
    as `drive.data_entries` gives them.
    """
    return {
        "name": name,
        "config_hash": config_hash(content),
        "data": list(data),
        "versions": versions(),
        "git": git_state(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


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
