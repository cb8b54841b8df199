"""What `classic.bezier.kernels` computes, in plain NumPy."""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import FloatArray, IntArray


def ransac_line(
    point: FloatArray,
    value: FloatArray,
    sample: IntArray,
    most_away: float,
    least_points: int,
    most_turn: float,
) -> tuple[FloatArray, float]:
    """The line with the largest sum of values, as `kernels.ransac_line`."""
    best, line = -1.0, np.zeros(4)
    for chosen in sample:
        near = np.isin(np.arange(len(point)), chosen)
        for again in range(2):
            middle = point[near].mean(axis=0)
            spread = (point[near] - middle).T @ (point[near] - middle)
            if np.trace(spread) == 0:
                break
            across, along = np.linalg.eigh(spread)[1][:, 1]
            across, along = (across, along) if along > 0 else (-across, -along)
            if along <= 0 or abs(across) > most_turn * along:
                break
            near = np.abs((point - middle) @ [along, -across]) <= most_away
            if near.sum() < max(least_points, 2):
                break
            if again and value[near].sum() > best:
                best, line = value[near].sum(), np.array([*middle, across, along])
    return line, best


def basis(t: FloatArray) -> FloatArray:
    """Bernstein's polynomials of degree 3, (P, 4)."""
    return np.stack([(1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t**2, t**3], axis=1)


def straightness(control: FloatArray) -> float:
    """The mean cosine between the legs, as `kernels.straightness`."""
    leg = np.diff(control, axis=0)
    size = np.linalg.norm(leg, axis=1)
    cosine = [leg[k] @ leg[k + 1] / (size[k] * size[k + 1]) for k in range(2)]
    return float(np.mean(cosine))


def spline_score(
    ridge: FloatArray,
    control: FloatArray,
    jitter: int,
    step: float,
    angle_ratio: float,
    length_ratio: float,
) -> float:
    """The score of a spline, as `kernels.spline_score`."""
    point = basis(np.linspace(0, 1, round(1 / step) + 1)) @ control
    length = np.linalg.norm(np.diff(point, axis=0), axis=1).sum()
    pixel = np.floor(point + 0.5).astype(int)
    pixel = pixel[(pixel[:, 1] >= 0) & (pixel[:, 1] < len(ridge))]
    pixel = pixel[np.r_[True, (np.diff(pixel, axis=0) != 0).any(axis=1)]] if len(pixel) else pixel
    padded = np.pad(ridge, ((0, 0), (10_000, 10_000)))
    total = sum(padded[r, 10_000 + c - jitter : 10_001 + c + jitter].sum() for c, r in pixel)
    less = angle_ratio * (straightness(control) - 1)
    less += length_ratio * (min(length / len(ridge), 1) - 1)
    return float(total * (1 + less / 2))


def bezier_through(point: FloatArray) -> FloatArray:
    """The spline from the first to the last point, as `kernels.bezier_through`."""
    t = np.r_[0, np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1))]
    weight = basis(t / t[-1])
    rest = point - weight[:, [0, 3]] @ point[[0, -1]]
    inner = np.linalg.lstsq(weight[:, 1:3], rest)[0]
    return np.stack([point[0], *inner, point[-1]])


def ransac_spline(
    point: FloatArray,
    sample: IntArray,
    least_straight: float,
    ridge: FloatArray,
    *how: float,
) -> tuple[FloatArray, float]:
    """The best spline through samples, as `kernels.ransac_spline`."""
    best, control = -np.inf, np.zeros((4, 2))
    for chosen in sample:
        one = bezier_through(point[chosen])
        if straightness(one) < least_straight:
            continue
        score = spline_score(ridge, one, int(how[0]), *how[1:])
        if score > best:
            best, control = score, one
    return control, best
