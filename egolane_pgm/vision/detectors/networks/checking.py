"""Find the layout that fits an ONNX file, and a YAML to start from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from egolane_pgm.vision.detectors.networks.running import Shape, lengths, read_onnx, shape_text

#: Number of x of the polylines of CLRNet and LaneATT; row anchors have no more lines than the
#: second number, and masks are wider.
_POINTS, _MOST_LINES = 72, 12


def describe_onnx(onnx: Path) -> str:
    """Return a YAML to start from, with the inputs, outputs and layouts that fit as comments.

    Raises InputError for a file that is no ONNX.
    """
    declared = read_onnx(onnx, "network")
    fits = [fit for _, fit in sorted(_fitting(declared.outputs), key=lambda one: one[0])]
    layouts = ", ".join(dict.fromkeys(keys["layout"] for keys in fits))
    lines = [
        *(f"# {name}: takes {shape_text(shape)}" for name, shape in declared.inputs.items()),
        *(f"# {name}: gives {shape_text(shape)}" for name, shape in declared.outputs.items()),
        f"# layouts that fit: {layouts or 'none (docs/networks.md has the shapes of each)'}",
    ]
    if not fits:
        return "\n".join(lines)
    keys = fits[0] | {"model": onnx.name}
    given = keys.pop("inputs", {})
    picture, *others = sorted(declared.inputs, key=lambda each: each in given)
    shape = declared.inputs[picture] or ()
    if len(shape) == 4 and shape[2] and shape[3]:
        keys["size"] = [shape[3], shape[2]]
    if others:
        keys["inputs"] = {each: given.get(each, 0) for each in others}
    lines.append("# check size, mean, scale, colours, activation and classes")
    return "\n".join([*lines, yaml.safe_dump(keys, sort_keys=False, default_flow_style=None)])


def _fitting(declared: Mapping[str, Shape]) -> Iterator[tuple[tuple[bool, bool, int, int], Any]]:
    """Yield the keys of the ready networks whose layout fits the outputs of a file, and a sort key:
    equal names fit best, then equal lengths, more outputs, more specific layouts."""
    for name in ready_networks():
        keys = read_yaml(READY / f"{name}.yaml", "model: lanes.onnx")
        network = Network(**keys)
        own = network.named_outputs
        for names in ((*own.values(),), *permutations(declared, len(own))):
            if not set(names) <= set(declared):
                continue
            output = dict(zip(own, names, strict=True))
            shapes = {role: declared[each] for role, each in output.items()}
            sizes = lengths(network, shapes, None)
            if sizes is None or _is_another(network, sizes, declared):
                continue
            differs = lengths(network, shapes, network.numbers) is None
            n_classes = sizes.get("k")
            if n_classes and isinstance(network.classes, int) and n_classes != network.classes:
                left = ("channels", "activation") if n_classes == 1 else ("channels",)
                keys = {k: v for k, v in keys.items() if k not in left} | {"classes": n_classes}
            order = -list(OUTPUTS).index(network.layout)
            yield (output != own, differs, -len(own), order), keys | {"output": output}
            break


def _is_another(network: Network, sizes: dict[str, int], declared: Mapping[str, Shape]) -> bool:
    """Return whether outputs are of another layout with the same number of axes."""
    if network.layout == "row_anchors":
        # Several such outputs are hybrid anchors with another number of lines.
        short = [s for s in declared.values() if s and len(s) == 4 and (s[3] or 99) <= _MOST_LINES]
        return len(short) > 1 or sizes.get("n", 0) > _MOST_LINES
    if network.layout == "polylines":
        return sizes.get("k") != network.length + 1 + _POINTS
    return sizes.get("w", 99) <= _MOST_LINES
