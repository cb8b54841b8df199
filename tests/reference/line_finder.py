"""What `detectors.simple.kernels` computes, in plain NumPy."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import BoolArray, FloatArray, IntArray


def contour_runs(
    mask: NDArray[np.uint8], points: NDArray[np.int32], starts: IntArray, owner: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray, IntArray]:
    """The runs along the rows of a mask, as `kernels.contour_runs`."""
    border = np.full(mask.shape, -1, dtype=np.int64)
    border[points[:, 1], points[:, 0]] = np.repeat(owner, np.diff(starts))
    change = np.diff(np.pad((mask != 0).astype(np.int8), ((0, 0), (1, 1))), axis=1)
    row, left = np.nonzero(change == 1)
    right = np.nonzero(change == -1)[1] - 1
    sums = np.pad(np.cumsum(mask, axis=1, dtype=np.int64), ((0, 0), (1, 0)))
    return row, left, right, border[row, left], sums[row, right + 1] - sums[row, left]


def common_scores(
    x: FloatArray,
    y: FloatArray,
    area: FloatArray,
    middle: FloatArray,
    slope: FloatArray,
    tolerance: FloatArray,
    headings: FloatArray,
    curvatures: FloatArray,
    squeezes: FloatArray,
    side_m: float,
    bin_m: float,
) -> FloatArray:
    """(H, K, Q): how sharply pieces gather, as `kernels.common_scores`."""
    n_bins = int(np.floor(2 * side_m / bin_m)) + 1
    out = np.empty((len(headings), len(curvatures), len(squeezes)))
    for index in np.ndindex(out.shape):
        h, k, q = headings[index[0]], curvatures[index[1]], squeezes[index[2]]
        o = (y - x * (h + k * x / 2)) / (1 + q * x)
        share = np.maximum(1 - ((slope - h - k * middle - q * o) / tolerance) ** 2, 0)
        at = (o + side_m) / bin_m
        inside = (at >= 0) & (at < n_bins - 1)
        b = np.floor(at[inside]).astype(int)
        part = at[inside] - b
        weight = (area * share)[inside]
        histogram = np.bincount(b, weight * (1 - part), n_bins)
        histogram += np.bincount(b + 1, weight * part, n_bins)
        out[index] = (histogram**2).sum()
    return out


def along_common(
    x: FloatArray,
    y: FloatArray,
    contour: IntArray,
    middle: FloatArray,
    slope: FloatArray,
    tolerance: FloatArray,
    common: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Offsets and agreement of runs, as `kernels.along_common`."""
    heading, curvature, squeeze, rate = common
    offset = (y - heading * x - curvature * x**2 / 2 - rate * x**3 / 6) / (1 + squeeze * x)
    expected = heading + curvature * middle + rate * middle**2 / 2
    off = slope[contour] - expected[contour] - squeeze * offset
    return offset, np.maximum(1 - (off / tolerance[contour]) ** 2, 0)


def line_equations(
    x: FloatArray,
    y: FloatArray,
    width: FloatArray,
    offset: FloatArray,
    agreement: FloatArray,
    found: FloatArray,
    squeeze: float,
    has: BoolArray,
    reach_m: float,
) -> tuple[FloatArray, FloatArray]:
    """The normal equations of least squares, as `kernels.line_equations`."""
    line = np.argmin(np.abs(offset[:, None] - found), axis=1)
    near = np.flatnonzero((np.abs(offset - found[line]) <= reach_m) & (agreement > 0))
    line, x = line[near], x[near]
    design = np.zeros((len(near), 4 + len(found)))
    shared = np.stack([x, x**2 / 2, found[line] * x, x**3 / 6], axis=1)
    design[:, :4] = np.where(has, shared, 0.0)
    design[np.arange(len(near)), 4 + line] = 1 + squeeze * x
    weighted = (width * agreement)[near, None] * design
    return design.T @ weighted, weighted.T @ (y[near] + squeeze * found[line] * x)


def rows_covered(
    row: IntArray,
    offset: FloatArray,
    agreement: FloatArray,
    found: FloatArray,
    reach_m: float,
    n_rows: int,
) -> IntArray:
    """In how many rows runs cover each line, as `kernels.rows_covered`."""
    near = (np.abs(offset - found[:, None]) <= reach_m) & (agreement > 0)
    return np.array([len(np.unique(row[covers])) for covers in near])


def rows_shown(
    x: FloatArray,
    left_m: float,
    across_m: float,
    valid: BoolArray,
    shape: FloatArray,
    step: int,
) -> IntArray:
    """In how many rows the picture shows each line, as `kernels.rows_shown`."""
    x, valid = x[::step], valid[::step]
    y = shape @ np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6])
    column = np.floor((y - left_m) / across_m + 0.5).astype(np.int64)
    inside = (column >= 0) & (column < valid.shape[1])
    return (inside & valid[np.arange(len(x)), np.where(inside, column, 0)]).sum(axis=1)


def best_beside(score: FloatArray, first: int, likely: FloatArray) -> FloatArray:
    """The best of the scores on either side, as `kernels.best_beside`."""
    lag = first + np.arange(len(likely))
    padded = np.pad(score, lag[-1])
    at = np.arange(len(score))[:, None] + lag[-1]
    return (np.maximum(padded[at - lag], padded[at + lag]) * likely).max(axis=1)


def rows_in_view(
    x: FloatArray,
    left_m: float,
    across_m: float,
    valid: BoolArray,
    line: FloatArray,
    aside: int,
    length_m: float,
) -> tuple[IntArray, IntArray]:
    """Rows and columns of a line's first metres in view, as `kernels.rows_in_view`."""
    y = line[0] + x * (line[1] + x * (line[2] / 2 + x * line[3] / 6))
    columns = np.floor((y - left_m) / across_m + 0.5).astype(np.int64)
    rows = np.flatnonzero((columns >= aside) & (columns < valid.shape[1] - aside))
    rows = rows[valid[rows, columns[rows] - aside] & valid[rows, columns[rows] + aside]]
    if len(rows):
        rows = rows[x[rows] <= x[rows[-1]] + length_m]
    return rows[::-1], columns[rows[::-1]]


def paint_contrasts(
    image: NDArray[np.uint8],
    map_uv: NDArray[np.int16],
    rows: IntArray,
    columns: IntArray,
    aside: int,
    half: int,
    near: int,
    far: int,
    dark: float,
) -> tuple[FloatArray, FloatArray]:
    """Contrast of a line and of what is beside it, as `kernels.paint_contrasts`."""
    across = np.arange(-aside, aside + 1)
    uv = map_uv[rows[:, None], columns[:, None] + across]
    seen = image[uv[..., 1], uv[..., 0]].max(axis=2)
    strip = np.ones((1, 2 * half + 1), dtype=np.uint8)
    narrow = cv2.morphologyEx(seen, cv2.MORPH_TOPHAT, strip)
    narrow = narrow / (seen.mean(axis=1, keepdims=True) + dark)
    own = narrow[:, np.abs(across) <= near].max(axis=1)
    beside = [narrow[:, is_side].max(axis=1) for is_side in (across <= -far, across >= far)]
    return own, np.minimum(*beside)
