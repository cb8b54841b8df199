"""The kernel of the line finder in plain NumPy."""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import FloatArray


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
