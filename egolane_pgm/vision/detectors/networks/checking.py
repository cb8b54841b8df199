"""Which layout fits an ONNX file, and the YAML to start from."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import permutations
from pathlib import Path
from typing import Any

import yaml

from egolane_pgm.tools.files import read_yaml
from egolane_pgm.vision.detectors.networks.description import (
    OUTPUTS,
    READY,
    Network,
    ready_networks,
)
from egolane_pgm.vision.detectors.networks.onnx_file import Shape, read_onnx
from egolane_pgm.vision.detectors.networks.running import (
    impossible,
    lengths,
    named,
    said,
    wrong_length,
)

#: How many x the polylines of CLRNet and LaneATT have.
_POINTS = 72

#: Row anchors have no more lines, and masks are wider.
_MOST_LINES = 12

#: How well a layout fits, the network that comes along, the output for each thing that its layout
#: reads, and how many classes there are. The lowest fits best.
_Fit = tuple[tuple[bool, bool, int, int], str, dict[str, str], int | None]


def check_onnx(onnx: Path) -> str:
    """What an ONNX file takes and gives, which layouts fit, and the YAML to start from; the first
    of these as comments of the last. Raises InputError for a file that is no ONNX."""
    declared = read_onnx(onnx, "network")
    fits = sorted(_fitting(declared.outputs))
    layouts = ", ".join(dict.fromkeys(_ready(fit[1])["layout"] for fit in fits))
    lines = [
        *(f"# {name}: takes {said(shape)}" for name, shape in declared.inputs.items()),
        *(f"# {name}: gives {said(shape)}" for name, shape in declared.outputs.items()),
        f"# layouts that fit: {layouts or 'none (docs/networks.md shows what each reads)'}",
    ]
    if not fits:
        return "\n".join(lines)
    _, name, output, n_classes = fits[0]
    given = Network(**_ready(name)).inputs
    keys = {**_ready(name), "model": onnx.name, "output": output}
    picture, *others = sorted(declared.inputs, key=lambda each: each in given)
    shape = declared.inputs[picture] or ()
    if len(shape) == 4 and shape[2] and shape[3]:
        keys["size"] = [shape[3], shape[2]]
    if picture in declared.whole:
        keys |= {"mean": 0, "scale": 1}
    if others:
        keys["inputs"] = {each: given.get(each, 0) for each in others}
    if n_classes and isinstance(keys.get("classes"), int) and n_classes != keys["classes"]:
        keys["classes"] = n_classes
        keys.pop("channels", None)
        if n_classes == 1:
            keys.pop("activation", None)
    if keys["layout"] in ("prototypes", "queries"):
        kinds = _class_names(declared.notes)
        lines += [f"# class {k}: {kind}" for k, kind in kinds.items()]
        if kinds:
            keys["classes"] = _lines_by_name(kinds)
        if not kinds or not keys["classes"]:
            lines.append("# which classes are solid and which dashed lines is for you to say")
    lines.append(
        f"# as {name}, which comes along: are size, mean, scale, colours and activation yours?"
    )
    return "\n".join([*lines, yaml.safe_dump(keys, sort_keys=False, default_flow_style=None)])


def _ready(name: str) -> dict[str, Any]:
    return read_yaml(READY / f"{name}.yaml", "model: lanes.onnx")


def _class_names(notes: Mapping[str, str]) -> dict[int, str]:
    """The names of classes, as Ultralytics writes them into a file; empty where it has none."""
    with suppress(ValueError, SyntaxError):
        names = ast.literal_eval(notes.get("names", ""))
        if isinstance(names, dict):
            return names
    return {}


def _lines_by_name(names: Mapping[int, str]) -> dict[str, list[int]]:
    """The key `classes` where names of classes tell: solid yellow, dashed."""
    told = {"solid": "solid", "dashed": "dash"}
    found = {key: [k for k in names if word in str(names[k]).lower()] for key, word in told.items()}
    return {key: kinds for key, kinds in found.items() if kinds}


def _fitting(declared: Mapping[str, Shape]) -> Iterator[_Fit]:
    """The networks that come along whose layout fits the outputs of a file. Best are those with
    the same names, then those of the same numbers, then layouts that read more outputs, then those
    that ask for more."""
    short = [s for s in declared.values() if s and len(s) == 4 and (s[3] or 99) <= _MOST_LINES]
    for name in ready_networks():
        network = Network(**_ready(name))
        layout, own = network.layout, network.named_outputs
        # Several such outputs are anchors in rows and columns, of another number of lines.
        if layout == "row_anchors" and len(short) > 1:
            continue
        n_read = sum(role[0] != "(" for role in OUTPUTS[layout])
        names = () if layout == "road_lines" else permutations(declared, len(own))
        for output in (own, *(dict(zip(own, each, strict=True)) for each in names)):
            parts = {role: named(text)[0] for role, text in output.items()}
            if not set(parts.values()) <= set(declared):
                continue
            shapes = {role: declared[part] for role, part in parts.items()}
            sizes = lengths(OUTPUTS[layout], shapes)
            if isinstance(sizes, str) or sizes.get("w", math.inf) <= _MOST_LINES:
                continue
            if impossible(layout, sizes):
                continue
            if network.first_x and sizes.get("k") != network.first_x + _POINTS:
                continue
            if layout != "row_anchors" or sizes.get("n", 0) <= _MOST_LINES:
                differs = wrong_length(network, sizes) is not None
                fit = (output != own, differs, -n_read, -list(OUTPUTS).index(layout))
                yield fit, name, output, sizes.get("k")
                break
