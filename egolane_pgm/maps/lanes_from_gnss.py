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

from egolane_pgm.maps.across import Across
from egolane_pgm.types import FloatArray


@dataclass(frozen=True)
class GnssNoise:
    """How a receiver errs across the road.

    - lane_width_m
    - sigma_m: of the noise from second to second, and of the car inside its lane
    - drift_sigma_m, drift_s: standard deviation and correlation time of the drift
    - off_share: positions that say nothing: between lanes, off the road, reflected
    """

    lane_width_m: float = 3.5
    sigma_m: float = 1.0
    drift_sigma_m: float = 2.0
    drift_s: float = 300.0
    off_share: float = 0.05


#: Positions that say nothing are anywhere in this width, metres.
_ANYWHERE_M = 50.0


def _drifts(noise: GnssNoise) -> FloatArray:
    """The cells of the drift (D,), metres: half as wide as the noise, to four standard deviations
    on either side."""
    width = noise.sigma_m / 2
    half = int(np.ceil(4 * noise.drift_sigma_m / width))
    return np.asarray(np.arange(-half, half + 1) * width)


def _wander(noise: GnssNoise) -> tuple[FloatArray, FloatArray]:
    """The drift's first distribution (D,), which it keeps, and its rates (D, D) of going from cell
    to cell in a second: to the neighbours only, with the steps of a Gauss-Markov process
    (Metropolis). Wider steps would let the drift follow a lane change."""
    drift = _drifts(noise)
    start = np.exp(-0.5 * (drift / max(noise.drift_sigma_m, 1e-9)) ** 2)
    rate = 4 * (noise.drift_sigma_m / noise.sigma_m) ** 2 / noise.drift_s
    rates = np.diag(rate * np.minimum(1.0, start[1:] / start[:-1]), 1)
    rates += np.diag(rate * np.minimum(1.0, start[:-1] / start[1:]), -1)
    return start / start.sum(), rates - np.diag(rates.sum(axis=1))


def _density(off_m: FloatArray, sigma_m: float, noise: GnssNoise) -> FloatArray:
    """The likelihood of a position at some distance from where it should be."""
    density = np.exp(-0.5 * (off_m / sigma_m) ** 2) / (np.sqrt(2 * np.pi) * sigma_m)
    return np.asarray((1 - noise.off_share) * density + noise.off_share / _ANYWHERE_M)


def beside_lines(
    seen: Across, time_s: FloatArray, believed: FloatArray, noise: GnssNoise, cells: int = 1
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
