"""Fit the model of lines (`model`) by expectation-maximisation, to frames whose lane is known.

Two variables are hidden: the place inside the lane, which is uniform over the cells in every frame,
and the origin of each reported line, a line of the road or clutter. The fit maximises the posterior
with priors around a first guess that count as `strength` frames. They are strong because
neighbouring frames are correlated. Each iteration increases the log posterior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.evidence.line_geometry.kernels import expected_counts
from egolane_pgm.evidence.line_geometry.model import REACH_M, LineModel, places
from egolane_pgm.types import FloatArray, IntArray

#: Frames of each lane that the first guess is worth.
STRENGTH = 1000.0

#: Limits of the standard deviation of a line. A larger one would take in everything.
LARGEST_SIGMA_M = 0.3
SMALLEST_SIGMA_M = 0.05

ITERATIONS = 20

#: The smallest and the largest distance of a shoulder line from the road, lane widths.
_SHOULDER_RANGE = (0.4, 1.6)


@dataclass(frozen=True)
class Statistics:
    """Expected counts under a model.

    - log_likelihood: of all frames
    - frames: (n,) number of frames of each lane
    - lines: (n, n + 3) reports of each line of the model from each lane
    - classes: (n + 3, 4) reports of each line in each class
    - moment0, moment1, moment2: (n + 3,) sums of the powers of a report's distance from its place,
      metres
    - clutter: (4,) reports that are clutter, of each class
    """

    log_likelihood: float
    frames: FloatArray
    lines: FloatArray
    classes: FloatArray
    moment0: FloatArray
    moment1: FloatArray
    moment2: FloatArray
    clutter: FloatArray


def fit_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lane: IntArray,
    first: LineModel,
    width_m: float,
    cells: int,
    *,
    strength: float = STRENGTH,
    iterations: int = ITERATIONS,
) -> tuple[LineModel, FloatArray]:
    """Fits a model; gives it with the log posterior (up to a constant) before each iteration.

    - offset_m, kind: (T, L) lines of the frames to learn from, as in `reading.SeenLines`
    - lane: (T,) counted from 0; a lane without a frame keeps the first guess
    - first: the first guess
    - width_m, cells: lane width, and cells per lane
    - strength: frames of each lane that the first guess is worth
    """
    model = first
    history = np.empty(iterations)
    for k in range(iterations):
        found = expect(offset_m, kind, lane, model, width_m, cells)
        history[k] = found.log_likelihood + log_prior(model, first, strength, width_m)
        model = maximise(found, model, first, strength, width_m)
    return model, history


def expect(
    offset_m: FloatArray,
    kind: IntArray,
    lane: IntArray,
    model: LineModel,
    width_m: float,
    cells: int,
) -> Statistics:
    """The E step: expected counts under a model."""
    n, n_lines = model.rates.shape
    frames = np.bincount(lane, minlength=n).astype(np.float64)
    arrays: list[Any] = [np.zeros(s) for s in ((n, n_lines), (n_lines, 4), (3, n_lines), 4)]
    log_likelihood = expected_counts(
        offset_m,
        kind,
        lane,
        places(model, width_m),
        model.rates,
        model.class_shares,
        model.sigma_m,
        model.clutter,
        width_m,
        cells,
        *arrays,
    )
    log_likelihood -= float(frames @ model.expected)
    lines, classes, (zeroth, first, second), clutter = arrays
    return Statistics(log_likelihood, frames, lines, classes, zeroth, first, second, clutter)


def maximise(
    found: Statistics, model: LineModel, first: LineModel, strength: float, width_m: float
) -> LineModel:
    """The M step. The shoulders come first, then the sigmas about their new places; all other
    parameters are separate."""
    n = model.n_lanes
    tau2 = first.sigma_m**2
    # The direction away from the road: left for the left shoulder, right for the right one.
    outward = np.array([-1.0, 1.0])
    weight = found.moment0[-2:] / model.sigma_m[-2:] ** 2
    prior = strength / tau2[-2:]
    pull = outward * found.moment1[-2:] / model.sigma_m[-2:] ** 2
    pull += prior * (first.shoulders - model.shoulders) * width_m
    total = weight + prior
    move = np.divide(pull, total, out=np.zeros(2), where=total > 0)
    shoulders = np.clip(model.shoulders + move / width_m, *_SHOULDER_RANGE)
    shift = np.zeros(n + 3)
    shift[-2:] = outward * (shoulders - model.shoulders) * width_m
    squares = found.moment2 - 2 * shift * found.moment1 + shift**2 * found.moment0
    total = found.moment0 + strength
    variance = np.divide(squares + strength * tau2, total, out=tau2.copy(), where=total > 0)
    sigma = np.clip(np.sqrt(variance), SMALLEST_SIGMA_M, LARGEST_SIGMA_M)
    total = found.frames[:, None] + strength
    rates = np.divide(
        found.lines + strength * first.rates, total, out=first.rates.copy(), where=total > 0
    )
    total = found.classes.sum(axis=1, keepdims=True) + strength
    shares = np.divide(
        found.classes + strength * first.class_shares,
        total,
        out=first.class_shares.copy(),
        where=total > 0,
    )
    metres = 2 * REACH_M * (found.frames.sum() + n * strength)
    clutter = (found.clutter + 2 * REACH_M * n * strength * first.clutter) / metres
    return LineModel(rates, shares, sigma, shoulders, clutter)


def log_prior(model: LineModel, first: LineModel, strength: float, width_m: float) -> float:
    """The logarithm of the prior density whose maximum is the first guess, up to a constant."""
    if strength == 0:
        return 0.0
    metres = 2 * REACH_M * model.n_lanes
    away = (model.shoulders - first.shoulders) * width_m / first.sigma_m[-2:]
    terms = (
        _times_log(first.rates, model.rates) - model.rates.sum(),
        _times_log(first.class_shares, model.class_shares),
        metres * (_times_log(first.clutter, model.clutter) - model.clutter.sum()),
        -np.log(model.sigma_m).sum() - 0.5 * ((first.sigma_m / model.sigma_m) ** 2).sum(),
        -0.5 * (away**2).sum(),
    )
    return strength * math.fsum(float(term) for term in terms)


def _times_log(weight: FloatArray, value: FloatArray) -> float:
    kept = weight > 0
    return float((weight[kept] * np.log(value[kept])).sum())
