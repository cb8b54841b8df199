"""Which of the marking pixels hang together well enough to belong to a line.

Contours by Suzuki and Abe's border following (`cv2.findContours`), as in section
`section:simple-line-detector` of paper.tex. What is thrown away is small, or lies across the road:
the flanks of vehicles stand up from the road and so become streaks that point at the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.detectors.simple.birdseye import BirdsEye
from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import FloatArray, IntArray


@dataclass(frozen=True)
class Strips:
    """The contours that are kept, as N runs of pixels across the road.

    row (N,): row of the view. x_m, y_m (N,): middle of the run, metres. width_m (N,).
    contour (N,): which contour it belongs to, 0 to K - 1. middle_m (K,): metres ahead of a
    contour's middle; slope (K,): its direction, metres to the right per metre ahead; slope_sd (K,):
    how well its shape tells it.
    """

    row: IntArray
    x_m: FloatArray
    y_m: FloatArray
    width_m: FloatArray
    contour: IntArray
    middle_m: FloatArray
    slope: FloatArray
    slope_sd: FloatArray


def find_strips(view: BirdsEye, mask: NDArray[np.uint8], parameters: Parameters) -> Strips:
    """The contours of a mask (R, C) that may be marking."""
    from egolane_pgm.detectors.simple.kernels import contour_runs

    borders, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not borders:
        nothing, none = np.zeros(0), np.zeros(0, dtype=np.int64)
        return Strips(none, nothing, nothing, nothing, none, nothing, nothing, nothing)
    starts = np.cumsum([0, *map(len, borders)])
    points = np.concatenate(borders)[:, 0].astype(np.int32)
    around = tree[0, :, 3]
    owner = np.where(around < 0, np.arange(len(borders)), around)
    row, left, right, contour = contour_runs(mask, points, starts, owner)
    width = (right - left + 1).astype(np.float64) * view.across_m
    x = view.x_m[row]
    y: FloatArray = view.y_m[0] + 0.5 * (left + right) * view.across_m
    area, middle, slope, slope_sd = _directions(view, x, y, width, contour, len(borders))
    keep = (area >= number(parameters, "least_area_m2")) & (
        np.abs(slope) <= number(parameters, "most_slope")
    )
    renumbered = np.cumsum(keep) - 1
    kept = keep[contour]
    return Strips(
        row[kept],
        x[kept],
        y[kept],
        width[kept],
        renumbered[contour[kept]],
        middle[keep],
        slope[keep],
        slope_sd[keep],
    )


def _directions(
    view: BirdsEye, x: FloatArray, y: FloatArray, width: FloatArray, contour: IntArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Area (square metres), middle (metres ahead), slope and its uncertainty for each of `count`
    contours: the line through the middles of a contour's runs, weighted by their width."""

    def total(values: FloatArray) -> FloatArray:
        return np.bincount(contour, values, count).astype(np.float64)

    # A hole's border has no runs of its own.
    weight = np.maximum(total(width), 1e-9)
    middle = total(width * x) / weight
    x = x - middle[contour]
    y = y - (total(width * y) / weight)[contour]
    # A run is as long as a pixel, and wide: both spread.
    along = total(width * x * x) / weight + view.along_m**2 / 12
    across = total(width * (y * y + width * width / 12)) / weight
    slope = total(width * x * y) / weight / along
    spread = np.maximum(across - slope * slope * along, 0.0)
    return weight * view.along_m, middle, slope, np.sqrt(spread / along)
