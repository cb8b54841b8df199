"""x in rows that are evenly spaced from the bottom to the top: CLRNet, LaneATT."""

from __future__ import annotations

import numpy as np
import scipy

from egolane_pgm.vision.detectors.networks.answers import Line, points
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.running import Outputs


def polylines(network: Network, outputs: Outputs) -> list[Line]:
    """The x of each candidate that is likely enough, from where it starts over its length."""
    assert network.first_x is not None
    assert network.start is not None
    assert network.length is not None
    width, height = network.size
    values = outputs["candidates"]
    share = scipy.special.softmax(values[:, :2], axis=1)[:, 1]
    x_scale = 1.0 if network.in_pixels else width - 1
    steps = values.shape[1] - network.first_x - 1
    v = np.linspace(1, 0, steps + 1) * (height - 1)
    lines = []
    for k in np.flatnonzero(share >= network.threshold):
        line = values[k]
        first = int(np.clip(round(line[network.start] * steps), 0, steps))
        n = round(line[network.length] * (1 if network.in_pixels else steps))
        there = slice(first, first + max(n, 0))
        lines.append(Line(points(line[network.first_x :][there] * x_scale, v[there]), share[k]))
    return lines
