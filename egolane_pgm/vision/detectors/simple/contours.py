"""Groups marking pixels into contours and keeps those that may belong to a line.

The contours come from Suzuki and Abe's border following (`cv2.findContours`), as in the paper's
section `section:simple-line-detector`. Small contours are dropped, and so are those that run across
the road. The latter removes the flanks of vehicles: these stand up from the road, and so the
bird's-eye view shows them as streaks that point at the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye

#: The area of the smallest contour that is kept, square metres, and the steepest one, metres to the
#: side per metre ahead.
_LEAST_AREA_M2, _MOST_SLOPE = 0.04, 0.35


@dataclass(frozen=True)
class Strips:
    """The K contours that are kept, cut into N runs of pixels across the road.

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
    """Finds the contours of a mask (R, C) that may be marking. The mask is 0 where there is none;
    where it is larger, a pixel weighs more."""
    borders, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not borders:
        nothing, none = np.zeros(0), np.zeros(0, dtype=np.int64)
        return Strips(none, nothing, nothing, nothing, none, nothing, nothing, nothing)
    starts = np.cumsum([0, *map(len, borders)])
    points = np.concatenate(borders)[:, 0].astype(np.int32)
    around = tree[0, :, 3]
    owner = np.where(around < 0, np.arange(len(borders)), around)
    row, left, right, contour, total = _runs(mask, points, starts, owner)
    pixels = right - left + 1
    width = total * (view.across_m * pixels.sum() / total.sum())
    area = np.bincount(contour, pixels, len(borders)) * (view.across_m * view.along_m)
    x = view.x_m[row]
    y: FloatArray = view.y_m[0] + 0.5 * (left + right) * view.across_m
    middle, slope, slope_sd = _directions(view, x, y, width, contour, len(borders))
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


def _runs(
    mask: NDArray[np.uint8], points: NDArray[np.int32], starts: IntArray, owner: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray, IntArray]:
    """The N runs along the rows of a mask's pixels that are not 0: row, first and last column,
    contour, and the sum of the pixels, (N,) each.

    - mask: (R, C)
    - points: (P, 2) column and row of the points of all borders, one border after the other
    - starts: (B + 1,) where each border begins in `points`, and P
    - owner: (B,) the contour of each border; for the border of a hole, the contour around it
    """
    n_columns = mask.shape[1]
    flat = np.flatnonzero(mask)
    is_first = np.diff(flat, prepend=-2) != 1
    is_first |= flat % n_columns == 0
    first = np.flatnonzero(is_first)
    last = np.append(first[1:], len(flat)) - 1
    # A run begins on a border.
    border = np.empty(mask.shape, dtype=np.int32)
    border[points[:, 1], points[:, 0]] = np.repeat(owner, np.diff(starts))
    row, left = np.divmod(flat[first], n_columns)
    total = np.add.reduceat(mask.ravel()[flat], first, dtype=np.int64)
    return row, left, flat[last] % n_columns, border[row, left].astype(np.int64), total


def _directions(
    view: BirdsEye, x: FloatArray, y: FloatArray, width: FloatArray, contour: IntArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fits a line through the middles of each contour's runs, weighted by their width. Gives the
    middle (metres ahead), slope and slope's standard deviation, (count,) each."""

    def total(values: FloatArray) -> FloatArray:
        return np.bincount(contour, values, count).astype(np.float64)

    # The border of a hole has no runs of its own, so its weight would be 0.
    weight = np.maximum(total(width), 1e-9)
    middle = total(width * x) / weight
    x = x - middle[contour]
    y = y - (total(width * y) / weight)[contour]
    # A run is one pixel long and has a width; both add to the spread (a uniform's variance).
    along = total(width * x * x) / weight + view.along_m**2 / 12
    across = total(width * (y * y + width * width / 12)) / weight
    slope = total(width * x * y) / weight / along
    spread = np.maximum(across - slope * slope * along, 0.0)
    return middle, slope, np.sqrt(spread / along)
