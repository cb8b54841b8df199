"""Finds how a camera looks at the road, from lines that are parallel on the road.

The lines of a road meet at the vanishing point of the direction of travel, which gives pitch and
yaw. The rate at which they spread below it is their lateral distance over the camera's height; a
known lane width therefore gives the height.

All fits are done without lens distortion and roll, where a ray is (a, b, 1) with a to the right and
b down. There a line of a road with curvature is

    a = a0 + s (b - b0) + c / (b - b0).

(a0, b0) is the vanishing point and s the line's offset over the camera's height. c is half the
curvature times the height; it is the same for all lines, so that a bend does not move b0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from egolane_pgm.types import BoolArray, FloatArray, InputError
from egolane_pgm.vision.camera.model import (
    RANGES,
    USUAL_HEIGHTS,
    Camera,
    distorted,
    image_to_road,
    level_rays,
    said_height,
    undistorted,
    with_vanishing_point,
)

#: The horizontal field of view that is assumed for a lens that was not measured, degrees.
ASSUMED_FIELD_OF_VIEW = 62.0

#: The smallest b - b0 that is used: 38 m ahead for a camera 1.5 m above the road. Roads rise and
#: fall beyond.
NEAREST_TO_HORIZON = 0.04

#: The lowest and the highest camera on cars and lorries, metres. A gap that would need another
#: height is not between neighbouring lines.
_HEIGHTS = (0.5, 4.0)

#: A gap that differs from the most common one by less than this share is one lane.
_SAME_GAP = 0.15

#: The most by which vanishing points of single frames scatter through pitch, heading and bends
#: (a, b). If they scatter more, they were not those of lines.
_MOST_SPREAD = (0.15, 0.05)

#: Standard deviations: of the noise of a line's points, and of c (a road of 500 m radius).
_NOISE, _BEND = 0.001, 0.0015

_MIN_POINTS = 5


@dataclass(frozen=True)
class FrameFit:
    """The lines of one frame, fitted through one point.

    - vanishing_point: (2,) a0, b0
    - slope: (L,) s of each line, ascending
    - bend: c
    """

    vanishing_point: FloatArray
    slope: FloatArray
    bend: float


@dataclass(frozen=True)
class RoadView:
    """What parallel lines say about a camera.

    - camera: with pitch, yaw and height as found
    - vanishing_points: (F, 2) of the single frames, pixels of the undistorted picture
    - vanishing_point: (2,) of all frames, pixels of the undistorted picture
    - spread_px: (2,) half the distance between the 16th and 84th percentiles of vanishing_points
    - gaps_m: (G,) distances between neighbouring lines
    - is_lane: (G,) which of these count as a lane of the camera's lane_width_m
    """

    camera: Camera
    vanishing_points: FloatArray
    vanishing_point: FloatArray
    spread_px: FloatArray
    gaps_m: FloatArray
    is_lane: BoolArray


def assumed_camera(
    width: int, height: int, field_of_view_deg: float = ASSUMED_FIELD_OF_VIEW
) -> Camera:
    """A camera for a lens that was not measured: the principal point is the middle of the picture,
    and the focal length follows from the horizontal field of view.

    Offsets hardly depend on this guess, because vanishing point and lane width are measured.
    Raises InputError for a field of view outside 10 to 150 degrees.
    """
    if not 10 <= field_of_view_deg <= 150:
        raise InputError(f"field of view {field_of_view_deg} is not between 10 and 150 degrees")
    focal = width / 2 / math.tan(math.radians(field_of_view_deg) / 2)
    return Camera(
        width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, height_m=_HEIGHTS[0]
    )


def to_level(camera: Camera, u: FloatArray, v: FloatArray) -> FloatArray:
    """The rays a, b, (..., 2), of pixels u, v, without lens distortion and roll."""
    return level_rays(camera, *undistorted(camera, u, v))


def from_level(camera: Camera, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The pixels u, v of rays (..., 2) in the undistorted picture."""
    roll = math.radians(camera.roll_deg)
    a = math.cos(roll) * rays[..., 0] + math.sin(roll) * rays[..., 1]
    b = -math.sin(roll) * rays[..., 0] + math.cos(roll) * rays[..., 1]
    return camera.fx * a + camera.cx, camera.fy * b + camera.cy


