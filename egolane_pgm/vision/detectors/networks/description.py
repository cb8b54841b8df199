"""The YAML file that describes a network, which lies beside its ONNX file.

model: twinlitenet.onnx
size: [640, 360]
output: ll
layout: lanes
classes: 2
activation: softmax
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from egolane_pgm.experiment import Section, validated
from egolane_pgm.parameters import Parameter, Parameters, Value
from egolane_pgm.tools.files import read_yaml
from egolane_pgm.types import InputError, suggestion
from egolane_pgm.vision.detectors.networks.onnx_file import weight_files

#: How the file of a network may end.
YAML = (".yaml", ".yml")

#: The value of a parameter that names no network.
NO_NETWORK = "none"

#: The outputs of each layout and their shapes: a letter stands for a length, the same wherever it
#: is. Those in brackets may be absent; those without a shape may have any.
OUTPUTS = {
    "drivable": {"mask": "1 k h w", "(lanes)": "1 k m n"},
    "lanes": {"mask": "1 k h w"},
    "instances": {"mask": "1 k h w"},
    "row_anchors": {"columns": "1 k r n"},
    "hybrid_anchors": {
        "loc_row": "1 g r 4",
        "loc_col": "1 h c 4",
        "exist_row": "1 2 r 4",
        "exist_col": "1 2 c 4",
    },
    "polylines": {"candidates": "1 n k"},
    "prototypes": {"boxes": "1 a b", "prototypes": "1 m h w"},
    "queries": {"scores": "1 n k", "masks": "1 n h w"},
    "lstr_curves": {"scores": "1 n 2", "curves": "1 n 8"},
    "polynomials": {"curves": "1 k"},
    "beziers": {"scores": "1 n", "curves": "1 n 4 2"},
    "road_lines": {"places": "", "scores": "", "(deviations)": "", "(visible)": ""},
}

#: Rows of `row_anchors`, pixels of an input 288 high (data/constant.py of the first
#: Ultra-Fast-Lane-Detection).
ROWS = {
    "tusimple": np.arange(64.0, 285.0, 4.0),
    "culane": np.array(
        [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287]
    ),
}

#: Numbers of each of the `polynomials`: its logit, lower and upper end, four coefficients.
POLYNOMIAL = 7

#: Layouts whose number of classes must be said, since it is checked.
COUNTED = ("drivable", "lanes", "instances", "row_anchors")

_MASKS = ("drivable", "lanes", "instances")
_ANCHORS = ("row_anchors", "hybrid_anchors")

#: The keys that only some layouts have.
_OF_LAYOUTS = {
    "classes": (*COUNTED, "prototypes", "queries", "road_lines"),
    "channels": _MASKS,
    "activation": (*_MASKS, "road_lines"),
    "threshold": tuple(layout for layout in OUTPUTS if layout not in _ANCHORS),
    "rows": _ANCHORS,
    "first_x": ("polylines",),
    "start": ("polylines",),
    "length": ("polylines",),
    "in_pixels": ("polylines",),
    "ahead": ("road_lines",),
}

#: Those without a default.
_NEEDED = ("rows", "first_x", "start", "length", "ahead")

#: YAML files that come along; the ONNX lies where the YAML is asked for.
READY = Path(__file__).parent / "ready"


_Three = FiniteFloat | tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class Network(Section):
    """What a network takes and gives.

    It takes the picture without its topmost part, resized, each value as (value - mean) * scale.
    What it gives is read as the layout says (docs/networks.md): masks, a channel for each line,
    columns of rows, polylines, segments with classes, coefficients of curves, metres on the road.
    """

    model: str = Field(description="the ONNX file, relative to the YAML", examples=["net.onnx"])
    size: tuple[Annotated[int, Field(ge=8, le=8192)], Annotated[int, Field(ge=8, le=8192)]] = Field(
        description="width and height of its input, pixels", examples=[[640, 360]]
    )
    mean: _Three = Field(
        default=0.0,
        description="subtracted from values of 0 to 255: one number, or one for each of the three"
        " colours in the network's order",
        examples=[[123.7, 116.3, 103.5]],
    )
    scale: _Three = Field(
        default=1 / 255,
        description="what the values are then multiplied with, one number or three",
        examples=[[0.0171, 0.0175, 0.0174]],
    )
    swap_rb: bool = Field(
        default=True,
        description="whether its order of colours is red, green, blue, as usual; OpenCV's own is"
        " the other one",
    )
    cut_top: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="share of the picture's height that is cut off above (sky)",
    )
    letterbox: int | None = Field(
        default=None,
        ge=0,
        le=255,
        description="grey of the bars that keep the picture's proportions; left out, it is"
        " stretched to `size`",
        examples=[114],
    )
    inputs: dict[str, FiniteFloat | tuple[FiniteFloat, ...] | str] = Field(
        default={},
        description="what each input but the picture gets: a number everywhere, a list of numbers,"
        " or by its name an output of the picture before",
        examples=[{"input_mask": 0, "state": "hidden_state"}],
    )
    output: str | dict[str, str] | None = Field(
        default=None,
        description="name of the output in the file, or, by what they are, of several;"
        " name[first:stop:step] is a part of one. May be left out where the names are these, or"
        " where there is one only",
        examples=["ll", {"scores": "pred_logits", "curves": "pred_curves"}],
    )
    layout: Literal[tuple(OUTPUTS)] = Field(  # type: ignore[valid-type]
        description="how the output is read", examples=["lanes"]
    )
    classes: (
        Annotated[int, Field(ge=1)]
        | dict[Literal["solid", "dashed"], tuple[Annotated[int, Field(ge=0)], ...]]
        | None
    ) = Field(
        default=None,
        description="how many classes there are, which is checked, or which of them are continuous"
        " lines and which are dashed ones",
        examples=[2, {"solid": [2, 4], "dashed": [1]}],
    )
    channels: tuple[Annotated[int, Field(ge=0)], ...] | None = Field(
        default=None,
        min_length=1,
        description="those that are looked at; left out, all but the first, which is the"
        " background",
        examples=[[1]],
    )
    activation: Literal["none", "sigmoid", "softmax"] = Field(
        default="none", description="what makes probabilities of the output"
    )
    threshold: float = Field(default=0.5, gt=0, lt=1, description="the least probability")
    rows: Literal["tusimple", "culane"] | tuple[FiniteFloat, ...] | None = Field(
        default=None,
        description="rows of anchors: a data set's, or pixels of the input",
        examples=["tusimple", [121, 131, 141]],
    )
    first_x: int | None = Field(
        default=None,
        ge=2,
        description="place of the first x in a polyline's numbers",
        examples=[6],
    )
    start: int | None = Field(
        default=None,
        ge=2,
        description="place of the share of the height at which the line starts, from the bottom",
        examples=[2],
    )
    length: int | None = Field(
        default=None, ge=2, description="place of the line's length", examples=[5]
    )
    in_pixels: bool = Field(
        default=False,
        description="whether a polyline's x is in pixels of the input and its length in rows; else"
        " both are shares",
    )
    ahead: tuple[Annotated[float, Field(ge=0)], ...] | None = Field(
        default=None,
        min_length=2,
        description="distances ahead of the places of `road_lines`, metres",
        examples=[[5, 10, 20, 40]],
    )
    every: int = Field(default=1, ge=1, description="the network looks at every n-th frame only")

    @model_validator(mode="after")
    def _fits_its_layout(self) -> Self:
        for key, layouts in _OF_LAYOUTS.items():
            needed = layouts if key in _NEEDED else COUNTED if key == "classes" else ()
            if self.layout in needed and getattr(self, key) is None:
                raise ValueError(f"layout {self.layout} needs {key}")
            if self.layout not in layouts and key in self.model_fields_set:
                raise ValueError(f"{key}: goes with layout {' or '.join(layouts)} only")
        if isinstance(self.classes, int) and max(self.looked_at, default=0) >= self.classes:
            raise ValueError(
                f"channels: {max(self.looked_at)} is not one of {self.classes} classes,"
                " which are counted from 0"
            )
        if self.classes == 1 and self.activation == "softmax":
            raise ValueError("activation: softmax needs several classes; for one take sigmoid")
        if self.layout in ("drivable", "lanes", "row_anchors") and self.continuous:
            raise ValueError(f"classes: a line of {self.layout} has none; say how many there are")
        if self.layout == "row_anchors" and self.classes in (1, 2):
            raise ValueError("classes: needs two columns and 'no line' at least")
        roles, given = OUTPUTS[self.layout], self.named_outputs
        unknown = [role for role in given if not {role, f"({role})"} & set(roles)]
        if unknown or any(role[0] != "(" and role not in given for role in roles):
            raise ValueError(f"output: layout {self.layout} reads {', '.join(roles)}")
        return self

    @property
    def named_outputs(self) -> dict[str, str]:
        """The name of each output that is read, by what it is."""
        needed = [role for role in OUTPUTS[self.layout] if role[0] != "("]
        if isinstance(self.output, str):
            return {needed[0]: self.output}
        return self.output or {role: role for role in needed}

    @property
    def continuous(self) -> dict[int, bool]:
        """Whether the lines of a class are continuous, by class; empty where nothing says so."""
        if self.classes is None or isinstance(self.classes, int):
            return {}
        return {k: name == "solid" for name, kinds in self.classes.items() for k in kinds}

    @property
    def looked_at(self) -> tuple[int, ...]:
        """The channels of a mask that are looked at."""
        if self.layout not in _MASKS or self.classes is None:
            return ()
        if isinstance(self.classes, int):
            return self.channels or tuple(range(min(1, self.classes - 1), self.classes))
        return self.channels or tuple(sorted(self.continuous))

    _file: Path = Path()
    _folder: Path = Path()

    @property
    def file(self) -> Path:
        """The YAML file."""
        return self._file

    @property
    def onnx(self) -> Path:
        """The ONNX file."""
        return self._folder / self.model


def ready_networks() -> list[str]:
    """The names of the YAML files that come along."""
    return sorted(file.stem for file in READY.glob("*.yaml"))


def read_network(path: str | Path) -> Network:
    """The network that a YAML file describes. Where there is none, one that comes along may have
    its name; its ONNX is looked for beside the place that was named.

    Raises InputError, a line for every key that does not fit; also where the ONNX file is absent.
    """
    path = Path(path)
    file = path if path.is_file() else READY / path.name
    if not file.is_file():
        raise InputError(f"{path}: no such file; it describes a network (docs/networks.md)")
    network = validated(Network, read_yaml(file, "model: lanes.onnx"), str(path))
    network._file, network._folder = file, path.parent
    if not network.onnx.is_file():
        raise InputError(f"{path}: model: no file {network.onnx}")
    return network


class NetworkFile(Parameter):
    """A parameter whose value is the YAML file of a network, or `none` where that is its
    default."""

    def check(self, value: object, n_lanes: int, where: str) -> Value:
        """The value. Raises InputError for a name that is no YAML file's."""
        if value == NO_NETWORK and self.default == NO_NETWORK:
            return NO_NETWORK
        if value == "":
            raise InputError(
                f"{where}: is missing; it names the YAML file of a network, e.g. {self.name}="
                "lanes.yaml (docs/networks.md shows how to write one)"
            )
        if isinstance(value, str) and Path(value).name in ready_networks():
            value += ".yaml"
        if not isinstance(value, str) or not value.endswith(YAML):
            hint = suggestion(str(value), ready_networks())
            raise InputError(f"{where}: {value!r} is not the name of a network's .yaml file{hint}")
        return value


def network_files(parameters: Parameters) -> list[Path]:
    """The files of the networks that some parameters name: for each the YAML, the ONNX and the
    files of its weights. Raises InputError for a network that cannot be read."""
    files = []
    for path in parameters.values():
        if not isinstance(path, str) or not path.endswith(YAML):
            continue
        network = read_network(path)
        files += [network.file, network.onnx, *weight_files(network.onnx, f"{path}: model")]
    return files
