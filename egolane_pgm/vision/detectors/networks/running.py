"""Takes pictures through a network, by OpenCV (`cv2.dnn`).

OpenCV 5 has no function that lists the inputs of an ONNX file, and does not compare a picture with
the declared one: the package onnx reads these.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.extras import needed as extra
from egolane_pgm.types import FloatArray, InputError, suggestion
from egolane_pgm.vision.camera.picture import Image, check_size
from egolane_pgm.vision.camera.writing import silent
from egolane_pgm.vision.detectors.networks.description import OUTPUTS, Network

if TYPE_CHECKING:
    from onnx import ValueInfoProto

#: A size that is not fixed is None. Shape None: none is declared.
Shape = tuple[int | None, ...] | None

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


@dataclass(frozen=True)
class Declared:
    """A network as its file has it.

    - inputs, outputs: their names and shapes, in their order
    - types: the types of the inputs
    - content: the file, with the weights that it keeps in others
    """

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]
    types: dict[str, np.dtype[Any]]
    content: bytes


def read_onnx(path: Path, where: str) -> Declared:
    """Read a network with its weights. Raises InputError, starting with `where`, for a file that
    cannot be read or is no ONNX, and if weights are missing."""
    with extra(f"{where}: {path}", "vision"):
        import onnx
        from google.protobuf.message import DecodeError
    try:
        # Without a format onnx would take a file that ends in .json or .txt for text.
        model = onnx.load(str(path), format="protobuf")
    except OSError as error:
        raise InputError(f"{where}: {path}: {error.strerror or error}") from None
    except (DecodeError, ValueError, onnx.checker.ValidationError) as error:
        said = " ".join(str(error).split())[:240]
        raise InputError(f"{where}: {path}: is no ONNX file that can be read: {said}") from None
    if not model.graph.output:
        raise InputError(f"{where}: {path}: is no ONNX file")
    # Older files list the weights among the inputs.
    weights = {tensor.name for tensor in model.graph.initializer}
    inputs = [port for port in model.graph.input if port.name not in weights]
    kinds = {port.name: port.type.tensor_type.elem_type for port in inputs}
    return Declared(
        {port.name: _shape(port) for port in inputs},
        {port.name: _shape(port) for port in model.graph.output},
        {name: onnx.helper.tensor_dtype_to_np_dtype(kind) for name, kind in kinds.items()},
        model.SerializeToString(),
    )


def _shape(port: ValueInfoProto) -> Shape:
    tensor = port.type.tensor_type
    if not tensor.HasField("shape"):
        return None
    return tuple(size.dim_value if size.dim_value > 0 else None for size in tensor.shape.dim)


def load(network: Network, fit: Fit) -> Callable[[Image], Outputs]:
    """Load a network, try it once, and make the function that takes a picture (H, W, 3) through it.

    Raises InputError for a file that is no ONNX or that OpenCV cannot run, for inputs or outputs
    that differ from what the YAML says, and, while it runs, for an output that is not finite.
    """
    file, onnx = network.files
    declared = read_onnx(onnx, f"{file}: model")
    names = _output_names(network, declared)
    picture = _picture_input(network, declared)
    where = f"{file}: model: {onnx.name}: OpenCV {cv2.__version__} cannot"
    with _opencv_errors(f"{where} load it"):
        net = cv2.dnn.readNetFromONNX(np.frombuffer(declared.content, dtype=np.uint8))
    given = {
        name: np.full([size or 1 for size in declared.inputs[name] or ()], value, dtype=np.float32)
        for name, value in network.inputs.items()
    }

    def run(image: Image) -> Outputs:
        values = as_input(network, fit, image)
        if declared.types[picture].kind in "iu":
            values = values.round().astype(declared.types[picture])
        with _opencv_errors(f"{where} run it"):
            for port, value in (*given.items(), (picture, values)):
                net.setInput(value, port)
            # OpenCV 5 gives all outputs or one.
            answers = net.forward(list(declared.outputs))
        found = dict(zip(declared.outputs, map(np.asarray, answers), strict=True))
        for name in names.values():
            if not np.isfinite(found[name]).all():
                raise InputError(f"{file}: output {name}: has numbers that are not finite (NaN)")
        return {role: found[name].astype(np.float64) for role, name in names.items()}

    outputs = run(np.full((fit.height, fit.width, 3), 114, dtype=np.uint8))
    shapes = {role: value.shape for role, value in outputs.items()}
    if lengths(network, shapes, network.numbers) is None:
        given_as = ", ".join(f"{names[role]} {said(shape)}" for role, shape in shapes.items())
        patterns = OUTPUTS[network.layout].items()
        needs = ", ".join(f"{role} {' x '.join(one.split())}" for role, one in patterns)
        known = "".join(f", {letter} = {n}" for letter, n in network.numbers.items())
        raise InputError(
            f"{file}: output: {given_as}; layout {network.layout} needs {needs}{known}"
            " (docs/networks.md)"
        )
    return lambda image: {role: value[0] for role, value in run(image).items()}


@contextmanager
def _opencv_errors(message: str) -> Iterator[None]:
    """Make one line of an error of OpenCV's."""
    try:
        with silent():
            yield
    except cv2.error as error:
        # What it says last is the cause: OpenCV(5.0.0) FILE: error: (-2:Unspecified error) CAUSE >
        cause = re.split(r"error: \(-\d+:[^)]*\) ", " ".join(str(error).split()))[-1]
        raise InputError(f"{message}: {cause.removesuffix(' >')[:240]}") from None