def from_level_to_image(camera: Camera, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The pixels u, v of rays (..., 2) in the picture."""
    return distorted(camera, *from_level(camera, rays))


def check_lane_width(lane_width_m: float) -> None:
    """Raises InputError for a width that no lane has, for instance in other units."""
    low, high, _ = RANGES["lane_width_m"]
    if not low <= lane_width_m <= high:
        raise InputError(f"lane width {lane_width_m:g}: lanes are {low:g} to {high:g} m wide")


def _fit_at(lines: Sequence[FloatArray], b0: float) -> tuple[FloatArray, float]:
    """Fits a0, the s of each line and c with the horizon at b0. Returns them with the loss, which
    grows linearly for outliers."""
    n_lines = len(lines)
    blocks, targets = [], []
    for i, points in enumerate(lines):
        below = points[:, 1] - b0
        block = np.zeros((len(points), n_lines + 2))
        block[:, 0], block[:, 1 + i], block[:, -1] = 1.0, below, 1.0 / below
        blocks.append(block)
        targets.append(points[:, 0])
    prior = np.zeros((1, n_lines + 2))
    prior[0, -1] = _NOISE / _BEND
    design = np.vstack([*blocks, prior])
    target = np.append(np.concatenate(targets), 0.0)
    weight = np.ones(len(target))
    for _ in range(4):
        root = np.sqrt(weight)
        solved = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
        off = (target - design @ solved) / _NOISE
        weight = 1.0 / np.sqrt(1.0 + (off / 2) ** 2)
    return solved, float(np.sum(1.0 / weight - 1.0))


def fit_frame(lines: Sequence[FloatArray], about_b0: float) -> FrameFit | None:
    """Fits the lines of one frame through a common vanishing point.

    - lines: the points (N, 2), a and b, of each line
    - about_b0: a rough horizon; points near it and above are left out

    Returns None unless at least two lines spread.
    """
    usable = [points[points[:, 1] > about_b0 + NEAREST_TO_HORIZON] for points in lines]
    usable = [points for points in usable if len(points) >= _MIN_POINTS]
    if len(usable) < 2:
        return None
    low, high = about_b0 - 2 * _MOST_SPREAD[1], about_b0 + 0.9 * NEAREST_TO_HORIZON
    found = minimize_scalar(
        lambda b0: _fit_at(usable, b0)[1], bounds=(low, high), options={"xatol": 1e-7}
    )
    b0 = float(found.x)
    solved, _ = _fit_at(usable, b0)
    slope = np.sort(solved[1:-1])
    if slope[-1] - slope[0] < 0.3:
        return None
    return FrameFit(np.array([solved[0], b0]), slope, float(solved[-1]))


def one_lane(gaps: FloatArray, weights: FloatArray) -> BoolArray:
    """Which of the gaps (G,) are near the most common one, counted by their weights (G,)."""
    if not gaps.size:
        return np.zeros(0, dtype=bool)
    away = np.abs(gaps / gaps[:, None] - 1)
    common = gaps[np.argmax(np.maximum(1 - away / _SAME_GAP, 0) @ weights)]
    common = np.median(gaps[np.abs(gaps / common - 1) < _SAME_GAP])
    return np.asarray(np.abs(gaps / common - 1) < _SAME_GAP)


def view_from(
    camera: Camera,
    ahead: FloatArray,
    each: FloatArray,
    fits: Sequence[FrameFit],
    lane_width_m: float,
    what: str,
) -> RoadView:
    """Finds the pitch, yaw and height of a camera from fitted lines of the road.

    - camera: gives the pinhole, distortion and roll; pitch, yaw and height are replaced
    - ahead: (2,) a, b of the vanishing point of all frames
    - each: (F, 2) a, b of the vanishing points of single frames
    - fits: the fits of single frames
    - lane_width_m: the width of the road's lanes
    - what: how error messages name the lines

    Raises InputError if the lines do not meet or do not give a height.
    """
    check_lane_width(lane_width_m)
    pixels = np.stack(from_level(camera, each), axis=-1)
    u, v = (float(value) for value in from_level(camera, ahead))
    spread = np.diff(np.percentile(pixels, [16, 84], axis=0), axis=0)[0] / 2
    where = f"({u:.0f}, {v:.0f})"
    if spread[1] > _MOST_SPREAD[1] * camera.fy or spread[0] > _MOST_SPREAD[0] * camera.fx:
        raise InputError(
            f"{what}: the lines of {len(each)} frames meet at {where} give or take"
            f" ({spread[0]:.0f}, {spread[1]:.0f}) pixels, so they do not meet; give straighter,"
            " longer lines"
        )
    if not (0 <= u < camera.width and 0 <= v < camera.height):
        raise InputError(
            f"{what}: the lines meet at {where}, outside the picture of {camera.width}x"
            f"{camera.height}; the horizon must be in it"
        )
    turned = replace(with_vanishing_point(camera, u, v), height_m=1.0, lateral_m=0.0)
    offsets = [_offsets(turned, ahead, fit) for fit in fits]
    gaps = np.concatenate([[], *(np.diff(offset) for offset in offsets)])
    middles = np.concatenate([[], *((offset[1:] + offset[:-1]) / 2 for offset in offsets)])
    low, high = (lane_width_m / height for height in reversed(_HEIGHTS))
    sane = (gaps > low) & (gaps < high)
    gaps, middles = gaps[sane], middles[sane]
    # A small error of roll or lens makes the gaps far to the side wrong, so they count less.
    weights = 1 / (1 + middles**2)
    lanes = one_lane(gaps, weights)
    if not lanes.any():
        raise InputError(
            f"{what}: no two neighbouring lines are one lane of {lane_width_m:g} m apart for any"
            f" camera {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} m above the road; check the lane width"
        )
    height_m = lane_width_m / float(np.average(gaps[lanes], weights=weights[lanes]))
    seen = replace(turned, height_m=height_m, lateral_m=camera.lateral_m, lane_width_m=lane_width_m)
    return RoadView(
        seen,
        pixels,
        np.array([u, v]),
        spread,
        gaps * height_m,
        lanes,
    )


def _offsets(turned: Camera, ahead: FloatArray, fit: FrameFit) -> FloatArray:
    """The offsets (L,) of a frame's lines, in heights of the camera."""
    below = np.stack([ahead[0] + fit.slope * 0.2, np.full_like(fit.slope, ahead[1] + 0.2)], axis=-1)
    return image_to_road(turned, *from_level(turned, below), undistorted=True)[1]


def describe_assumed_lens(field_of_view_deg: float) -> str:
    """Describe a lens that was not measured."""
    return (
        f"Lens: not measured; a horizontal field of view of {field_of_view_deg:g} degrees assumed,"
        " no distortion\n  (offsets hardly depend on it, distances ahead do)."
    )


def doubts_of(view: RoadView) -> str:
    """What speaks against a view, in one line, or nothing: a height that cars' cameras do not have,
    or gaps of twice a lane's width that outnumber the lanes, where half the height is usual; else a
    width that lanes do not have."""
    assert view.camera.lane_width_m is not None
    high, (low, most), one = view.camera.height_m, USUAL_HEIGHTS, view.camera.lane_width_m
    n_lanes = int(view.is_lane.sum())
    n_double = int((np.abs(view.gaps_m / one - 2) < 2 * _SAME_GAP).sum())
    if low <= high <= most and (high / 2 < low or n_double <= n_lanes):
        said = f"doubtful: lanes are 2.5 to 4.5 m wide almost everywhere, not {one:g} m; the"
        return "" if 2.5 <= one <= 4.5 else f"{said} height follows from this width"
    taken, other = ("two lanes were", 2 * high) if high < low else ("half a lane was", high / 2)
    return (
        f"doubtful: with lanes of {one:g} m {said_height(view.camera)} ({n_lanes} gaps between"
        f" lines are lanes, {n_double} twice as wide). If {taken} taken for a lane, it is at"
        f" {other:.2f} m: leave out what is no line of a lane (ignore), or give other stills"
    )


def describe_view(view: RoadView, what: str) -> str:
    """Describe a view in some lines. what: the lines used."""
    (u, v), (du, dv) = view.vanishing_point, view.spread_px
    lanes = view.gaps_m[view.is_lane]
    return (
        f"Road: {what}.\n  They meet at ({u:.1f}, {v:.1f}) px of the undistorted picture, give or"
        f" take ({du:.1f}, {dv:.1f}) px in {len(view.vanishing_points)} frames.\n"
        f"Height: from a lane width of {view.camera.lane_width_m:g} m; {len(lanes)} of"
        f" {len(view.gaps_m)} gaps between neighbouring lines are lanes\n"
        f"  (standard deviation {np.std(lanes):.2f} m; those near the car count most)."
    )
