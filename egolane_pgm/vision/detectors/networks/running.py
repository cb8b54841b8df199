"""Takes pictures through a network, by OpenCV (`cv2.dnn`)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray, InputError, suggestion
from egolane_pgm.vision.camera.picture import Image, check_size
from egolane_pgm.vision.camera.writing import silent
from egolane_pgm.vision.detectors.networks.description import OUTPUTS, ROWS, Network
from egolane_pgm.vision.detectors.networks.onnx_file import Declared, Shape, read_onnx

#: What a network gives for one picture, without the first axis, by what it is.
Outputs = dict[str, FloatArray]


@dataclass(frozen=True)
class Fit:
    """Where a camera's picture is in the input of a network.

    - width, height: of the picture, pixels
    - top: its first row that the network sees
    - left, upper, wide, high: the rectangle of the input that shows the picture, pixels
    """

    width: int
    height: int
    top: int
    left: int
    upper: int
    wide: int
    high: int

    def to_picture(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take pixels u, v of the input to pixels of the picture."""
        in_u = (u + 0.5 - self.left) * self.width / self.wide - 0.5
        in_v = (v + 0.5 - self.upper) * (self.height - self.top) / self.high - 0.5
        return in_u, in_v + self.top


def fit_of(network: Network, width: int, height: int) -> Fit:
    """Where a picture of this size is in the input."""
    top = min(round(network.cut_top * height), height - 1)
    wide, high = network.size
    if network.letterbox is None:
        return Fit(width, height, top, 0, 0, wide, high)
    ratio = min(wide / width, high / (height - top))
    inner_w, inner_h = max(round(width * ratio), 1), max(round((height - top) * ratio), 1)
    left, upper = (wide - inner_w) // 2, (high - inner_h) // 2
    return Fit(width, height, top, left, upper, inner_w, inner_h)


def as_input(network: Network, fit: Fit, image: Image) -> NDArray[np.float32]:
    """The input (1, 3, h, w) of a network for a picture (H, W, 3). Raises InputError for a picture
    of another size than the camera's."""
    check_size(image, fit.width, fit.height)
    (width, height), inner = network.size, (fit.wide, fit.high)
    grey = network.letterbox or 0
    seen = np.full((height, width, 3), grey, dtype=np.uint8)
    seen[fit.upper : fit.upper + fit.high, fit.left : fit.left + fit.wide] = cv2.resize(
        image[fit.top :], inner, interpolation=cv2.INTER_LINEAR
    )
    if network.swap_rb:
        seen = seen[..., ::-1]
    mean, scale = (np.asarray(v, dtype=np.float32) for v in (network.mean, network.scale))
    values = (seen.astype(np.float32) - mean) * scale
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None])


def load(network: Network, fit: Fit) -> Callable[[Image], Outputs]:
    """Load a network, try it once, and make the function that takes a picture (H, W, 3) through it.

    Raises InputError for a file that is no ONNX or that OpenCV cannot run, for inputs or outputs
    that differ from what the YAML says, and, while it runs, for an output that is not finite.
    """
    file, onnx = network.files
    where = f"{file}: model: {onnx.name}"
    declared = read_onnx(onnx, f"{file}: model")
    names = _output_names(network, declared)
    picture = _picture_input(network, declared, where)
    with _opencv_errors(f"{where}: OpenCV {cv2.__version__} cannot load it"):
        net = cv2.dnn.readNetFromONNX(np.frombuffer(declared.content, dtype=np.uint8))
    given = {
        name: np.full([size or 1 for size in declared.inputs[name] or ()], value, dtype=np.float32)
        for name, value in network.inputs.items()
    }

    def run(image: Image) -> Outputs:
        values = as_input(network, fit, image)
        if declared.types[picture].kind in "iu":
            values = values.round().astype(declared.types[picture])
        with _opencv_errors(f"{where}: OpenCV {cv2.__version__} cannot run it"):
            for port, value in (*given.items(), (picture, values)):
                net.setInput(value, port)
            # OpenCV 5 gives all outputs or one.
            answers = net.forward(list(declared.outputs))
        found = dict(zip(declared.outputs, map(np.asarray, answers), strict=True))
        outputs = {role: found[name] for role, name in names.items()}
        _check(network, names, outputs)
        return {role: value[0].astype(np.float64) for role, value in outputs.items()}

    run(np.full((fit.height, fit.width, 3), 114, dtype=np.uint8))
    return run


@contextmanager
def _opencv_errors(message: str) -> Iterator[None]:
    """Make one line of an error of OpenCV's."""
    try:
        with silent():
            yield
    except cv2.error as error:
        # What it says last is the cause: OpenCV(5.0.0) FILE: error: (-2:Unspecified error) CAUSE >
        said = re.split(r"error: \(-\d+:[^)]*\) ", " ".join(str(error).split()))[-1]
        raise InputError(f"{message}: {said.removesuffix(' >')[:240]}") from None


