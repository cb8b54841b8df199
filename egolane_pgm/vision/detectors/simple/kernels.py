"""The numba kernels of the line finder."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray


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
    n_headings, n_pieces = len(headings), len(x)
    n_bins = math.floor(2 * side_m / bin_m) + 1
    out = np.empty((n_headings, len(curvatures), len(squeezes)))
    # One more than the bins, because rounding may take a piece over the edge.
    histograms = np.empty((n_bins + 1, n_headings))
    first_heading = headings[0]
    step = max((headings[-1] - first_heading) / max(n_headings - 1, 1), 1e-12)
    # By how much a step of the heading changes a piece's bin, and its difference of slope as a
    # share of the tolerance.
    scale, bin_step, off_step = np.empty(n_pieces), np.empty(n_pieces), np.empty(n_pieces)
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


@kernel()
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
    """The normal equations of least squares for what lines share and for their offsets, without
    the prior: (4 + M, 4 + M) and (4 + M,).

    Unknown are heading, curvature, squeeze and rate, then each line's offset. A run at x, y on a
    line with offset o and squeeze q says, linearly: h x + k x^2 / 2 + q' o x + r x^3 / 6 +
    o' (1 + q x) = y + q o x. (The left side counts squeeze times offset twice, so one of them is
    on the right.) It belongs to the nearest line.

    - x, y, width, offset, agreement: (N,) the runs; the last two as `along_common` gives them
    - found: (M,) the offsets of the lines so far
    - squeeze: the squeeze so far
    - has: (4,) whether the lines have each of the shared values
    - reach_m: largest distance of a run from its line
    """
    n_lines = len(found)
    normal = np.zeros((4 + n_lines, 4 + n_lines))
    right = np.zeros(4 + n_lines)
    row = np.zeros(4)
    for i in range(len(x)):
        if agreement[i] <= 0:
            continue
        line = 0
        for m in range(1, n_lines):
            if abs(offset[i] - found[m]) < abs(offset[i] - found[line]):
                line = m
        if abs(offset[i] - found[line]) > reach_m:
            continue
        o, weight = found[line], width[i] * agreement[i]
        row[0] = x[i]
        row[1] = x[i] * x[i] / 2
        row[2] = o * x[i]
        row[3] = x[i] * x[i] * x[i] / 6
        own = 1 + squeeze * x[i]
        value = y[i] + squeeze * o * x[i]
        for a in range(4):
            if not has[a]:
                continue
            weighted = weight * row[a]
            for b in range(a + 1):
                if has[b]:
                    normal[a, b] += weighted * row[b]
            normal[4 + line, a] += weighted * own
            right[a] += weighted * value
        normal[4 + line, 4 + line] += weight * own * own
        right[4 + line] += weight * own * value
    for a in range(4 + n_lines):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return normal, right


@kernel()
def feet_on_rays(
    above: NDArray[np.uint8],
    valid: BoolArray,
    far_m: float,
    left_m: float,
    along_m: float,
    across_m: float,
    rays: FloatArray,
    x: FloatArray,
    share: float,
    n_dark: int,
    n_edge: int,
    n_road: int,
) -> NDArray[np.uint8]:
    """Where rays from the camera meet the dark foot of a vehicle, (K, A): 1 at a sample at which
    the mean of the next `n_dark` samples is below `share` of the mean of `n_road` samples of road
    that come `n_edge` samples before, else 0.

    - above, valid: (R, C) the bird's-eye view and what of it the picture shows
    - far_m, left_m, along_m, across_m: place of its first row and column, and size of its pixels
    - rays: (A,) metres to the right per metre ahead
    - x: (K,) metres ahead of the samples of each ray, rising
    """
    n_rows, n_columns = above.shape
    n = len(x)
    out = np.zeros((n, len(rays)), dtype=np.uint8)
    total = np.zeros(n + 1)
    shown = np.zeros(n + 1, dtype=np.int64)
    before = n_road + n_edge
    for a in range(len(rays)):
        for k in range(n):
            r = int((far_m - x[k]) / along_m + 0.5)
            c = math.floor((x[k] * rays[a] - left_m) / across_m + 0.5)
            value, seen = 0.0, 0
            if 0 <= r < n_rows and 0 <= c < n_columns and valid[r, c]:
                value, seen = float(above[r, c]), 1
            total[k + 1] = total[k] + value
            shown[k + 1] = shown[k] + seen
        for k in range(before, n - n_dark + 1):
            if shown[k + n_dark] - shown[k - before] < n_dark + before:
                continue
            road = (total[k - n_edge] - total[k - before]) / n_road
            dark = (total[k + n_dark] - total[k]) / n_dark
            out[k, a] = dark < share * road
    return out


@kernel()
def in_front(
    ends: FloatArray, x: FloatArray, y: FloatArray, first: float, step: float
) -> BoolArray:
    """Which pixels of a view are nearer than the end of the ray through them, (R, C).

    - ends: (A,) metres ahead at which each ray ends; rays that are not among them do not end
    - x, y: (R,) and (C,) metres ahead of the rows and to the right of the columns
    - first, step: the first ray and the distance of the rays, metres to the right per metre ahead
    """
    out = np.ones((len(x), len(y)), dtype=np.bool_)
    for r in range(len(x)):
        for c in range(len(y)):
            a = math.floor((y[c] / x[r] - first) / step + 0.5)
            if 0 <= a < len(ends) and x[r] >= ends[a]:
                out[r, c] = False
    return out
