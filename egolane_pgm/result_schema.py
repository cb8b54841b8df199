"""What stands in the files of a result directory: each key of run.json and scores.json with its
type, and each column of beliefs.parquet.

Everything that reads a result reads it through `read_run`, `read_scores` and `read_beliefs` (by
`results.read_result`), so that a file that was damaged, cut off or edited is refused here, in one
line that names file and key, and nothing behind has to expect it. Keys and columns that are not
known here are left alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic_core import from_json

from egolane_pgm.experiment import Section, validated
from egolane_pgm.tools.files import open_parquet, read_text
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
    plugins: dict[str, dict[str, str]] = Field(
        description="file and sha256 of graph and evidence rule"
    )
    code: str | None = Field(default=None, description="a checksum of this package's code")
    seconds: Finite | None = Field(
        default=None, description="that reading, filtering and scoring took"
    )
    frame_rate: float = Field(gt=0, allow_inf_nan=False, description="frames per second")
    values: dict[str, Annotated[list[str], Field(min_length=1)]] = Field(
        description="names of each hidden node's values"
    )

    @model_validator(mode="after")
    def _has_lanes(self) -> Self:
        lanes = [str(k + 1) for k in range(self.n_lanes)]
        if self.values.get("Lane") != lanes:
            raise ValueError(f"values.Lane is not 1 to {self.n_lanes}, the lanes of n_lanes")
        return self


class Delay(Stored):
    """How late lane changes are held, in frames; see `scoring.stability`."""

    median_frames: Finite | None = Field(description="median over the changes that were not missed")
    p90_frames: Finite | None = Field(description="90th percentile of the same")
    share_missed: Share | None = Field(description="share of the changes that were never held")
    changes: MeanCount = Field(description="true lane changes")


class PerLane(Stored):
    """Scores of each lane, from lane 1."""

    precision: list[Share] = Field(description="right over predicted as that lane")
    recall: list[Share] = Field(description="right over actual")
    f1: list[Share] = Field(description="harmonic mean of the two")


class Intervals(Stored):
    """95 % intervals [low, high]; null for a short drive."""

    accuracy: Bounds | None = Field(description="[low, high]")
    f1: Bounds | None = Field(description="[low, high]")


class Scores(Stored):
    """All scores of one belief, see `scoring.summary.score_with_intervals`; null where a score is
    not defined. Row k of `confusion` counts the frames that were answered k + 1, the last row those
    without an answer; column k those whose true lane is k + 1."""

    precision: Share = Field(description="mean over the lanes")
    recall: Share = Field(description="mean over the lanes")
    f1: Share = Field(description="mean over the lanes of their F1 (macro F1)")
    accuracy: Share = Field(description="right over scored frames")
    log_loss: Finite | None = Field(description="over all annotated frames, crossing ones too")
    brier: Finite | None = Field(description="0 to 2, 0 is perfect")
    expected_calibration_error: Finite | None = Field(description="0 to 1, 15 bins")
    coverage: Share = Field(description="share of scored frames that get an answer")
    false_switches_per_minute: Finite | None = Field(
        description="of the assigned lane, while the true one stays"
    )
    delay: Delay = Field(description="how late lane changes are held")
    per_lane: PerLane = Field(description="scores of each lane")
    confusion: list[list[MeanCount]] = Field(description="n + 1 rows of n counts")
    frames: MeanCount = Field(description="annotated frames")
    frames_scored: MeanCount = Field(description="those that are not crossing")
    intervals: Intervals = Field(description="95 % block-bootstrap intervals")

    @model_validator(mode="after")
    def _is_of_one_road(self) -> Self:
        n_lanes = len(self.confusion) - 1
        if n_lanes < 1 or any(len(row) != n_lanes for row in self.confusion):
            raise ValueError("confusion is not of n + 1 rows of n counts")
        return self


class Told(Stored):
    """How many told lane changes are right within some seconds."""

    right: MeanCount = Field(description="events that tell a true change")
    false: MeanCount = Field(description="events that tell none, where the truth speaks")
    missed: MeanCount = Field(description="true changes that are not told")
    precision: Share | None = Field(description="right / (right + false)")
    recall: Share | None = Field(description="right / (right + missed)")
    false_per_hour: Finite | None = Field(description="false events per hour of annotated frames")


class EventDelay(Stored):
    """Seconds from the end of a true crossing to the telling."""

    median: Finite | None = Field(description="seconds, negative where told before the end")
    p90: Finite | None = Field(description="90th percentile, seconds")


class Lead(Stored):
    """Seconds from a warning to the lane change."""

    median: Finite | None = Field(description="seconds")
    p10: Finite | None = Field(description="10th percentile, seconds")


class Warned(Stored):
    """How early the car is seen to cross a line, see `scoring.events.score_crossing`."""

    auc: Share | None = Field(description="area under the ROC curve for `this frame is crossing`")
    precision: Share | None = Field(description="share of warned frames that are crossing")
    recall: Share | None = Field(description="share of crossing frames that are warned of")
    changes: MeanCount = Field(description="true lane changes")
    warned: MeanCount = Field(description="how many of them a warning precedes or meets")
    lead_s: Lead = Field(description="from the warning to the change of the label")
    warnings: MeanCount = Field(description="how many there are")
    false_per_hour: Finite | None = Field(description="warnings far from any crossing, per hour")


class Events(Stored):
    """The lane changes that are told: how many, and, with ground truth, how right they are; see
    `scoring.events.event_scores`."""

    told: MeanCount = Field(
        description="told lane changes; with ground truth those that can be right or false"
    )
    changes: MeanCount | None = Field(default=None, description="true lane changes")
    hours: Finite | None = Field(default=None, description="of annotated frames")
    within: dict[str, Told] | None = Field(
        default=None, description="per tolerance in seconds, `0.5`, `1` and `2`"
    )
    delay_s: EventDelay | None = Field(
        default=None, description="from the end of the true crossing to the telling"
    )
    crossing: Warned | None = Field(
        default=None,
        description="the probability of being on a line as a warning, of graphs with RoadPosition",
    )

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

    name: str = Field(description="name of the experiment")
    scores: dict[str, Scores] = Field(
        description="by which frames: `all_frames`, and others that the comparison names"
    )

    @model_validator(mode="after")
    def _has_all_frames(self) -> Self:
        if "all_frames" not in self.scores:
            raise ValueError("scores.all_frames: is missing")
        return self


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


class HeldOutScores(Stored):
    """scores.json of an experiment that was compared."""

    schema_version: int = Field(description="version of these keys")
    name: str = Field(description="name of the experiment")
    held_out: HeldOut = Field(description="its part of the comparison")


#: Per score [estimate, low, high].
Differences = dict[str, Annotated[list[Finite], Field(min_length=3, max_length=3)] | None]


class Compared(HeldOut):
    """What a comparison says of an experiment on a recording."""

    source: str = Field(description="name of its file")
    graph: str = Field(description="graph")
    evidence: str = Field(description="evidence rule")
    filter: str = Field(description="filter")
    fit: str = Field(description="how parameters were fitted without each block")
    tuned_on: str = Field(description="what the parameters have seen, as in the experiment")
    is_causal: bool = Field(description="false: a belief about a frame uses later frames too")
    causal: Causal = Field(description="the same of filter and evidence apart")
    why_not_causal: list[str] = Field(description="a line for each that is not")
    unassigned_below: Share = Field(description="probability that an answer needs")
    free_parameters: Count = Field(description="numbers that were fitted to labels")
    fixed_parameters: Count | None = Field(description="numbers that `fit: tune` does not search")
    trials: Count | None = Field(description="trials of each block's search")
    microseconds_per_frame: Finite = Field(description="evidence and filter")
    chosen: list[str] = Field(description="the parameters that `fit: choose` chose")
    parameters: list[dict[str, Any]] = Field(
        description="per block those that were fitted without it; empty for several seeds"
    )
    spread: dict[str, dict[str, Finite | None]] = Field(
        description="per choice of frames and score the standard deviation over the seeds"
    )
    seeds: list[dict[str, Any]] = Field(description="parameters and scores with each seed")
    lags: dict[str, Any] | None = Field(description="scores of answers that wait, if asked for")
    difference_to: str | None = Field(description="name of the first experiment")
    difference: dict[str, Differences] | None = Field(
        description="per choice of frames and score, 95 % by paired block bootstrap"
    )
    health: dict[str, Any] | None = Field(description="of the model, if asked for")
    events: dict[str, Any] | None = Field(description="scores of lane changes, if asked for")


class ComparedRecording(Stored):
    """What a comparison says of a recording."""

    title: str = Field(description="what it is called")
    drive: str | None = Field(
        default=None, description="title of the first recording of its drive; if told"
    )
    run: Count | None = Field(description="the paper's run, if it is one")
    frames: Count = Field(description="annotated frames")
    blocks: Count = Field(description="parts that were held out, one after the other")
    notes: list[str] = Field(description="what was odd, a line each")
    health: dict[str, Any] | None = Field(description="of the detector, if asked for")
    experiments: list[Compared] = Field(min_length=1, description="the first is compared with")


class Together(Stored):
    """An experiment over several recordings: plain means."""

    name: str = Field(description="name of the experiment")
    recordings: Count = Field(description="how many there are")
    drives: Count = Field(description="how many drives they are of")
    scores: Differences = Field(description="per score, null where a drive is short")
    spread: dict[str, Finite | None] = Field(description="standard deviation over the seeds")
    difference: Differences | None = Field(description="to the first experiment")


class Comparison(Stored):
    """`egolane compare --json` of experiments, each block of a drive held out; see
    `comparing.groups.document`."""

    schema_version: int = Field(description="version of these keys")
    held_out: Literal[True] = Field(description="whether scores are of frames held out")
    blocks: Count = Field(description="parts that were held out, one after the other")
    recordings: list[ComparedRecording] = Field(
        min_length=1, description="those that were compared"
    )
    together: list[Together] = Field(description="the experiments over all recordings")
    failed: list[dict[str, Any]] = Field(description="title, run and error of the others")


class ComparisonPart(ComparedRecording):
    """comparison.json of one recording."""

    schema_version: int = Field(description="version of these keys")


class InSampleRun(Stored):
    """A run of the paper under several graphs."""

    run: Count = Field(description="number of the paper's run")
    scores: dict[str, dict[str, Any]] = Field(description="per graph, and of the detector")
    mean_log_evidence: dict[str, Finite | None] = Field(description="per graph")


class InSample(Stored):
    """`egolane compare --json` of graphs with the paper's parameters."""

    schema_version: int = Field(description="version of these keys")
    parameters: str = Field(description="recovered or published")
    tuned_on: Literal["same_frames"] = Field(description="the scores are of frames seen before")
    runs: list[InSampleRun] = Field(min_length=1, description="the paper's runs")


