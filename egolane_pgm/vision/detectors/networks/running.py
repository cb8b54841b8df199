"""Run a network on pictures, by OpenCV (`cv2.dnn`).

OpenCV 5 does not list the inputs of an ONNX file, nor compare a picture with the declared input, so
the package onnx reads these.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.extras import needed as extra
from egolane_pgm.types import FloatArray, InputError, suggestion
from egolane_pgm.vision.camera.picture import Image, check_size
from egolane_pgm.vision.camera.writing import silent
from egolane_pgm.vision.detectors.networks.description import OUTPUTS, Network

#: The declared sizes, None for one that is not fixed; None if no shape is declared.
Shape = tuple[int | None, ...] | None

#: The outputs for one picture, without the first axis, by role.
Outputs = dict[str, FloatArray]


@dataclass(frozen=True)
class Fit:
    """The position of a camera's picture in the input of a network.

    - width, height: of the picture, pixels
    - top: first row of the picture that is used
    - left, upper, wide, high: rectangle of the input with the picture, pixels
    """

    width: int
    height: int
    top: int
    left: int
    upper: int
    wide: int
    high: int

    def to_picture(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Transform pixels u, v of the input to pixels of the picture."""
        in_u = (u + 0.5 - self.left) * self.width / self.wide - 0.5
        in_v = (v + 0.5 - self.upper) * (self.height - self.top) / self.high - 0.5
        return in_u, in_v + self.top


def fit_of(network: Network, width: int, height: int) -> Fit:
    """Return the position of a picture of this size in the input."""
    top = min(round(network.cut_top * height), height - 1)
    wide, high = network.size
    if network.letterbox is None:
        return Fit(width, height, top, 0, 0, wide, high)
    ratio = min(wide / width, high / (height - top))
    inner_w = max(round(width * ratio), 1)
    inner_h = max(round((height - top) * ratio), 1)
    left = (wide - inner_w) // 2
    upper = (high - inner_h) // 2
    return Fit(width, height, top, left, upper, inner_w, inner_h)


def as_input(network: Network, fit: Fit, image: Image) -> NDArray[np.float32]:
    """Return the input (1, 3, h, w) for a picture (H, W, 3). Raises InputError for a picture of
    another size than the camera's."""
    check_size(image, fit.width, fit.height)
    width, height = network.size
    seen = np.full((height, width, 3), network.letterbox or 0, dtype=np.uint8)
    seen[fit.upper : fit.upper + fit.high, fit.left : fit.left + fit.wide] = cv2.resize(
        image[fit.top :], (fit.wide, fit.high), interpolation=cv2.INTER_LINEAR
    )
    if network.swap_rb:
        seen = seen[..., ::-1]
    mean, scale = (np.asarray(v, dtype=np.float32) for v in (network.mean, network.scale))
    values = (seen.astype(np.float32) - mean) * scale
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None])


@dataclass(frozen=True)
class Declared:
    """The names and shapes of a network's inputs and outputs, and its file with all weights."""

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]
    content: bytes


def read_onnx(path: Path, where: str) -> Declared:
    """Read a network with its weights. Raises InputError, starting with `where`, for a file that
    cannot be read or is not an ONNX file, and if weights are missing."""
    with extra(f"{where}: {path}", "vision"):
        import onnx
        from google.protobuf.message import DecodeError
    try:
        # Without a format onnx would read a file that ends in .json or .txt as text.
        model = onnx.load(str(path), format="protobuf")
    except OSError as error:
        raise InputError(f"{where}: {path}: {error.strerror or error}") from None
    except (DecodeError, ValueError, onnx.checker.ValidationError) as error:
        reason = " ".join(str(error).split())[:240]
        raise InputError(
            f"{where}: {path}: is not an ONNX file that can be read: {reason}"
        ) from None
    if not model.graph.output:
        raise InputError(f"{where}: {path}: is not an ONNX file")

    def shapes(ports: list[onnx.ValueInfoProto]) -> dict[str, Shape]:
        tensors = {port.name: port.type.tensor_type for port in ports}
        return {
            name: tuple(size.dim_value if size.dim_value > 0 else None for size in tensor.shape.dim)
            if tensor.HasField("shape")
            else None
            for name, tensor in tensors.items()
        }

    # Older files list the weights among the inputs.
    weights = {tensor.name for tensor in model.graph.initializer}
    inputs = [port for port in model.graph.input if port.name not in weights]
    return Declared(shapes(inputs), shapes(model.graph.output), model.SerializeToString())


