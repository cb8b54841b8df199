"""The numba kernels of the line finder."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.jit import kernel
from egolane_pgm.types import FloatArray, IntArray


@kernel()
def contour_runs(
    mask: NDArray[np.uint8], points: NDArray[np.int32], starts: IntArray, owner: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """The N runs of ones along the rows of a mask: row, first and last column, and contour, (N,)
    each.

    - mask: (R, C)
    - points: (P, 2) column and row of the points of all borders, one border after the other
    - starts: (B + 1,) where each border begins in `points`, and P
    - owner: (B,) the contour of each border; for the border of a hole, the contour around it
    """
    n_rows, n_columns = mask.shape
    border = np.full((n_rows, n_columns), -1, dtype=np.int32)
    for b in range(len(starts) - 1):
        for p in range(starts[b], starts[b + 1]):
            border[points[p, 1], points[p, 0]] = owner[b]
    # A run begins on a border, so no row has more runs than border points.
    most = len(points)
    row = np.empty(most, dtype=np.int64)
    left = np.empty(most, dtype=np.int64)
    right = np.empty(most, dtype=np.int64)
    contour = np.empty(most, dtype=np.int64)
    n = 0
    for r in range(n_rows):
        c = 0
        while c < n_columns:
            if mask[r, c] == 0:
                c += 1
                continue
            row[n] = r
            left[n] = c
            contour[n] = border[r, c]
            while c < n_columns and mask[r, c] != 0:
                c += 1
            right[n] = c - 1
            n += 1
    return row[:n], left[:n], right[:n], contour[:n]


@kernel()
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
    """How sharply N pieces of marking gather at a few offsets, (H, K, Q), for lines
    y = o (1 + q x) + h x + k x^2 / 2 with offset o and common heading h, curvature k and squeeze q.

    - x, y: (N,) place of each piece, metres ahead and to the right
    - area: (N,) its area, square metres
    - middle: (N,) metres ahead of the middle of the piece's contour
    - slope: (N,) direction of that contour, m/m
    - tolerance: (N,) difference of slope from the line's at which the piece stops counting
    - headings (H,), curvatures (K,), squeezes (Q,): the values to try
    - side_m, bin_m: largest offset, and size of the bins of offset, metres

    The score is the sum of squares of the area per bin. Each piece is shared between the two
    nearest bins.
    """
    n_bins = math.floor(2 * side_m / bin_m) + 1
    out = np.empty((len(headings), len(curvatures), len(squeezes)))
    histogram = np.empty(n_bins)
    n_pieces = len(x)
    for iq in range(len(squeezes)):
        q = squeezes[iq]
        for ik in range(len(curvatures)):
            k = curvatures[ik]
            for ih in range(len(headings)):
                h = headings[ih]
                histogram[:] = 0.0
                for i in range(n_pieces):
                    o = (y[i] - x[i] * (h + 0.5 * k * x[i])) / (1.0 + q * x[i])
                    off = (slope[i] - h - k * middle[i] - q * o) / tolerance[i]
                    share = 1.0 - off * off
                    at = (o + side_m) / bin_m
                    if share <= 0.0 or at < 0.0 or at >= n_bins - 1:
                        continue
                    b = int(at)
                    part = at - b
                    histogram[b] += area[i] * share * (1.0 - part)
                    histogram[b + 1] += area[i] * share * part
                total = 0.0
                for b in range(n_bins):
                    total += histogram[b] * histogram[b]
                out[ih, ik, iq] = total
    return out
