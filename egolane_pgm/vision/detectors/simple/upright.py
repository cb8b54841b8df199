"""Finds what stands upright on the road in the bird's-eye view, and so hides the road behind it.

A vehicle stands on its shadow: between its wheels the road is dark, whatever the weather and the
colour of the vehicle. Seen along a ray from the camera, bright road ends there; and side by side
the rays on which it ends at one distance are as wide as a vehicle. The shade of a bridge is wider,
a crack or a seam is narrower. Behind its foot a vehicle hides the road, and its edges, which stand
upright, appear in the bird's-eye view as streaks that point away from the camera. No marking is
looked for there. Where headlights end, at night, the road is dark as well, and nothing tells that
from a shadow: vehicles are looked for by daylight only.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray
from egolane_pgm.vision.camera.model import Camera, vanishing_point
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye
from egolane_pgm.vision.detectors.simple.kernels import feet_on_rays, in_front

#: Distance of neighbouring rays, metres to the side per metre ahead, and the largest.
_RAY_STEP, _RAY_MOST = 0.005, 1.0

#: Each sample of a ray is farther away than the one before by this share, as a picture resolves
#: distances.
_FARTHER = 0.02

#: The samples of a foot: dark ones (seen under a bumper a fifth of the camera's height above the
#: road), before them the shadow's edge, and before that the road.
_DARK, _EDGE, _ROAD = 5, 2, 8

#: The narrowest and the widest foot, metres: a motorcycle is narrower, a lorry with the shadow
#: that the low sun casts beside it is about as wide as its lane.
_NARROWEST_M, _WIDEST_M = 0.8, 4.0


#: The share of what is above the horizon that is no brighter than `is_daylight` takes for the sky
#: (trees and bridges hide much of it), the same of the road, on which there are vehicles, and the
#: least brightness of the sky over that of the road: in pictures of four cameras by day 0.7.
_SKY, _LIT, _DAYLIGHT = 0.9, 0.75, 0.5


def is_daylight(camera: Camera, image: Image) -> bool:
    """Whether the sky in a picture, (H, W, 3) or (H, W), is about as bright as the road, which
    headlights alone do not make it. A picture without sky counts as taken by day."""
    horizon = math.floor(vanishing_point(camera)[1])
    red = (image if image.ndim == 2 else image[:, :, 2])[::8, ::8]
    sky, below = red[: max(horizon, 0) // 8], red[max(horizon, 0) // 8 :]
    # Where headlights shine brightest: not the bonnet, not far ahead.
    road = below[len(below) // 4 : 3 * len(below) // 4, red.shape[1] // 4 : 3 * red.shape[1] // 4]
    if not sky.size or not road.size:
        return True
    return bool(np.quantile(sky, _SKY) >= _DAYLIGHT * np.quantile(road, _LIT))


def free_road(view: BirdsEye, above: Image, parameters: Parameters) -> BoolArray:
    """Where a bird's-eye view of one colour (R, C) shows no vehicle and nothing behind one; (R, C).

    With a `shadow_share` of 0 everything is free.
    """
    free = np.ones(above.shape, dtype=bool)
    share = number(parameters, "shadow_share")
    near, far = float(view.x_m[-1]), float(view.x_m[0])
    count = int(math.log(far / near) / math.log1p(_FARTHER)) + 1
    if not share or count < _DARK + _EDGE + _ROAD:
        return free
    x = near * (1 + _FARTHER) ** np.arange(count)
    rays = np.arange(-_RAY_MOST, _RAY_MOST + _RAY_STEP / 2, _RAY_STEP)
    # Rays begin at the camera, which may be beside the vehicle's middle.
    y = view.y_m - view.camera.lateral_m
    geometry = (float(view.x_m[0]), float(y[0]), view.along_m, view.across_m)
    feet = feet_on_rays(above, view.valid, *geometry, rays, x, share, _DARK, _EDGE, _ROAD)
    ends = np.full(len(rays), np.inf)
    outlines, tree = cv2.findContours(feet, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    for k, outline in enumerate(outlines):
        if tree[0, k, 3] >= 0:
            continue  # It is that of a hole.
        first, top, width, _ = cv2.boundingRect(outline)
        at = x[top]
        if _NARROWEST_M <= width * _RAY_STEP * at <= _WIDEST_M:
            behind = ends[first : first + width]
            np.minimum(behind, at, out=behind)
    if np.isfinite(ends).any():
        free = in_front(ends, view.x_m, y, -_RAY_MOST, _RAY_STEP)
    return free
