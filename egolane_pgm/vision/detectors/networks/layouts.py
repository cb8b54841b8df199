"""Read the outputs of a network, by layout.

To add a layout, add its outputs to `description.OUTPUTS` and its function to `_LINES`. The function
returns lines in pixels of the network's input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.special import expit, softmax

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.networks.description import ROWS, Network
from egolane_pgm.vision.detectors.networks.running import Fit, Outputs

#: First and last row of `hybrid_anchors`, shares of the picture's height (its utils/common.py).
_SHARES = {"tusimple": (160 / 720, 710 / 720), "culane": (0.42, 1.0)}

#: The four lines of `hybrid_anchors`: the inner ones have anchors in rows, the outer ones in
#: columns; the last number is the least share of anchors of a line (`pred2coords` of its demo.py).
_ANCHORS = (("row", (1, 2), 1 / 2), ("col", (0, 3), 1 / 4))

#: Largest overlap of two boxes of a class.
_OVERLAP = 0.7

#: Least probability of a pixel in a mask.
_INSIDE = 0.5

#: Position of a polyline's start among the numbers of a candidate.
_START = 2


@dataclass(frozen=True)
class Line:
    """A line: its points (P, 2), pixels, its probability, and its class or None."""

    points: FloatArray
    probability: float = 1.0
    kind: int | None = None


def answer(network: Network, fit: Fit, outputs: Outputs) -> Image | list[Line]:
    """Read the outputs of a network: a mask (H, W) of the picture, 255 on markings; or lines, in
    pixels of the picture."""
    if network.layout == "lanes":
        return _mask(network, fit, outputs["mask"])
    return [
        replace(line, points=np.stack(fit.to_picture(*line.points.T), axis=1))
        for line in _LINES[network.layout](network, outputs)
        if len(line.points) > 1 and (line.kind in network.continuous or not network.continuous)
    ]


def _probabilities(network: Network, output: FloatArray) -> FloatArray:
    """Return the probabilities (K, h, w) of the used channels."""
    share: FloatArray = output
    if network.activation != "none":
        share = softmax(output, axis=0) if network.activation == "softmax" else expit(output)
    return share[list(network.used_channels)]


def _mask(network: Network, fit: Fit, output: FloatArray) -> Image:
    """Return the mask of all lines."""
    share = cv2.resize(_probabilities(network, output).sum(axis=0), network.size)
    share = share[fit.upper : fit.upper + fit.high, fit.left : fit.left + fit.wide]
    mask = np.zeros((fit.height, fit.width), dtype=np.uint8)
    lower = cv2.resize(share, (fit.width, fit.height - fit.top))
    mask[fit.top :] = np.where(lower >= network.threshold, 255, 0)
    return mask


def _instances(network: Network, outputs: Outputs) -> list[Line]:
    """SCNN: a mask per line. Its probability is the mean of its pixels."""
    shares = _probabilities(network, outputs["mask"])
    kinds = network.used_channels if network.continuous else (None,) * len(shares)
    return [
        Line(_middle(network, share, network.threshold), float(share[inside].mean()), kind)
        for share, kind in zip(shares, kinds, strict=True)
        if (inside := share >= network.threshold).any()
    ]


def _middle(network: Network, share: FloatArray, least: float) -> FloatArray:
    """Return the weighted middle (P, 2) of each row of a mask (h, w) above a probability."""
    weight = np.where(share >= least, share, 0)
    total = weight.sum(axis=1)
    rows = np.flatnonzero(total)
    at = (weight[rows] @ np.arange(weight.shape[1])) / total[rows]
    across = network.size[0] / weight.shape[1]
    down = network.size[1] / weight.shape[0]
    return np.stack([(at + 0.5) * across - 0.5, (rows + 0.5) * down - 0.5], axis=1)


def _prototypes(network: Network, outputs: Outputs) -> list[Line]:
    """YOLO: each box has a class and coefficients of common masks."""
    common = outputs["prototypes"]
    boxes = outputs["boxes"].T
    classes, coefficients = np.split(boxes[:, 4:], [-len(common)], axis=1)
    share = classes.max(axis=1)
    kind = classes.argmax(axis=1)
    first = boxes[:, :2] - boxes[:, 2:4] / 2
    size = boxes[:, 2:4]
    rectangles = np.concatenate([first, size], axis=1).tolist()
    kept = cv2.dnn.NMSBoxesBatched(
        rectangles, share.tolist(), kind.tolist(), network.threshold, _OVERLAP
    )
    height, width = common.shape[1:]
    scale = np.array([width, height]) / network.size
    rows, columns = np.mgrid[:height, :width]
    lines = []
    for k in np.array(kept, dtype=np.int64).ravel():
        left, upper = first[k] * scale
        right, lower = (first[k] + size[k]) * scale
        inside = (columns >= left) & (columns < right) & (rows >= upper) & (rows < lower)
        mask = expit(np.tensordot(coefficients[k], common, axes=1)) * inside
        lines.append(Line(_middle(network, mask, _INSIDE), share[k], int(kind[k])))
    return lines


def _row_anchors(network: Network, outputs: Outputs) -> list[Line]:
    """Ultra-Fast-Lane-Detection: the expected column in each row whose most probable class is not
    "no line" (equation 5 of its paper). A column is as wide as the input over columns - 1."""
    output = outputs["columns"]
    n_columns = output.shape[0] - 1
    column = np.tensordot(np.arange(n_columns), softmax(output[:-1], axis=0), axes=1)
    u = (column + 0.5) * (network.size[0] - 1) / (n_columns - 1)
    is_line = output.argmax(axis=0) < n_columns
    likely = 1 - softmax(output, axis=0)[-1]
    rows = ROWS[str(network.rows)]
    return [
        Line(np.stack([u[at, k], rows[at]], axis=1), float(likely[at, k].mean()))
        for k, at in enumerate(is_line.T)
        if at.any()
    ]


def _hybrid_anchors(network: Network, outputs: Outputs) -> list[Line]:
    """Ultra-Fast-Lane-Detection v2: the cell of each anchor with a line, interpolated with its
    neighbours (`pred2coords`)."""
    width, height = network.size

    def row_of(share: FloatArray) -> FloatArray:
        """Return rows of the input from shares of the picture's height."""
        return (share - network.cut_top) / (1 - network.cut_top) * height - 0.5

    lines = []
    for axis, which, least in _ANCHORS:
        cells = outputs[f"loc_{axis}"]
        exists = outputs[f"exist_{axis}"]
        is_line = exists.argmax(axis=0) == 1
        likely = softmax(exists, axis=0)[1]
        away = np.abs(np.arange(len(cells))[:, None, None] - cells.argmax(axis=0))
        weight = softmax(np.where(away <= 1, cells, -np.inf), axis=0)
        at = (np.tensordot(np.arange(len(cells)), weight, axes=1) + 0.5) / (len(cells) - 1)
        if axis == "col":
            anchors = np.linspace(0, 1, cells.shape[1]) * width - 0.5
        else:
            anchors = row_of(np.linspace(*_SHARES[str(network.rows)], cells.shape[1]))
        for line in which:
            seen = is_line[:, line]
            if seen.sum() <= len(seen) * least:
                continue
            across = at[seen, line]
            along = anchors[seen]
            u, v = (across * width - 0.5, along) if axis == "row" else (along, row_of(across))
            lines.append(Line(np.stack([u, v], axis=1), float(likely[seen, line].mean())))
    return lines


