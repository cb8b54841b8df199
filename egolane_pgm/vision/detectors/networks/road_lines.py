"""Lines on the road, in metres: openpilot's driving model, heads for lanes in 3D."""

from __future__ import annotations

import numpy as np

from egolane_pgm.vision.detectors.networks.answers import Line, activated, best_class, points
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.running import Outputs

#: Places with a larger standard deviation are left out, metres.
_MOST_SD_M = 0.5


def road_lines(network: Network, outputs: Outputs) -> list[Line]:
    """The lines, each with its places to the right at the distances `ahead`, that are likely
    enough: where they are sure enough (deviations are logarithms of standard deviations, as
    mixture density networks give them) and seen.

    scores: one number for each line, or its classes; with softmax, the first of these is no line.
    """
    assert network.ahead is not None
    ahead = np.array(network.ahead)
    places = outputs["places"].reshape(-1, len(ahead))
    share = activated(network, outputs["scores"].reshape(len(places), -1), 1)
    if network.activation == "softmax":
        share[:, 0] = 0
    best, kind = best_class(share)
    if network.activation == "softmax":
        best = share.sum(axis=1)
    good = np.ones(places.shape, dtype=bool)
    if "deviations" in outputs:
        good &= np.exp(outputs["deviations"].reshape(places.shape)) <= _MOST_SD_M
    if "visible" in outputs:
        good &= outputs["visible"].reshape(places.shape) >= 0.5
    kept = np.flatnonzero(best >= network.threshold)
    return [Line(points(ahead[good[k]], places[k, good[k]]), best[k], int(kind[k])) for k in kept]
