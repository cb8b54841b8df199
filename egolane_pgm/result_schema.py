"""What stands in the files of a result directory: each key of run.json and scores.json with its
type, and each column of beliefs.parquet.

Everything that reads a result reads it through `read_run`, `read_scores` and `read_beliefs` (by
`results.read_result`), so that a file that was damaged, cut off or edited is refused here, in one
line that names file and key, and nothing behind has to expect it. Keys and columns that are not
known here are left alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic_core import from_json

from egolane_pgm.experiment import Section, validated
from egolane_pgm.files import read_parquet, read_text
from egolane_pgm.types import MAX_LANES, InputError

SCHEMA_VERSION = 1

_AGAIN = "; run the experiment again"

Count = Annotated[int, Field(ge=0, le=2**53)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]

#: Of several seeds the mean is said, and so the numbers of frames need not be whole.
MeanCount = Annotated[float, Field(ge=0, allow_inf_nan=False)]

Bounds = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class Stored(Section):
    """A part of a file that a program wrote: types are as JSON has them, further keys are kept."""

    model_config = ConfigDict(extra="allow", strict=True, defer_build=True)


class Causal(Stored):
    """Whether a belief about a frame knows that frame and earlier ones only."""

    filter: bool
    evidence: bool


class Data(Stored):
    """A file that was read."""

    path: str
    sha256: str
    bytes: Count


class Summary(Stored):
    """What run.json and scores.json both say."""

    schema_version: int
    name: str
    tuned_on: Literal["same_frames", "other_frames", "not_tuned", "unknown"]
    is_causal: bool
    causal: Causal
    why_not_causal: list[str]
    n_lanes: int = Field(ge=1, le=MAX_LANES)
    frames: Count
    frames_scored: Count
    mean_log_evidence: Finite | None
    impossible_frames: Count
    warnings: list[str]


class Run(Summary):
    """run.json: where the numbers come from."""

    config_hash: str
    data: list[Data]
    versions: dict[str, str]
    git: dict[str, Any] | None
    created: str
    plugins: dict[str, dict[str, str]]
    frame_rate: float = Field(gt=0, allow_inf_nan=False)
    values: dict[str, Annotated[list[str], Field(min_length=1)]]

    @model_validator(mode="after")
    def _has_lanes(self) -> Self:
        lanes = [str(k + 1) for k in range(self.n_lanes)]
        if self.values.get("Lane") != lanes:
            raise ValueError(f"values.Lane is not 1 to {self.n_lanes}, the lanes of n_lanes")
        return self


class Delay(Stored):
    """How late lane changes are held, in frames; see `scoring.stability`."""

    median_frames: Finite | None
    p90_frames: Finite | None
    share_missed: Share | None
    changes: MeanCount


class PerLane(Stored):
    """Scores of each lane, from lane 1."""

    precision: list[Share]
    recall: list[Share]
    f1: list[Share]


class Intervals(Stored):
    """95 % intervals [low, high]; null for a short drive."""

    accuracy: Bounds | None
    f1: Bounds | None


class Scores(Stored):
    """All scores of one belief, see `scoring.summary.score_with_intervals`; null where a score is
    not defined. Row k of `confusion` counts the frames that were answered k + 1, the last row those
    without an answer; column k those whose true lane is k + 1."""

    precision: Share
    recall: Share
    f1: Share
    accuracy: Share
    log_loss: Finite | None
    brier: Finite | None
    expected_calibration_error: Finite | None
    coverage: Share
    false_switches_per_minute: Finite | None
    delay: Delay
    per_lane: PerLane
    confusion: list[list[MeanCount]]
    frames: MeanCount
    frames_scored: MeanCount
    intervals: Intervals

    @model_validator(mode="after")
    def _is_of_one_road(self) -> Self:
        n_lanes = len(self.confusion) - 1
        if n_lanes < 1 or any(len(row) != n_lanes for row in self.confusion):
            raise ValueError("confusion is not of n + 1 rows of n counts")
        return self


class Told(Stored):
    """How many told lane changes are right within some seconds."""

    right: MeanCount
    false: MeanCount
    missed: MeanCount
    precision: Share | None
    recall: Share | None
    false_per_hour: Finite | None


class EventDelay(Stored):
    """Seconds from the end of a true crossing to the telling."""

    median: Finite | None
    p90: Finite | None


class Lead(Stored):
    """Seconds from a warning to the lane change."""

    median: Finite | None
    p10: Finite | None


class Warned(Stored):
    """How early the car is seen to cross a line, see `scoring.events.score_crossing`."""

    auc: Share | None
    precision: Share | None
    recall: Share | None
    changes: MeanCount
    warned: MeanCount
    lead_s: Lead
    warnings: MeanCount
    false_per_hour: Finite | None


class Events(Stored):
    """The lane changes that are told: how many, and, with ground truth, how right they are; see
    `scoring.events.event_scores`."""

    told: MeanCount
    changes: MeanCount | None = None
    hours: Finite | None = None
    within: dict[str, Told] | None = None
    delay_s: EventDelay | None = None
    crossing: Warned | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        scored = ("changes", "hours", "within", "delay_s")
        there = [name for name in scored if getattr(self, name) is not None]
        if there and len(there) < len(scored):
            lacking = next(name for name in scored if name not in there)
            raise ValueError(f"has {there[0]}, but not {lacking}")
        return self


class HeldOut(Stored):
    """An experiment's part of a comparison, see `comparing.groups.document`."""

    name: str
    scores: dict[str, Scores]

    @model_validator(mode="after")
    def _has_all_frames(self) -> Self:
        if "all_frames" not in self.scores:
            raise ValueError("scores.all_frames: is missing")
        return self