def _polylines(network: Network, outputs: Outputs) -> list[Line]:
    """CLRNet, LaneATT: x in evenly spaced rows from the bottom to the top, from the start of each
    probable candidate over its length."""
    values = outputs["candidates"]
    first_x = network.length + 1
    share = softmax(values[:, :2], axis=1)[:, 1]
    x_scale = 1.0 if network.in_pixels else network.size[0] - 1
    steps = values.shape[1] - first_x - 1
    v = np.linspace(1, 0, steps + 1) * (network.size[1] - 1)
    lines = []
    for k in np.flatnonzero(share >= network.threshold):
        first = int(np.clip(round(values[k, _START] * steps), 0, steps))
        n = round(values[k, network.length] * (1 if network.in_pixels else steps))
        at = slice(first, first + max(n, 0))
        x = values[k, first_x:][at] * x_scale
        lines.append(Line(np.stack([x, v[at]], axis=1), share[k]))
    return lines


def _lstr_curves(network: Network, outputs: Outputs) -> list[Line]:
    """LSTR, in shares of the input: from the lower to the upper y,
    k'' / (y - f'')^2 + m'' / (y - f'') + n' + b'' y - b''' (equation 5 of Liu 2021)."""
    share = softmax(outputs["scores"], axis=1)[:, 1]
    kept = share >= network.threshold
    lower, upper, k, f, m, n, b, c = outputs["curves"][kept].T[:, :, None]
    y = lower + (upper - lower) * np.linspace(0, 1, 100)
    # A curve may have a pole in the picture.
    with np.errstate(divide="ignore", invalid="ignore"):
        x = k / (y - f) ** 2 + m / (y - f) + n + b * y - c
    points = np.stack([x * network.size[0] - 0.5, y * network.size[1] - 0.5], axis=2)
    return [
        Line(line[np.isfinite(line[:, 0])], likely)
        for line, likely in zip(points, share[kept], strict=True)
    ]


#: The function of each layout with lines.
_LINES: dict[str, Callable[[Network, Outputs], list[Line]]] = {
    "instances": _instances,
    "row_anchors": _row_anchors,
    "hybrid_anchors": _hybrid_anchors,
    "polylines": _polylines,
    "prototypes": _prototypes,
    "lstr_curves": _lstr_curves,
}