def _picture_input(network: Network, declared: Declared, where: str) -> str:
    """The name of the input that gets the picture. Raises InputError for other inputs than the YAML
    says."""
    for name in network.inputs:
        if name not in declared.inputs:
            hint = suggestion(name, declared.inputs)
            raise InputError(f"{network.files[0]}: inputs: unknown name '{name}'{hint}")
    left = [name for name in declared.inputs if name not in network.inputs]
    if len(left) != 1:
        listed = ", ".join(declared.inputs) or "none"
        raise InputError(
            f"{where} takes {len(declared.inputs)} inputs ({listed}), not one picture; say in"
            f" inputs what the others get, e.g. inputs: {{{left[-1] if left else 'state'}: 0}}"
        )
    shape, needed = declared.inputs[left[0]], (1, 3, network.size[1], network.size[0])
    if isinstance(lengths({"picture": " ".join(map(str, needed))}, {"picture": shape}), str):
        raise InputError(
            f"{where} takes {said(shape)} ({left[0]}), but size {list(network.size)} makes"
            f" {said(needed)} (pictures, colours, height, width)"
        )
    return left[0]


def _output_names(network: Network, declared: Declared) -> dict[str, str]:
    """The output in the file for each thing that the layout reads."""
    names, given = list(declared.outputs), network.named_outputs
    if network.output is None and len(names) == len(given) == 1:
        return dict.fromkeys(given, names[0])
    for name in given.values():
        if name not in names:
            what = (
                f"unknown name '{name}'{suggestion(name, names)}"
                if network.output
                else ("is missing")
            )
            raise InputError(
                f"{network.files[0]}: output: {what}; {network.model} gives {', '.join(names)}"
            )
    return given


def said(shape: Shape) -> str:
    """A shape in words: 1 x 3 x ? x ?."""
    return " x ".join("?" if size is None else str(size) for size in shape or (None,))


def lengths(patterns: dict[str, str], shapes: Mapping[str, Shape]) -> dict[str, int] | str:
    """The length of each letter of some patterns (`description.OUTPUTS`), or the name of the first
    shape that does not fit. A size that is not known fits."""
    found: dict[str, int] = {}
    for name, shape in shapes.items():
        pattern = patterns.get(name, patterns.get(f"({name})", "")).split()
        if shape is not None and len(pattern) != len(shape):
            return name
        for letter, size in zip(pattern, shape or (), strict=False):
            if size is not None and size != found.setdefault(
                letter, int(letter) if letter.isdecimal() else size
            ):
                return name
    return found


def _check(network: Network, names: dict[str, str], outputs: dict[str, NDArray[Any]]) -> None:
    """Raise InputError for outputs of other shapes than the YAML says, or with NaN."""
    patterns = OUTPUTS[network.layout]
    sizes = lengths(patterns, {role: value.shape for role, value in outputs.items()})
    for role, output in outputs.items():
        where = f"{network.files[0]}: output {names[role]}"
        if sizes == role or 0 in output.shape:
            raise InputError(
                f"{where} is {said(output.shape)}; layout {network.layout} needs"
                f" {patterns[role].replace(' ', ' x ')} (docs/networks.md)"
            )
        if not np.isfinite(output).all():
            bad = np.count_nonzero(~np.isfinite(output))
            raise InputError(f"{where}: {bad} of {output.size} numbers are not finite (NaN)")
    assert isinstance(sizes, dict)
    if problem := misfit(network, sizes):
        raise InputError(f"{network.files[0]}: output: {problem}")


def misfit(network: Network, sizes: dict[str, int]) -> str | None:
    """What differs from the numbers that the YAML says, None if nothing does."""
    n_classes, a, b, m = (sizes.get(letter, 0) for letter in "kabm")
    if isinstance(network.classes, int) and n_classes not in (0, network.classes):
        return f"has {n_classes} classes, but the YAML says classes: {network.classes}"
    if network.looked_at and max(network.looked_at) >= (n_classes or math.inf):
        return f"has {n_classes} classes, counted from 0, but the YAML names others"
    rows = network.rows
    if isinstance(rows, str):
        rows = tuple(ROWS[rows]) if network.layout == "row_anchors" else None
    if rows is not None and sizes.get("r", len(rows)) != len(rows):
        return f"has {sizes['r']} rows, but the YAML has {len(rows)}"
    last = max(network.first_x or 0, network.start or 0, network.length or 0)
    if network.layout == "polylines" and n_classes and n_classes <= last + 1:
        return f"has {n_classes} numbers per line; first_x, start and length must be among them"
    # Boxes that are not suppressed yet are more than the numbers of each.
    if network.layout == "prototypes" and a and b and m and b != 6 + m and not 5 + m <= a < b:
        return (
            f"has boxes {a} x {b}; with {m} prototypes these are 4 + classes + {m} numbers x"
            f" boxes, or boxes x {6 + m} (docs/networks.md)"
        )
    return None
