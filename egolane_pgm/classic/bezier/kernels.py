"""The numba kernels of Aly's detector. Points are (column, row) of a view or picture, pixels."""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import FloatArray, IntArray

#: Pixels to either side that a spline covers.
_JITTER = 2

#: Number of steps along a spline.
_STEPS = 100

#: Weight of a spline's straightness in its score.
_ANGLE_RATIO = 1.2

#: Weight of a spline's length in its score.
_LENGTH_RATIO = 1.5


@kernel()
def ransac_line(
    point: FloatArray,
    value: FloatArray,
    sample: IntArray,
    most_away: float,
    least_points: int,
    most_turn: float,
) -> tuple[FloatArray, float]:
    """The line with the largest sum of values on it, as (4,): column and row of a point and of the
    direction (towards larger rows), and that sum; -1 if there is no line.

    - point, value: (N, 2) and (N,)
    - sample: (I, S) the points of each sample
    - most_away: how far a point may be from the line
    - least_points: the fewest points on a line
    - most_turn: the largest tangent of its angle with the columns
    """
    best = -1.0
    line = np.zeros(4)
    near = np.empty(len(point), dtype=np.bool_)
    for i in range(len(sample)):
        near[:] = False
        for k in sample[i]:
            near[k] = True
        for again in range(2):
            # The line of least squared distances through the chosen points.
            n = 0
            c = 0.0
            r = 0.0
            for k in range(len(point)):
                if near[k]:
                    n += 1
                    c += point[k, 0]
                    r += point[k, 1]
            c = c / n
            r = r / n
            cc = 0.0
            cr = 0.0
            rr = 0.0
            for k in range(len(point)):
                if near[k]:
                    cc += (point[k, 0] - c) ** 2
                    cr += (point[k, 0] - c) * (point[k, 1] - r)
                    rr += (point[k, 1] - r) ** 2
            turn = 0.5 * math.atan2(2 * cr, rr - cc)
            across = math.sin(turn)
            along = math.cos(turn)
            if along <= 0 or abs(across) > most_turn * along or cc + rr == 0:
                break
            n = 0
            score = 0.0
            for k in range(len(point)):
                away = (point[k, 0] - c) * along - (point[k, 1] - r) * across
                near[k] = abs(away) <= most_away
                if near[k]:
                    n += 1
                    score += value[k]
            if n < max(least_points, 2):
                break
            if again == 1 and score > best:
                best = score
                line[:] = (c, r, across, along)
    return line, best


@kernel()
def bezier(control: FloatArray, t: float) -> tuple[float, float]:
    """Column and row of a cubic Bezier spline, control points (4, 2), at the parameter t."""
    s = 1.0 - t
    a = s * s * s
    b = 3 * s * s * t
    c = 3 * s * t * t
    d = t * t * t
    return (
        a * control[0, 0] + b * control[1, 0] + c * control[2, 0] + d * control[3, 0],
        a * control[0, 1] + b * control[1, 1] + c * control[2, 1] + d * control[3, 1],
    )


@kernel()
def straightness(control: FloatArray) -> float:
    """The mean cosine of the two angles between the three legs of the control points (4, 2)."""
    total = 0.0
    for k in range(2):
        ac = control[k + 1, 0] - control[k, 0]
        ar = control[k + 1, 1] - control[k, 1]
        bc = control[k + 2, 0] - control[k + 1, 0]
        br = control[k + 2, 1] - control[k + 1, 1]
        size = math.sqrt((ac * ac + ar * ar) * (bc * bc + br * br))
        total += (ac * bc + ar * br) / size if size > 0 else 1.0
    return total / 2


@kernel()
def spline_score(ridge: FloatArray, control: FloatArray) -> float:
    """The score S (1 + (a (theta - 1) + b (l - 1)) / 2) of a spline, control points (4, 2).

    S is the sum of the ridges (R, C) that it covers, theta its straightness, l its length over R, a
    and b are _ANGLE_RATIO and _LENGTH_RATIO (Aly 2008, section II E). A spline longer than the view
    is as good as one of its length, as it may be no more than a loop.
    """
    n_rows, n_columns = ridge.shape
    total = 0.0
    length = 0.0
    before_c = control[0, 0]
    before_r = control[0, 1]
    last_c = -1
    last_r = -1
    for i in range(_STEPS + 1):
        c, r = bezier(control, i / _STEPS)
        length += math.hypot(c - before_c, r - before_r)
        before_c = c
        before_r = r
        at_c = math.floor(c + 0.5)
        at_r = math.floor(r + 0.5)
        if (at_c == last_c and at_r == last_r) or not 0 <= at_r < n_rows:
            continue
        last_c = at_c
        last_r = at_r
        for beside in range(max(at_c - _JITTER, 0), min(at_c + _JITTER + 1, n_columns)):
            total += ridge[at_r, beside]
    less = _ANGLE_RATIO * (straightness(control) - 1)
    less += _LENGTH_RATIO * (min(length / n_rows, 1.0) - 1)
    return float(total * (1 + less / 2))


@kernel()
def bezier_through(point: FloatArray) -> FloatArray:
    """The control points (4, 2) of the Bezier spline that starts and ends with the first and the
    last of N points (N, 2), and is nearest to the others by least squares. The points' parameters
    are their shares of the chord length."""
    n = len(point)
    t = np.zeros(n)
    for i in range(1, n):
        t[i] = t[i - 1] + math.hypot(point[i, 0] - point[i - 1, 0], point[i, 1] - point[i - 1, 1])
    control = np.empty((4, 2))
    control[0] = point[0]
    control[3] = point[n - 1]
    bb = 0.0
    bc = 0.0
    cc = 0.0
    right = np.zeros((2, 2))
    for i in range(1, n - 1):
        u = t[i] / t[n - 1] if t[n - 1] > 0 else 0.0
        s = 1.0 - u
        b = 3 * s * s * u
        c = 3 * s * u * u
        bb += b * b
        bc += b * c
        cc += c * c
        for axis in range(2):
            rest = point[i, axis] - s**3 * point[0, axis] - u**3 * point[n - 1, axis]
            right[0, axis] += b * rest
            right[1, axis] += c * rest
    size = bb * cc - bc * bc
    for axis in range(2):
        if size > 1e-9:
            control[1, axis] = (cc * right[0, axis] - bc * right[1, axis]) / size
            control[2, axis] = (bb * right[1, axis] - bc * right[0, axis]) / size
        else:
            # Too few different points: straight.
            step = (point[n - 1, axis] - point[0, axis]) / 3
            control[1, axis] = point[0, axis] + step
            control[2, axis] = point[0, axis] + 2 * step
    return control


@kernel()
def ransac_spline(
    point: FloatArray,
    sample: IntArray,
    least_straight: float,
    ridge: FloatArray,
) -> tuple[FloatArray, float]:
    """The best of the splines through samples of points: control points (4, 2), and its score,
    minus infinity if no spline was found.

    - point: (N, 2), sorted by row
    - sample: (I, S) the points of each sample, ascending
    - least_straight: the least straightness of a spline
    - ridge: (R, C)
    """
    best = -np.inf
    control = np.zeros((4, 2))
    chosen = np.empty((sample.shape[1], 2))
    for i in range(len(sample)):
        for k in range(sample.shape[1]):
            chosen[k] = point[sample[i, k]]
        one = bezier_through(chosen)
        if straightness(one) < least_straight:
            continue
        score = spline_score(ridge, one)
        if score > best:
            best = score
            control[:] = one
    return control, best
