"""From ridges in a view to cubic Bezier splines (Aly 2008, sections II C to II E).

First lines come from sums of columns. In a box around each, RANSAC fits
a line; in a box around that, a spline. Points are (column, row) of the view, pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import cv2
import numpy as np

from egolane_pgm.classic.bezier import kernels
from egolane_pgm.types import FloatArray, IntArray

#: Length of the smoothing of the sums of columns, columns.
_SCORE_TAPS = 21

#: Standard deviation of that smoothing, columns.
_SCORE_SIGMA = 2.0

#: Least score of a first line.
_LEAST_SCORE = 0.1

#: First lines nearer than this are one, columns.
_GROUP = 30.0

#: Number of samples of RANSAC.
_SAMPLES = 40

#: Number of points of a sample.
_POINTS = 4

#: Reach to either side of a first line, columns.
_LINE_WINDOW = 30.0

#: Reach to either side of a line, columns.
_SPLINE_WINDOW = 20.0

#: Farthest point of a line from it, columns.
_LINE_AWAY = 0.4

#: Fewest points of a line.
_LINE_POINTS = 10

#: Largest angle of a line with the columns, degrees.
_MOST_TURN_DEG = 5.0

#: Least straightness of a spline, from 0 to 1.
_STRAIGHT = 0.8

#: Least length of a spline, pixels.
_LENGTH = 30.0

#: Largest turn of a spline, radians.
_TURN = 1.22

#: Two splines are one if their chords, or the means along them, are nearer than these angles
#: (radians) and distances (pixels), ...
_MERGE = ((0.1, 5.0), (0.2, 10.0))

#: ... and their middles are nearer than this, pixels.
_MERGE_CENTROID = 15.0

#: Boxes that share more than this are one.
_OVERLAP = 0.5


def spline_finder() -> Callable[[FloatArray], FloatArray]:
    """Make the function from ridges (R, C) to cubic Bezier splines, best first: their control
    points (M, 4, 2), from far to near. Each call takes the same random numbers, drawn here, so that
    a picture's splines do not depend on the pictures before."""
    rng = np.random.default_rng(0)
    line_draw, spline_draw = (rng.random((_SAMPLES, _POINTS)) for _ in range(2))

    def find(ridge: FloatArray) -> FloatArray:
        rows, columns = np.nonzero(ridge)
        if not len(rows):
            return np.zeros((0, 4, 2))
        point = np.stack([columns, rows], axis=1).astype(np.float64)
        value = ridge[rows, columns]
        lines = _first_lines(ridge, point, value)
        boxes = _boxes(lines, _LINE_WINDOW, ridge.shape[1])
        lines = _fitted_lines(_chosen(boxes, point, value, line_draw), ridge.shape[0])
        boxes = _boxes(lines, _SPLINE_WINDOW, ridge.shape[1])
        return _checked(*_fitted_splines(_chosen(boxes, point, value, spline_draw), ridge))

    return find


def _first_lines(ridge: FloatArray, point: FloatArray, value: FloatArray) -> FloatArray:
    """The columns with the most ridges, near ones made one: lines (K, 3) through all rows, their
    columns in the first and in the last row, and score."""
    total = np.bincount(point[:, 0].astype(np.int64), value, ridge.shape[1]).astype(np.float64)
    edge = cv2.BORDER_CONSTANT
    total = cv2.GaussianBlur(total[None], (_SCORE_TAPS, 1), _SCORE_SIGMA, borderType=edge)[0]
    padded = np.pad(total, 1)
    left = padded[:-2]
    right = padded[2:]
    peak = np.flatnonzero((total > left) & (total >= right) & (total >= _LEAST_SCORE))
    # The top of the parabola through a local maximum and its neighbours.
    bend = left[peak] - 2 * total[peak] + right[peak]
    column = peak + (left[peak] - right[peak]) / (2 * bend)
    return _grouped(np.column_stack([column, column, total[peak]]))


def _grouped(lines: FloatArray) -> FloatArray:
    """Merge the two nearest lines into their mean, weighted by score, until none are nearer than
    `_GROUP` columns on the average of both ends."""
    end = lines[:, :2].copy()
    score = lines[:, 2].copy()
    while len(score) > 1:
        away = np.abs(end[:, None] - end).mean(axis=2)
        away[np.diag_indices(len(score))] = np.inf
        i, j = np.unravel_index(int(np.argmin(away)), away.shape)
        if away[i, j] >= _GROUP:
            break
        end[i] = (score[i] * end[i] + score[j] * end[j]) / (score[i] + score[j])
        score[i] += score[j]
        end = np.delete(end, j, axis=0)
        score = np.delete(score, j)
    return np.column_stack([end, score])


