"""Curves u(t) = a + b t + c t^2 of the picture, (3,) each: robust fits, and how all of them move
together from frame to frame.

u is the column, pixels; t goes from -1 in the top row of the searched region to 1 in its
bottom row.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: The t at which a curve from before counts as seen again, and curves are compared.
ROWS = np.linspace(-1.0, 1.0, 21)

#: Weight of a prior curve in each of ROWS, points.
PRIOR = 0.3

#: A parabola is preferred to a straight line only if it has this many times as many points.
_BENT = 1.05


def value(curve: FloatArray, t: FloatArray) -> FloatArray:
    """The columns of curves (..., 3) at t (T,): (..., T)."""
    columns: FloatArray = curve @ np.stack([np.ones_like(t), t, t * t])
    return columns


def fit(t: FloatArray, u: FloatArray, degree: int, prior: FloatArray | None = None) -> FloatArray:
    """The least-squares curve, (3,), of F points. prior: a curve that counts as PRIOR more points
    in each of ROWS; None suffices where the points determine the curve well."""
    weight = np.ones(len(t))
    if prior is not None:
        t = np.concatenate([t, ROWS])
        u = np.concatenate([u, value(prior, ROWS)])
        weight = np.concatenate([weight, np.full(len(ROWS), np.sqrt(PRIOR))])
    design = t[:, None] ** np.arange(degree + 1) * weight[:, None]
    curve = np.zeros(3)
    curve[: degree + 1] = np.linalg.lstsq(design, u * weight)[0]
    return curve


def consensus(
    t: FloatArray, u: FloatArray, draws: FloatArray, error: float
) -> tuple[BoolArray, int]:
    """The points, (F,), that the best of some random straight lines and parabolas holds, and its
    degree.

    - draws: (I, 3) numbers from 0 to 1 that choose the points of each trial
    - error: how far a point may be from the curve, pixels
    """
    chosen = (draws * len(t)).astype(np.int64)
    (straight, n_straight), (bent, n_bent) = (best_curve(t, u, chosen, error, k) for k in (1, 2))
    degree = 2 if n_bent > _BENT * n_straight else 1
    curve = bent if degree == 2 else straight
    return np.abs(u - value(curve, t)) <= error, degree


@kernel()
def best_curve(
    t: FloatArray, u: FloatArray, chosen: IntArray, error: float, degree: int
) -> tuple[FloatArray, int]:
    """The curve, (3,), through some of F points that has most points near it, and how many.

    - chosen: (I, 3) the points of each trial; the first degree + 1 are used
    """
    best = np.zeros(3)
    most = 0
    for k in range(len(chosen)):
        i, j, m = chosen[k]
        if t[i] == t[j]:
            continue
        c = 0.0
        if degree == 2:
            if t[i] == t[m] or t[j] == t[m]:
                continue
            c = (u[m] - u[i]) / (t[m] - t[i]) - (u[j] - u[i]) / (t[j] - t[i])
            c /= t[m] - t[j]
        b = (u[j] - u[i]) / (t[j] - t[i]) - c * (t[i] + t[j])
        a = u[i] - t[i] * (b + c * t[i])
        n = 0
        for p in range(len(t)):
            if abs(u[p] - a - t[p] * (b + c * t[p])) <= error:
                n += 1
        if n > most:
            best[0] = a
            best[1] = b
            best[2] = c
            most = n
    return best, most


def common_motion(before: FloatArray, now: FloatArray) -> FloatArray:
    """Return the motion of the road in the picture between two frames, as the curve q + r t that is
    added to each curve; from L curves, (L, 3), before and now.

    A homography of the road that takes each row of the picture to itself is u' = p u + q + r t, and
    p is 1 unless the camera gets higher: a car that moves sideways changes r, one that turns q.
    """
    if not len(before):
        return np.zeros(3)
    change = np.median(value(now - before, ROWS), axis=0)
    return fit(ROWS, change, 1)


def parallel(
    t: FloatArray, u: FloatArray, curve: FloatArray, pixels_per_m: FloatArray
) -> FloatArray:
    """The curve parallel to another one on the road, (3,), that is nearest to F points.

    - pixels_per_m: (2,) length of a metre across at t = 0, and its change with t, pixels
    """
    scale = pixels_per_m[0] + pixels_per_m[1] * t
    away = float(scale @ (u - value(curve, t)) / (scale @ scale))
    return curve + away * np.array([pixels_per_m[0], pixels_per_m[1], 0.0])


def nearby(
    t: FloatArray, u: FloatArray, curve: FloatArray, noise: FloatArray, error: float
) -> BoolArray:
    """The points, (F,), that belong to a line of which only a prediction is known: curves are drawn
    around it, the best 30 % are fitted to the points that each of them holds, and the best of these
    has its points.

    - curve: (3,)
    - noise: (D, 2) added to its place and its slope, pixels
    - error: how far a point may be from a curve, pixels
    """
    away = u - value(curve, t)
    design = np.stack([np.ones_like(t), t])
    held = np.abs(away - noise @ design) <= error
    best = np.argsort(-held.sum(axis=1), kind="stable")[: max(1, round(0.3 * len(noise)))]
    weight = held[best].astype(np.float64)
    squares = np.einsum("df,if,jf->dij", weight, design, design) + 1e-6 * np.eye(2)
    fitted = np.linalg.solve(squares, ((weight * away) @ design.T)[:, :, None])[:, :, 0]
    held = np.abs(away - fitted @ design) <= error
    most: BoolArray = held[held.sum(axis=1).argmax()]
    return most
