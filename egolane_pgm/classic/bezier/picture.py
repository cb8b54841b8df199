"""Post-processing in the picture (Aly 2008, section II F): splines are moved onto the markings,
whose middle the picture shows finer than the view, and continued along them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from egolane_pgm.classic.bezier.ridges import ridge_weights
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, image_to_road, road_to_image

#: Half the width of a usual marking, metres: how far a profile is smoothed.
_HALF_WIDTH_M = 0.075

#: Largest move of a point to either side, pixels.
_BESIDE = 10

#: Least cosine between the directions of a point before and after its move.
_KEPT = 0.9

#: Step of the extension, pixels.
_STEP = 10.0

#: Reach of the extension's search to either side, pixels.
_BESIDE_EXTENSION = 20

#: Largest distance ahead of the extension, metres.
_FARTHEST_M = 28.0

#: Least cosine of the extension's direction to the last step.
_TURN = 0.86

#: Least cosine of the extension's direction to the mean direction.
_TURN_OF_ALL = 0.95

#: Least contrast of the extension, as a share of the spline's.
_CONTRAST = 0.35


def refined(grey: FloatArray, camera: Camera, point: FloatArray) -> FloatArray:
    """Points (P, 2), columns and rows of a picture (H, W), along one spline from far to near: moved
    onto the marking, and continued at both ends. A point moves if it finds a marking and the spline
    keeps its direction."""
    along = _unit(np.gradient(point, axis=0))
    place, contrast = _strip(grey, camera, point, along, _BESIDE)
    moved = np.where(np.isfinite(place)[:, None], place_of(point, along, place), point)
    for _ in range(2):
        new = _unit(np.gradient(moved, axis=0))
        turned = (new * along).sum(axis=1) < _KEPT
        in_sky = np.isnan(image_to_road(camera, *moved.T)[0])
        moved[turned | in_sky] = point[turned | in_sky]
    if not np.isfinite(contrast).any():
        return moved
    # The usual contrast of the marking.
    least = float(np.nanmedian(contrast)) * _CONTRAST
    ahead = _extension(grey, camera, moved[::-1], least)
    behind = _extension(grey, camera, moved, least)
    return np.concatenate([ahead[::-1], moved, behind])


def place_of(point: FloatArray, along: FloatArray, place: FloatArray) -> FloatArray:
    """Points (P, 2) moved `place` (P,) pixels along their normals."""
    moved: FloatArray = point + place[:, None] * np.stack([along[:, 1], -along[:, 0]], axis=1)
    return moved


def _strip(
    grey: FloatArray, camera: Camera, point: FloatArray, along: FloatArray, half: int
) -> tuple[FloatArray, FloatArray]:
    """Where on the normal of each point the brightest strip of a marking's width is, (P,) pixels,
    and how much brighter than the profile's median; NaN where no strip is in view."""
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    step = np.arange(-half, half + 1)
    # The grey levels along the normals, a pixel apart.
    column, row = point.T[:, :, None] + normal.T[:, :, None] * step
    height, width = grey.shape
    inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
    profile = np.where(inside, map_coordinates(grey, [row, column], order=1), np.nan)
    x, y = image_to_road(camera, point[:, 0], point[:, 1])
    left, right = (
        np.stack(road_to_image(camera, x, y + side * _HALF_WIDTH_M), axis=1) for side in (-1, 1)
    )
    sigma = np.maximum(np.abs(((right - left) * normal).sum(axis=1)) / 2, 0.5)
    seen = np.isfinite(profile)
    usable = np.isfinite(sigma) & (seen.sum(axis=1) > half)
    place = np.full(len(point), np.nan)
    contrast = np.full(len(point), np.nan)
    if not usable.any():
        return place, contrast
    level = profile[usable]
    sigma = sigma[usable, None, None]
    level = np.where(seen[usable], level, np.nanmedian(level, axis=1)[:, None])
    ridge = ridge_weights((step[:, None] - step) / sigma)
    answer = (ridge @ level[:, :, None])[:, :, 0]
    best = np.argmax(answer[:, 1:-1], axis=1) + 1
    rows = np.arange(len(best))
    before, here, after = (answer[rows, best + k] for k in (-1, 0, 1))
    is_peak = (before < here) & (here >= after) & (here > 0)
    bend = np.where(is_peak, before - 2 * here + after, -1.0)
    place[usable] = np.where(is_peak, step[best] + (before - after) / (2 * bend), np.nan)
    contrast[usable] = np.where(is_peak, here, np.nan)
    return place, contrast


def _extension(grey: FloatArray, camera: Camera, point: FloatArray, least: float) -> FloatArray:
    """Points (E, 2) that continue points behind their last one, while strips are found that are
    bright enough and turn little."""
    mean = _unit(point[-1] - point[0])
    at = point[-1]
    along = _unit(point[-1] - point[-2])
    found: list[FloatArray] = []
    while len(found) < 100:
        ahead = at + _STEP * along
        x, _ = image_to_road(camera, ahead[0], ahead[1])
        if not 0 < x <= _FARTHEST_M:
            break
        place, contrast = _strip(grey, camera, ahead[None], along[None], _BESIDE_EXTENSION)
        if not contrast[0] >= least:
            break
        new = place_of(ahead[None], along[None], place)[0]
        turn = _unit(new - at)
        if turn @ along < _TURN or turn @ mean < _TURN_OF_ALL:
            break
        found.append(new)
        at = new
        along = turn
    return np.array(found).reshape(-1, 2)


def _unit(vector: FloatArray) -> FloatArray:
    """Vectors (..., 2) of length 1."""
    size = np.hypot(vector[..., 0], vector[..., 1])
    return np.asarray(vector / np.maximum(size, 1e-9)[..., None])
