"""What a network sees in a picture, as every layout gives it, and what layouts share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.networks.description import Network


@dataclass(frozen=True)
class Line:
    """One line: its points (P, 2), its probability, and its class, None where it has none.

    A layout gives u and v, pixels of the network's input, which become pixels of the picture;
    `road_lines` gives x and y on the road, metres ahead and to the right.
    """

    points: FloatArray
    probability: float = 1.0
    kind: int | None = None


@dataclass(frozen=True)
class Answer:
    """What a network sees: a mask (H, W) of the picture, 255 where it sees the area or the
    markings; or lines, in the picture or on the road."""

    mask: Image | None
    lines: tuple[Line, ...] = ()
    on_road: bool = False


def points(u: FloatArray, v: FloatArray) -> FloatArray:
    """(P, 2) of two (P,)."""
    return np.stack([u, v], axis=1)


def activated(network: Network, output: FloatArray, axis: int) -> FloatArray:
    """Probabilities of the same shape; classes are along the axis."""
    share: FloatArray = output
    if network.activation == "softmax":
        share = scipy.special.softmax(output, axis=axis)
    elif network.activation == "sigmoid":
        share = scipy.special.expit(output)
    return share


def best_class(share: FloatArray) -> tuple[FloatArray, IntArray]:
    """The probability and the class, (N,) each, of candidates with the probabilities (N, K) of
    their classes."""
    best = share.argmax(axis=1)
    return share[np.arange(len(share)), best], best
