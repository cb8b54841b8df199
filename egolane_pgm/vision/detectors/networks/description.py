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

#: How the file of a network may end.
YAML = (".yaml", ".yml")

#: The value of a parameter that names no network.
NO_NETWORK = "none"

#: The outputs of each layout and their shapes: a letter stands for a length, the same wherever it
#: is. Those in brackets may be absent.
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
    "lstr_curves": {"scores": "1 n 2", "curves": "1 n 8"},
}

#: Rows of `row_anchors`, pixels of an input 288 high (data/constant.py of the first
#: Ultra-Fast-Lane-Detection).
ROWS = {
    "tusimple": np.arange(64.0, 285.0, 4.0),
    "culane": np.array(
        [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287]
    ),
}

_MASKS = ("drivable", "lanes", "instances")
_ANCHORS = ("row_anchors", "hybrid_anchors")

#: The keys that only some layouts have, and those of them that these need.
_OF_LAYOUTS = {
    "classes": (*_MASKS, "row_anchors", "prototypes"),
    "channels": _MASKS,
    "activation": _MASKS,
    "threshold": tuple(layout for layout in OUTPUTS if layout not in _ANCHORS),
    "rows": _ANCHORS,
    "first_x": ("polylines",),
    "start": ("polylines",),
    "length": ("polylines",),
    "in_pixels": ("polylines",),
}
_NEEDED = ("rows", "first_x", "start", "length")

#: YAML files that come along; the ONNX lies where the YAML is asked for.
READY = Path(__file__).parent / "ready"

_Size = Annotated[int, Field(ge=8, le=8192)]
_Three = FiniteFloat | tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Place = Annotated[int | None, Field(ge=2)]
_Class = Annotated[int, Field(ge=0)]


class Network(Section):
    """What a network takes and gives.

    It takes the picture without its topmost part, resized, each value as (value - mean) * scale.
    What it gives is read as the layout says. docs/networks.md has a row for each key.
    """

    model: str
    size: tuple[_Size, _Size]
    mean: _Three = 0.0
    scale: _Three = 1 / 255
    swap_rb: bool = True
    cut_top: Annotated[float, Field(ge=0, lt=1)] = 0.0
    letterbox: Annotated[int | None, Field(ge=0, le=255)] = None
    inputs: dict[str, FiniteFloat] = Field(default={})
    output: str | dict[str, str] | None = None
    layout: Literal[tuple(OUTPUTS)]  # type: ignore[valid-type]
    classes: (
        Annotated[int, Field(ge=1)] | dict[Literal["solid", "dashed"], tuple[_Class, ...]] | None
    ) = None
    channels: Annotated[tuple[_Class, ...] | None, Field(min_length=1)] = None
    activation: Literal["none", "sigmoid", "softmax"] = "none"
    threshold: Annotated[float, Field(gt=0, lt=1)] = 0.5
    rows: Literal["tusimple", "culane"] | tuple[FiniteFloat, ...] | None = None
    first_x: _Place = None
    start: _Place = None
    length: _Place = None
    in_pixels: bool = False

    @model_validator(mode="after")
    def _fits_its_layout(self) -> Self:
        for key, layouts in _OF_LAYOUTS.items():
            is_needed = key in _NEEDED or (key == "classes" and self.layout != "prototypes")
            if is_needed and self.layout in layouts and getattr(self, key) is None:
                raise ValueError(f"layout {self.layout} needs {key}")
            if self.layout not in layouts and key in self.model_fields_set:
                raise ValueError(f"{key}: goes with layout {' or '.join(layouts)} only")
        if self.classes == 1 and self.activation == "softmax":
            raise ValueError("activation: softmax needs several classes; for one take sigmoid")
        if self.layout in ("drivable", "lanes", "row_anchors") and self.continuous:
            raise ValueError(f"classes: a line of {self.layout} has none; say how many there are")
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
        """Whether the lines of a class are continuous, by class; empty if nothing says so."""
        if self.classes is None or isinstance(self.classes, int):
            return {}
        return {k: name == "solid" for name, kinds in self.classes.items() for k in kinds}

    @property
    def numbers(self) -> dict[str, int]:
        """The lengths that the YAML says, by their letters in OUTPUTS."""
        found = {"k": self.classes} if isinstance(self.classes, int) else {}
        if self.layout == "row_anchors" and self.rows is not None:
            found["r"] = len(ROWS[self.rows] if isinstance(self.rows, str) else self.rows)
        elif not isinstance(self.rows, str | None):
            found["r"] = len(self.rows)
        return found

    @property
    def last(self) -> int:
        """The last place along k that is read."""
        x = self.first_x and self.first_x + 1
        return max(*self.looked_at, x or 0, self.start or 0, self.length or 0, 0)

    @property
    def looked_at(self) -> tuple[int, ...]:
        """The channels of a mask that are looked at."""
        if self.layout not in _MASKS or self.classes is None:
            return ()
        if isinstance(self.classes, int):
            return self.channels or tuple(range(min(1, self.classes - 1), self.classes))
        return self.channels or tuple(sorted(self.continuous))

    _file: Path = Path()
    _onnx: Path = Path()

    @property
    def files(self) -> tuple[Path, Path]:
        """The YAML and the ONNX."""
        return self._file, self._onnx


def ready_networks() -> list[str]:
    """The names of the YAML files that come along."""
    return sorted(file.stem for file in READY.glob("*.yaml"))


def read_network(path: str | Path) -> Network:
    """The network that a YAML file describes. If there is none, one that comes along may have
    its name; its ONNX is looked for beside the place that was named.

    Raises InputError, a line for every key that does not fit, or if the ONNX file is absent.
    """
    path = Path(path)
    file = path if path.is_file() else READY / path.name
    if not file.is_file():
        raise InputError(f"{path}: no such file; it describes a network (docs/networks.md)")
    network = validated(Network, read_yaml(file, "model: lanes.onnx"), str(path))
    network._file, network._onnx = file, path.parent / network.model
    if not network._onnx.is_file():
        raise InputError(f"{path}: model: no file {network._onnx}")
    return network


class NetworkFile(Parameter):
    """A parameter whose value is the YAML file of a network, or `none` if that is its default."""

    def check(self, value: object, n_lanes: int, where: str) -> Value:
        """The value. Raises InputError for a name that is no YAML file's."""
        if value == NO_NETWORK and self.default == NO_NETWORK:
            return NO_NETWORK
        name = Path(str(value)).name
        if name in ready_networks():
            return f"{value}.yaml"
        if not name.endswith(YAML):
            hint = suggestion(name, ready_networks()) if name else ""
            raise InputError(
                f"{where}: {value!r} is not the name of a .yaml file; it describes a network"
                f" (docs/networks.md){hint}"
            )
        return str(value)


def network_files(parameters: Parameters) -> list[Path]:
    """The YAML and the ONNX of each network that some parameters name. Raises InputError for a
    network that cannot be read."""
    paths = [p for p in parameters.values() if isinstance(p, str) and p.endswith(YAML)]
    return [file for path in paths for file in read_network(path).files]
