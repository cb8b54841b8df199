"""Reads the outputs of a network as its layout says, and brings what it sees onto the road.

To add a layout: its outputs in `description.OUTPUTS`, and here a function that reads them.
A mask is looked at from above as a picture is. Lines, which come as points, are drawn from above
into a mask, so that both are found by the same code afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.networks.description import POLYNOMIAL, ROWS, Network
from egolane_pgm.vision.detectors.networks.running import Fit, Outputs
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look

#: The width of a line that is drawn from above, metres.
_LINE_M = 0.1

#: Fractional bits of the places that cv2.polylines draws at.
_BITS = 4

#: Points of lines that are farther ahead are left out, metres.
_FARTHEST_M = 150.0


@dataclass(frozen=True)
class Line:
    """One line: its points (P, 2), its probability, and its class, None where it has none.

    A layout gives u and v, pixels of the network's input, which become pixels of the picture;
    `road_lines` gives x and y on the road, metres ahead and to the right.
    """

    points: FloatArray
    probability: float = 1.0
    kind: int | None = None


@dataclass(frozen=True)
class Answer:
    """What a network sees: a mask (H, W) of the picture, 255 where it sees the area or the
    markings; or lines, in the picture or on the road."""

    mask: Image | None
    lines: tuple[Line, ...] = ()
    on_road: bool = False


def answer(network: Network, fit: Fit, outputs: Outputs) -> Answer:
    """Reads the outputs of a network."""
    if network.layout in ("drivable", "lanes"):
        return mask(network, fit, outputs)
    is_on_road = network.layout == "road_lines"
    lines = [line for line in _LINES[network.layout](network, outputs) if len(line.points) > 1]
    if network.continuous:
        lines = [line for line in lines if line.kind in network.continuous]
    if not is_on_road:
        lines = [replace(line, points=_points(*fit.to_picture(*line.points.T))) for line in lines]
    return Answer(None, lines=tuple(lines), on_road=is_on_road)


def from_above(view: BirdsEye, seen: Answer) -> NDArray[np.uint8]:
    """1 where the bird's-eye view shows what the network sees, else 0; (R, C)."""
    if seen.mask is not None:
        above = (look(view, seen.mask) > 127).astype(np.uint8)
    else:
        above = np.zeros(view.valid.shape, dtype=np.uint8)
        wide = max(round(_LINE_M / view.across_m), 1)
        for line in seen.lines:
            x, y = on_road(view.camera, seen, line)
            column = (y - view.y_m[0]) / view.across_m
            row = (view.x_m[0] - x) / view.along_m
            points = np.round(_points(column, row) * 2**_BITS).astype(np.int32)
            cv2.polylines(above, [points], False, 1, wide, cv2.LINE_8, _BITS)
    above[~view.valid] = 0
    return above


def on_road(camera: Camera, seen: Answer, line: Line) -> tuple[FloatArray, FloatArray]:
    """The points of a line on the road, x ahead and y to the right, (P,), metres."""
    x, y = line.points.T if seen.on_road else image_to_road(camera, *line.points.T)
    # What is above the horizon or much farther than a view has no place in it.
    near = np.isfinite(x) & (x > 0) & (x < _FARTHEST_M) & (np.abs(y) < 100)
    return x[near], y[near]


def _points(u: FloatArray, v: FloatArray) -> FloatArray:
    """(P, 2) of two (P,)."""
    return np.stack([u, v], axis=1)


def _activated(network: Network, output: FloatArray, axis: int) -> FloatArray:
    """Probabilities of the same shape; classes are along the axis."""
    share: FloatArray = output
    if network.activation == "softmax":
        share = scipy.special.softmax(output, axis=axis)
    elif network.activation == "sigmoid":
        share = scipy.special.expit(output)
    return share


def _best_class(share: FloatArray) -> tuple[FloatArray, IntArray]:
    """The probability and the class, (N,) each, of candidates with the probabilities (N, K) of
    their classes."""
    best = share.argmax(axis=1)
    return share[np.arange(len(share)), best], best


# --- masks: of the road's free area, of all markings, or one for each line ------------------------


def probabilities(network: Network, output: FloatArray) -> FloatArray:
    """The probabilities (K, h, w) of the channels that are looked at."""
    return _activated(network, output, 0)[list(network.looked_at)]


