"""The lane from GNSS alone: how far the car is from the middle of its road.

A receiver's error across the road is a metre of noise and a drift of metres that lasts for
minutes, to which the map adds its own. The drift is therefore hidden beside the lane, and so is
whether the map has the right number of lanes. What tells the lane is then the car's way across the
road: there is no lane beyond the last one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.types import Evidence, FloatArray, InputError


@dataclass(frozen=True)
class GnssNoise:
    """How a receiver errs across the road, and how often cars change lanes.

    - lane_width_m
    - sigma_m: of the noise from second to second, and of the car inside its lane
    - drift_sigma_m, drift_s: standard deviation and correlation time of the drift
    - off_share: positions that say nothing: between lanes, off the road, reflected
    - change: P(change to the lane at the left), and to that at the right, per second
    - count_wrong: P(the map has a lane too few or too many), both equally likely
    - count_stays: P(the map stays as right or wrong as it is), per second
    """

    lane_width_m: float = 3.5
    sigma_m: float = 1.0
    drift_sigma_m: float = 2.0
    drift_s: float = 300.0
    off_share: float = 0.05
    change: float = 0.02
    count_wrong: float = 0.1
    count_stays: float = 0.999


#: The drift's cells: so many, of this width in metres, around 0.
_CELLS, _CELL_M = 33, 0.5

#: Positions that say nothing are anywhere in this width, metres.
_ANYWHERE_M = 50.0


@dataclass(frozen=True)
class GnssLanes:
    """What T offsets say of the lane.

    - lane (T, n + 1): P(lane), of the map's n lanes from the left and of one more
    - fewer, more (T,): P(the road has fewer lanes than the map says), and more
    """

    lane: FloatArray
    fewer: FloatArray
    more: FloatArray


def lanes_from_offsets(
    offset_m: FloatArray, n_lanes: int, noise: GnssNoise | None = None, *, smooth: bool = False
) -> GnssLanes:
    """The lane of a car on a road of n lanes by the map, second by second.

    - offset_m (T,): metres to the right of the middle of the road's lanes, one a second; NaN
      unknown
    - smooth: each second knows all the others; by default those before only

    Raises InputError for fewer than one lane.
    """
    if n_lanes < 1:
        raise InputError(f"n_lanes: {n_lanes} is less than 1")
    noise = noise or GnssNoise()
    compiled = _network(n_lanes, noise)
    seen = Evidence({("Lane", "Drift"): _likelihood(offset_m, n_lanes, noise)})
    beliefs = smooth_beliefs(compiled, seen) if smooth else filter_beliefs(compiled, seen, "exact")
    count = beliefs.marginals["Count"]
    return GnssLanes(beliefs.lane, count[:, 0], count[:, 2])


def _drifts() -> FloatArray:
    return np.asarray((np.arange(_CELLS) - _CELLS // 2) * _CELL_M, dtype=np.float64)


def _likelihood(offset_m: FloatArray, n_lanes: int, noise: GnssNoise) -> FloatArray:
    """P(offset | lane, drift), (T, n + 1, cells)."""
    centre = (np.arange(n_lanes + 1) - (n_lanes - 1) / 2) * noise.lane_width_m
    z = (offset_m[:, None, None] - centre[:, None] - _drifts()) / noise.sigma_m
    density = np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * noise.sigma_m)
    said = (1 - noise.off_share) * density + noise.off_share / _ANYWHERE_M
    return np.where(np.isnan(said), 1.0, said)


def _network(n_lanes: int, noise: GnssNoise) -> Compiled:
    """Count is 0, 1 or 2: a lane fewer than the map's, as many, one more. Lane moves to neighbours
    that there are; Drift wanders about 0."""
    wrong = noise.count_wrong / 2
    fewer = wrong if n_lanes > 1 else 0.0
    stays, goes = noise.count_stays, 1 - noise.count_stays
    counts = np.array([[stays, goes, 0.0], [goes / 2, stays, goes / 2], [0.0, goes, stays]])
    if n_lanes == 1:
        counts[1] = [0.0, stays, goes]
    size = n_lanes + 1
    first, lane = np.zeros((3, size)), np.zeros((size, 3, size))
    for count in range(3):
        n = max(n_lanes - 1 + count, 1)
        first[count, :n] = 1 / n
        for here in range(size):
            # The lane beyond the last one is the last one.
            at = min(here, n - 1)
            for there in (at - 1, at + 1):
                if 0 <= there < n:
                    lane[here, count, there] = noise.change
            lane[here, count, at] = 1 - lane[here, count].sum()
    drift = _drifts()
    start = np.exp(-0.5 * (drift / noise.drift_sigma_m) ** 2)
    # Steps to the neighbouring cells whose size is the drift's, and which leave `start` as it is
    # (Metropolis). Wider steps would let the drift follow a lane change.
    step = min(noise.drift_sigma_m**2 / noise.drift_s / _CELL_M**2, 0.5)
    up = step * np.minimum(1.0, start[1:] / start[:-1])
    down = step * np.minimum(1.0, start[:-1] / start[1:])
    wander = np.diag(up, 1) + np.diag(down, -1)
    wander += np.diag(1 - wander.sum(axis=1))
    network = declare(
        [
            *prior("Count", [fewer, 1 - fewer - wrong, wrong]),
            *dynamics("Count", [previous("Count")], counts),
            *prior("Lane", first, ["Count"]),
            *dynamics("Lane", [previous("Lane"), "Count"], lane),
            *prior("Drift", start / start.sum()),
            *dynamics("Drift", [previous("Drift")], wander),
        ],
        [("Lane", "Drift")],
    )
    return compile(network, hidden=("Lane", "Drift", "Count"), observed=[("Lane", "Drift")])
