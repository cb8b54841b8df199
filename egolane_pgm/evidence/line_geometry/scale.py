"""The lane width in the detector's unit, from the frames so far, as a distribution.

A detector of the picture may have any lateral scale, and one that wanders: its lane width is a
nuisance that is filtered together with the lane. Two filters over a logarithmic grid of widths read
the gaps between neighbouring strong lines, which are whole numbers of lanes (`lane_width`): for the
first the width hardly ever changes, for the second it wanders around that of the first. Each
predicts the next frame's gaps, and so the probability of each follows by Bayes' rule.

Neighbouring frames show the same lines, so a gap counts as a fraction of one. A new scale needs
minutes to be believed, as do stretches in which every other line is missing.

`place_finder` measures with it where in its lane the car is, whichever lane that is, for graphs
without RoadPosition. Lines lie on a lattice whose step is the lane width, so each reliable one says
the place as an angle: a car in the middle of a lane has lines half a step to either side. The place
is the mean of these angles over the lines of late, without any belief over lanes.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from egolane_pgm.evidence.line_geometry import kernels, lane_width
from egolane_pgm.evidence.line_geometry.habits import FULL_LRI, Habits, line_classes, translated
from egolane_pgm.evidence.line_geometry.model import LANE_M
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import BoolArray, FloatArray, LineLog

#: The grid: logarithmic steps from the narrowest to the widest width, in any unit.
_STEP = 0.02
_NARROWEST, _WIDEST = 0.1, 1e4
_N_WIDTHS = math.ceil(math.log(_WIDEST / _NARROWEST) / _STEP)
GRID = _NARROWEST * np.exp(_STEP * np.arange(_N_WIDTHS))

#: The widths that stand for the distribution are its quantiles, this many.
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

#: A scale that wanders begins anew with this probability in each frame, around the steady one with
#: this standard deviation of its logarithm.
RETURNS, WANDERS = 0.05, 0.1

#: Probability that the scale of an unknown detector wanders, and how quickly that may change.
MAY_WANDER, CHANGES = 0.05, 1e-4

#: How much of the count of neighbouring lanes that are seen at once is kept from frame to frame.
KEPT_PAIRS = 0.9998

#: The numbers that `kernels.follow_width` takes in addition to arrays.
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

#: The place is not known where the mean is shorter (1: one line, always at the same place). It is
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
    kernels.follow_width(
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


def place_finder(parameters: Parameters) -> Callable[[LineLog], FloatArray]:
    """A function that gives the place in T frames, (T,): lane widths right of the lane's middle,
    -.5 to .5, NaN where it is not known. It knows the frames so far, however they are grouped.

    - parameters: of any rule; those that are numbers of `lane_width_m` (expected) and `max_lri`.
    """
    given = {name: value for name, value in parameters.items() if isinstance(value, int | float)}
    detector = Habits(given.get("max_lri", FULL_LRI), says_valid=True, says_continuous=True)
    width, mean, last_s = new_belief(given.get("lane_width_m", LANE_M)), 0j, -math.inf

    def places_of(recorded: LineLog) -> FloatArray:
        nonlocal mean, last_s
        log = translated(recorded, detector)
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