class RunScores(Summary):
    """scores.json of a run. `model` and `detector` are there with ground truth."""

    model: Scores | None = None
    detector: Scores | None = None
    sure: Share | None
    lanes: list[Annotated[list[Finite], Field(min_length=3, max_length=3)]]
    events: Events


class HeldOutScores(Stored):
    """scores.json of an experiment that was compared."""

    schema_version: int
    name: str
    held_out: HeldOut


def read_run(directory: Path) -> Any:
    """What run.json says. Raises InputError in one line, naming the file and a key that does not
    fit."""
    return _read_json(directory / "run.json", lambda _: Run)


def read_scores(directory: Path) -> Any:
    """What scores.json says. Raises InputError as `read_run`."""
    return _read_json(
        directory / "scores.json",
        lambda content: HeldOutScores if "held_out" in content else RunScores,
    )


def _read_json(file: Path, model_of: Callable[[dict[str, Any]], type[Section]]) -> Any:
    text = _text_of(file)
    try:
        content = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise InputError(f"{file}: is not JSON ({error}){_AGAIN}") from None
    if not isinstance(content, dict):
        raise InputError(f"{file}: needs keys and values{_AGAIN}")
    version = content.get("schema_version", SCHEMA_VERSION)
    if version != SCHEMA_VERSION or isinstance(version, bool):
        raise InputError(
            f"{file}: has schema_version {str(version)[:20]}, this program reads"
            f" {SCHEMA_VERSION}{_AGAIN}"
        )
    validated_in_one_line(model_of(content), content, file)
    return content


def validated_in_one_line(model: type[Section], content: Any, file: Path) -> None:
    """Raise InputError, in one line, where the content does not fit the model."""
    try:
        validated(model, content, str(file))
    except InputError as error:
        first, *others = error.lines
        more = f" (and {len(others)} more of the like)" if others else ""
        raise InputError(f"{first}{more}{_AGAIN}") from None


def _text_of(file: Path) -> str:
    if not file.is_file():
        raise InputError(f"{file}: is missing, the result is not whole{_AGAIN}")
    return read_text(file)


# --- beliefs.parquet --------------------------------------------------------------------------


def read_beliefs(file: Path, run: Mapping[str, Any]) -> dict[str, np.ndarray[Any, Any]]:
    """The columns of beliefs.parquet, (T,) each, by name; those that a result may lack only where
    it has them. Of frames that are not annotated `true_lane` is 0 and `is_crossing` false.

    - run: what run.json says, which names the hidden nodes and their values.

    Raises InputError in one line, naming the file and the column, where one is missing, has another
    type, an empty cell, or numbers that cannot be (lanes that the road does not have, beliefs that
    do not add up to 1, frame ids that do not increase).
    """
    import pyarrow as pa

    if not file.is_file():
        raise InputError(f"{file}: is missing, the result is not whole{_AGAIN}")
    try:
        table = read_parquet(file)
        names = table.column_names
    except (OSError, ValueError, pa.ArrowException) as error:
        said = " ".join(str(error).split())[:120]
        raise InputError(f"{file}: is not a whole Parquet file ({said}){_AGAIN}") from None
    if len(table) != run["frames"]:
        raise InputError(f"{file}: has {len(table)} frames, run.json says {run['frames']}{_AGAIN}")
    found: dict[str, np.ndarray[Any, Any]] = {}
    for name, kind, is_needed in _columns(run, set(names)):
        if name in names or is_needed:
            try:
                found[name] = _column(table, name, kind)
            except (pa.ArrowException, KeyError, ValueError) as error:
                raise InputError(f"{file}: column {name}: {error}{_AGAIN}") from None
    for name, problem in _impossible(found, run):
        raise InputError(f"{file}: column {name}: {problem}{_AGAIN}")
    return found


