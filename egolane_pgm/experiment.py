"""The keys of an experiment: its recording, evidence rule, graph, filter and parameters.

`loading` reads them from YAML files; `model` checks the parameters of plugins.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, NoReturn, Self, TypeVar, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import ErrorDetails

from egolane_pgm.types import MAX_LANES, InputError, not_one_of, suggestion

#: What an experiment keeps for `n_lanes: map`.
FROM_MAP = 0


class FrozenDict(dict[str, Any]):
    """A dict that stays as it is. It can be pickled, and hashed where its values can."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("an experiment stays as it is; model_copy(update={...}) makes another")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenDict, (dict(self),)


def frozen(value: Any) -> Any:
    """The same with dicts and lists that stay as they are; numbers and arrays of NumPy become
    Python's, and paths text."""
    if isinstance(value, Mapping):
        return FrozenDict({key: frozen(each) for key, each in value.items()})
    if isinstance(value, (np.ndarray, np.generic)):
        return frozen(value.tolist())
    if isinstance(value, (list, tuple)):
        return tuple(map(frozen, value))
    if isinstance(value, set):
        return frozenset(map(frozen, value))
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _or_map(schema: dict[str, Any]) -> None:
    """A number of lanes may be left to the map."""
    number = {"type": schema.pop("type"), "minimum": 1, "maximum": schema.pop("maximum")}
    schema["anyOf"] = [number, {"const": "map"}]


def _or_one(schema: dict[str, Any]) -> None:
    """A list of one may be written without the brackets."""
    several = {key: schema.pop(key) for key in ("type", "items")}
    schema["anyOf"] = [several["items"], several]


def _or_from_frame(schema: dict[str, Any]) -> None:
    """Ranges of frames may be all from one on."""
    ranges = {key: schema.pop(key) for key in ("type", "items")}
    from_frame = {"from_frame": {"type": "integer"}}
    schema["anyOf"] = [
        ranges,
        {"type": "object", "properties": from_frame, "additionalProperties": False},
    ]


#: A number greater than 0.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

#: A section with keys of its own, such as parameters.
_Keys = Annotated[dict[str, Any], AfterValidator(frozen)]


