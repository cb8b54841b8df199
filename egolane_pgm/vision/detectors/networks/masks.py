"""Masks: of the road's free area, of all markings, or one for each line."""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.detectors.networks.answers import Answer, Line, activated, points
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.running import Fit, Outputs


def probabilities(network: Network, output: FloatArray) -> FloatArray:
    """The probabilities (K, h, w) of the channels that are looked at."""
    return activated(network, output, 0)[list(network.looked_at)]


def mask(network: Network, fit: Fit, outputs: Outputs) -> Answer:
    """The answer of a network with one mask for all lines, or for the road, which lines are part
    of."""
    masks = [probabilities(network, output).sum(axis=0) for output in outputs.values()]
    # Where it has the size already, OpenCV copies it only.
    share = np.max([cv2.resize(one, network.size) for one in masks], axis=0)
    share = share[fit.upper : fit.upper + fit.high, fit.left : fit.left + fit.wide]
    seen = np.zeros((fit.height, fit.width), dtype=np.uint8)
    lower = cv2.resize(share, (fit.width, fit.height - fit.top))
    seen[fit.top :] = np.where(lower >= network.threshold, 255, 0)
    return Answer(seen)


def instances(network: Network, outputs: Outputs) -> list[Line]:
    """The lines of a network with a mask for each, which are as probable as their pixels on
    average."""
    shares = probabilities(network, outputs["mask"])
    kinds = network.looked_at if network.continuous else (None,) * len(shares)
    seen = shares >= network.threshold
    return [
        Line(middle(network, share, network.threshold), float(share[there].mean()), kind)
        for share, there, kind in zip(shares, seen, kinds, strict=True)
        if there.any()
    ]


def middle(network: Network, share: FloatArray, least: float) -> FloatArray:
    """The weighted middle (P, 2) of a mask's (h, w) pixels with the least probability, row by row,
    in pixels of the input."""
    weight = np.where(share >= least, share, 0)
    total = weight.sum(axis=1)
    rows = np.flatnonzero(total)
    at = (weight[rows] @ np.arange(weight.shape[1])) / total[rows]
    across, down = network.size[0] / weight.shape[1], network.size[1] / weight.shape[0]
    return points((at + 0.5) * across - 0.5, (rows + 0.5) * down - 0.5)