def belief_columns(run: Mapping[str, Any]) -> dict[str, list[str]]:
    """Per hidden node the columns of its values."""
    return {node: [f"{node}_{v}" for v in names] for node, names in run["values"].items()}


def tentative_columns(run: Mapping[str, Any]) -> list[str]:
    """The columns of the detector's own answer."""
    return [f"detector_{k + 1}" for k in range(run["n_lanes"])]


#: The columns whose cells are empty where a frame is not annotated, and what is read there.
_EMPTY: dict[str, int | bool] = {"true_lane": 0, "is_crossing": False}


def _columns(run: Mapping[str, Any], there: set[str]) -> Iterator[tuple[str, str, bool]]:
    """The name of each column, its type, and whether it has to be there."""
    yield "frame_id", "int64", True
    yield "time_s", "float64", True
    for names in belief_columns(run).values():
        yield from ((name, "float64", True) for name in names)
    yield "assigned_lane", "int64", True
    has_detector = "detector_lane" in there
    yield from ((name, "float64", has_detector) for name in tentative_columns(run))
    yield "detector_lane", "int64", False
    yield "log_evidence", "float64", True
    yield "is_impossible", "bool", True
    yield "true_lane", "int64", True
    yield "is_crossing", "bool", True
    yield "clip", "string", False
    yield "road_lanes", "int64", False
    yield "origin", "int64", "road_lanes" in there
    yield "block", "int64", False


def _column(table: Any, name: str, kind: str) -> np.ndarray[Any, Any]:
    import pyarrow as pa

    if table.column_names.count(name) != 1:
        raise ValueError("is missing" if name not in table.column_names else "is there twice")
    column = table.column(name)
    wanted = {"int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_()}.get(
        kind, pa.string()
    )
    is_number = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
    fits = is_number if kind in ("int64", "float64") else column.type == wanted
    if not (fits or (pa.types.is_large_string(column.type) and kind == "string")):
        raise ValueError(f"has type {column.type}, not {kind}")
    if name in _EMPTY:
        column = column.fill_null(pa.scalar(_EMPTY[name], column.type))
    if column.null_count:
        raise ValueError(f"has {column.null_count} empty cells")
    try:
        array = column.cast(wanted).to_numpy(zero_copy_only=False)
    except pa.ArrowException:
        raise ValueError(f"has type {column.type} and values that are no {kind}") from None
    return np.asarray(array, dtype=np.str_) if kind == "string" else np.asarray(array)


def _impossible(
    found: Mapping[str, np.ndarray[Any, Any]], run: Mapping[str, Any]
) -> Iterator[tuple[str, str]]:
    """Each column with numbers that no result has, and what is wrong with them."""
    n_lanes = run["n_lanes"]
    if np.any(np.diff(found["frame_id"]) <= 0):
        yield "frame_id", "does not increase from frame to frame"
    if not np.isfinite(found["time_s"]).all():
        yield "time_s", "is not a number in every frame"
    if np.isnan(found["log_evidence"]).any():
        yield "log_evidence", "is not a number in every frame"
    groups = {**belief_columns(run), "detector": tentative_columns(run)}
    for names in groups.values():
        for name in names:
            values = found.get(name)
            # NaN is not between 0 and 1 either.
            if values is not None and not ((values >= 0) & (values <= 1 + 1e-9)).all():
                yield name, "is not a probability in every frame"
    for node, names in belief_columns(run).items():
        total = np.sum([found[name] for name in names], axis=0)
        if np.any(np.abs(total - 1) > 1e-6):
            yield f"{node}_{run['values'][node][0]}", f"the belief over {node} does not add up to 1"
    for name in ("assigned_lane", "detector_lane", "true_lane", "road_lanes"):
        values = found.get(name)
        if values is not None and np.any((values < 0) | (values > n_lanes)):
            yield name, f"has lanes that are not of 1 to {n_lanes}"
