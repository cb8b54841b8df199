"""Fits the plane of the road to the disparities of a stereo pair.

A point Z metres away along the optical axis lies f B / Z pixels farther left in the second picture.
On a flat road this disparity is linear in the pixel, d = a u + b v + c, and it is 0 at the horizon
(paper, section `section:simple-line-detector`: "the ground plane equation"). Pixels are those of
the first picture, rectified and at full size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from egolane_pgm.types import BoolArray, FloatArray
from egolane_pgm.vision.camera.model import Camera, axes

#: How many planes through three random points are tried, and the least number of points (of at most
#: MOST_POINTS) on a sure plane.
_TRIALS, _POINTS = 100, 200

#: The largest differences of a plane's pitch and roll (degrees) and of the camera's height (share)
#: from the calibrated ones.
MOST_PITCH_DEG, _MOST_ROLL_DEG, _MOST_HEAVE = 2.5, 1.5, 0.12

#: The most points that a plane is fitted to.
MOST_POINTS = 3000

#: For each round of least squares, how near a point must be to the plane to count, in tolerances.
_ROUNDS = (2.0, 1.5, 1.0, 1.0)


@dataclass(frozen=True)
class Plane:
    """A plane of the road, d = a u + b v + c.

    - abc: (3,) its coefficients; those of the calibrated plane where none is sure
    - share: the share of the points that lie on it
    - is_sure: whether enough points lie on it, and the camera can be in this pose
    """

    abc: FloatArray
    share: float
    is_sure: bool


def ground_plane(camera: Camera) -> FloatArray:
    """The coefficients (3,) of the flat road below a calibrated camera.

    A ray (right, down, 1) of the camera meets the road at Z = -h / (n . ray), where n is the upward
    direction in the camera's axes and h its height. Hence d = -(f B / h) n . ray.
    """
    assert camera.baseline_m is not None
    up = axes(camera)[:, 2]
    scale = -camera.fx * camera.baseline_m / camera.height_m
    a, b = scale * up[0] / camera.fx, scale * up[1] / camera.fy
    return np.array([a, b, scale * up[2] - a * camera.cx - b * camera.cy])


def pose(camera: Camera, planes: FloatArray) -> FloatArray:
    """The camera's height (metres), pitch and roll (degrees) above planes (..., 3), as (..., 3);
    the inverse of `ground_plane`. NaN for coefficients that are no plane."""
    assert camera.baseline_m is not None
    a, b, c = np.moveaxis(planes, -1, 0)
    up = -np.stack([a * camera.fx, b * camera.fy, c + a * camera.cx + b * camera.cy], axis=-1)
    length = np.linalg.norm(up, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = camera.fx * camera.baseline_m / length
        pitch = np.degrees(np.arcsin(np.clip(up[..., 2] / length, -1, 1)))
        roll = np.degrees(np.arctan2(-up[..., 0], -up[..., 1]))
    return np.stack([height, pitch, roll], axis=-1)


def disparity_at(plane: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """The disparity of the plane (3,) at pixels u, v."""
    return np.asarray(plane[0] * u + plane[1] * v + plane[2])


def fit_plane(
    camera: Camera,
    u: FloatArray,
    v: FloatArray,
    disparity: FloatArray,
    tolerance_px: float,
    least_share: float,
) -> Plane:
    """Finds the plane that most points lie on.

    The candidates are the calibrated plane and planes through three random points; the best one is
    refined by least squares.

    - u, v, disparity: (N,) the points, pixels; N is at most a few thousand
    - tolerance_px: largest distance of a point from a plane that it lies on, pixels
    - least_share: of the points, on a sure plane
    """
    calibrated = ground_plane(camera)
    off = disparity - disparity_at(calibrated, u, v)
    if len(off) < _POINTS:
        return Plane(calibrated, 0.0, False)
    # Points are centred and scaled so that the three equations are well conditioned.
    centre, scale = np.array([u.mean(), v.mean()]), max(float(np.ptp(u)), float(np.ptp(v)), 1.0)
    points = np.stack([(u - centre[0]) / scale, (v - centre[1]) / scale, np.ones_like(u)])

    def whole(tilt: FloatArray) -> FloatArray:
        """The planes (..., 3), in pixels, that differ from the calibrated one by `tilt` (..., 3),
        in centred and scaled points."""
        slope = tilt[..., :2] / scale
        shift = tilt[..., 2] - slope @ centre
        return np.asarray(calibrated + np.concatenate([slope, shift[..., None]], axis=-1))

    tilts = _candidates(points.T, off)
    is_possible = _possible(camera, whole(tilts))
    # The calibrated plane stays a candidate whatever rounding says.
    is_possible[0] = True
    tilts = tilts[is_possible]
    a, b, c = tilts.T[:, :, None]
    is_near = np.abs(a * points[0] + b * points[1] + c - off) <= tolerance_px
    best = tilts[int(np.argmax(is_near.sum(axis=1)))]
    for times in _ROUNDS:
        near = np.abs(best @ points - off) <= times * tolerance_px
        if near.sum() < _POINTS:
            return Plane(calibrated, float(near.mean()), False)
        design = points * near
        best = np.linalg.lstsq(design @ points.T, design @ off)[0]
    share = float((np.abs(best @ points - off) <= tolerance_px).mean())
    found = whole(best)
    is_sure = share >= least_share
    is_sure &= bool(_possible(camera, found[None])[0])
    return Plane(found if is_sure else calibrated, share, is_sure)


def _candidates(points: FloatArray, off: FloatArray) -> FloatArray:
    """The tilts to try, (K, 3): none, then those of planes through three random points each."""
    three = np.random.default_rng(0).integers(0, len(off), (_TRIALS, 3))
    matrices = points[three]
    three = three[np.abs(np.linalg.det(matrices)) > 1e-3]
    through = np.linalg.solve(points[three], off[three][..., None])[..., 0]
    return np.concatenate([np.zeros((1, 3)), through])


def _possible(camera: Camera, planes: FloatArray) -> BoolArray:
    """Whether the camera can be in the pose that planes (K, 3) ask for, (K,)."""
    height, pitch, roll = np.moveaxis(pose(camera, planes), -1, 0)
    heave = np.abs(height / camera.height_m - 1)
    possible: BoolArray = (
        (np.abs(pitch - camera.pitch_deg) <= MOST_PITCH_DEG)
        & (np.abs(roll - camera.roll_deg) <= _MOST_ROLL_DEG)
        & (heave <= _MOST_HEAVE)
    )
    return possible
