"""The YAML file of a lane network, in one folder with its ONNX file.

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
from egolane_pgm.tools.files import read_yaml
from egolane_pgm.types import InputError, suggestion

#: The outputs of each layout and their shapes: a letter is a length, equal in all outputs.
OUTPUTS = {
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

#: The layouts with a mask of each line or class.
_MASKS = ("lanes", "instances")

#: The layouts with anchors in rows.
_ANCHORS = ("row_anchors", "hybrid_anchors")

#: For each key, the layouts that have it and those that need it.
_LAYOUTS = {
    "classes": ((*_MASKS, "row_anchors", "prototypes"), (*_MASKS, "row_anchors")),
    "channels": (_MASKS, ()),
    "activation": (_MASKS, ()),
    "threshold": ((*_MASKS, "polylines", "prototypes", "lstr_curves"), ()),
    "rows": (_ANCHORS, _ANCHORS),
    "length": (("polylines",), ("polylines",)),
    "in_pixels": (("polylines",), ()),
}

#: The folder of ready YAML files; their ONNX files are the user's.
READY = Path(__file__).parent / "ready"

_Size = Annotated[int, Field(ge=8, le=8192)]
_Three = FiniteFloat | tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Class = Annotated[int, Field(ge=0)]


class Network(Section):
    """The inputs and outputs of a network; docs/networks.md describes the keys.

    The input is the picture without its topmost part, resized, each value as (value - mean) *
    scale. The layout determines how the outputs are read.
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
    rows: Literal["tusimple", "culane"] | None = None
    length: Annotated[int, Field(ge=3)] = 0
    in_pixels: bool = False

    @model_validator(mode="after")
    def _fits_its_layout(self) -> Self:
        for key, (layouts, needed) in _LAYOUTS.items():
            if key in self.model_fields_set and self.layout not in layouts:
                raise ValueError(f"{key}: goes with layout {' or '.join(layouts)} only")
            if self.layout in needed and not getattr(self, key):
                raise ValueError(f"layout {self.layout} needs {key}")
        if self.classes == 1 and self.activation == "softmax":
            raise ValueError("activation: softmax needs several classes; for one take sigmoid")
        if self.layout in ("lanes", "row_anchors") and self.continuous:
            raise ValueError(f"classes: lines of layout {self.layout} have none; give their number")
        roles = OUTPUTS[self.layout]
        if set(self.named_outputs) != set(roles):
            raise ValueError(f"output: layout {self.layout} reads {', '.join(roles)}")
        return self

    @property
    def named_outputs(self) -> dict[str, str]:
        """The name of each output by its role in the layout."""
        roles = list(OUTPUTS[self.layout])
        if isinstance(self.output, str):
            return {roles[0]: self.output}
        return self.output or dict(zip(roles, roles, strict=True))

    @property
    def continuous(self) -> dict[int, bool]:
        """Whether the lines of a class are continuous, by class; empty if unknown."""
        if self.classes is None or isinstance(self.classes, int):
            return {}
        return {k: name == "solid" for name, kinds in self.classes.items() for k in kinds}

    @property
    def numbers(self) -> dict[str, int]:
        """The lengths that the YAML determines, by their letters in OUTPUTS."""
        found = {"k": self.classes} if isinstance(self.classes, int) else {}
        if self.layout == "row_anchors" and self.rows is not None:
            found["r"] = len(ROWS[self.rows])
        return found

    @property
    def used_channels(self) -> tuple[int, ...]:
        """The channels of a mask that are used."""
        if self.layout not in _MASKS or self.classes is None:
            return ()
        if isinstance(self.classes, int):
            return self.channels or tuple(range(min(1, self.classes - 1), self.classes))
        return self.channels or tuple(sorted(self.continuous))


def ready_networks() -> list[str]:
    """Return the names of the ready YAML files."""
    return sorted(file.stem for file in READY.glob("*.yaml"))


def read_network(path: str | Path) -> Network:
    """Read the YAML file of a network. The ready YAML is used for the name of a ready network, and
    if the file does not exist, with an ONNX file in that folder.

    Raises InputError for a file that is absent, and for a key that does not fit.
    """
    path = Path(path)
    if path.suffix == ".onnx":
        raise InputError(
            f"network: {path} is the ONNX file; give the YAML that describes it (docs/networks.md;"
            f" `egolane show {path.name}` lists the layouts that fit)"
        )
    path = path.with_name(f"{path.name}.yaml") if path.name in ready_networks() else path
    file = path if path.is_file() else READY / path.name
    if not file.is_file():
        hint = suggestion(path.name, ready_networks())
        raise InputError(f"network: '{path}' is not the YAML of a network (docs/networks.md){hint}")
    network = validated(Network, read_yaml(file, "model: lanes.onnx"), str(path))
    return network.model_copy(update={"model": str(path.parent / network.model)})
