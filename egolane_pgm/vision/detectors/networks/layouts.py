"""Reads the outputs of a network as its layout says, and brings what it sees onto the road.

To add a layout: its outputs in `description.OUTPUTS`, a file that reads them, and its function in
`_LINES`.

A mask is looked at from above as a picture is. Lines, which come as points, are drawn from above
into a mask, so that both are found by the same code afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.detectors.networks.anchors import hybrid_anchors, row_anchors
from egolane_pgm.vision.detectors.networks.answers import Answer, Line, points
from egolane_pgm.vision.detectors.networks.curves import beziers, lstr_curves, polynomials
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.masks import instances, mask
from egolane_pgm.vision.detectors.networks.polylines import polylines
from egolane_pgm.vision.detectors.networks.road_lines import road_lines
from egolane_pgm.vision.detectors.networks.running import Fit, Outputs
from egolane_pgm.vision.detectors.networks.segments import prototypes, queries
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look

#: The width of a line that is drawn from above, metres.
_LINE_M = 0.1

#: Fractional bits of the places that cv2.polylines draws at.
_BITS = 4

#: Points of lines that are farther ahead are left out, metres.
_FARTHEST_M = 150.0

#: The function that reads each layout with lines.
_LINES: dict[str, Callable[[Network, Outputs], list[Line]]] = {
    "instances": instances,
    "row_anchors": row_anchors,
    "hybrid_anchors": hybrid_anchors,
    "polylines": polylines,
    "prototypes": prototypes,
    "queries": queries,
    "lstr_curves": lstr_curves,
    "polynomials": polynomials,
    "beziers": beziers,
    "road_lines": road_lines,
}


def answer(network: Network, fit: Fit, outputs: Outputs) -> Answer:
    """Reads the outputs of a network."""
    if network.layout in ("drivable", "lanes"):
        return mask(network, fit, outputs)
    is_on_road = network.layout == "road_lines"
    lines = [line for line in _LINES[network.layout](network, outputs) if len(line.points) > 1]
    if network.continuous:
        lines = [line for line in lines if line.kind in network.continuous]
    if not is_on_road:
        lines = [replace(line, points=points(*fit.to_picture(*line.points.T))) for line in lines]
    return Answer(None, lines=tuple(lines), on_road=is_on_road)


def from_above(view: BirdsEye, seen: Answer) -> NDArray[np.uint8]:
    """1 where the bird's-eye view shows what the network sees, else 0; (R, C)."""
    if seen.mask is not None:
        above = (look(view, seen.mask) > 127).astype(np.uint8)
    else:
        above = np.zeros(view.valid.shape, dtype=np.uint8)
        wide = max(round(_LINE_M / view.across_m), 1)
        for line in seen.lines:
            x, y = on_road(view.camera, seen, line)
            column = (y - view.y_m[0]) / view.across_m
            row = (view.x_m[0] - x) / view.along_m
            corners = np.round(points(column, row) * 2**_BITS).astype(np.int32)
            cv2.polylines(above, [corners], False, 1, wide, cv2.LINE_8, _BITS)
    above[~view.valid] = 0
    return above


def on_road(camera: Camera, seen: Answer, line: Line) -> tuple[FloatArray, FloatArray]:
    """The points of a line on the road, x ahead and y to the right, (P,), metres."""
    x, y = line.points.T if seen.on_road else image_to_road(camera, *line.points.T)
    # What is above the horizon or much farther than a view has no place in it.
    near = np.isfinite(x) & (x > 0) & (x < _FARTHEST_M) & (np.abs(y) < 100)
    return x[near], y[near]
