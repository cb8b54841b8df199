"""Takes pictures through a network, by OpenCV (`cv2.dnn`)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray, InputError, suggestion
from egolane_pgm.vision.camera.picture import Image, check_size
from egolane_pgm.vision.camera.writing import silent
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.onnx_file import Declared, read_onnx

#: What a network gives for one picture, without the first axis.
Output = NDArray[np.float32]

#: Takes a picture (H, W, 3) and gives the output that is looked at.
Run = Callable[[Image], Output]


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
        """Takes pixels u, v of the input to pixels of the picture."""
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
    """The input (1, 3, h, w) of a network for a picture (H, W, 3).

    Raises InputError for a picture of another size than the camera's.
    """
    check_size(image, fit.width, fit.height)
    seen = cv2.resize(image[fit.top :], (fit.wide, fit.high), interpolation=cv2.INTER_LINEAR)
    if network.letterbox is not None:
        width, height = network.size
        right, lower = width - fit.left - fit.wide, height - fit.upper - fit.high
        bars = (fit.upper, lower, fit.left, right)
        grey = (float(network.letterbox),) * 3
        seen = cv2.copyMakeBorder(seen, *bars, cv2.BORDER_CONSTANT, value=grey)
    if network.swap_rb:
        seen = seen[..., ::-1]
    mean, scale = (np.asarray(v, dtype=np.float32) for v in (network.mean, network.scale))
    values = (seen.astype(np.float32) - mean) * scale
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None])


def load(network: Network, fit: Fit) -> Run:
    """Loads a network and tries it once.

    Raises InputError for a file that is no ONNX or that OpenCV cannot run, and for a network whose
    input or output differs from what its YAML says. `Run` raises it for an output that is not
    finite.
    """
    where, onnx = str(network.file), network.onnx
    declared = read_onnx(onnx, f"{where}: model")
    _check_input(network, declared)
    name = _output_name(network, declared)
    with _opencv_errors(f"{where}: model: OpenCV {cv2.__version__} cannot load {onnx}"):
        net = cv2.dnn.readNetFromONNX(np.frombuffer(declared.content, dtype=np.uint8))

    def run(image: Image) -> Output:
        values = as_input(network, fit, image)
        with _opencv_errors(f"{where}: OpenCV {cv2.__version__} cannot run {onnx}"):
            net.setInput(values)
            found = net.forward(name)
        output = np.asarray(found)
        _check_output(network, name, output)
        return np.asarray(output[0], dtype=np.float32)

    grey = np.full((fit.height, fit.width, 3), 114, dtype=np.uint8)
    run(grey)
    return run


@contextmanager
def _opencv_errors(message: str) -> Iterator[None]:
    """Makes one line of an error of OpenCV's."""
    try:
        with silent():
            yield
    except cv2.error as error:
        # What it says last is the cause: OpenCV(5.0.0) FILE: error: (-2:Unspecified error) CAUSE >
        said = re.split(r"error: \(-\d+:[^)]*\) ", " ".join(str(error).split()))[-1]
        raise InputError(f"{message}: {said.removesuffix(' >')[:240]}") from None


def _check_input(network: Network, declared: Declared) -> None:
    where = f"{network.file}: model: {network.onnx.name}"
    if len(declared.inputs) != 1:
        names = ", ".join(declared.inputs) or "none"
        raise InputError(f"{where} takes {len(declared.inputs)} inputs ({names}), not one picture")
    ((name, shape),) = declared.inputs.items()
    if shape is None:
        return
    needed = (1, 3, network.size[1], network.size[0])
    fits = len(shape) == 4 and all(
        size in (None, want) for size, want in zip(shape, needed, strict=True)
    )
    if not fits:
        takes = " x ".join("?" if size is None else str(size) for size in shape)
        gets = " x ".join(map(str, needed))
        raise InputError(
            f"{where} takes {takes} ({name}), but size {list(network.size)} makes {gets}"
            " (pictures, colours, height, width)"
        )


def _output_name(network: Network, declared: Declared) -> str:
    where, names = str(network.file), list(declared.outputs)
    if network.output is None:
        if len(names) != 1:
            raise InputError(
                f"{where}: output: is missing; {network.onnx.name} gives {', '.join(names)}"
            )
        return names[0]
    if network.output not in names:
        raise InputError(
            f"{where}: output: unknown name '{network.output}'{suggestion(network.output, names)}"
        )
    return network.output


def _check_output(network: Network, name: str, output: NDArray[np.generic]) -> None:
    """Raises InputError for an output of another shape than the YAML says, or with NaN."""
    where = f"{network.file}: output {name}"
    shape, found = output.shape, " x ".join(map(str, output.shape))
    if output.dtype.kind != "f":
        raise InputError(f"{where} gives {output.dtype}, not probabilities or logits")
    n_axes = 3 if network.layout == "polylines" else 4
    if len(shape) != n_axes or shape[0] != 1 or 0 in shape:
        raise InputError(
            f"{where} is {found}; layout {network.layout} needs {n_axes} axes, the first of length"
            " 1 (docs/networks.md)"
        )
    if network.classes is not None and shape[1] != network.classes:
        raise InputError(
            f"{where} has {shape[1]} classes ({found}), but the YAML says classes:"
            f" {network.classes}"
        )
    if network.rows is not None and shape[2] != len(network.rows):
        raise InputError(
            f"{where} has {shape[2]} rows ({found}), but the YAML lists {len(network.rows)}"
        )
    if network.first_x is not None:
        last = max(network.first_x + 1, network.start or 0, network.length or 0)
        if last >= shape[2]:
            raise InputError(
                f"{where} has {shape[2]} numbers per line ({found}); first_x, start and length"
                " must be among them"
            )
    if not np.isfinite(output).all():
        bad = np.count_nonzero(~np.isfinite(output))
        raise InputError(f"{where}: {bad} of {output.size} numbers are not finite (NaN)")
