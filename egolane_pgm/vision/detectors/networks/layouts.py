"""Turns the output of a network into masks or lines of the picture, and brings them onto the road.

A mask is looked at from above as a picture is. Lines, which come as points, are drawn from above
into a mask, so that both are found by the same code afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import image_to_road
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.running import Fit, Output
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look

#: The width of a line that is drawn from above, metres.
_LINE_M = 0.1

#: Fractional bits of the places that cv2.polylines draws at.
_BITS = 4


@dataclass(frozen=True)
class Answer:
    """What a network sees in a picture, in the picture's pixels.

    - mask: (H, W), 255 where it sees the area or the markings; None for a network that gives lines
    - lines: for each line its points, (P, 2), u and v
    """

    mask: Image | None
    lines: tuple[FloatArray, ...] = ()


def answer(network: Network, fit: Fit, output: Output) -> Answer:
    """Reads the output of a network."""
    if network.layout in ("drivable", "lanes"):
        return Answer(_mask(network, fit, output))
    lines = {
        "instances": _lines_of_instances,
        "row_anchors": _lines_of_row_anchors,
        "polylines": _lines_of_polylines,
    }[network.layout](network, output)
    return Answer(
        None, tuple(np.stack(fit.to_picture(u, v), axis=1) for u, v in lines if len(u) > 1)
    )


def from_above(view: BirdsEye, seen: Answer) -> NDArray[np.uint8]:
    """1 where the bird's-eye view shows what the network sees, else 0; (R, C)."""
    if seen.mask is not None:
        above = (look(view, seen.mask) > 127).astype(np.uint8)
    else:
        above = np.zeros(view.valid.shape, dtype=np.uint8)
        wide = max(round(_LINE_M / view.across_m), 1)
        for line in seen.lines:
            x, y = image_to_road(view.camera, line[:, 0], line[:, 1])
            # What is above the horizon or much farther than the view has no place in it.
            near = np.isfinite(x) & (x > 0) & (x < 4 * view.x_m[0]) & (np.abs(y) < 100)
            column = (y[near] - view.y_m[0]) / view.across_m
            row = (view.x_m[0] - x[near]) / view.along_m
            points = np.round(np.stack([column, row], axis=1) * 2**_BITS).astype(np.int32)
            cv2.polylines(above, [points], False, 1, wide, cv2.LINE_8, _BITS)
    above[~view.valid] = 0
    return above


def probabilities(network: Network, output: Output) -> NDArray[np.float32]:
    """The probabilities (K, h, w) of the channels that are looked at."""
    if network.activation == "softmax":
        output = scipy.special.softmax(output, axis=0)
    elif network.activation == "sigmoid":
        output = scipy.special.expit(output)
    return output[list(network.looked_at)]


def _mask(network: Network, fit: Fit, output: Output) -> Image:
    share = probabilities(network, output).sum(axis=0)
    width, height = network.size
    if share.shape != (height, width):
        share = cv2.resize(share, (width, height), interpolation=cv2.INTER_LINEAR)
    share = share[fit.upper : fit.upper + fit.high, fit.left : fit.left + fit.wide]
    share = cv2.resize(share, (fit.width, fit.height - fit.top), interpolation=cv2.INTER_LINEAR)
    mask = np.zeros((fit.height, fit.width), dtype=np.uint8)
    mask[fit.top :] = np.where(share >= network.threshold, 255, 0)
    return mask


#: Pixels u, v of the network's input.
_Points = tuple[FloatArray, FloatArray]


def _lines_of_instances(network: Network, output: Output) -> list[_Points]:
    """For each channel, the weighted middle of its pixels above the threshold, row by row."""
    lines = []
    for share in probabilities(network, output):
        weight = np.where(share >= network.threshold, share, 0).astype(np.float64)
        total = weight.sum(axis=1)
        rows = np.flatnonzero(total)
        middle = (weight[rows] @ np.arange(weight.shape[1])) / total[rows]
        across, down = network.size[0] / weight.shape[1], network.size[1] / weight.shape[0]
        lines.append(((middle + 0.5) * across - 0.5, (rows + 0.5) * down - 0.5))
    return lines


def _lines_of_row_anchors(network: Network, output: Output) -> list[_Points]:
    """The expected column in each row where the likeliest class is not "no line" (Ultra-Fast-Lane-
    Detection, equation 5 of its paper). A column is as wide as the input over columns - 1."""
    n_columns = output.shape[0] - 1
    share = scipy.special.softmax(output[:-1].astype(np.float64), axis=0)
    column = np.tensordot(np.arange(n_columns), share, axes=1)
    u = (column + 0.5) * (network.size[0] - 1) / (n_columns - 1)
    is_there = output.argmax(axis=0) < n_columns
    rows = np.asarray(network.rows)
    return [(u[there, k], rows[there]) for k, there in enumerate(is_there.T)]


def _lines_of_polylines(network: Network, output: Output) -> list[_Points]:
    """The x of each candidate that is likely enough, from where it starts over its length."""
    assert network.first_x is not None
    assert network.start is not None
    assert network.length is not None
    width, height = network.size
    values = output.astype(np.float64)
    likely = scipy.special.softmax(values[:, :2], axis=1)[:, 1] >= network.threshold
    x_scale = 1.0 if network.in_pixels else width - 1
    steps = values.shape[1] - network.first_x - 1
    v = np.linspace(1, 0, steps + 1) * (height - 1)
    lines = []
    for line in values[likely]:
        first = int(np.clip(round(line[network.start] * steps), 0, steps))
        n = round(line[network.length] * (1 if network.in_pixels else steps))
        there = slice(first, first + max(n, 0))
        lines.append((line[network.first_x :][there] * x_scale, v[there]))
    return lines
