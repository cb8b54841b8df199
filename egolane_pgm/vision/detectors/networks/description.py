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

from pydantic import AfterValidator, Field, model_validator

from egolane_pgm.experiment import Section, validated
from egolane_pgm.parameters import Parameter, Parameters, Value
from egolane_pgm.tools.files import read_yaml
from egolane_pgm.types import InputError
from egolane_pgm.vision.detectors.networks.onnx_file import weight_files

#: How the file of a network may end.
YAML = (".yaml", ".yml")

#: The value of a parameter that names no network.
NO_NETWORK = "none"

#: The keys that only some layouts have.
_OF_LAYOUTS = {
    "classes": ("drivable", "lanes", "instances", "row_anchors"),
    "channels": ("drivable", "lanes", "instances"),
    "activation": ("drivable", "lanes", "instances"),
    "threshold": ("drivable", "lanes", "instances", "polylines"),
    "rows": ("row_anchors",),
    "first_x": ("polylines",),
    "start": ("polylines",),
    "length": ("polylines",),
    "in_pixels": ("polylines",),
}

#: Those without a default.
_NEEDED = ("classes", "rows", "first_x", "start", "length")


def _finite(value: float) -> float:
    if not abs(value) < float("inf"):
        raise ValueError("is not a finite number")
    return value


_Number = Annotated[float, AfterValidator(_finite)]
_Three = _Number | tuple[_Number, _Number, _Number]


class Network(Section):
    """What a network takes and gives.

    It takes the picture without its topmost part, resized, each value as (value - mean) * scale.
    It gives one output that is looked at, in one of these layouts; each begins with an axis of
    length 1.

    - `drivable`, `lanes`: (1, classes, h, w), masks of the road's free area or of all its markings.
    - `instances`: the same with a channel for each line.
    - `row_anchors`: (1, classes, rows, lines), for each row of the picture and each line the column
      in `classes - 1` columns, the last class saying that there is no line.
    - `polylines`: (1, candidates, numbers), each with the logits of "no line" and "line" first, and
      from `first_x` on its x in rows that are evenly spaced from the bottom to the top.
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
    output: str | None = Field(
        default=None,
        description="name of the output in the file; may be left out where there is one only",
        examples=["ll"],
    )
    layout: Literal["drivable", "lanes", "instances", "row_anchors", "polylines"] = Field(
        description="how the output is read", examples=["lanes"]
    )
    classes: int | None = Field(
        default=None, ge=1, description="how many classes there are; checked", examples=[2]
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
    rows: tuple[_Number, ...] | None = Field(
        default=None,
        min_length=2,
        description="rows of `row_anchors`, pixels of the input",
        examples=[[121, 131, 141]],
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
    every: int = Field(default=1, ge=1, description="the network looks at every n-th frame only")

    @model_validator(mode="after")
    def _fits_its_layout(self) -> Self:
        for key, layouts in _OF_LAYOUTS.items():
            if self.layout in layouts and key in _NEEDED and getattr(self, key) is None:
                raise ValueError(f"layout {self.layout} needs {key}")
            if self.layout not in layouts and key in self.model_fields_set:
                raise ValueError(f"{key}: goes with layout {' or '.join(layouts)} only")
        if self.classes is not None and max(self.looked_at, default=0) >= self.classes:
            raise ValueError(
                f"channels: {max(self.looked_at)} is not one of {self.classes} classes,"
                " which are counted from 0"
            )
        if self.classes == 1 and self.activation == "softmax":
            raise ValueError("activation: softmax needs several classes; for one take sigmoid")
        if self.layout == "row_anchors" and self.classes is not None and self.classes < 3:
            raise ValueError("classes: needs two columns and 'no line' at least")
        return self

    @property
    def looked_at(self) -> tuple[int, ...]:
        """The channels of a mask that are looked at."""
        if self.layout not in _OF_LAYOUTS["channels"] or self.classes is None:
            return ()
        return self.channels or tuple(range(min(1, self.classes - 1), self.classes))

    _file: Path = Path()

    @property
    def file(self) -> Path:
        """The YAML file."""
        return self._file

    @property
    def onnx(self) -> Path:
        """The ONNX file."""
        return self._file.parent / self.model


def read_network(path: str | Path) -> Network:
    """The network that a YAML file describes.

    Raises InputError, a line for every key that does not fit; also where the ONNX file is absent.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; it describes a network (docs/networks.md)")
    network = validated(Network, read_yaml(path, "model: lanes.onnx"), str(path))
    network._file = path
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
        if not isinstance(value, str) or not value.endswith(YAML):
            raise InputError(f"{where}: {value!r} is not the name of a network's .yaml file")
        return value


def networks_of(parameters: Parameters) -> list[Path]:
    """The YAML files of the networks that some parameters name."""
    return [Path(v) for v in parameters.values() if isinstance(v, str) and v.endswith(YAML)]


def network_files(parameters: Parameters) -> list[Path]:
    """The files of the networks that some parameters name: for each the YAML, the ONNX and the
    files of its weights. Raises InputError for a network that cannot be read."""
    files = []
    for path in networks_of(parameters):
        onnx = read_network(path).onnx
        files += [path, onnx, *weight_files(onnx, f"{path}: model")]
    return files
