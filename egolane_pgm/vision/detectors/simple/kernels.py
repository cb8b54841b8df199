"""The numba kernel of the line finder."""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import FloatArray


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
    """Score how sharply N pieces of marking gather at a few offsets, (H, K, Q), for lines
    y = o (1 + q x) + h x + k x^2 / 2 with offset o and common heading h, curvature k and squeeze q.

    - x, y: (N,) place of each piece, metres ahead (more than 0) and to the right
    - area: (N,) its area, square metres
    - middle: (N,) metres ahead of the middle of the piece's contour
    - slope: (N,) direction of that contour, m/m
    - tolerance: (N,) difference of slope from the line's at which the piece stops counting
    - headings (H,), rising in equal steps, curvatures (K,), squeezes (Q,): the values to try
    - side_m, bin_m: largest offset, and size of the bins of offset, metres

    The score is the sum of squares of the area per bin. Each piece is shared between the two
    nearest bins. Its bin and its difference of slope are linear in the heading, so a piece is
    brought into these terms once, and then only the headings at which it counts are visited.
    """
    n_headings = len(headings)
    n_pieces = len(x)
    n_bins = math.floor(2 * side_m / bin_m) + 1
    out = np.empty((n_headings, len(curvatures), len(squeezes)))
    # One more than the bins, because rounding may take a piece over the edge.
    histograms = np.empty((n_bins + 1, n_headings))
    first_heading = headings[0]
    step = max((headings[-1] - first_heading) / max(n_headings - 1, 1), 1e-12)
    # By how much a step of the heading changes a piece's bin, and its difference of slope as a
    # share of the tolerance.
    scale = np.empty(n_pieces)
    bin_step = np.empty(n_pieces)
    off_step = np.empty(n_pieces)
    total = np.empty(n_headings)
    for iq in range(len(squeezes)):
        q = squeezes[iq]
        for i in range(n_pieces):
            scale[i] = 1.0 / (1.0 + q * x[i])
            bin_step[i] = step * x[i] * scale[i] / bin_m
            off_step[i] = step * scale[i] / tolerance[i]
        for ik in range(len(curvatures)):
            k = curvatures[ik]
            histograms[:] = 0.0
            for i in range(n_pieces):
                o = (y[i] - x[i] * (first_heading + 0.5 * k * x[i])) * scale[i]
                at_first = (o + side_m) / bin_m
                off_first = (slope[i] - first_heading - k * middle[i] - q * o) / tolerance[i]
                # The headings at which the piece counts, and is not too far to the side.
                low = max((off_first - 1.0) / off_step[i], (at_first - n_bins + 1) / bin_step[i])
                high = min((off_first + 1.0) / off_step[i], at_first / bin_step[i])
                for ih in range(max(math.ceil(low), 0), min(math.floor(high) + 1, n_headings)):
                    off = off_first - ih * off_step[i]
                    at = at_first - ih * bin_step[i]
                    b = int(at)
                    share = area[i] * (1.0 - off * off)
                    part = share * (at - b)
                    histograms[b, ih] += share - part
                    histograms[b + 1, ih] += part
            total[:] = 0.0
            for b in range(n_bins):
                for ih in range(n_headings):
                    total[ih] += histograms[b, ih] * histograms[b, ih]
            for ih in range(n_headings):
                out[ih, ik, iq] = total[ih]
    return out
