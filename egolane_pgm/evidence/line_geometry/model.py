"""The geometric model of lines: which lines a detector reports from each lane, and where.

From lane l, counted from 0, a detector reports lines as a Poisson process over the lateral offset z
from the lane's centre. For lines of class c its intensity is

    lambda_lc(z) = sum_k rates[l, k] class_shares[k, c] N(z; place[l, k], s[l, k]^2) + clutter[c]
    s[l, k]^2 = sigmas_m[k]^2 + (sigma_per_m place[l, k])^2

The n + 1 lines of the road, k = 0 to n, lie at (k - l - 1/2) lane widths. Two more lie off the
road: `shoulders[0]` lane widths left of the leftmost line and `shoulders[1]` right of the rightmost
one. A vehicle at u right of the centre sees a line that lies at z = o + u at the offset o. Hence
log p_l(u) = sum over lines of log lambda_lc(o + u) - Lambda_l, where Lambda_l is the expected
number of lines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.parameters import Value, number
from egolane_pgm.types import FloatArray

#: The classes of lines: 0 valid and continuous; 1 valid with LRI >= STRONG_LRI of `scale`; 2 valid
#: with a lower LRI; 3 not valid with LRI >= LEAST_LRI.
N_CLASSES = 4

#: The lane width to which lines are scaled; all metres here are relative to such lanes.
LANE_M = 3.5

#: The farthest line that counts, metres.
REACH_M = 16.0

#: Step of the tables over z, metres.
TABLE_STEP_M = 0.02

#: Generic share of continuous reports of lines inside the road, shares of classes 1 to 3 among
#: reports that are not continuous, and false lines per metre of each class.
INNER_CONTINUOUS = 0.05
PLAIN_SHARES = (0.88, 0.06, 0.06)
CLUTTER_PER_M = 0.05 * np.array([0.05, 0.5, 0.2, 0.25])

#: Generic standard deviation of a line, metres.
LINE_SIGMA_M = 0.25

#: Generic standard deviation of an independent error, metres per metre between line and car. 0
#: with `width_wanders`, which also makes far lines less exact.
LINE_SIGMA_PER_M = 0.03

#: Generic distance of the shoulder lines from the road, lane widths.
SHOULDER_DISTANCE = 0.9

#: The lowest intensity, so that no report of a detector is impossible.
LEAST_INTENSITY = 1e-9


@dataclass(frozen=True)
class LineModel:
    """The parameters of the model; the n + 3 lines are the road's, then the left and the right
    shoulder.

    - rates: (n, n + 3) expected number of reports of each line, from each lane
    - class_shares: (n + 3, 4) shares of the classes among them
    - sigmas_m: (n + 3,) standard deviation of a line about its place, metres
    - shoulders: (2,) distances of the shoulders from the road's outer lines, lane widths
    - clutter: (4,) false lines per metre, of each class
    - sigma_per_m: how much further a line is off its place with each metre between it and the car
    """

    rates: FloatArray
    class_shares: FloatArray
    sigmas_m: FloatArray
    shoulders: FloatArray
    clutter: FloatArray
    sigma_per_m: float = 0.0

    @property
    def expected(self) -> FloatArray:
        """Lambda, the expected number of lines from each lane, (n,)."""
        return np.asarray(self.rates.sum(axis=1) + self.clutter.sum() * 2 * REACH_M)


@dataclass(frozen=True)
class Kind:
    """Generic constants of a detector on a road.

    - seen_near: rate of the lines of the own lane
    - fade: share of it that is lost with each lane further away
    - seen_far: lowest rate of a line of the road
    - shoulder_left, shoulder_right: rate of a line left and right of the road
    - edge_continuous: share of continuous reports of the road's outer lines
    """

    seen_near: float = 0.9
    fade: float = 0.2
    seen_far: float = 0.15
    shoulder_left: float = 0.08
    shoulder_right: float = 0.13
    edge_continuous: float = 0.25


#: The default kind.
GENERIC = Kind()

#: The parameters that a fit gives: fields of the model.
FITTED = ("rates", "class_shares", "sigmas_m", "shoulders", "clutter")


def line_model(n_lanes: int, parameters: Mapping[str, Value], kind: Kind = GENERIC) -> LineModel:
    """Return the model of checked parameters; those that are `generic` get the constants of a kind.

    By these, near lines are reported more often than far ones.
    """
    n_lines = n_lanes + 3
    rates = np.empty((n_lanes, n_lines))
    for lane in range(n_lanes):
        lines_away = np.abs(np.arange(n_lanes + 1) - lane - 0.5) - 0.5
        rates[lane, : n_lanes + 1] = np.maximum(
            kind.seen_far, kind.seen_near * (1 - kind.fade * lines_away)
        )
    rates[:, -2:] = kind.shoulder_left, kind.shoulder_right
    shares = np.empty((n_lines, N_CLASSES))
    shares[:, 0] = INNER_CONTINUOUS
    shares[[0, n_lanes], 0] = kind.edge_continuous
    shares[:, 1:] = (1 - shares[:, :1]) * np.array(PLAIN_SHARES)
    sigmas = np.full(n_lines, LINE_SIGMA_M)
    shoulders = np.full(2, SHOULDER_DISTANCE)
    generic = zip(FITTED, (rates, shares, sigmas, shoulders, CLUTTER_PER_M), strict=True)
    fields = {
        name: default
        if isinstance(parameters[name], str)
        else np.array(parameters[name]).reshape(default.shape)
        for name, default in generic
    }
    grows = isinstance(parameters["sigmas_m"], str) and not number(parameters, "width_wanders")
    return LineModel(**fields, sigma_per_m=LINE_SIGMA_PER_M if grows else 0.0)


def without_flags(model: LineModel) -> LineModel:
    """The model for a detector without a continuous flag: class 0 is divided among the others, so
    that lines differ in their places only."""
    shares = model.class_shares.copy()
    clutter = model.clutter.copy()
    shares[:, 1] += np.where(shares[:, 0] < 1, 0, shares[:, 0])
    shares[:, 0] = 0
    shares /= shares.sum(axis=1, keepdims=True)
    clutter[1] += clutter[0]
    clutter[0] = 0
    return replace(model, class_shares=shares, clutter=clutter)


def places(model: LineModel, width_m: float) -> FloatArray:
    """The place of each line, (n, n + 3), metres to the right of the centre of each lane."""
    n = len(model.rates)
    lane = np.arange(n)[:, None]
    road = (np.arange(n + 1) - lane - 0.5) * width_m
    left = -(lane + 0.5 + model.shoulders[0]) * width_m
    right = (n - lane - 0.5 + model.shoulders[1]) * width_m
    return np.concatenate([road, left, right], axis=1)


def log_intensity(model: LineModel, width_m: float) -> FloatArray:
    """The logarithm of a model's intensity, (n, 4, Z), per lane and class, over every z that a line
    within reach can have: z = -(REACH_M + width_m) + TABLE_STEP_M * index."""
    last = REACH_M + width_m
    n_steps = math.ceil(2 * last / TABLE_STEP_M) + 2
    z = -last + TABLE_STEP_M * np.arange(n_steps)
    place = places(model, width_m)[..., None]
    sigma = np.hypot(model.sigmas_m[:, None], model.sigma_per_m * place)
    with np.errstate(over="ignore"):
        exponent = -0.5 * ((z - place) / sigma) ** 2
    density = np.exp(exponent) / (sigma * math.sqrt(2 * math.pi))
    weights = model.rates[:, :, None] * model.class_shares
    intensity = weights.transpose(0, 2, 1) @ density + model.clutter[:, None]
    return np.asarray(np.log(np.maximum(intensity, LEAST_INTENSITY)))
