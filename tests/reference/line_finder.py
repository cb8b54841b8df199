"""What `detectors.simple.kernels` computes, in plain NumPy."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import BoolArray, FloatArray, IntArray


def contour_runs(
    mask: NDArray[np.uint8], points: NDArray[np.int32], starts: IntArray, owner: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """The runs of ones along the rows of a mask, as `kernels.contour_runs`."""
    border = np.full(mask.shape, -1, dtype=np.int64)
    border[points[:, 1], points[:, 0]] = np.repeat(owner, np.diff(starts))
    change = np.diff(np.pad((mask != 0).astype(np.int8), ((0, 0), (1, 1))), axis=1)
    row, left = np.nonzero(change == 1)
    right = np.nonzero(change == -1)[1] - 1
    return row, left, right, border[row, left]


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
