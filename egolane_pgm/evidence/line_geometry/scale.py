"""The distribution of the lane width in the detector's unit, from the frames so far.

The lateral scale of a detector is unknown and may drift, so the lane width is a nuisance variable,
filtered together with the lane. Two filters over a logarithmic grid of widths take the gaps between
neighbouring strong lines, which are whole numbers of lanes (`lane_width`): for the first the width
hardly ever changes, for the second it wanders around the first one. Each predicts the gaps of the
next frame, which gives the probability of each by Bayes' rule.

Neighbouring frames show the same lines, so a gap counts as a fraction of one. A new scale needs
minutes of evidence, and so do stretches in which every other line is missing.

`place_finder` measures with it the lateral offset in the lane, for graphs without RoadPosition.
Lines lie on a lattice whose step is the lane width, so each reliable one gives the offset as an
angle: a car in the middle of a lane has lines half a step to either side. The offset is the mean of
these angles over recent lines, without a belief over lanes.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from egolane_pgm.evidence.line_geometry import lane_width
from egolane_pgm.evidence.line_geometry.flag_semantics import (
    FULL_LRI,
    FlagSemantics,
    line_classes,
    translated,
)
from egolane_pgm.evidence.line_geometry.model import LANE_M
from egolane_pgm.parameters import Parameters
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, LineLog

#: The grid: logarithmic steps from the narrowest to the widest width, in any unit.
_STEP = 0.02
_NARROWEST, _WIDEST = 0.1, 1e4
_N_WIDTHS = math.ceil(math.log(_WIDEST / _NARROWEST) / _STEP)
GRID = _NARROWEST * np.exp(_STEP * np.arange(_N_WIDTHS))

#: The number of quantiles that represent the distribution.
N_QUANTILES = 7

#: The share of gaps that are no whole number of lanes.
OFF_LATTICE = 0.6

#: The number of gaps that count as one for the width that wanders. It has to follow quickly.
ALIKE_WANDERING = 10.0

#: The share of the belief in a width that moves to either neighbour in a frame, if the scale is
#: steady and if it wanders.
STEADY_MOVES, WANDERING_MOVES = 0.0005, 0.025

#: Probability that the scale of a detector is another one from this frame on. It is so small that
#: misleading gaps are taken for a new scale only if they last for a minute or longer.
ANOTHER_SCALE = 1e-40

#: A scale that wanders starts again with this probability in each frame, around the steady one with
#: this standard deviation of its logarithm.
RETURNS, WANDERS = 0.05, 0.1

#: Probability that the scale of an unknown detector wanders, and how quickly that may change.
MAY_WANDER, CHANGES = 0.05, 1e-4

#: How much of the count of neighbouring lanes that are seen at once is kept from frame to frame.
KEPT_PAIRS = 0.9998

#: The numbers that `follow_width` takes in addition to arrays.
RATES = np.array(
    [
        STEADY_MOVES,
        WANDERING_MOVES,
        ANOTHER_SCALE,
        RETURNS,
        MAY_WANDER,
        CHANGES,
        KEPT_PAIRS,
        lane_width.ALIKE,
        ALIKE_WANDERING,
    ]
)


#: The logarithmic distances of a gap and a width, in steps, for which there is a likelihood.
_FIRST = math.floor(math.log(0.02) / _STEP)
_LAST = math.ceil(math.log(lane_width.MOST_LANES + 1.5) / _STEP)
_GAP = np.exp(_STEP * np.arange(_FIRST, _LAST + 1))
_LANES = np.maximum(1, np.round(_GAP))
_NORMAL = np.exp(-0.5 * ((_GAP - _LANES) / lane_width.GAP_SIGMA) ** 2) / (
    lane_width.GAP_SIGMA * math.sqrt(2 * math.pi)
)
_DENSITY = np.where(_LANES <= lane_width.MOST_LANES, _NORMAL, 0.0)

#: For each of them the logarithm of the likelihood, relative to a gap anywhere; and 1 where the gap
#: is two lanes.
_LOG_LIKELIHOOD = np.log((1 - OFF_LATTICE) * _DENSITY + OFF_LATTICE)
_IS_TWO_LANES = np.where(np.abs(_GAP - 2) < lane_width.PAIR_WITHIN, 1.0, 0.0)

#: A width that wanders, around the steady one, (2 h + 1,).
_HALF = round(3 * WANDERS / _STEP)
_AROUND = np.exp(-0.5 * (np.arange(-_HALF, _HALF + 1) * _STEP / WANDERS) ** 2)
_SPREAD = _AROUND / _AROUND.sum()

#: Lines farther away, in lane widths, do not count for the place: an error of the width moves them
#: the more.
REACH = 1.5

#: The place is a mean over about this time, seconds. A car that changes lane in 5 s goes a tenth of
#: a lane meanwhile, which is how well the place is known.
MEAN_S = 0.5

#: The place is unknown if the mean is shorter (1: one line, always at the same place). It is
#: so about a second after the last line.
DEFINITE = 0.1


@dataclass(frozen=True)
class WidthBelief:
    """The belief over the lane width; the arrays change with every frame.

    - steady, wandering: (_N_WIDTHS,) probabilities of the widths, if the scale is steady and if it
      wanders
    - pairs: (_N_WIDTHS,) number of gaps between every other line that were two lanes of that width
    - counts: (2,) probability that the scale wanders, and number of gaps between every other line
    - prior: (_N_WIDTHS,) the belief before the first frame
    """

    steady: FloatArray
    wandering: FloatArray
    pairs: FloatArray
    counts: FloatArray
    prior: FloatArray


def new_belief(expected_m: float) -> WidthBelief:
    """The belief before the first frame. expected_m: the expected width."""
    away = (np.log(GRID) - math.log(expected_m)) / lane_width.EXPECTED_WITHIN
    prior = 1 / (1 + away**2)
    prior /= prior.sum()
    counts = np.array([MAY_WANDER, 0.0])
    return WidthBelief(prior.copy(), prior.copy(), np.zeros(_N_WIDTHS), counts, prior)


def follow(belief: WidthBelief, offset_m: FloatArray, is_strong: BoolArray) -> FloatArray:
    """The lane width before each of T frames, (T, N_QUANTILES): equally probable values in rising
    order, in the unit of the offsets. The belief becomes that after the last frame.

    offset_m, is_strong: (T, L) the lines, and whether their places are reliable.
    """
    widths = np.empty((len(offset_m), N_QUANTILES))
    follow_width(
        offset_m,
        is_strong,
        belief.steady,
        belief.wandering,
        belief.pairs,
        belief.counts,
        belief.prior,
        _LOG_LIKELIHOOD,
        _IS_TWO_LANES,
        _FIRST,
        _SPREAD,
        RATES,
        lane_width.DOUBLE,
        lane_width.ENOUGH_PAIRS,
        lane_width.LEAST_PAIRS,
        math.log(_NARROWEST),
        _STEP,
        widths,
    )
    return widths


@kernel()
def follow_width(
    offset_m: FloatArray,
    is_strong: BoolArray,
    steady: FloatArray,
    wandering: FloatArray,
    pairs: FloatArray,
    counts: FloatArray,
    prior: FloatArray,
    log_likelihood: FloatArray,
    is_two_lanes: FloatArray,
    first: int,
    spread: FloatArray,
    rates: FloatArray,
    least_double: float,
    enough_pairs: float,
    least_pairs: float,
    log_narrowest: float,
    step: float,
    width_m: FloatArray,
) -> None:
    """Fills width_m (T, K) with quantiles of the lane width before each frame; the belief `steady`,
    `wandering`, `pairs`, `counts` becomes that after the last one.

    Belief and prior as in `WidthBelief`; the tables and rates are
    constants of `scale`. least_double: a gap of less than this share of the frame's largest
    one is a line reported twice.
    """
    moves, moves_wandering, another, returns, may_wander, changes = rates[:6]
    kept, alike, alike_wandering = rates[6:9]
    n_frames, n_lines = offset_m.shape
    n_widths, n_table, n_quantiles = len(prior), len(log_likelihood), width_m.shape[1]
    half = len(spread) // 2
    lines = np.empty(n_lines)
    moved = np.empty(n_widths)
    around = np.empty(n_widths)
    says = np.empty(n_widths)
    off_table = log_likelihood[0]
    for t in range(n_frames):
        # Predict.
        moved[0], moved[-1] = steady[0], steady[-1]
        for j in range(1, n_widths - 1):
            moved[j] = steady[j] + moves * (steady[j - 1] - 2 * steady[j] + steady[j + 1])
        for j in range(n_widths):
            steady[j] = moved[j] + another * (prior[j] - moved[j])
        # A width by which no two neighbouring lanes are ever seen at once is impossible. The factor
        # is so small because other widths may have sunk to `another`.
        total = 0.0
        for j in range(n_widths):
            if counts[1] >= enough_pairs and pairs[j] < least_pairs * counts[1]:
                steady[j] *= 1e-60
            moved[j] = steady[j]
            total += moved[j]
        around[:] = 0.0
        for j in range(n_widths):
            moved[j] /= total
            if moved[j] > 1e-6:
                for d in range(max(-half, -j), min(half, n_widths - 1 - j) + 1):
                    around[j + d] += moved[j] * spread[d + half]
        left = wandering[0]
        total = 0.0
        for j in range(n_widths):
            here = wandering[j]
            right = wandering[j + 1] if j + 1 < n_widths else here
            new = here + moves_wandering * (left - 2 * here + right)
            wandering[j] = new + returns * (around[j] - new)
            if counts[1] >= enough_pairs and pairs[j] < least_pairs * counts[1]:
                wandering[j] *= 1e-60
            total += wandering[j]
            left = here
        for j in range(n_widths):
            wandering[j] /= total
        counts[0] += changes * (may_wander - counts[0])
        # The quantiles of the mixture.
        below = 0.0
        k = 0
        for j in range(n_widths):
            below += counts[0] * wandering[j] + (1 - counts[0]) * moved[j]
            while k < n_quantiles and below * n_quantiles >= k + 0.5:
                width_m[t, k] = math.exp(log_narrowest + step * j)
                k += 1
        # The gaps of this frame.
        n = 0
        for i in range(n_lines):
            if is_strong[t, i]:
                lines[n] = offset_m[t, i]
                n += 1
        if n < 2:
            continue
        lines[:n].sort()
        largest = 0.0
        for i in range(n - 1):
            largest = max(largest, lines[i + 1] - lines[i])
        single = 1
        for i in range(1, n):
            if lines[i] - lines[single - 1] > least_double * largest:
                lines[single] = lines[i]
                single += 1
        for j in range(n_widths):
            pairs[j] *= kept
            says[j] = 0.0
        counts[1] *= kept
        n_gaps = 0
        for apart in (1, 2):
            for i in range(single - apart):
                gap = lines[i + apart] - lines[i]
                if gap == math.inf:
                    continue
                n_gaps += 1
                if apart == 2:
                    counts[1] += 1
                start = round((math.log(gap) - log_narrowest) / step) - first
                # Widths whose gap is off the table are alike.
                for j in range(max(0, start - n_table + 1), min(n_widths, start + 1)):
                    says[j] += log_likelihood[start - j] - off_table
                    if apart == 2:
                        pairs[j] += is_two_lanes[start - j]
        if n_gaps == 0:
            continue
        most = 0.0
        for j in range(n_widths):
            most = max(most, says[j])
        of_steady = 0.0
        of_wandering = 0.0
        total = 0.0
        total_wandering = 0.0
        for j in range(n_widths):
            # Most neighbours have equal gaps, and exp takes longer than the rest.
            if j == 0 or says[j] != says[j - 1]:
                likelihood = math.exp((says[j] - most) / alike)
                quick = math.exp((says[j] - most) / alike_wandering)
            of_steady += moved[j] * quick
            of_wandering += wandering[j] * quick
            steady[j] *= likelihood
            total += steady[j]
            wandering[j] *= quick
            total_wandering += wandering[j]
        for j in range(n_widths):
            steady[j] /= total
            wandering[j] /= total_wandering
        of_wandering *= counts[0]
        counts[0] = of_wandering / (of_wandering + (1 - counts[0]) * of_steady)


def place_finder(parameters: Parameters) -> Callable[[LineLog], FloatArray]:
    """A function that gives the place in T frames, (T,): lane widths right of the lane's middle,
    -.5 to .5, NaN where it is not known. It knows the frames so far, however they are grouped.

    - parameters: of any rule; those that are numbers of `lane_width_m` (expected) and `max_lri`.
    """
    given = {name: value for name, value in parameters.items() if isinstance(value, int | float)}
    detector = FlagSemantics(given.get("max_lri", FULL_LRI), uses_valid=True, uses_continuous=True)
    width, mean, last_s = new_belief(given.get("lane_width_m", LANE_M)), 0j, -math.inf

    def places_of(recorded: LineLog) -> FloatArray:
        nonlocal mean, last_s
        log = recorded if detector.full_lri == FULL_LRI else translated(recorded, detector)
        _, is_strong = line_classes(log)
        widths = follow(width, log.offset_m, is_strong)
        away = log.offset_m / widths[:, widths.shape[1] // 2, None]
        near = is_strong & (np.abs(away) < REACH)
        seen = np.exp(-2j * math.pi * away, where=near, out=np.zeros(near.shape, dtype=complex))
        place = np.full(len(log), np.nan)
        for t, time_s in enumerate(log.time_s.tolist()):
            kept = math.exp(-max(time_s - last_s, 0.0) / MEAN_S)
            mean, last_s = kept * mean - (1 - kept) * sum(seen[t].tolist()), time_s
            if abs(mean) >= DEFINITE:
                place[t] = cmath.phase(mean) / (2 * math.pi)
        return place

    return places_of
