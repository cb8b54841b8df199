"""Which layout fits an ONNX file, and the YAML to start from."""

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
from egolane_pgm.vision.detectors.networks.running import Shape, lengths, read_onnx, said

#: How many x the polylines of CLRNet and LaneATT have; row anchors have no more lines than the
#: second number, and masks are wider.
_POINTS, _MOST_LINES = 72, 12

#: How well a layout fits, the network that comes along, the output for each thing that its layout
#: reads, and how many classes there are. The lowest fits best.
_Fit = tuple[tuple[bool, bool, int, int], str, dict[str, str], int | None]


def describe_onnx(onnx: Path) -> str:
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
    keys = {**_ready(name), "model": onnx.name, "output": output}
    given = keys.pop("inputs", {})
    picture, *others = sorted(declared.inputs, key=lambda each: each in given)
    shape = declared.inputs[picture] or ()
    if len(shape) == 4 and shape[2] and shape[3]:
        keys["size"] = [shape[3], shape[2]]
    if declared.types[picture].kind in "iu":
        keys |= {"mean": 0, "scale": 1}
    if others:
        keys["inputs"] = {each: given.get(each, 0) for each in others}
    if n_classes and isinstance(keys.get("classes"), int) and n_classes != keys["classes"]:
        keys["classes"] = n_classes
        keys.pop("channels", None)
        if n_classes == 1:
            keys.pop("activation", None)
    lines.append(
        f"# as {name}, which comes along: are size, mean, scale, colours, activation and classes"
        " yours?"
    )
    return "\n".join([*lines, yaml.safe_dump(keys, sort_keys=False, default_flow_style=None)])


def _ready(name: str) -> dict[str, Any]:
    return read_yaml(READY / f"{name}.yaml", "model: lanes.onnx")


def _fitting(declared: Mapping[str, Shape]) -> Iterator[_Fit]:
    """The networks that come along whose layout fits the outputs of a file. Best are those with
    the same names, then those of the same numbers, then layouts that read more outputs, then those
    that ask for more."""
    for name in ready_networks():
        network = Network(**_ready(name))
        own = network.named_outputs
        for names in ((*own.values(),), *permutations(declared, len(own))):
            output = dict(zip(own, names, strict=True))
            if not set(names) <= set(declared):
                continue
            shapes = {role: declared[each] for role, each in output.items()}
            sizes = lengths(network, shapes, None)
            if sizes is None or _is_another(network, sizes, declared):
                continue
            differs = lengths(network, shapes, network.numbers) is None
            n_read = sum(role[0] != "(" for role in OUTPUTS[network.layout])
            order = -list(OUTPUTS).index(network.layout)
            yield (output != own, differs, -n_read, order), name, output, sizes.get("k")
            break


def _is_another(network: Network, sizes: dict[str, int], declared: Mapping[str, Shape]) -> bool:
    """Whether outputs are of another layout of the same number of axes."""
    if network.layout == "row_anchors":
        # Several such outputs are anchors in rows and columns, of another number of lines.
        short = [s for s in declared.values() if s and len(s) == 4 and (s[3] or 99) <= _MOST_LINES]
        return len(short) > 1 or sizes.get("n", 0) > _MOST_LINES
    if network.layout == "polylines":
        return sizes.get("k") != (network.first_x or 0) + _POINTS
    return sizes.get("w", 99) <= _MOST_LINES
