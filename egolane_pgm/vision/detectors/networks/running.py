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
from egolane_pgm.vision.detectors.networks.description import OUTPUTS, POLYNOMIAL, ROWS, Network
from egolane_pgm.vision.detectors.networks.onnx_file import Declared, Shape, read_onnx

#: What a network gives for one picture, without the first axis, by what it is.
Outputs = dict[str, FloatArray]

#: Takes the next picture (H, W, 3) of a drive and gives the outputs that are looked at.
Run = Callable[[Image], Outputs]

#: The name of an output, and which part of its last axis is meant.
_Part = tuple[str, slice]


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
    inputs or outputs differ from what its YAML says. `Run` raises it for an output that is not
    finite.
    """
    where, onnx = str(network.file), network.onnx
    declared = read_onnx(onnx, f"{where}: model")
    picture = _picture_input(network, declared)
    parts = _parts(network, declared)
    with _opencv_errors(f"{where}: model: OpenCV {cv2.__version__} cannot load {onnx}"):
        net = cv2.dnn.readNetFromONNX(np.frombuffer(declared.content, dtype=np.uint8))

    names, given = list(declared.outputs), _first_inputs(network, declared)

    def run(image: Image) -> Outputs:
        values = as_input(network, fit, image)
        with _opencv_errors(f"{where}: OpenCV {cv2.__version__} cannot run {onnx}"):
            for port, value in (*given.items(), (picture, values)):
                whole = declared.whole.get(port)
                net.setInput(value if whole is None else value.round().astype(whole), port)
            # OpenCV 5 gives all outputs or one.
            found = dict(zip(names, map(np.asarray, net.forward(names)), strict=True))
        outputs = {role: _part(found, part) for role, part in parts.items()}
        _check_outputs(network, parts, outputs)
        for port, source in network.inputs.items():
            if isinstance(source, str):
                _push(given[port], _part(found, named(source)))
        return {role: value[0].astype(np.float64) for role, value in outputs.items()}

    grey = np.full((fit.height, fit.width, 3), 114, dtype=np.uint8)
    run(grey)
    given = _first_inputs(network, declared)
    return run


def named(text: str) -> _Part:
    """The name and the part of `name[first:stop:step]`."""
    name, *bounds = re.fullmatch(  # type: ignore[union-attr]
        r"(.*?)(?:\[(-?\d*):(-?\d*)(?::(\d+))?\])?", text
    ).groups()
    return name, slice(*(int(bound) if bound else None for bound in bounds))


def _part(found: Mapping[str, NDArray[Any]], part: _Part) -> NDArray[Any]:
    name, which = part
    return found[name][..., which] if which != slice(None) else found[name]


def _first_inputs(network: Network, declared: Declared) -> dict[str, NDArray[np.float32]]:
    """What all inputs but the picture get at first: constants, and zeros for what is fed back."""
    given = {}
    for name, value in network.inputs.items():
        shape = [size or 1 for size in declared.inputs[name] or ()]
        numbers = np.array(0 if isinstance(value, str) else value, dtype=np.float32)
        if numbers.size not in (1, math.prod(shape)):
            needed = said(declared.inputs[name])
            raise InputError(f"{network.file}: inputs.{name}: {numbers.size} numbers, not {needed}")
        given[name] = np.array(np.broadcast_to(numbers.ravel(), math.prod(shape))).reshape(shape)
    return given


def _push(state: NDArray[np.float32], new: NDArray[Any]) -> None:
    """Puts an output behind what a state already holds; the oldest numbers leave it."""
    both = np.concatenate([state.ravel(), new.ravel().astype(np.float32)])
    state[...] = both[-state.size :].reshape(state.shape)


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


def _picture_input(network: Network, declared: Declared) -> str:
    """The name of the input that gets the picture. Raises InputError for other inputs than the YAML
    says."""
    where = f"{network.file}: model: {network.onnx.name}"
    sources = [source for source in network.inputs.values() if isinstance(source, str)]
    for names, known in ((network.inputs, declared.inputs), (sources, declared.outputs)):
        for name in names:
            if named(name)[0] not in known:
                hint = suggestion(name, known)
                raise InputError(f"{network.file}: inputs: unknown name '{name}'{hint}")
    left = [name for name in declared.inputs if name not in network.inputs]
    if len(left) != 1:
        listed = ", ".join(declared.inputs) or "none"
        raise InputError(
            f"{where} takes {len(declared.inputs)} inputs ({listed}), not one picture; say in"
            f" inputs what the others get, e.g. inputs: {{{left[-1] if left else 'state'}: 0}}"
        )
    name, shape = left[0], declared.inputs[left[0]]
    needed = (1, 3, network.size[1], network.size[0])
    fits = shape is None or (
        len(shape) == 4
        and all(size in (None, want) for size, want in zip(shape, needed, strict=True))
    )
    if not fits:
        raise InputError(
            f"{where} takes {said(shape)} ({name}), but size {list(network.size)} makes"
            f" {said(needed)} (pictures, colours, height, width)"
        )
    if name in declared.whole and np.min(network.scale) < 1:
        raise InputError(f"{where} takes whole numbers ({declared.whole[name]}); say scale: 1")
    return name


def _parts(network: Network, declared: Declared) -> dict[str, _Part]:
    """The output, or the part of it, for each thing that the layout reads."""
    names, given = list(declared.outputs), network.named_outputs
    if network.output is None and len(names) == len(given) == 1:
        given = dict.fromkeys(given, names[0])
    parts = {role: named(text) for role, text in given.items()}
    for name, _ in parts.values():
        if name not in names:
            hint = suggestion(name, names)
            what = f"unknown name '{name}'{hint}" if network.output else "is missing"
            raise InputError(
                f"{network.file}: output: {what}; {network.onnx.name} gives {', '.join(names)}"
            )
    return parts


def said(shape: Shape) -> str:
    """A shape in words: 1 x 3 x ? x ?."""
    return " x ".join("?" if size is None else str(size) for size in shape or (None,))


def lengths(patterns: dict[str, str], shapes: Mapping[str, Shape]) -> dict[str, int] | str:
    """The length of each letter of some patterns (`description.OUTPUTS`), or the name of the first
    shape that does not fit. A size that is not known fits."""
    found: dict[str, int] = {}
    for name, shape in shapes.items():
        pattern = patterns.get(name, patterns.get(f"({name})", "")).split()
        if not pattern or shape is None:
            continue
        if len(pattern) != len(shape):
            return name
        for letter, size in zip(pattern, shape, strict=True):
            if size is not None and size != found.setdefault(
                letter, int(letter) if letter.isdecimal() else size
            ):
                return name
    return found


def _check_outputs(
    network: Network, parts: dict[str, _Part], outputs: dict[str, NDArray[Any]]
) -> None:
    """Raises InputError for outputs of other shapes than the YAML says, or with NaN."""
    patterns = OUTPUTS[network.layout]
    sizes = lengths(patterns, {role: value.shape for role, value in outputs.items()})
    for role, output in outputs.items():
        where, found = f"{network.file}: output {parts[role][0]}", said(output.shape)
        if output.dtype.kind != "f":
            raise InputError(f"{where} gives {output.dtype}, not probabilities or logits")
        if sizes == role or 0 in output.shape:
            raise InputError(
                f"{where} is {found}; layout {network.layout} needs"
                f" {patterns[role].replace(' ', ' x ')} (docs/networks.md)"
            )
        if not np.isfinite(output).all():
            bad = np.count_nonzero(~np.isfinite(output))
            raise InputError(f"{where}: {bad} of {output.size} numbers are not finite (NaN)")
    assert isinstance(sizes, dict)
    counts = {role: output.size for role, output in outputs.items()}
    if problem := wrong_length(network, sizes) or _wrong_count(network, counts):
        raise InputError(f"{network.file}: output: {problem}")


def impossible(layout: str, sizes: dict[str, int]) -> str | None:
    """What no network of a layout gives, None where one may. A size that is not known fits."""
    if layout == "polynomials" and sizes.get("k", 0) % POLYNOMIAL:
        return f"has {sizes['k']} numbers; each polynomial needs {POLYNOMIAL}"
    if layout == "prototypes" and {"a", "b", "m"} <= set(sizes):
        a, b, m = sizes["a"], sizes["b"], sizes["m"]
        # Boxes that are not suppressed yet are more than the numbers of each.
        if b != 6 + m and not 5 + m <= a < b:
            return (
                f"has boxes {a} x {b}; with {m} prototypes these are 4 + classes + {m} numbers x"
                f" boxes, or boxes x {6 + m} (docs/networks.md)"
            )
    return None


def wrong_length(network: Network, sizes: dict[str, int]) -> str | None:
    """What differs from the numbers that the YAML says, None where nothing does."""
    last = max(network.first_x or 0, network.start or 0, network.length or 0)
    if isinstance(network.classes, int) and sizes.get("k", network.classes) != network.classes:
        return f"has {sizes['k']} classes, but the YAML says classes: {network.classes}"
    if max(network.looked_at, default=0) >= sizes.get("k", math.inf):
        return f"has {sizes['k']} classes, counted from 0, but the YAML names others"
    rows = network.rows
    if isinstance(rows, str):
        rows = tuple(ROWS[rows]) if network.layout == "row_anchors" else None
    if rows is not None and sizes.get("r", len(rows)) != len(rows):
        return f"has {sizes['r']} rows, but the YAML has {len(rows)}"
    if network.layout == "polylines" and sizes.get("k", math.inf) <= last + 1:
        return f"has {sizes['k']} numbers per line; first_x, start and length must be among them"
    return impossible(network.layout, sizes)


def _wrong_count(network: Network, counts: dict[str, int]) -> str | None:
    """What does not fit of the numbers of lines on the road, None where all does."""
    if network.ahead is None:
        return None
    n_lines, rest = divmod(counts["places"], len(network.ahead))
    if rest or not n_lines:
        return f"has {counts['places']} places, not a multiple of {len(network.ahead)} distances"
    if counts["scores"] % n_lines:
        return f"has {counts['scores']} scores for {n_lines} lines"
    for role in ("deviations", "visible"):
        if counts.get(role, counts["places"]) != counts["places"]:
            return f"has {counts[role]} {role} for {counts['places']} places"
    return None
