"""Group marking pixels into contours, and keep those that may belong to a line.

A contour (paper, section `section:simple-line-detector`) is a connected set of pixels. Small
contours are dropped, and so are those that run across the road, such as the flanks of vehicles,
which are upright and so point at the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye

#: Area of the smallest contour that is kept, square metres.
_LEAST_AREA_M2 = 0.04

#: Largest slope of a contour, metres to the side per metre ahead.
_MOST_SLOPE = 0.35


@dataclass(frozen=True)
class Strips:
    """K contours, cut into N runs of pixels across the road.

    - row: (N,) the run's row in the view
    - x_m, y_m: (N,) middle of the run, metres
    - width_m: (N,) width of the run, weighted by the values of its pixels over the mean of all
    - contour: (N,) the contour that the run belongs to, 0 to K - 1
    - middle_m: (K,) middle of the contour, metres ahead
    - slope: (K,) direction of the contour, metres to the right per metre ahead
    - slope_sd: (K,) standard deviation of the slope, from the contour's shape
    """

    row: IntArray
    x_m: FloatArray
    y_m: FloatArray
    width_m: FloatArray
    contour: IntArray
    middle_m: FloatArray
    slope: FloatArray
    slope_sd: FloatArray


def find_strips(view: BirdsEye, mask: NDArray[np.uint8]) -> Strips:
    """Find the contours of a mask (R, C) of marking, whose values are the weights of its pixels."""
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    count -= 1
    # Runs of pixels that are not 0 along the rows.
    n_columns = mask.shape[1]
    flat = np.flatnonzero(mask)
    first = np.flatnonzero((np.diff(flat, prepend=-2) != 1) | (flat % n_columns == 0))
    row, left = np.divmod(flat[first], n_columns)
    right = flat[np.append(first[1:], len(flat)) - 1] % n_columns if count else left
    total = np.add.reduceat(mask.ravel()[flat], first, dtype=np.int64) if count else left
    contour = labels[row, left].astype(np.int64) - 1
    pixels = right - left + 1
    width = total * (view.across_m * pixels.sum() / max(total.sum(), 1))
    x = view.x_m[row]
    y: FloatArray = view.y_m[0] + 0.5 * (left + right) * view.across_m

    def total_of(values: FloatArray) -> FloatArray:
        return np.bincount(contour, values, count).astype(np.float64)

    area = total_of(pixels) * (view.across_m * view.along_m)
    # A line through the middles of each contour's runs, weighted by their width.
    weight = total_of(width)
    middle = total_of(width * x) / weight
    away_x = x - middle[contour]
    away_y = y - (total_of(width * y) / weight)[contour]
    # A run is one pixel long and has a width; both add to the spread (a uniform's variance).
    along = total_of(width * away_x * away_x) / weight + view.along_m**2 / 12
    across = total_of(width * (away_y * away_y + width * width / 12)) / weight
    slope = total_of(width * away_x * away_y) / weight / along
    slope_sd = np.sqrt(np.maximum(across - slope * slope * along, 0.0) / along)
    keep = (area >= _LEAST_AREA_M2) & (np.abs(slope) <= _MOST_SLOPE)
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
