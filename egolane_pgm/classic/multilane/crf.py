"""Which seeds belong to one line: pairs beyond doubt are joined first, then a conditional random
field decides about the others.

Each candidate link from one seed to another one below it is a node with two states, on or off.
Links that share a seed, directly or through others, are one group, and each group is solved alone.
With the unary probability u of a link and the quality c of the curves that the links make, the
energy of a group's assignment is

    E = sum over links of (-u if on, else -(1 - u)) + (-c if any link is on, else -1/2)

A seed has at most one link from above and one from below. c = exp(-(MSE / 50)^2) of a cubic
through the markings of a chain of linked seeds, for the worst chain of the group. At 1/2 a curve is
as likely wrong as right, so assignments with a worse one are not considered; all off always is.

The last step of the public code, which merges linked seeds, reads the label of a wrong link. That
is mended here: each link is merged by its own label.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import expit

from egolane_pgm.classic.multilane.markings import Markings, grouped
from egolane_pgm.classic.multilane.road import Road
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Largest distance error of a candidate link, the sum over both its ends, pixels.
FARTHEST = 65.0

#: Largest direction error of a candidate link, the sum over both its ends, degrees.
STEEPEST = 80.0

#: The unary probability of a link with errors x (pixels) and y (degrees) is the logistic function
#: of a x^2 + b x y + c y^2 + d x + e y + f.
UNARY = (0.000140047, 0.001069285, -0.000263005, -0.283444141, -0.255786389, 24.86101278)

#: The mean squared error at which a curve's quality is exp(-1), square pixels.
SPREAD = 50.0

#: A link is certain if exp(-d^2), added up over both its ends, is more than this and no other link
#: of either seed reaches it.
CERTAIN = 1.96

#: The error for which d = 1, pixels.
CERTAIN_PX = 20.0

#: Number of markings at an end of a seed that give its direction there.
END = 30


@dataclass(frozen=True)
class Links:
    """The K candidate links.

    - above, below: (K,) the seeds
    - apart: (K, 2) how far the extrapolation of either seed misses the other, pixels
    - turn: (K,) degrees, the angles between the link and both seeds
    """

    above: IntArray
    below: IntArray
    apart: FloatArray
    turn: FloatArray

    def __len__(self) -> int:
        return len(self.above)


def join_seeds(markings: Markings, road: Road, exact_up_to: int) -> Markings:
    """The same markings, with all seeds of one line joined to one.

    - exact_up_to: groups of at most this many links are solved exactly, larger ones as published
    """
    scale = road.scale
    for _ in range(2):
        links = candidate_links(markings, road)
        markings = merged(markings, links, certain(links, scale))
    links = candidate_links(markings, road)
    probability = unary(links, scale)
    sums = power_sums(markings, scale)
    is_on = probability > 0.5
    for of in groups_of(links, len(sums)):
        if len(of) > 1:
            solve = least_energy if len(of) <= exact_up_to else forced_in_turn
            is_on[of] = solve(links.above[of], links.below[of], probability[of], sums)
    return merged(markings, links, is_on)


def candidate_links(markings: Markings, road: Road) -> Links:
    """Return all pairs of seeds that might belong to one line, by the two gates."""
    end = max(2, round(END * road.row_scale))
    return Links(*pairs(markings.row, markings.u, markings.starts, end, FARTHEST * road.scale))


def certain(links: Links, scale: float) -> BoolArray:
    """Mark the links, (K,), that are certain: good, and the only good one of both seeds."""
    good = np.exp(-((links.apart / (CERTAIN_PX * scale)) ** 2)).sum(axis=1) > CERTAIN
    n_above = np.bincount(links.above[good], minlength=links.above.max(initial=-1) + 1)
    n_below = np.bincount(links.below[good], minlength=links.below.max(initial=-1) + 1)
    sure: BoolArray = good & (n_above[links.above] == 1) & (n_below[links.below] == 1)
    return sure


def unary(links: Links, scale: float) -> FloatArray:
    """The probability (K,) of each link alone."""
    a, b, c, d, e, f = UNARY
    x = links.apart.sum(axis=1) / scale
    y = links.turn
    exponent = a * x * x + b * x * y + c * y * y + d * x + e * y + f
    return np.asarray(expit(exponent))


def power_sums(markings: Markings, scale: float) -> FloatArray:
    """(S, 12): of each seed the sums of t^0 to t^6, u t^0 to u t^3 and u^2 over its markings, from
    which a cubic of any chain follows. t is the row, scaled to -1 to 1, u the column, pixels."""
    if not len(markings):
        return np.zeros((0, 12))
    middle = (markings.row.min() + markings.row.max()) / 2
    t = (markings.row - middle) / max(1.0, markings.row.max() - middle)
    u = (markings.u - markings.u.mean()) / scale
    powers = t[:, None] ** np.arange(7)
    each = np.concatenate([powers, u[:, None] * powers[:, :4], (u * u)[:, None]], axis=1)
    sums: FloatArray = np.add.reduceat(each, markings.starts[:-1], axis=0)
    return sums


def groups_of(links: Links, n_seeds: int) -> list[IntArray]:
    """The groups: which links are in each."""
    if not len(links):
        return []
    group = _lines_of(links.above, links.below, n_seeds)[links.above]
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def merged(markings: Markings, links: Links, is_on: BoolArray) -> Markings:
    """The markings with the seeds of each link that is on joined."""
    if not is_on.any():
        return markings
    line = _lines_of(links.above[is_on], links.below[is_on], len(markings))
    return grouped(markings.row, markings.left, markings.right, line[markings.seed])


def _lines_of(above: IntArray, below: IntArray, n_seeds: int) -> IntArray:
    """The line, (S,), of each seed, if the seeds above and below, (K,) each, belong together."""
    graph = coo_array((np.ones(len(above)), (above, below)), shape=(n_seeds, n_seeds))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


@kernel()
def pairs(
    row: FloatArray, u: FloatArray, starts: IntArray, end: int, farthest: float
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """The fields of Links.

    - row, u: (N,) the markings of S seeds, top to bottom in each
    - starts: (S + 1,) where each seed begins, and N
    - end: number of markings at an end of a seed that give its direction
    - farthest: the first gate, pixels
    """
    n_seeds = len(starts) - 1
    # For each seed: row, column and slope at its head (0) and tail (1).
    place = np.empty((n_seeds, 2, 3))
    for s in range(n_seeds):
        for tail in range(2):
            first = starts[s]
            stop = starts[s + 1]
            if tail:
                first = max(first, stop - end)
            else:
                stop = min(stop, first + end)
            n = stop - first
            v_mean = row[first:stop].mean()
            u_mean = u[first:stop].mean()
            vv = 1e-9
            vu = 0.0
            for i in range(first, stop):
                vv += (row[i] - v_mean) ** 2
                vu += (row[i] - v_mean) * (u[i] - u_mean)
            at = row[first + n - 1] if tail else row[first]
            place[s, tail, 0] = at
            place[s, tail, 1] = u_mean + vu / vv * (at - v_mean)
            place[s, tail, 2] = vu / vv
    above = np.empty(n_seeds * n_seeds, dtype=np.int64)
    below = np.empty(n_seeds * n_seeds, dtype=np.int64)
    apart = np.empty((n_seeds * n_seeds, 2))
    turn = np.empty(n_seeds * n_seeds)
    k = 0
    for i in range(n_seeds):
        for j in range(n_seeds):
            down = place[j, 0, 0] - place[i, 1, 0]
            if down <= 0.0:
                continue
            across = place[j, 0, 1] - place[i, 1, 1]
            miss_above = abs(across - place[i, 1, 2] * down)
            miss_below = abs(across - place[j, 0, 2] * down)
            if miss_above + miss_below > farthest:
                continue
            lean = math.atan2(across, down)
            angles = abs(lean - math.atan(place[i, 1, 2])) + abs(lean - math.atan(place[j, 0, 2]))
            if math.degrees(angles) > STEEPEST:
                continue
            above[k] = i
            below[k] = j
            apart[k, 0] = miss_above
            apart[k, 1] = miss_below
            turn[k] = math.degrees(angles)
            k += 1
    return above[:k].copy(), below[:k].copy(), apart[:k].copy(), turn[:k].copy()


# --- the energy of a group, and its least --------------------------------------------------------


@kernel()
def curve_quality(sums: FloatArray) -> float:
    """exp(-(MSE / 50)^2) of the cubic through some markings, from their `power_sums` (12,)."""
    a = np.empty((4, 5))
    for i in range(4):
        for j in range(4):
            a[i, j] = sums[i + j]
        # Very short curves need this: their powers of t are nearly the same.
        a[i, i] += 1e-9 * sums[0]
        a[i, 4] = sums[7 + i]
    # Gauss without pivots: the matrix is positive definite.
    for i in range(4):
        for r in range(i + 1, 4):
            factor = a[r, i] / a[i, i]
            for j in range(i, 5):
                a[r, j] -= factor * a[i, j]
    explained = 0.0
    for i in range(4):
        explained += a[i, 4] * a[i, 4] / a[i, i]
    error = max(0.0, sums[11] - explained) / sums[0]
    return math.exp(-((error / SPREAD) ** 2))


@kernel()
def energy(
    is_on: BoolArray,
    above: IntArray,
    below: IntArray,
    probability: FloatArray,
    sums: FloatArray,
) -> float:
    """The energy of an assignment, (K,), of a group's links; infinite if it is not considered.

    - above, below, probability: (K,) the seeds of each link, and `unary`
    - sums: (S, 12) `power_sums`
    """
    n_links = len(above)
    n_seeds = len(sums)
    down = np.full(n_seeds, -1, dtype=np.int64)
    has_above = np.zeros(n_seeds, dtype=np.bool_)
    total = 0.0
    any_on = False
    for k in range(n_links):
        if not is_on[k]:
            total -= 1.0 - probability[k]
            continue
        if down[above[k]] >= 0 or has_above[below[k]]:
            return np.inf
        any_on = True
        down[above[k]] = below[k]
        has_above[below[k]] = True
        total -= probability[k]
    if not any_on:
        return total - 0.5
    worst = 1.0
    chain = np.empty(sums.shape[1])
    for k in range(n_links):
        seed = above[k]
        if not is_on[k] or has_above[seed]:
            continue
        chain[:] = sums[seed]
        while down[seed] >= 0:
            seed = down[seed]
            chain += sums[seed]
        worst = min(worst, curve_quality(chain))
    if worst < 0.5:
        return np.inf
    return total - worst


@kernel()
def forced_in_turn(
    above: IntArray, below: IntArray, probability: FloatArray, sums: FloatArray
) -> BoolArray:
    """An assignment, (K,), of small energy, as the authors find it: each link is turned on in turn,
    the others follow by their probability as far as they fit; the best of these is taken, or all
    off."""
    n_links = len(above)
    best = np.zeros(n_links, dtype=np.bool_)
    least = energy(best, above, below, probability, sums)
    order = np.argsort(-probability)
    for forced in range(n_links):
        is_on = np.zeros(n_links, dtype=np.bool_)
        from_above = np.zeros(len(sums), dtype=np.bool_)
        to_below = np.zeros(len(sums), dtype=np.bool_)
        for step in range(-1, n_links):
            k = forced if step < 0 else order[step]
            if from_above[above[k]] or to_below[below[k]] or (step >= 0 and probability[k] <= 0.5):
                continue
            is_on[k] = True
            from_above[above[k]] = True
            to_below[below[k]] = True
        here = energy(is_on, above, below, probability, sums)
        if here < least:
            best = is_on
            least = here
    return best


@kernel()
def least_energy(
    above: IntArray, below: IntArray, probability: FloatArray, sums: FloatArray
) -> BoolArray:
    """The assignment, (K,), of least energy, by trying all of them."""
    n_links = len(above)
    best = np.zeros(n_links, dtype=np.bool_)
    least = energy(best, above, below, probability, sums)
    is_on = np.zeros(n_links, dtype=np.bool_)
    for number in range(1, 1 << n_links):
        for k in range(n_links):
            is_on[k] = (number >> k) & 1
        here = energy(is_on, above, below, probability, sums)
        if here < least:
            best = is_on.copy()
            least = here
    return best