class PaperScores(Stored):
    """Scores of a repeated run, as the paper has them."""

    precision: Share = Field(description="mean over the lanes")
    recall: Share = Field(description="mean over the lanes")
    f1: Share = Field(description="as the paper computes it")
    accuracy: Share = Field(description="right over scored frames")
    log_loss: Finite | None = Field(description="over all annotated frames, crossing ones too")
    confusion: list[list[Count]] = Field(description="n + 1 rows of n counts, see `Scores`")


class ReproducedRun(Stored):
    """A run of the paper, repeated."""

    run: Count = Field(description="number of the paper's run")
    name: str = Field(description="name of the experiment")
    tuned_on: str = Field(description="what the parameters have seen, as in the experiment")
    frames: Count = Field(description="frames that were filtered")
    frames_scored: Count = Field(description="annotated frames that are not crossing")
    detector_frames_off: Count = Field(description="frames off the detector's published matrix")
    model_frames_off: Count = Field(description="frames off the model's")
    detector: PaperScores = Field(description="of the detector's own answer")
    model: PaperScores = Field(description="of the belief")


class Reproduction(Stored):
    """`egolane reproduce --json`."""

    schema_version: int = Field(description="version of these keys")
    parameters: str = Field(description="recovered or published")
    runs: list[ReproducedRun] = Field(description="the runs, in the order asked for")
    total_frames_off: Count = Field(description="over detectors and models of all runs")


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