def mask(network: Network, fit: Fit, outputs: Outputs) -> Answer:
    """The answer of a network with one mask for all lines, or for the road, which lines are part
    of."""
    masks = [probabilities(network, output).sum(axis=0) for output in outputs.values()]
    # Where it has the size already, OpenCV copies it only.
    share = np.max([cv2.resize(one, network.size) for one in masks], axis=0)
    share = share[fit.upper : fit.upper + fit.high, fit.left : fit.left + fit.wide]
    seen = np.zeros((fit.height, fit.width), dtype=np.uint8)
    lower = cv2.resize(share, (fit.width, fit.height - fit.top))
    seen[fit.top :] = np.where(lower >= network.threshold, 255, 0)
    return Answer(seen)


def instances(network: Network, outputs: Outputs) -> list[Line]:
    """The lines of a network with a mask for each."""
    shares = probabilities(network, outputs["mask"])
    kinds = network.looked_at if network.continuous else (None,) * len(shares)
    return [
        Line(_middle(network, share, network.threshold), kind=kind)
        for share, kind in zip(shares, kinds, strict=True)
    ]


def _middle(network: Network, share: FloatArray, least: float) -> FloatArray:
    """The weighted middle (P, 2) of a mask's (h, w) pixels with the least probability, row by row,
    in pixels of the input."""
    weight = np.where(share >= least, share, 0)
    total = weight.sum(axis=1)
    rows = np.flatnonzero(total)
    at = (weight[rows] @ np.arange(weight.shape[1])) / total[rows]
    across, down = network.size[0] / weight.shape[1], network.size[1] / weight.shape[0]
    return _points((at + 0.5) * across - 0.5, (rows + 0.5) * down - 0.5)


# --- instance segmentation: a class and a mask for each line --------------------------------------

#: Of boxes of one class that share more than this of their area, the most probable is kept.
_OVERLAP = 0.7

#: The least probability of a pixel of a mask.
_INSIDE = 0.5


def prototypes(network: Network, outputs: Outputs) -> list[Line]:
    """YOLO: each box has the coefficients of common masks. Boxes come as (4 + classes + masks,
    boxes), or, where the file ends in its own suppression, as (boxes, 6 + masks): corners,
    probability, class."""
    common = outputs["prototypes"]
    boxes = outputs["boxes"]
    n_masks = len(common)
    if boxes.shape[1] == 6 + n_masks:
        corners, share, kind = boxes[:, :4], boxes[:, 4], boxes[:, 5].astype(np.int64)
        kept = np.flatnonzero(share >= network.threshold)
    else:
        boxes = boxes.T
        share, kind = _best_class(boxes[:, 4:-n_masks])
        at, size = boxes[:, :2], boxes[:, 2:4]
        corners = np.concatenate([at - size / 2, at + size / 2], axis=1)
        places = np.concatenate([at - size / 2, size], axis=1)
        found = cv2.dnn.NMSBoxesBatched(
            places.tolist(), share.tolist(), kind.tolist(), network.threshold, _OVERLAP
        )
        kept = np.array(found, dtype=np.int64).ravel()
    height, width = common.shape[1:]
    scale = np.tile([width, height], 2) / np.tile(network.size, 2)
    rows, columns = np.mgrid[:height, :width]
    lines = []
    for k in kept:
        left, upper, right, lower = corners[k] * scale
        inside = (columns >= left) & (columns < right) & (rows >= upper) & (rows < lower)
        seen = scipy.special.expit(np.tensordot(boxes[k, -n_masks:], common, axes=1)) * inside
        lines.append(Line(_middle(network, seen, _INSIDE), share[k], int(kind[k])))
    return lines


def queries(network: Network, outputs: Outputs) -> list[Line]:
    """RF-DETR: each candidate has the logits of its classes and of its own mask."""
    share, kind = _best_class(scipy.special.expit(outputs["scores"]))
    masks = scipy.special.expit(outputs["masks"])
    kept = np.flatnonzero(share >= network.threshold)
    return [Line(_middle(network, masks[k], _INSIDE), share[k], int(kind[k])) for k in kept]


# --- a column for each row, and a row for each column: Ultra-Fast-Lane-Detection ------------------

