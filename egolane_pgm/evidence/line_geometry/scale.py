"""The distribution of the lane width in the detector's unit, from the frames so far.

The lateral scale of a detector is unknown and may drift, so the lane width is a nuisance variable,
filtered together with the lane. Two filters over a logarithmic grid of widths take the gaps between
neighbouring strong lines (`line_classes`), which are whole numbers of lanes (`lane_width`): for the
first the width hardly ever changes, for the second it wanders around the first one. Each predicts
the gaps of the next frame, which gives the probability of each by Bayes' rule.

Neighbouring frames show the same lines, so a gap counts as a fraction of one. A new scale needs
minutes of evidence, and so do stretches in which every other line is missing.

`place_finder` measures with it the lateral offset in the lane, for graphs without RoadPosition.
Lines lie on a lattice whose step is the lane width, so each reliable one gives the offset as an
angle: a car in the middle of a lane has lines half a step to either side. The offset is the mean of
these angles over recent lines, without a belief over lanes.

The kernels use constants of this file only: numba's cache notices changes of this file alone.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from egolane_pgm.evidence.line_geometry.model import LANE_M
from egolane_pgm.parameters import Parameters
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: The LRI of a well tracked line, on the paper's scale.
FULL_LRI = 10.0

#: The least LRI of a strong line, whose place is reliable.
STRONG_LRI = 6.0

#: The least LRI of a line that is not valid and yet counts.
LEAST_LRI = 3.0

#: An offset nearer to 0 than this is a placeholder of a detector that has not measured yet.
PLACEHOLDER_M = 1e-6

#: Gaps of more lanes than this count as off the lattice. If only every other line is seen, the
#: second next one is four lanes away; with a smaller limit, twice the true width would explain gaps
#: that the true width does not.
MOST_LANES = 4

#: Standard deviation of a gap, lane widths: lines lie within about .15 m of their place.
GAP_SIGMA = 0.06

#: A gap of less than this share of the frame's largest one is no lane, but a line reported twice.
DOUBLE = 0.1

#: The number of gaps that count as one, because neighbouring frames show the same lines: two
#: seconds of frames are little more evidence than a single one.
ALIKE = 20.0

#: The same for the width that wanders; fewer, because it has to follow quickly.
ALIKE_WANDERING = 10.0

#: The least share of two lanes among the gaps between every other line, if two neighbouring lanes
#: are ever seen at once.
LEAST_PAIRS = 0.03

#: The largest distance of such a gap from two lanes, lane widths.
PAIR_WITHIN = 0.15

#: The least number of gaps between every other line for this check: about three independent ones,
#: since a detector may report two lines only.
ENOUGH_PAIRS = 3 * ALIKE / LEAST_PAIRS

#: Scale of the prior, a Cauchy distribution of the logarithm of the width around the expected one.
#: A width a tenth away is half as probable; those far away keep a chance.
EXPECTED_WITHIN = 0.1

#: The grid of widths has logarithmic steps of this size.
_STEP = 0.02

#: The narrowest and the widest width of the grid, in any unit.
_NARROWEST = 0.1
_WIDEST = 1e4
_LOG_NARROWEST = math.log(_NARROWEST)
_N_WIDTHS = math.ceil(math.log(_WIDEST / _NARROWEST) / _STEP)
GRID = _NARROWEST * np.exp(_STEP * np.arange(_N_WIDTHS))

#: The number of quantiles that represent the distribution.
N_QUANTILES = 7

#: The share of gaps that are no whole number of lanes.
OFF_LATTICE = 0.6

#: The share of the belief in a width that moves to either neighbour in a frame, if the scale is
#: steady.
STEADY_MOVES = 0.0005

#: The same if the scale wanders.
WANDERING_MOVES = 0.025

#: Probability that the scale of a detector is another one from this frame on. It is so small that
#: misleading gaps are taken for a new scale only if they last for a minute or longer.
ANOTHER_SCALE = 1e-40

#: Probability in each frame that a scale that wanders starts again around the steady one.
RETURNS = 0.05

#: Standard deviation of the logarithm of a width around the steady one.
WANDERS = 0.1

#: Probability that the scale of an unknown detector wanders.
MAY_WANDER = 0.05

#: The share by which this probability returns to MAY_WANDER in each frame.
CHANGES = 1e-4

#: The factor of a width at which two neighbouring lanes are never seen at once, in each frame: such
#: a width is impossible. It is so small because other widths may have sunk to ANOTHER_SCALE.
NEVER_PAIRED = 1e-60

#: How much of the count of neighbouring lanes that are seen at once is kept from frame to frame.
KEPT_PAIRS = 0.9998

#: The logarithmic distances of a gap and a width, in steps, for which there is a likelihood.
_FIRST = math.floor(math.log(0.02) / _STEP)
_LAST = math.ceil(math.log(MOST_LANES + 1.5) / _STEP)
_GAP = np.exp(_STEP * np.arange(_FIRST, _LAST + 1))
_LANES = np.maximum(1, np.round(_GAP))
_NORMAL = np.exp(-0.5 * ((_GAP - _LANES) / GAP_SIGMA) ** 2) / (GAP_SIGMA * math.sqrt(2 * math.pi))
_DENSITY = np.where(_LANES <= MOST_LANES, _NORMAL, 0.0)

#: For each of them the logarithm of the likelihood, relative to a gap anywhere; and 1 where the gap
#: is two lanes.
_LOG_LIKELIHOOD = np.log((1 - OFF_LATTICE) * _DENSITY + OFF_LATTICE)
_IS_TWO_LANES = np.where(np.abs(_GAP - 2) < PAIR_WITHIN, 1.0, 0.0)

#: A width that wanders, around the steady one, (2 h + 1,).
_HALF = round(3 * WANDERS / _STEP)
_AROUND = np.exp(-0.5 * (np.arange(-_HALF, _HALF + 1) * _STEP / WANDERS) ** 2)
_SPREAD = _AROUND / _AROUND.sum()

#: Lines farther away, in lane widths, do not count for the place: an error of the width moves far
#: lines more.
REACH = 1.5

#: The place is a mean over about this time, seconds. A car that changes lane in 5 s goes a tenth of
#: a lane meanwhile, which is how well the place is known.
MEAN_S = 0.5

#: The place is unknown if the mean is shorter (1: one line, always at the same place). It is
#: so about a second after the last line.
DEFINITE = 0.1


class WidthBelief(NamedTuple):
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
    """Return the belief before the first frame. expected_m: the expected width."""
    away = (np.log(GRID) - math.log(expected_m)) / EXPECTED_WITHIN
    prior = 1 / (1 + away**2)
    prior /= prior.sum()
    counts = np.array([MAY_WANDER, 0.0])
    return WidthBelief(prior.copy(), prior.copy(), np.zeros(_N_WIDTHS), counts, prior)


@kernel()
def line_classes(
    offset_m: FloatArray, is_valid: BoolArray, is_continuous: BoolArray, lri: FloatArray
) -> tuple[IntArray, BoolArray]:
    """Return the class of each line (`model.N_CLASSES`), -1 in padding, and whether its place is
    reliable; (T, L) each. An unknown LRI counts as the highest."""
    n_frames, n_lines = offset_m.shape
    kind = np.empty((n_frames, n_lines), dtype=np.int64)
    is_strong = np.empty((n_frames, n_lines), dtype=np.bool_)
    for t in range(n_frames):
        for i in range(n_lines):
            kind[t, i] = -1
            is_strong[t, i] = False
            if not PLACEHOLDER_M < abs(offset_m[t, i]) < math.inf:
                continue
            is_reliable = not lri[t, i] < STRONG_LRI
            if is_valid[t, i]:
                is_strong[t, i] = is_reliable
                kind[t, i] = 0 if is_continuous[t, i] else 1 if is_reliable else 2
            elif not lri[t, i] < LEAST_LRI:
                kind[t, i] = 3
    return kind, is_strong


def follow(belief: WidthBelief, offset_m: FloatArray, is_strong: BoolArray) -> FloatArray:
    """Return the lane width before each of T frames, (T, N_QUANTILES): equally probable values in
    rising order, in the unit of the offsets. The belief becomes that after the last frame.

    offset_m, is_strong: (T, L) the lines, and whether their places are reliable.
    """
    # NumPy sorts at once; numba takes seconds to compile a sort.
    width_m: FloatArray = _follow(belief, np.sort(np.where(is_strong, offset_m, np.inf), axis=1))
    return width_m


@kernel()
def _follow(belief: WidthBelief, lines_m: FloatArray) -> FloatArray:
    """As `follow`; lines_m: (T, L) strong lines in rising order, then infinity; overwritten."""
    steady, wandering, pairs, counts, prior = belief
    n_frames = len(lines_m)
    width_m = np.empty((n_frames, N_QUANTILES))
    # The beliefs that predict a frame, and the support of its gaps for each width.
    predicted = np.empty(len(prior))
    kept = np.empty(len(prior))
    around = np.empty(len(prior) + 2 * _HALF)
    support = np.empty(len(prior))
    for t in range(n_frames):
        for j in range(len(prior)):
            is_paired = counts[1] < ENOUGH_PAIRS or pairs[j] >= LEAST_PAIRS * counts[1]
            kept[j] = 1.0 if is_paired else NEVER_PAIRED
        _predict_steady(steady, prior, kept, predicted)
        _predict_wandering(wandering, predicted, kept, around)
        counts[0] += CHANGES * (MAY_WANDER - counts[0])
        below = 0.0
        k = 0
        for j in range(len(prior)):
            below += counts[0] * wandering[j] + (1 - counts[0]) * predicted[j]
            while k < N_QUANTILES and below * N_QUANTILES >= k + 0.5:
                width_m[t, k] = math.exp(_LOG_NARROWEST + _STEP * j)
                k += 1
        n = _without_doubles(lines_m[t])
        if n > 0 and _compare_gaps(lines_m[t], n, pairs, counts, support):
            _weigh_widths(steady, wandering, counts, predicted, support)
    return width_m


@kernel(no_cpython_wrapper=True)
def _predict_steady(
    steady: FloatArray, prior: FloatArray, kept: FloatArray, predicted: FloatArray
) -> None:
    """Predict the belief in a steady width; fill `predicted`, normalised.

    - kept: factor of each width
    """
    n_widths = len(prior)
    predicted[0] = steady[0]
    predicted[-1] = steady[-1]
    for j in range(1, n_widths - 1):
        second = steady[j - 1] - 2 * steady[j] + steady[j + 1]
        predicted[j] = steady[j] + STEADY_MOVES * second
    for j in range(n_widths):
        steady[j] = (predicted[j] + ANOTHER_SCALE * (prior[j] - predicted[j])) * kept[j]
    total = 0.0
    for j in range(n_widths):
        predicted[j] = steady[j]
        total += predicted[j]
    for j in range(n_widths):
        predicted[j] /= total


@kernel(no_cpython_wrapper=True)
def _predict_wandering(
    wandering: FloatArray, steady: FloatArray, kept: FloatArray, around: FloatArray
) -> None:
    """Predict the belief in a width that wanders around a steady one.

    - steady: predicted belief in the steady width
    - kept: factor of each width
    - around: overwritten; _HALF longer on either side
    """
    n_widths = len(steady)
    for j in range(len(around)):
        around[j] = 0.0
    for j in range(n_widths):
        if steady[j] > 1e-6:
            for d in range(2 * _HALF + 1):
                around[j + d] += steady[j] * _SPREAD[d]
    left = wandering[0]
    total = 0.0
    for j in range(n_widths):
        here = wandering[j]
        right = wandering[j + 1] if j + 1 < n_widths else here
        new = here + WANDERING_MOVES * (left - 2 * here + right)
        wandering[j] = (new + RETURNS * (around[j + _HALF] - new)) * kept[j]
        total += wandering[j]
        left = here
    for j in range(n_widths):
        wandering[j] /= total


@kernel(no_cpython_wrapper=True)
def _without_doubles(lines: FloatArray) -> int:
    """Move the lines that repeat no other to the front; return their number, 0 for a single line.

    - lines: (L,) in rising order, then infinity
    """
    n = 0
    largest = 0.0
    while n < len(lines) and lines[n] < math.inf:
        if n > 0:
            largest = max(largest, lines[n] - lines[n - 1])
        n += 1
    if n < 2:
        return 0
    single = 1
    for i in range(1, n):
        if lines[i] - lines[single - 1] > DOUBLE * largest:
            lines[single] = lines[i]
            single += 1
    return single


@kernel(no_cpython_wrapper=True)
def _compare_gaps(
    lines: FloatArray, n: int, pairs: FloatArray, counts: FloatArray, support: FloatArray
) -> bool:
    """Compare the gaps between n sorted lines with every width; return whether there are any.

    - support: filled with the logarithm of the likelihood of each width
    """
    n_widths = len(pairs)
    n_table = len(_LOG_LIKELIHOOD)
    off_table = _LOG_LIKELIHOOD[0]
    for j in range(n_widths):
        pairs[j] *= KEPT_PAIRS
        support[j] = 0.0
    counts[1] *= KEPT_PAIRS
    n_gaps = 0
    for apart in (1, 2):
        for i in range(n - apart):
            gap = lines[i + apart] - lines[i]
            if gap == math.inf:
                continue
            n_gaps += 1
            if apart == 2:
                counts[1] += 1
            start = round((math.log(gap) - _LOG_NARROWEST) / _STEP) - _FIRST
            # Widths whose gap is off the table are alike.
            for j in range(max(0, start - n_table + 1), min(n_widths, start + 1)):
                support[j] += _LOG_LIKELIHOOD[start - j] - off_table
                if apart == 2:
                    pairs[j] += _IS_TWO_LANES[start - j]
    return n_gaps > 0


@kernel(no_cpython_wrapper=True)
def _weigh_widths(
    steady: FloatArray,
    wandering: FloatArray,
    counts: FloatArray,
    predicted: FloatArray,
    support: FloatArray,
) -> None:
    """Weigh both beliefs, and the probability that the scale wanders, with a frame's gaps.

    - predicted: normalised belief in a steady width
    - support: logarithm of the likelihood of each width
    """
    n_widths = len(steady)
    most = 0.0
    for j in range(n_widths):
        most = max(most, support[j])
    of_steady = 0.0
    of_wandering = 0.0
    total = 0.0
    total_wandering = 0.0
    likelihood = 0.0
    quick = 0.0
    for j in range(n_widths):
        # Most neighbours have equal gaps, and exp takes longer than the rest.
        if j == 0 or support[j] != support[j - 1]:
            likelihood = math.exp((support[j] - most) / ALIKE)
            quick = math.exp((support[j] - most) / ALIKE_WANDERING)
        of_steady += predicted[j] * quick
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
    """Return a function that gives the lateral offset in T frames, (T,): lane widths right of the
    lane's middle, -.5 to .5, NaN if unknown. It uses the frames so far, however they are grouped.

    - parameters: of any rule; those that are numbers of `lane_width_m` (expected) and `max_lri`.
    """
    given = {name: value for name, value in parameters.items() if isinstance(value, int | float)}
    max_lri = given.get("max_lri", FULL_LRI)
    width = new_belief(given.get("lane_width_m", LANE_M))
    mean = 0j
    last_s = -math.inf

    def places_of(log: LineLog) -> FloatArray:
        nonlocal mean, last_s
        with np.errstate(over="ignore"):
            lri = log.lri * FULL_LRI / max_lri
        _, is_strong = line_classes(log.offset_m, log.is_valid, log.is_continuous, lri)
        widths = follow(width, log.offset_m, is_strong)
        away = log.offset_m / widths[:, N_QUANTILES // 2, None]
        near = is_strong & (np.abs(away) < REACH)
        seen = np.exp(-2j * math.pi * away, where=near, out=np.zeros(near.shape, dtype=complex))
        place = np.full(len(log), np.nan)
        for t, time_s in enumerate(log.time_s.tolist()):
            kept = math.exp(-max(time_s - last_s, 0.0) / MEAN_S)
            mean = kept * mean - (1 - kept) * sum(seen[t].tolist())
            last_s = time_s
            if abs(mean) >= DEFINITE:
                place[t] = cmath.phase(mean) / (2 * math.pi)
        return place

    return places_of