def parse_comparison(text: str | bytes, file: Path) -> Any:
    """What comparison.json says: of several recordings, of one, or in-sample. Raises InputError as
    `read_run`."""
    again = "; compare again"

    def model_of(content: dict[str, Any]) -> type[Section]:
        return (
            ComparisonPart if "title" in content else InSample if "runs" in content else Comparison
        )

    return _parsed(text, file, model_of, again)


def _read_json(file: Path, model_of: Callable[[dict[str, Any]], type[Section]]) -> Any:
    return _parsed(_text_of(file), file, model_of)


def _parsed(
    text: str | bytes,
    file: Path,
    model_of: Callable[[dict[str, Any]], type[Section]],
    again: str = _AGAIN,
) -> Any:
    try:
        content = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise InputError(f"{file}: is not JSON ({error}){again}") from None
    if not isinstance(content, dict):
        raise InputError(f"{file}: needs keys and values{again}")
    version = content.get("schema_version", SCHEMA_VERSION)
    if version != SCHEMA_VERSION or isinstance(version, bool):
        raise InputError(
            f"{file}: has schema_version {str(version)[:20]}, this program reads"
            f" {SCHEMA_VERSION}{again}"
        )
    validated_in_one_line(model_of(content), content, file, again)
    return content


def validated_in_one_line(
    model: type[Section], content: Any, file: Path, again: str = _AGAIN
) -> None:
    """Raise InputError, in one line, where the content does not fit the model."""
    try:
        validated(model, content, str(file))
    except InputError as error:
        first, *others = error.lines
        more = f" (and {len(others)} more of the like)" if others else ""
        raise InputError(f"{first}{more}{again}") from None


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
        with open_parquet(file) as stored:
            table = stored.read()
            names = table.column_names
    except InputError as error:
        raise InputError(f"{error}{_AGAIN}") from None
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


