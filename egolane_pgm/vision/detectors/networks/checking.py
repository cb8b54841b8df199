"""Describe an ONNX file: its inputs, its outputs and the layouts that fit."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations
from pathlib import Path

from egolane_pgm.tools.files import read_yaml
from egolane_pgm.vision.detectors.networks.description import OUTPUTS, READY, ready_networks
from egolane_pgm.vision.detectors.networks.running import Shape, lengths, read_onnx, shape_text

#: Lengths of a candidate of LaneATT and CLRNet, values.
_CANDIDATES = (77, 78)

#: The largest number of lines of row anchors; masks are wider.
_MOST_LINES = 12


def describe_onnx(onnx: Path) -> str:
    """Return the inputs, the outputs and the layouts that fit, with the ready networks of each.

    Raises InputError for a file that is not ONNX.
    """
    declared = read_onnx(onnx, "network")
    lines = [f"takes {name}: {shape_text(shape)}" for name, shape in declared.inputs.items()]
    lines += [f"gives {name}: {shape_text(shape)}" for name, shape in declared.outputs.items()]
    if not any(map(_is_picture, declared.inputs.values())):
        lines.append(
            "no layout fits: the network takes no pictures of 1 x 3 x height x width; export it"
            " with the three colours before height and width"
        )
        return "\n".join(lines)
    for layout in sorted(OUTPUTS, key=lambda layout: -len(OUTPUTS[layout])):
        if _fits(layout, declared.outputs):
            files = {name: read_yaml(READY / f"{name}.yaml", "") for name in ready_networks()}
            ready = [name for name, keys in files.items() if keys["layout"] == layout]
            lines.append(f"layout {layout} fits, as for the ready networks {', '.join(ready)}")
    if len(lines) == len(declared.inputs) + len(declared.outputs):
        lines.append("no layout fits (docs/networks.md has the shapes of each)")
    return "\n".join(lines)


def _is_picture(shape: Shape) -> bool:
    # With the colours last, all other axes may be unknown.
    return shape is None or (len(shape) == 4 and shape[1] in (None, 3) and shape[3] != 3)


def _fits(layout: str, declared: Mapping[str, Shape]) -> bool:
    """Return whether some of the outputs of a file fit a layout, and not another one with the same
    number of axes."""
    roles = OUTPUTS[layout]
    every = permutations(declared.values(), len(roles))
    found = [lengths(layout, dict(zip(roles, shapes, strict=True)), {}) for shapes in every]
    if layout == "row_anchors":
        # Several such outputs are hybrid anchors with another number of lines.
        short = [s for s in declared.values() if s and len(s) == 4 and (s[3] or 99) <= _MOST_LINES]
        return len(short) < 2 and any(s is not None and s.get("n", 0) <= _MOST_LINES for s in found)
    if layout == "polylines":
        return any(s is not None and s.get("k") in _CANDIDATES for s in found)
    # A mask is wider than it has channels, unless these are last.
    return any(
        s is not None and s.get("w", 999) > max(_MOST_LINES, s.get("k", 0), s.get("m", 0))
        for s in found
    )