def _picture_input(network: Network, declared: Declared) -> str:
    """The name of the input that gets the picture. Raises InputError for other inputs than the YAML
    says."""
    left = [name for name in declared.inputs if name not in network.inputs]
    if len(left) != 1 or len(declared.inputs) != len(network.inputs) + 1:
        raise InputError(
            f"{network.files[0]}: inputs: {network.model} takes {', '.join(declared.inputs)}; say"
            f" what each gets but the picture, e.g. inputs: {{{(left or ['state'])[-1]}: 0}}"
        )
    shape, needed = declared.inputs[left[0]], (1, 3, network.size[1], network.size[0])
    if shape is not None and not (
        len(shape) == 4 and all(a in (None, b) for a, b in zip(shape, needed, strict=True))
    ):
        raise InputError(
            f"{network.files[0]}: size: {network.model} takes {said(shape)} ({left[0]}), but size"
            f" {list(network.size)} makes {said(needed)} (pictures, colours, height, width)"
        )
    return left[0]


def _output_names(network: Network, declared: Declared) -> dict[str, str]:
    """The output in the file for each thing that the layout reads."""
    names, given = list(declared.outputs), network.named_outputs
    if network.output is None and len(names) == len(given) == 1:
        return dict.fromkeys(given, names[0])
    for name in given.values():
        if name not in names:
            raise InputError(
                f"{network.files[0]}: output: no output '{name}'{suggestion(name, names)};"
                f" {network.model} gives {', '.join(names)}"
            )
    return given


def said(shape: Shape) -> str:
    """A shape in words: 1 x 3 x ? x ?."""
    return " x ".join("?" if size is None else str(size) for size in shape or (None,))


def lengths(
    network: Network, shapes: Mapping[str, Shape], numbers: Mapping[str, int] | None
) -> dict[str, int] | None:
    """The length of each letter of the layout's outputs, None for shapes that do not fit it. A size
    that is not known fits.

    numbers: the lengths that the YAML says; None where these do not count.
    """
    found = dict(numbers or {})
    for role, shape in shapes.items():
        patterns = OUTPUTS[network.layout]
        pattern = patterns.get(role, patterns.get(f"({role})", "")).split()
        if shape is not None and (len(pattern) != len(shape) or 0 in shape):
            return None
        for letter, size in zip(pattern, shape or (), strict=False):
            needed = int(letter) if letter.isdecimal() else size
            if size is not None and size != found.setdefault(letter, needed or size):
                return None
    if numbers is not None and network.last >= found.get("k", math.inf):
        return None
    a, b, m = (found.get(letter, 0) for letter in "abm")
    # Boxes that are not suppressed yet are more than the numbers of each.
    if network.layout == "prototypes" and a and b and m and b != 6 + m and not 5 + m <= a < b:
        return None
    return found
