"""Fit the model of lines (`model`) by expectation-maximisation, to frames whose lane is known.

Two variables are hidden: the place inside the lane, which is uniform over the cells in every frame,
and the origin of each reported line, a line of the road or clutter. The fit maximises the posterior
with priors around a first guess that count as `STRENGTH` frames. They are strong because
neighbouring frames are correlated. Each iteration increases the log posterior. All metres are those
of lanes of LANE_M.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from egolane_pgm.evidence.line_geometry.kernels import expected_counts
from egolane_pgm.evidence.line_geometry.model import LANE_M, REACH_M, LineModel, places
from egolane_pgm.types import FloatArray, IntArray

#: Frames of each lane that the first guess is worth.
STRENGTH = 1000.0

#: Limits of the standard deviation of a line. A larger one would take in everything.
LARGEST_SIGMA_M = 0.3
SMALLEST_SIGMA_M = 0.05

ITERATIONS = 20

#: The smallest and the largest distance of a shoulder line from the road, lane widths.
_SHOULDER_RANGE = (0.4, 1.6)


class Statistics(NamedTuple):
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
    offset_m: FloatArray, kind: IntArray, lane: IntArray, first: LineModel, cells: int
) -> LineModel:
    """Fit a model.

    - offset_m, kind: (T, L) lines of the frames to learn from, as in `reading.SeenLines`
    - lane: (T,) counted from 0; a lane without a frame keeps the first guess
    - first: the first guess
    - cells: cells per lane
    """
    model = first
    for _ in range(ITERATIONS):
        model = maximise(expect(offset_m, kind, lane, model, cells), model, first)
    return model


def expect(
    offset_m: FloatArray, kind: IntArray, lane: IntArray, model: LineModel, cells: int
) -> Statistics:
    """Return the expected counts under a model: the E step."""
    frames = np.bincount(lane, minlength=len(model.rates)).astype(np.float64)
    log_likelihood, lines, classes, (m0, m1, m2), clutter = expected_counts(
        offset_m,
        kind,
        lane,
        places(model, LANE_M),
        model.rates,
        model.class_shares,
        model.sigmas_m,
        model.clutter,
        LANE_M,
        cells,
    )
    log_likelihood -= float(frames @ model.expected)
    return Statistics(log_likelihood, frames, lines, classes, m0, m1, m2, clutter)


def maximise(found: Statistics, model: LineModel, first: LineModel) -> LineModel:
    """Return the most probable model: the M step.

    The shoulders come first, then the sigmas about their new places; all other parameters are
    separate.
    """
    n = len(model.rates)
    tau2 = first.sigmas_m**2
    # The direction away from the road: left for the left shoulder, right for the right one.
    outward = np.array([-1.0, 1.0])
    weight = found.moment0[-2:] / model.sigmas_m[-2:] ** 2
    prior = STRENGTH / tau2[-2:]
    pull = outward * found.moment1[-2:] / model.sigmas_m[-2:] ** 2
    pull += prior * (first.shoulders - model.shoulders) * LANE_M
    move = pull / (weight + prior)
    shoulders = np.clip(model.shoulders + move / LANE_M, *_SHOULDER_RANGE)
    shift = np.zeros(n + 3)
    shift[-2:] = outward * (shoulders - model.shoulders) * LANE_M
    squares = found.moment2 - 2 * shift * found.moment1 + shift**2 * found.moment0
    variance = (squares + STRENGTH * tau2) / (found.moment0 + STRENGTH)
    sigmas = np.clip(np.sqrt(variance), SMALLEST_SIGMA_M, LARGEST_SIGMA_M)
    rates = (found.lines + STRENGTH * first.rates) / (found.frames[:, None] + STRENGTH)
    total = found.classes.sum(axis=1, keepdims=True) + STRENGTH
    shares = (found.classes + STRENGTH * first.class_shares) / total
    metres = 2 * REACH_M * (found.frames.sum() + n * STRENGTH)
    clutter = (found.clutter + 2 * REACH_M * n * STRENGTH * first.clutter) / metres
    return LineModel(rates, shares, sigmas, shoulders, clutter)