#: First and last row of the second version, shares of the picture's height (its utils/common.py).
_SHARES = {"tusimple": (160 / 720, 710 / 720), "culane": (0.42, 1.0)}

#: Of the second version's four lines, those beside the car are found in rows, the outer ones in
#: columns; the least share of anchors that see one (`pred2coords` of its demo.py).
_ANCHORS = (("row", (1, 2), 1 / 2), ("col", (0, 3), 1 / 4))


def row_anchors(network: Network, outputs: Outputs) -> list[Line]:
    """The expected column in each row where the likeliest class is not "no line" (equation 5 of the
    first paper). A column is as wide as the input over columns - 1."""
    output = outputs["columns"]
    n_columns = output.shape[0] - 1
    share = scipy.special.softmax(output[:-1], axis=0)
    column = np.tensordot(np.arange(n_columns), share, axes=1)
    u = (column + 0.5) * (network.size[0] - 1) / (n_columns - 1)
    is_there = output.argmax(axis=0) < n_columns
    rows = ROWS[network.rows] if isinstance(network.rows, str) else np.asarray(network.rows)
    return [Line(_points(u[there, k], rows[there])) for k, there in enumerate(is_there.T)]


def hybrid_anchors(network: Network, outputs: Outputs) -> list[Line]:
    """The cell of each anchor that sees a line, to a fraction by its neighbours (`pred2coords`)."""
    width, height = network.size

    def row_of(share: FloatArray) -> FloatArray:
        """Rows of the input, by shares of the picture's height."""
        return (share - network.cut_top) / (1 - network.cut_top) * height - 0.5

    lines = []
    for way, which, least in _ANCHORS:
        cells, exists = outputs[f"loc_{way}"], outputs[f"exist_{way}"]
        there = exists.argmax(axis=0) == 1
        at = _expected(cells) / (cells.shape[0] - 1)
        likely = scipy.special.softmax(exists, axis=0)[1]
        if way == "col":
            anchors = np.linspace(0, 1, cells.shape[1]) * width - 0.5
        elif isinstance(network.rows, str):
            anchors = row_of(np.linspace(*_SHARES[network.rows], cells.shape[1]))
        else:
            anchors = np.asarray(network.rows)
        for line in which:
            seen = there[:, line]
            if seen.sum() <= len(seen) * least:
                continue
            across, along = at[seen, line], anchors[seen]
            found = (
                _points(across * width - 0.5, along)
                if way == "row"
                else _points(along, row_of(across))
            )
            lines.append(Line(found, float(likely[seen, line].mean())))
    return lines


def _expected(cells: FloatArray) -> FloatArray:
    """The middle (anchors, lines) of the likeliest of the cells (K, anchors, lines) and its
    neighbours, weighted by what they are worth."""
    away = np.abs(np.arange(len(cells))[:, None, None] - cells.argmax(axis=0))
    share = scipy.special.softmax(np.where(away <= 1, cells, -np.inf), axis=0)
    return np.tensordot(np.arange(len(cells)), share, axes=1) + 0.5


# --- x in rows that are evenly spaced from the bottom to the top: CLRNet, LaneATT -----------------


def polylines(network: Network, outputs: Outputs) -> list[Line]:
    """The x of each candidate that is likely enough, from where it starts over its length."""
    assert network.first_x is not None
    assert network.start is not None
    assert network.length is not None
    width, height = network.size
    values = outputs["candidates"]
    share = scipy.special.softmax(values[:, :2], axis=1)[:, 1]
    x_scale = 1.0 if network.in_pixels else width - 1
    steps = values.shape[1] - network.first_x - 1
    v = np.linspace(1, 0, steps + 1) * (height - 1)
    lines = []
    for k in np.flatnonzero(share >= network.threshold):
        line = values[k]
        first = int(np.clip(round(line[network.start] * steps), 0, steps))
        n = round(line[network.length] * (1 if network.in_pixels else steps))
        there = slice(first, first + max(n, 0))
        lines.append(Line(_points(line[network.first_x :][there] * x_scale, v[there]), share[k]))
    return lines


# --- coefficients of curves, in shares of the input's width and height ----------------------------

#: Where the points of a curve are, from its first to its last.
_STEPS = np.linspace(0, 1, 100)

#: Candidates beside a better one are left out (`local_maximum_window_size` of BezierLaneNet).
_WINDOW = 9