def load(network: Network, fit: Fit) -> Callable[[Image], Outputs]:
    """Load a network, try it, and make the function from a picture (H, W, 3) to its outputs.

    Raises InputError for a file that is not ONNX or that OpenCV cannot run, for inputs or outputs
    that differ from the YAML, and, while it runs, for an output that is not finite.
    """
    declared = read_onnx(Path(network.model), "model")
    names = _output_names(network, declared)
    picture = _picture_input(network, declared)
    where = f"model: {network.model}: OpenCV {cv2.__version__} cannot"
    with _opencv_errors(f"{where} load it"):
        net = cv2.dnn.readNetFromONNX(np.frombuffer(declared.content, dtype=np.uint8))
    constants = {
        name: np.full([size or 1 for size in declared.inputs[name] or ()], value, dtype=np.float32)
        for name, value in network.inputs.items()
    }

    def run(image: Image) -> Outputs:
        with _opencv_errors(f"{where} run it"):
            for port, value in (*constants.items(), (picture, as_input(network, fit, image))):
                net.setInput(value, port)
            # OpenCV 5 returns all outputs or one.
            answers = net.forward(list(declared.outputs))
        found = dict(zip(declared.outputs, map(np.asarray, answers), strict=True))
        for name in names.values():
            if not np.isfinite(found[name]).all():
                raise InputError(f"output {name}: has numbers that are not finite (NaN)")
        return {role: found[name].astype(np.float64) for role, name in names.items()}

    outputs = run(np.full((fit.height, fit.width, 3), 114, dtype=np.uint8))
    shapes = {role: value.shape for role, value in outputs.items()}
    sizes = lengths(network.layout, shapes, network.numbers)
    # The last index along k that is read.
    last = max(*network.used_channels, network.length and network.length + 2, 0)
    if sizes is None or last >= sizes.get("k", math.inf):
        found = ", ".join(f"{names[role]} {shape_text(shape)}" for role, shape in shapes.items())
        patterns = OUTPUTS[network.layout].items()
        needs = ", ".join(f"{role} {' x '.join(one.split())}" for role, one in patterns)
        known = "".join(f", {letter} = {n}" for letter, n in network.numbers.items())
        raise InputError(
            f"output: {found}; layout {network.layout} needs {needs}{known} (docs/networks.md)"
        )
    return lambda image: {role: value[0] for role, value in run(image).items()}


@contextmanager
def _opencv_errors(message: str) -> Iterator[None]:
    """Turn an error of OpenCV into one line."""
    try:
        with silent():
            yield
    except cv2.error as error:
        # The cause is at the end: OpenCV(5.0.0) FILE: error: (-2:Unspecified error) CAUSE >
        cause = re.split(r"error: \(-\d+:[^)]*\) ", " ".join(str(error).split()))[-1]
        raise InputError(f"{message}: {cause.removesuffix(' >')[:240]}") from None


def _picture_input(network: Network, declared: Declared) -> str:
    """Return the name of the input for the picture. Raises InputError if the
    YAML has other inputs."""
    left = [name for name in declared.inputs if name not in network.inputs]
    if len(left) != 1 or len(declared.inputs) != len(network.inputs) + 1:
        raise InputError(
            f"inputs: the network takes {', '.join(declared.inputs)}; give the constant of each but"
            f" the picture, e.g. inputs: {{{(left or ['state'])[-1]}: 0}}"
        )
    shape = declared.inputs[left[0]]
    needed = (1, 3, network.size[1], network.size[0])
    known = zip(shape or (), needed, strict=False)
    if shape is not None and (len(shape) != 4 or any(a not in (None, b) for a, b in known)):
        raise InputError(
            f"size: the network takes {shape_text(shape)} ({left[0]}), but size"
            f" {list(network.size)} makes {shape_text(needed)} (pictures, colours, height, width)"
        )
    return left[0]


def _output_names(network: Network, declared: Declared) -> dict[str, str]:
    """Return the output in the file for each role of the layout."""
    names = list(declared.outputs)
    given = network.named_outputs
    if network.output is None and len(names) == len(given) == 1:
        return dict.fromkeys(given, names[0])
    for name in given.values():
        if name not in names:
            raise InputError(
                f"output: no output '{name}'{suggestion(name, names)}; the network gives"
                f" {', '.join(names)}"
            )
    return given


def shape_text(shape: Shape) -> str:
    """Return a shape as text: 1 x 3 x ? x ?."""
    return " x ".join("?" if size is None else str(size) for size in shape or (None,))


def lengths(
    layout: str, shapes: Mapping[str, Shape], numbers: Mapping[str, int]
) -> dict[str, int] | None:
    """Return the length of each letter of a layout's outputs, None if the shapes do not fit it.

    An unknown size fits. numbers: lengths that are given.
    """
    found = dict(numbers)
    for role, shape in shapes.items():
        pattern = OUTPUTS[layout][role].split()
        if shape is not None and (len(pattern) != len(shape) or 0 in shape):
            return None
        for letter, size in zip(pattern, shape or (), strict=False):
            needed = int(letter) if letter.isdecimal() else size
            if size is not None and size != found.setdefault(letter, needed or size):
                return None
    a, b, m = (found.get(letter, 0) for letter in "abm")
    # Boxes outnumber their coefficients.
    return None if a and b and m and not 5 + m <= a < b else found