@dataclass(frozen=True)
class Column:
    """A column of beliefs.parquet.

    - name: with NODE_VALUE for each value of each hidden node, detector_LANE for each lane.
    - needed: whether it has to be there: "always"; "sometimes"; or the name of another column,
      which it goes with.
    """

    name: str
    kind: str
    needed: str
    meaning: str


#: The columns of beliefs.parquet in their order.
COLUMNS = (
    Column("frame_id", "int64", "always", "increases from row to row"),
    Column("time_s", "float64", "always", "seconds"),
    Column("NODE_VALUE", "float64", "always", "belief: Lane_1, ..., SensorState_OK, ..."),
    Column(
        "crossing",
        "float64",
        "sometimes",
        "probability that the car is on a line between two lanes, of graphs with RoadPosition",
    ),
    Column("assigned_lane", "int64", "always", "the answer; 0 for none (a tie, unassigned_below)"),
    Column("detector_LANE", "float64", "detector_lane", "the evidence rule's own answer"),
    Column("detector_lane", "int64", "sometimes", "its most probable lane; 0 for none"),
    Column("log_evidence", "float64", "always", "natural logarithm"),
    Column("is_impossible", "bool", "always", "the model does not allow the frame's evidence"),
    Column("true_lane", "int64", "always", "null where not annotated"),
    Column("is_crossing", "bool", "always", "the car is changing lanes; null where not annotated"),
    Column("clip", "string", "sometimes", "name of the clip, where there are several"),
    Column("road_lanes", "int64", "sometimes", "lanes of the road, with n_lanes: map"),
    Column("origin", "int64", "road_lanes", "lane k is lane k - origin of the first frame"),
    Column("block", "int64", "sometimes", "of a comparison: the block that was left out"),
)


def _columns(run: Mapping[str, Any], there: set[str]) -> Iterator[tuple[str, str, bool]]:
    """The name of each column, its type, and whether it has to be there."""
    several = {
        "NODE_VALUE": [name for names in belief_columns(run).values() for name in names],
        "detector_LANE": tentative_columns(run),
    }
    for column in COLUMNS:
        is_needed = column.needed == "always" or column.needed in there
        for name in several.get(column.name, [column.name]):
            yield name, column.kind, is_needed


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