class Section(BaseModel):
    """Some keys of a YAML file: unknown ones are refused, and nothing in it can be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """The same with other values for some keys, which are not checked."""
        return super().model_copy(update=frozen(update or {}), deep=deep)


AnySection = TypeVar("AnySection", bound=Section)


#: A column of a table, or one for each line in a table with a row per frame.
_Theirs = str | tuple[str, ...]


class Columns(Section):
    """The columns of a table, or the fields of messages, by our names, where theirs are other ones;
    and how they are written."""

    frame_id: str | None = Field(
        default=None, description="number of the frame; null: frames are numbered by their times"
    )
    time_s: str | None = Field(default=None, description="when the frame was seen")
    line: str | None = Field(default=None, description="number of the line, from 1 or from 0")
    offset_m: _Theirs | None = Field(
        default=None,
        description="where the line passes the car; a list of columns, from left to right, in a"
        " table with a row per frame",
        examples=["lateral", ["left", "right"]],
    )
    is_valid: _Theirs | None = Field(
        default=None, description="whether the detector trusts the line: true or false, 1 or 0"
    )
    is_continuous: _Theirs | None = Field(
        default=None, description="whether the line is not dashed, as `is_valid`"
    )
    lri: _Theirs | None = Field(default=None, description="the line reliability index")
    left_positive: bool = Field(
        default=False, description="whether offsets are positive to the left (ISO 8855, ROS)"
    )
    unit: Literal["m", "cm", "mm"] = Field(default="m", description="unit of the offsets")
    time_unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="unit of the times")

    @model_serializer(mode="wrap")
    def said(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The keys that are not left out."""
        return {key: value for key, value in dump(self).items() if key in self.model_fields_set}

    @model_validator(mode="after")
    def _one_column_per_line(self) -> Columns:
        n_lines = len(self.offset_m) if isinstance(self.offset_m, tuple) else None
        for name in ("is_valid", "is_continuous", "lri"):
            theirs = getattr(self, name)
            if theirs is not None and n_lines != (
                len(theirs) if isinstance(theirs, tuple) else None
            ):
                raise ValueError(f"{name}: needs as many columns as offset_m")
        return self


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
        description="name of the format, where the ending of `path` does not tell it, or a file of"
        " your own with `read(path, **options)`",
        examples=["tusimple", "./my_format.py"],
    )
    topic: str | None = Field(
        default=None,
        description="topic of a bag; left out, that of the paper's line detectors",
        examples=["/isis_line_detector/lines"],
    )
    frames: tuple[int, int] | None = Field(
        default=None,
        description="first frame id and the one after the last",
        examples=[[238, 10190]],
    )
    frame_rate: Positive = Field(default=10.0, le=1e6, description="frames per second")
    missing_frames: Literal["skip", "hold", "predict"] = Field(
        default="skip",
        description="what is put in for frame ids that the recording lacks: nothing (`skip`), the"
        " frame before (`hold`), or a frame without evidence (`predict`)",
    )
    lri: Literal["as_recorded", "clip"] = Field(
        default="as_recorded",
        description="whether a line's reliability index is used as recorded or clipped to its"
        " range",
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
        description="name or file of the detector that looks at the video or pictures of `path`",
        examples=["ml", "./my_detector.py"],
    )
    detector_parameters: _Keys = Field(
        default_factory=FrozenDict,
        description="values of the detector's parameters (`egolane show DETECTOR`)",
        examples=[{"every": 2}],
    )
    right: str | None = Field(
        default=None,
        description="the pictures of the second camera of a stereo pair, as `path`",
        examples=["right/*.png"],
    )
    options: _Keys = Field(
        default_factory=FrozenDict,
        description="further options of the format's reader",
        examples=[{"valid": "always"}],
    )
    columns: Columns | None = Field(
        default=None,
        description="the columns of a table, or the fields of a topic's messages, by our names",
        examples=[{"offset_m": "lateral", "left_positive": True}],
    )

    @model_validator(mode="after")
    def _one_source(self) -> Recording:
        if (self.path is None) == (self.simulate is None):
            raise ValueError("needs either path or simulate")
        if self.frames is not None and self.frames[0] >= self.frames[1]:
            raise ValueError(f"frames {list(self.frames)} is an empty range")
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