def lstr_curves(network: Network, outputs: Outputs) -> list[Line]:
    """LSTR: from the lower to the upper y, k'' / (y - f'')^2 + m'' / (y - f'') + n' + b'' y - b'''
    (equation 5 of Liu 2021)."""
    share = scipy.special.softmax(outputs["scores"], axis=1)[:, 1]
    kept = share >= network.threshold
    lower, upper, k, f, m, n, b, c = outputs["curves"][kept].T[:, :, None]
    y = lower + (upper - lower) * _STEPS
    # A curve may have its pole in view.
    with np.errstate(divide="ignore", invalid="ignore"):
        x = k / (y - f) ** 2 + m / (y - f) + n + b * y - c
    return _curves(network, share[kept], x, y)


def polynomials(network: Network, outputs: Outputs) -> list[Line]:
    """PolyLaneNet: x is a polynomial of y, the highest power first; all lines reach as far up as
    the first (`share_top_y` of its lib/models.py)."""
    values = outputs["curves"].reshape(-1, POLYNOMIAL)
    share = scipy.special.expit(values[:, 0])
    kept = share >= network.threshold
    y = values[0, 1] + (values[kept, 2:3] - values[0, 1]) * _STEPS
    x = (values[kept, 3:, None] * y[:, None] ** np.arange(3, -1, -1)[:, None]).sum(axis=1)
    return _curves(network, share[kept], x, y)


def beziers(network: Network, outputs: Outputs) -> list[Line]:
    """BezierLaneNet: cubic Bezier curves by their four points (`inference` of its
    bezier_base.py)."""
    share = scipy.special.expit(outputs["scores"])
    kept = (share >= network.threshold) & (share == maximum_filter1d(share, _WINDOW))
    power, t = np.arange(4), _STEPS[:, None]
    bernstein = scipy.special.comb(3, power) * t**power * (1 - t) ** (3 - power)
    x, y = np.moveaxis(bernstein @ outputs["curves"][kept], -1, 0)
    return _curves(network, share[kept], x, y)


def _curves(network: Network, share: FloatArray, x: FloatArray, y: FloatArray) -> list[Line]:
    """The lines through points (N, P), shares of the input's width and height."""
    width, height = network.size
    at = zip(x * width - 0.5, y * height - 0.5, share, strict=True)
    return [Line(_points(u, v)[np.isfinite(u)], likely) for u, v, likely in at]


# --- lines on the road, in metres: openpilot's driving model, heads for lanes in 3D ---------------

#: Places with a larger standard deviation are left out, metres.
_MOST_SD_M = 0.5


def road_lines(network: Network, outputs: Outputs) -> list[Line]:
    """The lines, each with its places to the right at the distances `ahead`, that are likely
    enough: where they are sure enough (deviations are logarithms of standard deviations, as
    mixture density networks give them) and seen.

    scores: one number for each line, or its classes; with softmax, the first of these is no line.
    """
    assert network.ahead is not None
    ahead = np.array(network.ahead)
    places = outputs["places"].reshape(-1, len(ahead))
    share = _activated(network, outputs["scores"].reshape(len(places), -1), 1)
    if network.activation == "softmax":
        share[:, 0] = 0
    best, kind = _best_class(share)
    if network.activation == "softmax":
        best = share.sum(axis=1)
    good = np.ones(places.shape, dtype=bool)
    if "deviations" in outputs:
        good &= np.exp(outputs["deviations"].reshape(places.shape)) <= _MOST_SD_M
    if "visible" in outputs:
        good &= outputs["visible"].reshape(places.shape) >= 0.5
    kept = np.flatnonzero(best >= network.threshold)
    return [Line(_points(ahead[good[k]], places[k, good[k]]), best[k], int(kind[k])) for k in kept]


#: The function that reads each layout with lines.
_LINES: dict[str, Callable[[Network, Outputs], list[Line]]] = {
    "instances": instances,
    "prototypes": prototypes,
    "queries": queries,
    "row_anchors": row_anchors,
    "hybrid_anchors": hybrid_anchors,
    "polylines": polylines,
    "lstr_curves": lstr_curves,
    "polynomials": polynomials,
    "beziers": beziers,
    "road_lines": road_lines,
}
