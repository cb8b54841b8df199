"""The lane from GNSS: how far the car is from the edge or the middle of its road.

A receiver's error across the road is a metre of noise and a drift of metres that lasts, to which
the map adds its own. Positions that follow each other err alike, so the drift is a hidden node in
addition to the lane. The lines give the drift while they are seen; where they are not, the position
less the drift gives the lane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from egolane_pgm.experiment import Gnss
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import FloatArray, IntArray

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


def _drifts(noise: Gnss) -> FloatArray:
    """The cells of the drift (D,), metres: half as wide as the noise, to four standard deviations
    on either side."""
    width = noise.sigma_m / 2
    half = int(np.ceil(4 * noise.drift_sigma_m / width))
    return np.asarray(np.arange(-half, half + 1) * width)


def _wander(noise: Gnss) -> tuple[FloatArray, FloatArray]:
    """The drift's first distribution (D,), which it keeps, and its rates (D, D) of going from cell
    to cell in a second: to the neighbours only, with the steps of a Gauss-Markov process
    (Metropolis). Wider steps would let the drift follow a lane change."""
    drift = _drifts(noise)
    start = np.exp(-0.5 * (drift / max(noise.drift_sigma_m, 1e-9)) ** 2)
    rate = 4 * (noise.drift_sigma_m / noise.sigma_m) ** 2 / noise.drift_s
    rates = np.diag(rate * np.minimum(1.0, start[1:] / start[:-1]), 1)
    rates += np.diag(rate * np.minimum(1.0, start[:-1] / start[1:]), -1)
    return start / start.sum(), rates - np.diag(rates.sum(axis=1))


def _density(off_m: FloatArray, sigma_m: float, noise: Gnss) -> FloatArray:
    """The likelihood of a position at some distance from where it should be."""
    density = np.exp(-0.5 * (off_m / sigma_m) ** 2) / (np.sqrt(2 * np.pi) * sigma_m)
    return np.asarray((1 - noise.off_share) * density + noise.off_share / _ANYWHERE_M)


def beside_lines(
    seen: Across, time_s: FloatArray, believed: FloatArray, noise: Gnss, cells: int = 1
) -> FloatArray:
    """The likelihood of the place across the road given positions, in addition to the lines:
    (T, K), its largest 1; 1 everywhere in frames without a position.

    - time_s (T,)
    - believed (T, K): the belief over the places by the lines alone, from the frames so far
    - cells: of each lane; with one the places are the lanes

    The likelihood of a position is a normal about each place; its variance is that of the noise
    plus that of the drift given the positions before. Then the position updates the drift, averaged
    over the belief over the places. Drift and place are taken for independent given the past, which
    is exact where the lines are sure.
    """
    drift = _drifts(noise)
    chance, rates = _wander(noise)
    centre = (np.arange(believed.shape[1]) + 0.5) * noise.lane_width_m / cells
    said = np.ones(believed.shape)
    usual = np.hypot(noise.sigma_m, noise.drift_sigma_m)
    # A receiver that says so is less sure than usual.
    worse = np.maximum(np.nan_to_num(seen.sigma_m) ** 2 - usual**2, 0.0)
    sigma = np.sqrt(noise.sigma_m**2 + worse)
    moves: dict[float, FloatArray] = {}
    last: float | None = None
    for t in np.flatnonzero(np.isfinite(seen.metres)):
        if last is not None:
            seconds = round(float(time_s[t]) - last, 1)
            if seconds not in moves:
                moves[seconds] = expm(rates * seconds)
            chance = chance @ moves[seconds]
        last = float(time_s[t])
        density = _density(seen.metres[t] - centre[:, None] - drift, float(sigma[t]), noise)
        by_place = density @ chance
        said[t] = by_place / by_place.max()
        chance = chance * (believed[t] @ density)
        chance /= chance.sum()
    return said