class Tuning(Section):
    """The settings of `egolane tune`; options of the command override them."""

    search: tuple[Literal["graph", "evidence", "detector"], ...] = Field(
        default=("graph", "evidence"),
        min_length=1,
        description="whose parameters are searched; the detector's are named detector.NAME",
    )
    objective: tuple[str, ...] = Field(
        default=("accuracy",),
        description="the score that is to be best, or several of them",
        examples=["accuracy", ["accuracy", "log_loss"]],
        json_schema_extra=_or_one,
    )
    sampler: str | None = Field(
        default=None,
        description="what proposes the trials; left out, the one that suits the number of scores",
        examples=["evolution", "tpe", "cma-es", "random", "nsga2"],
    )
    trials: int | None = Field(
        default=None, ge=1, le=10**7, description="number of trials in all", examples=[3000]
    )
    seed: int = Field(default=0, ge=0, description="random seed of the sampler")
    blocks: int = Field(
        default=5,
        ge=2,
        description="parts of the drive; each is scored with parameters found without it",
    )
    from_scratch: bool = Field(
        default=False, description="whether values that are known are not tried first"
    )
    parameters: _Keys = Field(
        default_factory=FrozenDict,
        description="per name [low, high], the names of a choice, or one value that is kept",
        examples=[{"sigma1": [0.1, 1], "p1": 0.9}],
    )
    never_fit: tuple[tuple[int, int | None], ...] = Field(
        default=(),
        description="ranges of frame ids (first, the one after the last or null) whose labels no"
        " held-out study looks at; or `{from_frame: 9577}`",
        examples=[[[0, 100]], {"from_frame": 9577}],
        json_schema_extra=_or_from_frame,
    )

    @field_validator("objective", mode="before")
    @classmethod
    def _one_or_several(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @field_validator("never_fit", mode="before")
    @classmethod
    def _ranges(cls, value: Any) -> Any:
        if isinstance(value, dict):
            for key in value:
                if key != "from_frame":
                    raise ValueError(f"unknown key '{key}'{suggestion(str(key), ['from_frame'])}")
            return ((value.get("from_frame"), None),)
        return value

    @model_validator(mode="after")
    def _not_empty(self) -> Tuning:
        if not self.objective:
            raise ValueError("objective needs at least one score, e.g. accuracy")
        for first, stop in self.never_fit:
            if stop is not None and first >= stop:
                raise ValueError(f"never_fit: [{first}, {stop}] is an empty range")
        return self


class Learning(Section):
    """The settings of learning the tables of a graph by EM."""

    labels: bool = Field(default=True, description="whether the annotated lanes are looked at")
    strength: Positive = Field(
        default=100.0, le=1e9, description="weight of the starting tables, in frames per row"
    )
    tables: tuple[str, ...] | None = Field(
        default=None,
        description="nodes whose tables are learned; left out, all that can be",
        examples=[["Lane", "SensorState"]],
    )
    iterations: int = Field(default=200, ge=1, le=10**6, description="largest number of EM steps")


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
    recording: Recording = Field(description="where the lines come from")
    ground_truth: GroundTruth | None = Field(
        default=None, description="annotated lanes; left out, nothing is scored"
    )
    road: str | None = Field(
        default=None,
        description="the road table of the drive (`egolane locate` writes it), for n_lanes: map",
        examples=["road.parquet"],
    )
    n_lanes: int = Field(
        le=MAX_LANES,
        strict=True,
        description="lanes of the road, or `map`: the road table tells them, and where their number"
        " changes the recording is cut into drives",
        examples=[4],
        json_schema_extra=_or_map,
    )
    evidence: str = Field(
        default="counting",
        description="rule by which lines become evidence: a name (`egolane show`) or a file of your"
        " own",
        examples=["line_geometry", "./my_evidence.py"],
    )
    graph: str = Field(
        default="sensor_failure",
        description="the network: a name (`egolane show`) or a file of your own",
        examples=["position_in_lane", "./my_graph.py"],
    )
    filter: Literal["assumed_density", "exact", "smoothed", "fixed_lag"] = Field(
        default="assumed_density",
        description="how beliefs are carried on: as in the paper, each node for itself"
        " (`assumed_density`); jointly (`exact`); with all frames, later ones too (`smoothed`); or"
        " with the frames up to `lag` later (`fixed_lag`)",
    )
    lag: int | None = Field(
        default=None,
        ge=0,
        validate_default=True,
        description="frames that fixed_lag waits before it answers",
        examples=[10],
    )
    decode: Literal["marginal", "viterbi"] = Field(
        default="marginal",
        description="the lane that is answered: the most probable one in each frame, or that of the"
        " most probable path through all frames (with filter smoothed)",
    )
    start_lane: int | tuple[float, ...] | None = Field(
        default=None,
        description="what is known of the lane in which the drive begins: its number, or how"
        " probable each of the n lanes is",
        examples=[3, [0, 0, 1, 1]],
    )
    evidence_reading: Literal["soft", "hard"] = Field(
        default="soft",
        description="how the evidence of a frame is read: as a likelihood (`soft`), or by its most"
        " probable value alone (`hard`)",
    )
    unassigned_below: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        allow_inf_nan=False,
        description="no lane is answered where the largest probability is less",
    )
    fit: Literal["none", "learn", "tune"] = Field(
        default="none", description="how `compare` finds parameters without the block it scores"
    )
    learning: Learning | None = Field(
        default=None, description="settings of `egolane learn` and of fit: learn"
    )
    parameters: _Keys = Field(
        default_factory=FrozenDict,
        description="values of the parameters of graph and evidence rule (`egolane show GRAPH`);"
        " those that are left out keep their defaults",
        examples=[{"sigma1": 0.35, "bonus_value": 9}],
    )
    tuned_on: Literal["same_frames", "other_frames", "not_tuned", "unknown"] = Field(
        default="unknown",
        description="what the parameters have seen, which stands next to every score: the frames"
        " that are scored (`same_frames`: in-sample), others only, or none",
    )
    tuning: Tuning | None = Field(default=None, description="settings of `egolane tune`")

    @field_validator("n_lanes", mode="before")
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

    @field_validator("decode")
    @classmethod
    def _path_of_all_frames(cls, value: str, info: ValidationInfo) -> str:
        if value == "viterbi" and info.data.get("filter", "smoothed") != "smoothed":
            raise ValueError("viterbi knows the whole drive, as filter smoothed does; say both")
        return value

    @field_validator("unassigned_below")
    @classmethod
    def _path_always_answers(cls, value: float, info: ValidationInfo) -> float:
        if value and info.data.get("decode") == "viterbi":
            raise ValueError("a path has a lane in every frame; goes with decode marginal only")
        return value

    _source: str = "experiment"

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


