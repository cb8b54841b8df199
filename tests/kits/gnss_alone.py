"""The lane from GNSS alone: the car's way across the road gives the lane, because there is no lane
beyond the last one. Whether the map has the right number of lanes is hidden too.

It does not beat the lane nearest to the last position (docs/maps.md), so the package has it not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from egolane_pgm.experiment import Gnss
from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.maps.lanes_from_gnss import _density, _drifts, _wander
from egolane_pgm.types import Evidence, FloatArray


class AloneNoise(Gnss):
    """How a receiver errs across the road, and how often cars change lanes.

    - change: P(change to the lane at the left), and to that at the right, per second
    - count_wrong: P(the map has a lane too few or too many), both equally likely
    - count_stays: P(the map stays as right or wrong as it is), per second
    """

    lane_width_m: float = 3.5
    sigma_m: float = 1.0
    drift_sigma_m: float = 2.0
    drift_s: float = 300.0
    change: float = 0.02
    count_wrong: float = 0.1
    count_stays: float = 0.999


@dataclass(frozen=True)
class GnssLanes:
    """The belief over the lane from T offsets.

    - lane (T, n + 1): P(lane), of the map's n lanes from the left and of one more
    - fewer, more (T,): P(the road has fewer lanes than the map says), and more
    """

    lane: FloatArray
    fewer: FloatArray
    more: FloatArray


def lanes_from_offsets(
    offset_m: FloatArray, n_lanes: int, noise: AloneNoise | None = None, *, smooth: bool = False
) -> GnssLanes:
    """The lane of a car on a road of n lanes by the map, second by second.

    - offset_m (T,): metres to the right of the middle of the road's lanes, one a second; NaN
      unknown
    - smooth: each second knows all the others; by default those before only
    """
    noise = noise or AloneNoise()
    compiled = _network(n_lanes, noise)
    seen = Evidence({("Lane", "Drift"): _likelihood(offset_m, n_lanes, noise)})
    beliefs = smooth_beliefs(compiled, seen) if smooth else filter_beliefs(compiled, seen, "exact")
    count = beliefs.marginals["Count"]
    return GnssLanes(beliefs.lane, count[:, 0], count[:, 2])


def _likelihood(offset_m: FloatArray, n_lanes: int, noise: AloneNoise) -> FloatArray:
    """P(offset | lane, drift), (T, n + 1, D)."""
    centre = (np.arange(n_lanes + 1) - (n_lanes - 1) / 2) * noise.lane_width_m
    off = offset_m[:, None, None] - centre[:, None] - _drifts(noise)
    said = _density(off, noise.sigma_m, noise)
    return np.where(np.isnan(said), 1.0, said)


def _network(n_lanes: int, noise: AloneNoise) -> Compiled:
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
    start, rates = _wander(noise)
    network = declare(
        [
            *prior("Count", [fewer, 1 - fewer - wrong, wrong]),
            *dynamics("Count", [previous("Count")], counts),
            *prior("Lane", first, ["Count"]),
            *dynamics("Lane", [previous("Lane"), "Count"], lane),
            *prior("Drift", start),
            *dynamics("Drift", [previous("Drift")], expm(rates)),
        ],
        [("Lane", "Drift")],
    )
    return compile(network, hidden=("Lane", "Drift", "Count"), observed=[("Lane", "Drift")])
