"""Find vehicles in the bird's-eye view, which hide the road behind them.

The road between the wheels of a vehicle is dark, in any weather. Along a ray from the camera the
bright road ends there, and the neighbouring rays on which it ends at one distance are as wide as a
vehicle. The shade of a bridge is wider, a crack or a seam is narrower. The upright edges of a
vehicle appear as streaks that point away from the camera, so no marking is searched behind its
foot. At night the road is dark where the headlights end, so vehicles are searched by daylight only.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.camera.model import Camera, is_shown, vanishing_point
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye

#: Distance of neighbouring rays, metres to the side per metre ahead.
_RAY_STEP = 0.005

#: The outermost ray, metres to the side per metre ahead.
_RAY_MOST = 1.0
_RAYS = np.arange(-_RAY_MOST, _RAY_MOST + _RAY_STEP / 2, _RAY_STEP)

#: Growth of the distance from one sample of a ray to the next, as a picture resolves distances.
_FARTHER = 0.02

#: Dark samples of a foot, under a bumper a fifth of the camera's height above the road.
_DARK = 5

#: Samples of the shadow's edge, nearer than the dark ones.
_EDGE = 2

#: Samples of the road, nearer than the edge.
_ROAD = 8

#: The narrowest foot, metres: a motorcycle is narrower.
_NARROWEST_M = 0.8

#: The widest foot, metres: a lorry with the shadow of the low sun is about as wide as its lane.
_WIDEST_M = 4.0

#: Quantile of the brightness of the sky, partly hidden by trees and bridges.
_SKY = 0.9

#: Quantile of the brightness of the road, with vehicles on it.
_LIT = 0.75

#: Least ratio of the sky's brightness to the road's by day; above 0.7 in pictures of four cameras.
_DAYLIGHT = 0.5


def is_daylight(camera: Camera, image: Image) -> bool:
    """Return whether the sky in a picture, (H, W, 3), is about as bright as the road.

    A picture without sky counts as taken by day, one that is black all over as taken by night. The
    camera's `ignore` rectangles are left out.
    """
    horizon = max(math.floor(vanishing_point(camera)[1]), 0) // 8
    red = image[::8, ::8, 2]
    rows, columns = (8 * np.arange(n) for n in red.shape)
    shown = is_shown(camera, columns, rows[:, None])
    # The part that headlights light most: neither the bonnet nor far ahead.
    height = len(red) - horizon
    width = red.shape[1]
    middle = slice(width // 4, 3 * width // 4)
    lit = slice(horizon + height // 4, horizon + 3 * height // 4)
    sky = red[:horizon][shown[:horizon]]
    road = red[lit, middle][shown[lit, middle]]
    if not sky.size or not road.size:
        return True
    return bool(np.quantile(sky, _SKY) > _DAYLIGHT * np.quantile(road, _LIT))


def free_road(view: BirdsEye, above: Image, parameters: Parameters) -> BoolArray:
    """Return the pixels, (R, C), of a one-colour view (R, C) with no vehicle on or before them.

    With a `shadow_share` of 0 all pixels are free.
    """
    free = np.ones(above.shape, dtype=bool)
    share = number(parameters, "shadow_share")
    near = float(view.x_m[-1])
    count = int(math.log(view.x_m[0] / near) / math.log1p(_FARTHER)) + 1
    if not share or count < _DARK + _EDGE + _ROAD:
        return free
    x: FloatArray = near * np.power(1 + _FARTHER, np.arange(count, dtype=np.float64))
    # Rays begin at the camera, which may be off the vehicle's centre line.
    y = view.y_m - view.camera.lateral_m
    feet = _feet(view, above, x, float(y[0]), share)
    ends = np.full(len(_RAYS), np.inf)
    _, _, boxes, _ = cv2.connectedComponentsWithStats(feet, connectivity=8)
    for first, top, width, *_ in boxes[1:]:
        if _NARROWEST_M <= width * _RAY_STEP * x[top] <= _WIDEST_M:
            ends[first : first + width] = np.minimum(ends[first : first + width], x[top])
    if np.isfinite(ends).any():
        ray = _nearest(y / view.x_m[:, None], -_RAY_MOST, _RAY_STEP)
        # Rays beyond the outermost ones do not end.
        free = view.x_m[:, None] < np.append(ends, np.inf)[np.clip(ray, -1, len(ends))]
    return free


def _feet(view: BirdsEye, above: Image, x: FloatArray, left_m: float, share: float) -> Image:
    """Return where rays from the camera meet the dark foot of a vehicle, (K, A), as 1, else 0.

    There the mean of the next dark samples is below `share` of the mean of the road before.

    - x: (K,) metres ahead of the samples of each ray, increasing
    - left_m: lateral position of the view's first column from the camera
    """
    row = _nearest(view.x_m[0] - x, 0.0, view.along_m)[:, None]
    column = _nearest(x[:, None] * _RAYS, left_m, view.across_m)
    inside = (column >= 0) & (column < above.shape[1])
    column = np.where(inside, column, 0)
    shown = inside & view.valid[row, column]
    # Cumulative sums over each ray, beginning with 0.
    total, seen = np.zeros((2, len(x) + 1, len(_RAYS)), dtype=np.int64)
    np.cumsum(np.where(shown, above[row, column], 0), axis=0, out=total[1:])
    np.cumsum(shown, axis=0, out=seen[1:])
    before = _ROAD + _EDGE
    at = np.arange(before, len(x) - _DARK + 1)
    road = (total[at - _EDGE] - total[at - before]) / _ROAD
    dark = (total[at + _DARK] - total[at]) / _DARK
    is_known = seen[at + _DARK] - seen[at - before] == _DARK + before
    feet = np.zeros((len(x), len(_RAYS)), dtype=np.uint8)
    feet[at] = is_known & (dark < share * road)
    return feet


def _nearest(values: FloatArray, first: float, step: float) -> IntArray:
    """Return the index of the nearest of evenly spaced values."""
    return np.asarray(np.floor((values - first) / step + 0.5), dtype=np.int64)
