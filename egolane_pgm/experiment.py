"""The keys of an experiment: its recording, evidence rule, graph, filter and parameters.

`loading` reads them from YAML files; `model` checks the parameters of plugins.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    InstanceOf,
    PlainSerializer,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
    with_config,
)
from typing_extensions import TypedDict

from egolane_pgm.contracts import Graph
from egolane_pgm.types import MAX_LANES, InputError, near_word

#: What an experiment keeps for `n_lanes: map`.
FROM_MAP = 0

#: The key of the detector's parameters.
DETECTOR = "detector"


def plain(value: Any) -> Any:
    """Return a copy: lists become tuples, NumPy's numbers and arrays Python's, and paths text."""
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return tuple(map(plain, value))
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _named(value: Any) -> Any:
    """A name, the content of a graph in memory, or the name of the class of another object."""
    if value is None or isinstance(value, str):
        return value
    return value.keys if isinstance(value, Graph) else type(value).__name__


def _check_range(value: tuple[int, int | None]) -> tuple[int, int | None]:
    first, stop = value
    if stop is not None and first >= stop:
        raise ValueError(f"[{first}, {stop}] is an empty range")
    return value


def _check_sampler(value: Any) -> Any:
    if not (value is None or isinstance(value, str) or hasattr(value, "sample_relative")):
        raise ValueError("needs the name of a sampler, or in Python a sampler of Optuna")
    return value


def _check_strength(value: Any) -> Any:
    if value is None:
        return value
    weights = value.values() if isinstance(value, Mapping) else (value,)
    are_numbers = all(isinstance(each, (int, float)) for each in weights)
    if not are_numbers or not all(0 < weight <= 1e9 for weight in weights):
        raise ValueError("needs a number greater than 0, at most 1e9, or one by name of the node")
    return value


#: What a model was tuned on, from held out to in-sample: nothing, another drive, other frames of
#: the drive that is scored, unknown frames, its frames as another detector saw them, or its frames.
TunedOn = Literal[
    "not_tuned", "other_drive", "other_frames", "unknown", "same_drive", "same_frames"
]


@dataclass(frozen=True)
class TrainedOn:
    """The drive that a fit was trained on, as `tune` and `learn` write it.

    - lines, labels: some marks of the whole recording, see `identity.marks_of`.
    - frames: frame ids of the training frames: first, and the one after the last, of each range.
    """

    lines: str
    labels: str
    frames: tuple[tuple[int, int], ...]


#: What the author of an experiment states, or what its fit was trained on.
Origin = TunedOn | Annotated[tuple[TrainedOn, ...], WithJsonSchema({"type": "array"})]

#: A number greater than 0.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

#: A number of lanes, or `map`.
_LaneNumber = Annotated[int, Field(ge=1, le=MAX_LANES)] | Literal["map"]

#: A list, which may be written without brackets if it has one item.
_OneOrSeveral = Annotated[
    tuple[str, ...],
    BeforeValidator(
        lambda value: (value,) if isinstance(value, str) else value,
        json_schema_input_type=str | Annotated[tuple[str, ...], Field(min_length=1)],
    ),
]

#: A section with free keys, such as parameters.
_Keys = Annotated[dict[str, Any], AfterValidator(plain)]


class Section(BaseModel):
    """Keys of a YAML file; unknown keys are refused, and no key can be set later."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @field_validator("*", mode="before")
    @classmethod
    def _is_no_flag(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse true and false for a number, which pydantic takes for 1 and 0."""
        kind = cls.model_fields[str(info.field_name)].annotation
        if isinstance(value, bool) and kind is not bool:
            raise ValueError("takes neither true nor false")
        return value

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values for some keys, which are not checked."""
        return super().model_copy(update=plain(update or {}), deep=deep)


AnySection = TypeVar("AnySection")


#: A column of a table, or one for each line in a table with a row per frame.
_Theirs = str | tuple[str, ...]


@with_config(ConfigDict(extra="allow"))
class Columns(TypedDict, total=False):
    """The columns of a table, or the fields of messages, by our names, and their units.

    Any other key is an input of the graph (`BOUNDS`), such as Rain.
    """

    frame_id: Annotated[
        str | None, Field(description="frame number; null: frames are numbered by their times")
    ]
    time_s: Annotated[
        str | None, Field(description="time of the frame; null: frame id over frame rate")
    ]
    line: Annotated[str, Field(description="number of the line, from 1 or from 0")]
    offset_m: Annotated[
        _Theirs,
        Field(
            description="lateral offset of the line; a list of columns, from left to right, for a"
            " table with a row per frame",
            examples=["lateral", ["left", "right"]],
        ),
    ]
    is_valid: Annotated[
        _Theirs,
        Field(description="whether the detector trusts the line: true or false, 1 or 0"),
    ]
    is_continuous: Annotated[
        _Theirs, Field(description="whether the line is not dashed, as `is_valid`")
    ]
    lri: Annotated[_Theirs, Field(description="line reliability index")]
    left_positive: Annotated[
        bool, Field(description="whether offsets are positive to the left (ISO 8855, ROS)")
    ]
    unit: Annotated[Literal["m", "cm", "mm"], Field(description="unit of the offsets")]
    time_unit: Annotated[Literal["s", "ms", "us", "ns"], Field(description="unit of the times")]


def _columns_per_line(columns: Columns) -> Columns:
    """Refuse columns of which some are given per line and others are not."""
    for name, value in columns.items():
        if name not in Columns.__annotations__:
            meant = near_word(name, Columns.__annotations__) if name.islower() else ""
            if meant or not isinstance(value, str):
                raise ValueError(f"unknown key '{name}'{meant}")
    offset = columns.get("offset_m")
    n_lines = len(offset) if isinstance(offset, tuple) else None
    for name in ("is_valid", "is_continuous", "lri"):
        theirs = columns.get(name)
        if theirs is not None and n_lines != (len(theirs) if isinstance(theirs, tuple) else None):
            raise ValueError(f"{name}: needs as many columns as offset_m")
    return plain(columns)  # type: ignore[no-any-return]


#: Columns, checked.
CheckedColumns = Annotated[Columns, AfterValidator(_columns_per_line)]


class Recording(Section):
    """The source of the lines: a file (`path`) or a simulated drive (`simulate`)."""

    path: str | None = Field(
        default=None,
        description="the file of the lines, or a folder of such; with `detector` a video, a folder"
        " of pictures or a pattern; relative to the YAML",
        examples=["drive.csv", "drive.bag", "drive.mcap", "frames/*.png"],
    )
    format: str | None = Field(
        default=None,
        description="name of the format, if it does not follow from the ending of `path`, or a file"
        " with `read(path, **options)`",
        examples=["tusimple", "./my_format.py"],
    )
    topic: str | None = Field(
        default=None,
        description="topic of a bag; by default the topic of the paper's line detectors",
        examples=["/isis_line_detector/lines"],
    )
    frames: Annotated[tuple[int, int], AfterValidator(_check_range)] | None = Field(
        default=None,
        description="first frame id and the one after the last",
        examples=[[238, 10190]],
    )
    frame_rate: Positive = Field(default=10.0, le=1e6, description="frames per second")
    missing_frames: Literal["skip", "hold", "predict"] = Field(
        default="skip",
        description="how missing frame ids are filled in: not at all (`skip`), with the frame"
        " before (`hold`), or with a frame without evidence (`predict`)",
    )
    simulate: str | None = Field(
        default=None,
        description="name of a simulated drive (`egolane show`)",
        examples=["quickstart"],
    )
    seed: int = Field(default=0, ge=0, description="random seed of the simulated drive")
    camera: str | None = Field(
        default=None,
        description="YAML file of the camera, for pictures and for lines given in pixels",
        examples=["cam.yaml"],
    )
    detector: str | None = Field(
        default=None,
        description="name or file of the detector for the video or pictures at `path`",
        examples=["ml", "./my_detector.py"],
    )
    right: str | None = Field(
        default=None,
        description="the pictures of the second camera of a stereo pair, as `path`",
        examples=["right/*.png"],
    )
    options: _Keys = Field(
        default_factory=dict,
        description="further options of the format's reader",
        examples=[{"valid": "always"}],
    )
    columns: CheckedColumns | None = Field(
        default=None,
        description="the columns of a table, or the fields of a topic's messages, by our names",
        examples=[{"offset_m": "lateral", "left_positive": True}],
    )

    @model_validator(mode="after")
    def _one_source(self) -> Recording:
        if (self.path is None) == (self.simulate is None):
            raise ValueError("needs either path or simulate")
        return self


class GroundTruth(Section):
    """Annotated lanes, which are needed for scores only."""

    path: str = Field(
        description="text file with `frame;lane;crossing` in each line; relative to the YAML",
        examples=["ground_truth.txt"],
    )
    extra_rows: tuple[tuple[int, int, int], ...] = Field(
        default=(),
        description="rows that the file lacks: frame, lane, crossing (0 or 1)",
        examples=[[[0, 2, 0]]],
    )


class FitSettings(Section):
    """How parameters or tables are fitted: the settings of `tune`, `learn` and held-out runs."""

    method: Literal["none", "learn", "tune"] = Field(
        default="none",
        description="how a held-out run fits the model to the other blocks: not at all, as `learn`"
        " or as `tune` does",
    )
    folds: int = Field(
        default=5, ge=2, description="number of blocks of the drive, held out in turn"
    )
    untrusted_frames: tuple[
        Annotated[tuple[int, int | None], AfterValidator(_check_range)], ...
    ] = Field(
        default=(),
        description="ranges of frame ids (first, the one after the last or null) whose labels are"
        " not fitted to",
        examples=[[[0, 100], [9577, None]]],
    )
    objective: Annotated[_OneOrSeveral, Field(min_length=1)] | None = Field(
        default=None,
        description="tune: the score to optimise, by default accuracy, or several; learn:"
        " `log_loss`, the filter's of the labels, the default with labels, or `log_evidence` of"
        " lines and labels, by EM",
        examples=["accuracy", ["accuracy", "log_loss"], "log_evidence"],
    )
    sampler: Annotated[
        Any,
        AfterValidator(_check_sampler),
        PlainSerializer(_named, when_used="json"),
        WithJsonSchema({"type": ["string", "null"]}),
    ] = Field(
        default=None,
        description="tune: the sampler; by default `evolution`, or `nsga2` for several scores; also"
        " the name of a class of `optuna.samplers`, and in Python any sampler of Optuna",
        examples=["evolution", "tpe", "cma-es", "random", "nsga2", "GPSampler"],
    )
    trials: int | None = Field(
        default=None,
        ge=1,
        le=10**7,
        description="tune: total number of trials; learn: number of starts, of which the best is"
        " kept: the declared values, then random ones",
        examples=[3000],
    )
    seed: int = Field(default=0, ge=0, description="random seed of the sampler, and of the starts")
    parameters: _Keys = Field(
        default_factory=dict,
        description="by name [low, high], the names of a choice, or one value to keep; if"
        " parameters of the detector (detector.NAME) are among them, only what is named is"
        " searched",
        examples=[{"sigma1": [0.1, 1], "p1": 0.9}],
    )
    learns: Literal["rule", "tables", "parameters"] | None = Field(
        default=None,
        description="learn: parameters of the evidence rule, from labels (`rule`), or tables or"
        " parameters of the graph; by default the rule if it can learn, otherwise tables",
    )
    labels: bool = Field(default=True, description="learn: whether annotated lanes are used")
    block: int = Field(
        default=300,
        ge=1,
        description="learn, log_loss: number of frames that weigh as much as one against the prior,"
        " since neighbouring frames are nearly the same",
    )
    strength: Annotated[
        Any, AfterValidator(_check_strength), WithJsonSchema({"type": ["number", "object", "null"]})
    ] = Field(
        default=None,
        description="learn: weight of the declared tables, in frames per row (log_loss: blocks), by"
        " default 10 for log_loss and 100 for log_evidence; or by name of the node",
        examples=[100, {"Lane": 1000, "WOR": 10}],
    )

    @property
    def scores(self) -> tuple[str, ...]:
        """The scores that a search optimises."""
        return self.objective or ("accuracy",)

    @field_validator("parameters", mode="before")
    @classmethod
    def _of_detector(cls, value: Any) -> Any:
        if not isinstance(value, Mapping) or not isinstance(value.get(DETECTOR), Mapping):
            return value
        flat = {f"{DETECTOR}.{name}": each for name, each in value[DETECTOR].items()}
        return {**{k: v for k, v in value.items() if k != DETECTOR}, **flat}


class Experiment(Section):
    """One experiment: a recording, how its lines become evidence, the graph, the parameters."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="short name; the result is written to results/NAME",
        examples=["my_drive"],
    )
    description: str = Field(
        default="", description="what it is, in a line", examples=["commute, light rain"]
    )
    recording: Recording = Field(description="source of the lines")
    ground_truth: GroundTruth | None = Field(
        default=None, description="annotated lanes; without them there are no scores"
    )
    road: str | None = Field(
        default=None,
        description="the road table of the drive (`egolane locate` writes it), for n_lanes: map",
        examples=["road.parquet"],
    )
    n_lanes: int = Field(
        le=MAX_LANES,
        strict=True,
        description="number of lanes of the road, or `map` to take it from the road table: the"
        " recording is cut into drives whenever the number changes",
        examples=[4],
    )
    evidence: str = Field(
        default="counting",
        description="rule by which lines become evidence: a name (`egolane show`) or a file of your"
        " own",
        examples=["line_geometry", "./my_evidence.py"],
    )
    graph: Annotated[
        str | InstanceOf[Graph],
        PlainSerializer(_named),
        WithJsonSchema({"type": "string"}),
    ] = Field(
        default="sensor_failure",
        description="the network: a name (`egolane show`) or a file of your own",
        examples=["position_in_lane", "./my_graph.py"],
    )
    filter: Literal["assumed_density", "exact", "smoothed", "viterbi", "fixed_lag"] = Field(
        default="assumed_density",
        description="inference method: `assumed_density` (product of marginals, as in the paper),"
        " `exact` (joint filter), `smoothed` (forward-backward), `viterbi` (smoothed; the answer is"
        " the most probable path), `fixed_lag` (`lag` frames of look-ahead)",
    )
    lag: int | None = Field(
        default=None,
        ge=0,
        validate_default=True,
        description="frames that fixed_lag waits before it answers",
        examples=[10],
    )
    start_lane: int | tuple[float, ...] | None = Field(
        default=None,
        description="what is known of the lane in which the drive begins: its number, or how"
        " probable each of the n lanes is",
        examples=[3, [0, 0, 1, 1]],
    )
    evidence_mode: Literal["soft", "hard"] = Field(
        default="soft",
        description="use of the evidence of a frame: the whole likelihood (`soft`), or its most"
        " probable value only (`hard`)",
    )
    min_confidence: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        allow_inf_nan=False,
        description="frames whose most probable lane is less probable get no lane",
    )
    parameters: _Keys = Field(
        default_factory=dict,
        description="values of the parameters of graph and evidence rule (`egolane show GRAPH`),"
        " and in `detector` of the detector; others keep their defaults",
        examples=[{"sigma1": 0.35, "bonus_value": 9}, {"detector": {"every": 2}}],
    )
    tuned_on: Origin = Field(
        default="unknown",
        description="frames used to tune the parameters, printed with every score: the scored"
        " frames (`same_frames`: in-sample), others only, or none; `tune` and `learn` write what"
        " they were trained on, which is compared with the frames of each run",
    )
    fit: FitSettings = Field(
        default=FitSettings(), description="settings of `tune`, `learn` and held-out runs"
    )

    @field_validator("n_lanes", mode="before", json_schema_input_type=_LaneNumber)
    @classmethod
    def _number_or_map(cls, value: Any, info: ValidationInfo) -> Any:
        has_road = info.data.get("road") is not None
        if value == "map" or (has_road and value == FROM_MAP):
            if not has_road:
                raise ValueError("map needs a road table (road: FILE, `egolane locate` writes it)")
            return FROM_MAP
        if has_road:
            raise ValueError("a road table gives the number of lanes (n_lanes: map)")
        if type(value) is int and value < 1:
            raise ValueError("input should be greater than or equal to 1")
        return value

    @field_validator("start_lane")
    @classmethod
    def _lane_of_the_road(cls, value: Any, info: ValidationInfo) -> Any:
        if value is None or "n_lanes" not in info.data:
            return value
        n_lanes = info.data["n_lanes"]
        if n_lanes == FROM_MAP:
            raise ValueError("does not go with n_lanes: map, each drive starts from the prior")
        if isinstance(value, int) and not 1 <= value <= n_lanes:
            raise ValueError(f"the road has lanes 1 (leftmost) to {n_lanes}")
        if isinstance(value, tuple):
            if len(value) != n_lanes:
                raise ValueError(f"needs a lane, or a number for each of the {n_lanes} lanes")
            if not all(0 <= each < math.inf for each in value) or not any(value):
                raise ValueError("the lanes' probabilities are not negative, and not all 0")
        return value

    @field_validator("lag")
    @classmethod
    def _lag_where_needed(cls, value: int | None, info: ValidationInfo) -> int | None:
        chosen = info.data.get("filter", "fixed_lag" if value is not None else None)
        if value is None and chosen == "fixed_lag":
            raise ValueError("filter fixed_lag needs a number of frames to wait, e.g. lag: 10")
        if value is not None and chosen != "fixed_lag":
            raise ValueError(f"only filter fixed_lag waits, filter {chosen} has no lag")
        return value

    @field_validator("parameters")
    @classmethod
    def _goes_with_a_detector(cls, value: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        recording, own = info.data.get("recording"), value.get(DETECTOR, {})
        if not isinstance(own, Mapping):
            raise ValueError(f"{DETECTOR}: needs keys and values")
        if own and recording is not None and recording.detector is None:
            raise ValueError(f"{DETECTOR}: the recording has no detector")
        return value

    @field_validator("min_confidence")
    @classmethod
    def _path_has_every_lane(cls, value: float, info: ValidationInfo) -> float:
        if value and info.data.get("filter") == "viterbi":
            raise ValueError("filter viterbi gives every frame a lane")
        return value

    _source: str = "experiment"

    def __hash__(self) -> int:
        # Dicts have no hash.
        return hash((self.name, self.graph, self.evidence))

    @property
    def keys(self) -> dict[str, Any]:
        """The keys that are set, as `make_experiment` takes them."""
        content = self.model_dump(exclude_unset=True)
        return {**content, "graph": self.graph} if "graph" in content else content

    @property
    def graph_name(self) -> str:
        """The name of the graph."""
        return self.graph if isinstance(self.graph, str) else self.graph.name

    @property
    def source(self) -> str:
        """The YAML file, for messages."""
        return self._source


def make_experiment(content: Mapping[str, Any], source: str) -> Experiment:
    """Make an experiment from its keys. Raises InputError for a key that does not fit.

    - content: keys and values; paths are absolute.
    - source: the YAML file, for messages.
    """
    experiment = validated(Experiment, content, source)
    experiment._source = source
    return experiment


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def validated(kind: type[AnySection], content: Mapping[str, Any], source: str) -> AnySection:
    """Make a section from some keys. Raises InputError for the first one that does not fit."""
    try:
        made: AnySection = _adapter(kind).validate_python(content)  # type: ignore[arg-type]
        return made
    except ValidationError as error:
        raise InputError(f"{source}: {_first_problem(error, kind)}") from None


#: Messages for pydantic's error types, in terms of YAML.
_NEEDS = {
    "model_type": "needs keys and values",
    "dict_type": "needs keys and values",
    "tuple_type": "needs a list",
}


def resolved(experiment: Experiment, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """All keys that have a value, defaults included, as plain types for YAML or JSON.

    `fit` is omitted: a resolved experiment has the fitted parameters themselves.
    """
    content = experiment.model_dump(mode="json", exclude={"fit"}, exclude_none=True)
    if experiment.n_lanes == FROM_MAP:
        content["n_lanes"] = "map"
    if isinstance(experiment.graph, Graph):
        content["graph"] = experiment.graph.name
    content["parameters"] = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in sorted(parameters.items())
    }
    if DETECTOR in experiment.parameters:
        content["parameters"][DETECTOR] = dict(experiment.parameters[DETECTOR])
    return content


def _first_problem(error: ValidationError, kind: Any) -> str:
    """pydantic's first complaint. An unknown key goes before others, with a suggestion."""
    problems = error.errors(include_url=False)
    problem = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    where = ".".join(map(str, problem["loc"]))
    if problem["type"] == "missing":
        return f"{where}: is missing"
    if problem["type"] == "extra_forbidden":
        above, key = ".".join(map(str, problem["loc"][:-1])), str(problem["loc"][-1])
        # Of all sections: a key may be at the wrong place.
        schema = _adapter(kind).json_schema()
        parts = (schema, *schema.get("$defs", {}).values())
        known = {each for part in parts for each in part.get("properties", ())}
        return f"{above}{': ' if above else ''}unknown key '{key}'{near_word(key, known)}"
    value = problem["input"]
    message = problem["msg"].removeprefix("Value error, ")
    message = _NEEDS.get(problem["type"], message[0].lower() + message[1:])
    shown = "" if isinstance(value, dict) else f" (got {repr(value)[:100]})"
    return f"{where}: {message}{shown}" if where else f"{message}{shown}"
