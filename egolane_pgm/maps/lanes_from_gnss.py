"""The lane from GNSS: how far the car is from the edge or the middle of its road.

A receiver's error across the road, that of the map's line included, is metres that last: it wanders
slowly, and jumps where the line is drawn elsewhere from the next way on. So this drift is a hidden
node in addition to the lane. The lines give it while they tell the lane; where they do not, the
position less the drift gives the lane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from egolane_pgm.experiment import Gnss
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import state_likelihood
from egolane_pgm.inference.layout import joint_input
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import Evidence, FloatArray, IntArray, LineLog

#: A position counts in a frame that is at most this many seconds later.
_LATE_S = 0.5


@dataclass(frozen=True)
class Across:
    """Where positions put a car across its road in T frames.

    - metres (T,): from the left edge of its lanes; NaN in frames without a position
    - sigma_m (T,): the receiver's own standard deviation; NaN where it gives none
    """

    metres: FloatArray
    sigma_m: FloatArray


def across(table: RoadTable, time_s: FloatArray, n_lanes: IntArray, lane_width_m: float) -> Across:
    """The positions of a road table, each in the first frame that is not before it.

    - time_s (T,): of the frames, by the table's clock
    - n_lanes (T,): lanes of the road in each frame. Where the map has another number, or does not
      say where its line lies, that is taken to be the middle of the road.
    """
    metres, sigma = np.full(len(time_s), np.nan), np.full(len(time_s), np.nan)
    frame = np.searchsorted(time_s, table.t_s)
    # Of several positions in a frame the last one counts; one of a pause in the lines does not.
    rows = np.flatnonzero((frame < len(time_s)) & np.isfinite(table.offset_m))
    rows = rows[time_s[frame[rows]] - table.t_s[rows] < _LATE_S]
    frame = frame[rows]
    line = table.way_line[rows]
    is_told = np.isfinite(line) & (table.n_lanes[rows] == n_lanes[frame])
    line = np.where(is_told, line, n_lanes[frame] / 2)
    metres[frame] = table.offset_m[rows] + line * lane_width_m
    sigma[frame] = table.sigma_m[rows]
    return Across(metres, sigma)


#: Positions that say nothing are anywhere in this width, metres.
_ANYWHERE_M = 50.0


#: The drift is drawn anew, for a jump, once in so many seconds on average.
_JUMP_S = 100.0


def _drifts(noise: Gnss) -> FloatArray:
    """The cells of the drift (D,), metres: as wide as the noise, to four standard deviations on
    either side."""
    half = int(np.ceil(4 * noise.drift_sigma_m / noise.sigma_m))
    return np.asarray(np.arange(-half, half + 1) * noise.sigma_m)


def _wander(noise: Gnss) -> tuple[FloatArray, FloatArray]:
    """The drift's first distribution (D,), which it keeps, and its rates (D, D) of going from cell
    to cell in a second: to the neighbours only, with the steps of a Gauss-Markov process
    (Metropolis). Wider steps would let the drift follow a lane change."""
    drift = _drifts(noise)
    start = np.exp(-0.5 * (drift / max(noise.drift_sigma_m, 1e-9)) ** 2)
    rate = (noise.drift_sigma_m / noise.sigma_m) ** 2 / noise.drift_s
    rates = np.diag(rate * np.minimum(1.0, start[1:] / start[:-1]), 1)
    rates += np.diag(rate * np.minimum(1.0, start[:-1] / start[1:]), -1)
    return start / start.sum(), rates - np.diag(rates.sum(axis=1))


def _density(off_m: FloatArray, sigma_m: float, noise: Gnss) -> FloatArray:
    """The likelihood of a position at some distance from where it should be."""
    density = np.exp(-0.5 * (off_m / sigma_m) ** 2) / (np.sqrt(2 * np.pi) * sigma_m)
    return np.asarray((1 - noise.off_share) * density + noise.off_share / _ANYWHERE_M)


def beside_lines(
    compiled: Compiled, lines: Evidence, node: str, log: LineLog, seen: Across, noise: Gnss
) -> FloatArray:
    """The likelihood of the place across the road given positions, in addition to the lines:
    (T, K), its largest 1; 1 everywhere in frames without a position.

    - lines: the evidence of the T frames of the log without the positions
    - node: the place, of K values from the left edge of the road to the right one of its widest

    It is P(position | place, the lines so far and the positions before), by the exact filter of the
    network with the drift as one more node: beside lines, a bias that lasts is evidence of the lane
    once, not with each position anew.
    """
    index, likelihood = joint_input(compiled, lines), state_likelihood(compiled, lines)
    place, size = compiled.node_value[node], compiled.cardinality[node]
    of_place = (place == np.arange(size)[:, None]).astype(np.float64)
    cells = size // compiled.cardinality["Lane"]
    centre = (np.arange(size) + 0.5) * noise.lane_width_m / cells
    usual = np.hypot(noise.sigma_m, noise.drift_sigma_m)
    # A receiver that says so is less sure than usual.
    worse = np.maximum(np.nan_to_num(seen.sigma_m) ** 2 - usual**2, 0.0)
    sigma = np.sqrt(noise.sigma_m**2 + worse)
    drift, (start, rates) = _drifts(noise), _wander(noise)
    moves: dict[float, FloatArray] = {}
    joint = np.outer(compiled.prior[index[0]], start)
    said = np.ones((len(log), size))
    time_s, has_lines = log.time_s, np.asarray(log.is_valid.any(axis=1))
    last: float | None = None
    for t in range(len(log)):
        if t > 0:
            joint = compiled.transition[index[t]].T @ joint
        given = joint * likelihood[t][:, None]
        total = given.sum()
        joint = given / total if total > 0 else joint / joint.sum()
        if not np.isfinite(seen.metres[t]):
            continue
        if last is not None:
            seconds = round(float(time_s[t]) - last, 1)
            if seconds not in moves:
                stays = np.exp(-seconds / _JUMP_S)
                moves[seconds] = stays * expm(rates * seconds) + (1 - stays) * start
            joint = joint @ moves[seconds]
        last = float(time_s[t])
        density = _density(seen.metres[t] - centre[:, None] - drift, float(sigma[t]), noise)
        here = of_place @ joint
        # A place that is impossible so far has the drift's first distribution.
        here = np.where(here.sum(axis=1, keepdims=True) > 0, here, start)
        by_place = (here * density).sum(axis=1) / here.sum(axis=1)
        said[t] = by_place / by_place.max()
        given = joint * density[place]
        # An unseen car may change lanes at any time: where there are no lines, the belief about its
        # lane is no evidence of the drift.
        blind = np.outer(given.sum(axis=1), joint.sum(axis=0) * density.mean(axis=0))
        joint = given if has_lines[t] else blind
    return said