def validated(model: type[AnySection], content: Mapping[str, Any], source: str) -> AnySection:
    """Make a section from some keys. Raises InputError for the first one that does not fit."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{source}: {_first_problem(error, model)}") from None
    except RecursionError:
        raise InputError(f"{source}: a section contains itself (&name ... *name)") from None


#: Keys that configure fits. A resolved experiment has the parameters themselves.
FITTING = {"tuning", "fit", "learning"}


def resolved(experiment: Experiment, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """All keys that have a value, defaults included, as plain types for YAML or JSON."""
    content = experiment.model_dump(mode="json", exclude=FITTING, exclude_none=True)
    if experiment.n_lanes == FROM_MAP:
        content["n_lanes"] = "map"
    content["parameters"] = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in sorted(parameters.items())
    }
    return content


def _first_problem(error: ValidationError, model: type[Section]) -> str:
    """pydantic's first complaint. An unknown key goes before others, with a suggestion."""
    problems = error.errors(include_url=False)
    for problem in problems:
        if problem["type"] == "extra_forbidden":
            *above, key = problem["loc"]
            prefix = f"{'.'.join(map(str, above))}: " if above else ""
            known = _section_at(model, problem["loc"])
            return f"{prefix}unknown key '{key}'{suggestion(str(key), known)}"
    return _problem(problems[0])


def _section_at(model: type[Section], loc: Sequence[int | str]) -> Iterable[str]:
    """The keys of the section that a key is in."""
    for part in loc[:-1]:
        given = model.model_fields[part].annotation if part in model.model_fields else None
        for kind in (given, *get_args(given)):
            if isinstance(kind, type) and issubclass(kind, Section):
                model = kind
    return model.model_fields


#: What pydantic says of a Python type, as one says it of YAML.
_NEEDS = {
    "model_type": "needs keys and values",
    "dict_type": "needs keys and values",
    "tuple_type": "needs a list",
}


def _problem(problem: ErrorDetails) -> str:
    """One of pydantic's complaints that is not about an unknown key."""
    where = ".".join(map(str, problem["loc"]))
    if problem["type"] == "missing":
        return f"{where}: is missing"
    value = problem["input"]
    if problem["type"] == "literal_error" and isinstance(value, str):
        choices = [
            c.strip("'") for c in problem["ctx"]["expected"].replace(" or ", ", ").split(", ")
        ]
        return f"{where}: {not_one_of(value, choices)}"
    message = problem["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    message = _NEEDS.get(problem["type"], message)
    shown = "" if isinstance(value, dict) else f" (got {repr(value)[:100]})"
    return f"{where}: {message}{shown}" if where else f"{message}{shown}"