def _boxes(lines: FloatArray, window: float, n_columns: int) -> FloatArray:
    """The first and last columns (B, 2) of boxes around lines, those made one that share more than
    `_OVERLAP` of the smaller."""
    left = np.maximum(lines[:, :2].min(axis=1) - window, 0)
    right = np.minimum(lines[:, :2].max(axis=1) + window, n_columns - 1)
    inside = left < right
    order = np.argsort(left[inside], kind="stable")
    boxes: list[list[float]] = []
    for box in np.stack([left[inside], right[inside]], axis=1)[order].tolist():
        if boxes:
            shared = min(boxes[-1][1], box[1]) - box[0]
            if shared > _OVERLAP * min(boxes[-1][1] - boxes[-1][0], box[1] - box[0]):
                boxes[-1][1] = max(boxes[-1][1], box[1])
                continue
        boxes.append(box)
    return np.array(boxes).reshape(-1, 2)


def _chosen(
    boxes: FloatArray, point: FloatArray, value: FloatArray, draw: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray, IntArray]]:
    """Yield the points (N, 2) in each box that has enough of them, their values (N,), and samples.

    A sample has indices of points, drawn with probabilities in proportion to their values by
    uniform random numbers; of the numbers' shape.
    """
    for left, right in boxes:
        inside = (point[:, 0] >= left) & (point[:, 0] <= right)
        if inside.sum() >= draw.shape[1]:
            share = np.cumsum(value[inside])
            sample = np.searchsorted(share, draw * share[-1], side="right")
            yield point[inside], value[inside], sample.clip(max=len(share) - 1)


def _fitted_lines(
    chosen: Iterable[tuple[FloatArray, FloatArray, IntArray]], n_rows: int
) -> FloatArray:
    """The RANSAC line of each box that has one, (K, 3) as in `_first_lines`."""
    most_turn = float(np.tan(np.deg2rad(_MOST_TURN_DEG)))
    found = []
    for point, value, sample in chosen:
        line, score = kernels.ransac_line(point, value, sample, _LINE_AWAY, _LINE_POINTS, most_turn)
        if score >= 0:
            turn = line[2] / line[3]
            ends = line[0] + turn * (np.array([0.0, n_rows - 1]) - line[1])
            found.append((*ends, score))
    return np.array(found).reshape(-1, 3)


def _fitted_splines(
    chosen: Iterable[tuple[FloatArray, FloatArray, IntArray]], ridge: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The control points (M, 4, 2) and the score (M,) of the RANSAC spline of each box that has
    one."""
    controls = []
    scores = []
    for point, _, sample in chosen:
        control, score = kernels.ransac_spline(point, np.sort(sample, axis=1), _STRAIGHT, ridge)
        if score > 0:
            controls.append(control)
            scores.append(score)
    return np.array(controls).reshape(-1, 4, 2), np.array(scores)


def points_on(control: FloatArray) -> FloatArray:
    """Eleven points (M, 11, 2) along splines (M, 4, 2)."""
    t = np.linspace(0, 1, 11)
    s = 1 - t
    basis = np.stack([s**3, 3 * s**2 * t, 3 * s * t**2, t**3], axis=1)
    points: FloatArray = basis @ control
    return points


def _checked(control: FloatArray, score: FloatArray) -> FloatArray:
    """The splines (M, 4, 2), best first, without those that are short or turned, and without the
    worse one of two that are nearly the same."""
    across, along = (control[:, 3] - control[:, 0]).T
    is_sound = (np.hypot(across, along) >= _LENGTH) & (np.abs(np.arctan2(across, along)) <= _TURN)
    kept: list[int] = []
    for k in np.argsort(-score, kind="stable"):
        if is_sound[k] and not any(_is_same(control[k], control[other]) for other in kept):
            kept.append(int(k))
    return control[kept]


def _is_same(one: FloatArray, other: FloatArray) -> bool:
    """Whether two splines' chords, or the means along them, are near in angle and distance, and so
    are their middles."""
    points = points_on(np.stack([one, other]))
    apart = np.hypot(*(points[0].mean(axis=0) - points[1].mean(axis=0)))
    if apart >= _MERGE_CENTROID:
        return False
    steps = _poses(points).mean(axis=1)
    chords = _poses(points[:, [0, -1]])[:, 0]
    away = np.abs([chords[0] - chords[1], steps[0] - steps[1]])
    return bool((away < _MERGE).all(axis=1).any())


def _poses(points: FloatArray) -> FloatArray:
    """Angle and distance from the corner, (M, P - 1, 2), of the legs between points (M, P, 2)."""
    along = np.diff(points, axis=1)
    theta = np.arctan2(along[..., 0], along[..., 1])
    away = points[:, :-1, 0] * np.cos(theta) - points[:, :-1, 1] * np.sin(theta)
    return np.stack([theta, away], axis=-1)
