"""Which layout fits an ONNX file, and the YAML to start from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import permutations
from pathlib import Path
from typing import Any

import yaml

from egolane_pgm.tools.files import read_yaml
from egolane_pgm.vision.detectors.networks.description import (
    OUTPUTS,
    POLYNOMIAL,
    READY,
    Network,
    ready_networks,
)
from egolane_pgm.vision.detectors.networks.onnx_file import Shape, read_onnx
from egolane_pgm.vision.detectors.networks.running import lengths, named, said

#: How many x the polylines of CLRNet and LaneATT have.
_POINTS = 72

#: Row anchors have no more lines, and masks are wider.
_MOST_LINES = 12

_Fit = tuple[bool, int, str, dict[str, str], int | None]


def check_onnx(onnx: Path) -> str:
    """What an ONNX file takes and gives, which layouts fit, and the YAML to start from; the first
    of these as comments of the last. Raises InputError for a file that is no ONNX."""
    declared = read_onnx(onnx, "network")
    fits = sorted(_fitting(declared.outputs))
    layouts = ", ".join(dict.fromkeys(_ready(fit[2])["layout"] for fit in fits))
    lines = [
        *(f"# {name}: takes {said(shape)}" for name, shape in declared.inputs.items()),
        *(f"# {name}: gives {said(shape)}" for name, shape in declared.outputs.items()),
        f"# layouts that fit: {layouts or 'none (docs/networks.md shows what each reads)'}",
    ]
    if not fits:
        return "\n".join(lines)
    _, _, name, output, n_classes = fits[0]
    given = Network(**_ready(name)).inputs
    keys = {**_ready(name), "model": onnx.name, "output": output}
    picture, *others = sorted(declared.inputs, key=lambda each: each in given)
    shape = declared.inputs[picture] or ()
    if len(shape) == 4 and shape[2] and shape[3]:
        keys["size"] = [shape[3], shape[2]]
    if others:
        keys["inputs"] = {each: given.get(each, 0) for each in others}
    if isinstance(keys.get("classes"), int):
        keys["classes"] = n_classes or keys["classes"]
    lines.append(f"# as {name}, which comes along: are size, mean, scale and colours yours?")
    return "\n".join([*lines, yaml.safe_dump(keys, sort_keys=False, default_flow_style=None)])


def _ready(name: str) -> dict[str, Any]:
    return read_yaml(READY / f"{name}.yaml", "model: lanes.onnx")


def _fitting(declared: Mapping[str, Shape]) -> Iterator[_Fit]:
    """The networks that come along whose layout fits the outputs of a file: whether these have
    other names, a number that is lower where the layout asks for more, the network's name, the
    output for each thing that the layout reads, and how many classes there are."""
    for name in ready_networks():
        network = Network(**_ready(name))
        layout, own = network.layout, network.named_outputs
        names = () if layout == "road_lines" else permutations(declared, len(own))
        for output in (own, *(dict(zip(own, each, strict=True)) for each in names)):
            parts = {role: named(text)[0] for role, text in output.items()}
            if not set(parts.values()) <= set(declared):
                continue
            shapes = {role: declared[part] for role, part in parts.items()}
            sizes = lengths(OUTPUTS[layout], shapes)
            if isinstance(sizes, str) or sizes.get("w", math.inf) <= _MOST_LINES:
                continue
            if layout == "polynomials" and sizes.get("k", POLYNOMIAL) % POLYNOMIAL:
                continue
            if network.first_x and sizes.get("k") != network.first_x + _POINTS:
                continue
            if layout != "row_anchors" or sizes.get("n", 0) <= _MOST_LINES:
                rank = -list(OUTPUTS).index(layout)
                yield output != own, rank, name, output, sizes.get("k")
                break
