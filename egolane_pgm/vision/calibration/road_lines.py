"""Finds painted lines in stills of a road, to calibrate a camera without labelled lines.

First it finds the point where most straight edges of all stills meet, by a vote of random pairs of
edges. Then each still is resampled along a fan of rays through that point, in which parallel lines
stand upright. The fan is turned and bent until bright, narrow streaks stand as upright as possible;
these streaks are the lines.

The lines of a road meet at the vanishing point of the direction of travel, which gives pitch and
yaw. The rate at which they spread below it is their lateral distance over the camera's height; a
known lane width therefore gives the height.

All fits are done without lens distortion and roll; a ray is (a, b, 1) with a to the right and
b down. There a line of a road with curvature is

    a = a0 + s (b - b0) + c / (b - b0).

(a0, b0) is the vanishing point and s the line's offset over the camera's height. c is half the
curvature times the height; it is the same for all lines, so that a bend does not move b0.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from egolane_pgm.tools.progress import bar
from egolane_pgm.types import BoolArray, FloatArray, InputError, problems_in
from egolane_pgm.vision.camera.model import (
    LANE_WIDTHS,
    USUAL_HEIGHTS,
    Camera,
    Points,
    distorted,
    image_to_road,
    is_shown,
    level_rays,
    pixels_of,
    said_height,
    undistorted,
    with_vanishing_point,
)
from egolane_pgm.vision.camera.picture import Image, check_size, rectangle
from egolane_pgm.vision.camera.pictures import Load, Source, first_size, spread

#: The horizontal field of view that is assumed for a lens that was not measured, degrees.
ASSUMED_FIELD_OF_VIEW = 62.0

#: The width of lanes that is assumed for a road whose lanes were not measured, metres.
ASSUMED_LANE_M = 3.5

#: The largest number of pictures of a drive that are looked at.
MOST_STILLS = 30

#: The comment on such a lens in the camera's YAML.
ASSUMED_LENS = (
    f"Lens: not measured; a horizontal field of view of {ASSUMED_FIELD_OF_VIEW:g} degrees assumed,"
    " no distortion\n  (offsets hardly depend on it, distances ahead do)."
)

#: The smallest b - b0 that is used: 38 m ahead for a camera 1.5 m above the road. Roads rise and
#: fall beyond.
NEAREST_TO_HORIZON = 0.04

#: The lowest and the highest camera on cars and lorries, metres. A gap that would need another
#: height is not between neighbouring lines.
_HEIGHTS = (0.5, 4.0)

#: A gap that differs from the most common one by less than this share is one lane.
_SAME_GAP = 0.15

#: The most by which vanishing points of single frames scatter through pitch, heading and bends
#: (a, b). If they scatter more, no lines were found.
_MOST_SPREAD = (0.15, 0.05)

#: A wider scatter is doubted: of 15 choices of pictures of one drive, none had more.
_DOUBTED_SPREAD = (0.05, 0.015)

#: Fewer gaps that are lanes, or a smaller share of all gaps, are doubted: of 15 choices of pictures
#: of one drive, those with fewer had heights off by 19 to 47 %, the others by at most 7 %.
_LEAST_LANES = 4
_LEAST_SHARE = 0.25

#: Standard deviation of the noise of a line's points, in units of a and b.
_NOISE = 0.001

#: Standard deviation of c: a road of 500 m radius.
_BEND = 0.0015

_MIN_POINTS = 5


@dataclass(frozen=True)
class FrameFit:
    """The lines of one frame, fitted through one point.

    - vanishing_point: (2,) a0, b0
    - slope: (L,) s of each line, ascending
    """

    vanishing_point: FloatArray
    slope: FloatArray


@dataclass(frozen=True)
class RoadView:
    """A camera as measured from parallel lines.

    - camera: with pitch, yaw and height as found
    - n_frames: how many frames had a vanishing point of their own
    - vanishing_point: (2,) of all frames, pixels of the undistorted picture
    - spread_px: (2,) half the distance between the 16th and 84th percentiles of single frames
    - gaps_m: (G,) distances between neighbouring lines
    - is_lane: (G,) which of these count as a lane of the camera's lane_width_m
    """

    camera: Camera
    n_frames: int
    vanishing_point: FloatArray
    spread_px: FloatArray
    gaps_m: FloatArray
    is_lane: BoolArray


def assumed_camera(width: int, height: int) -> Camera:
    """A camera for a lens that was not measured, with the principal point in the centre.

    Offsets hardly depend on the assumed focal length, because vanishing point and lane width are
    measured.
    """
    focal = width / 2 / math.tan(math.radians(ASSUMED_FIELD_OF_VIEW) / 2)
    return Camera(
        width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, height_m=_HEIGHTS[0]
    )


def calibrate_road(source: Source, camera: Camera | None = None) -> tuple[Camera, str]:
    """Calibrate a camera from up to MOST_STILLS pictures of a drive, with a warning of doubts.

    - camera: its lens, roll, `ignore` and lane width; by default a usual camera, and lanes of
      ASSUMED_LANE_M.

    Returns the camera, and a comment on its angles and its height. Raises InputError, naming the
    pictures, if the lines of the road do not give them.
    """
    with problems_in(source.path):
        if camera is None:
            lens = assumed_camera(*first_size(source))
            camera = replace(lens, lane_width_m=ASSUMED_LANE_M)
        found = find_in_stills(camera, spread(source, MOST_STILLS))
        view = view_from(camera, found.ahead, found.each, found.fits)
    n_lines = sum(len(lines) for lines in found.lines)
    u, v = view.vanishing_point
    du, dv = view.spread_px
    lanes = view.gaps_m[view.is_lane]
    comment = (
        f"Road: {n_lines} lines found in {len(found.lines)} pictures.\n"
        f"  They meet at ({u:.1f}, {v:.1f}) px of the undistorted picture, give or"
        f" take ({du:.1f}, {dv:.1f}) px in {view.n_frames} frames.\n"
        f"Height: from a lane width of {view.camera.lane_width_m:g} m; {len(lanes)} of"
        f" {len(view.gaps_m)} gaps between neighbouring lines are lanes\n"
        f"  (standard deviation {np.std(lanes):.2f} m; those near the car count most)."
    )
    if doubt := doubts_of(view):
        warnings.warn(f"{source.path}: {doubt}", stacklevel=2)
        comment += f"\n{doubt}"
    return view.camera, comment


def to_level(camera: Camera, u: FloatArray, v: FloatArray) -> FloatArray:
    """The rays a, b, (..., 2), of pixels u, v, without lens distortion and roll."""
    return level_rays(camera, *undistorted(camera, u, v))


def from_level(camera: Camera, rays: FloatArray) -> Points:
    """The pixels u, v of rays (..., 2) in the undistorted picture."""
    roll = math.radians(camera.roll_deg)
    a = math.cos(roll) * rays[..., 0] + math.sin(roll) * rays[..., 1]
    b = -math.sin(roll) * rays[..., 0] + math.cos(roll) * rays[..., 1]
    return pixels_of(camera, a, b)


def _fit_at(lines: Sequence[FloatArray], b0: float) -> tuple[FloatArray, float]:
    """Fit a0, the s of each line and c with the horizon at b0. Return them with the loss, which
    grows linearly for outliers."""
    points = np.concatenate(lines)
    below = points[:, 1] - b0
    number = np.repeat(np.arange(len(lines)), list(map(len, lines)))
    # The last row is the prior on c.
    design = np.zeros((len(points) + 1, len(lines) + 2))
    design[:-1, 0] = 1.0
    design[np.arange(len(points)), 1 + number] = below
    design[:, -1] = np.append(1.0 / below, _NOISE / _BEND)
    target = np.append(points[:, 0], 0.0)
    weight = np.ones(len(target))
    for _ in range(4):
        root = np.sqrt(weight)
        solved = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
        off = (target - design @ solved) / _NOISE
        weight = 1.0 / np.sqrt(1.0 + (off / 2) ** 2)
    return solved, float(np.sum(1.0 / weight - 1.0))


def fit_frame(lines: Sequence[FloatArray], about_b0: float) -> FrameFit | None:
    """Fit the lines of one frame through a common vanishing point.

    - lines: the points (N, 2), a and b, of each line
    - about_b0: a rough horizon; points near it and above are left out

    Returns None unless at least two lines spread.
    """
    usable = [points[points[:, 1] > about_b0 + NEAREST_TO_HORIZON] for points in lines]
    usable = [points for points in usable if len(points) >= _MIN_POINTS]
    if len(usable) < 2:
        return None
    low = about_b0 - 2 * _MOST_SPREAD[1]
    high = about_b0 + 0.9 * NEAREST_TO_HORIZON
    found = minimize_scalar(
        lambda b0: _fit_at(usable, b0)[1], bounds=(low, high), options={"xatol": 1e-7}
    )
    b0 = float(found.x)
    solved, _ = _fit_at(usable, b0)
    slope = np.sort(solved[1:-1])
    if slope[-1] - slope[0] < 0.3:
        return None
    return FrameFit(np.array([solved[0], b0]), slope)


def one_lane(gaps: FloatArray, weights: FloatArray) -> BoolArray:
    """Mark the gaps (G,) near the most common one, counted by their weights (G,)."""
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
) -> RoadView:
    """Find the pitch, yaw and height of a camera from fitted lines of the road.

    - camera: gives the pinhole, distortion, roll and width of lanes; pitch, yaw and height are
      replaced
    - ahead: (2,) a, b of the vanishing point of all frames
    - each: (F, 2) a, b of the vanishing points of single frames
    - fits: the fits of single frames

    Raises InputError if the lines do not meet or do not give a height.
    """
    lane_width_m = camera.lane_width_m
    assert lane_width_m is not None
    pixels = np.stack(from_level(camera, each), axis=-1)
    u, v = (float(value) for value in from_level(camera, ahead))
    spread = np.diff(np.percentile(pixels, [16, 84], axis=0), axis=0)[0] / 2
    where = f"({u:.0f}, {v:.0f})"
    if spread[1] > _MOST_SPREAD[1] * camera.fy or spread[0] > _MOST_SPREAD[0] * camera.fx:
        raise InputError(
            f"the lines of {len(each)} frames meet at {where} give or take"
            f" ({spread[0]:.0f}, {spread[1]:.0f}) pixels, so they do not meet; give straighter,"
            " longer lines"
        )
    if not (0 <= u < camera.width and 0 <= v < camera.height):
        raise InputError(
            f"the lines meet at {where}, outside the picture of {camera.width}x"
            f"{camera.height}; the horizon must be in it"
        )
    turned = replace(with_vanishing_point(camera, u, v), height_m=1.0, lateral_m=0.0)
    # The offsets (L,) of each frame's lines, in heights of the camera.
    offsets = [
        image_to_road(
            turned, *from_level(turned, _rays(ahead, 0.0, fit.slope, 0.2)), undistorted=True
        )[1]
        for fit in fits
    ]
    gaps = np.concatenate([[], *(np.diff(offset) for offset in offsets)])
    middles = np.concatenate([[], *((offset[1:] + offset[:-1]) / 2 for offset in offsets)])
    low, high = (lane_width_m / height for height in reversed(_HEIGHTS))
    sane = (gaps > low) & (gaps < high)
    gaps = gaps[sane]
    middles = middles[sane]
    # A small error of roll or lens makes the gaps far to the side wrong, so they count less.
    weights = 1 / (1 + middles**2)
    lanes = one_lane(gaps, weights)
    if not lanes.any():
        raise InputError(
            f"no two neighbouring lines are one lane of {lane_width_m:g} m apart for any"
            f" camera {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} m above the road; check the lane width"
        )
    # Of gaps that differ by up to 30 %, the median is nearer to the lane than the mean.
    gap = np.quantile(gaps[lanes], 0.5, weights=weights[lanes], method="inverted_cdf")
    height_m = lane_width_m / float(gap)
    seen = replace(turned, height_m=height_m, lateral_m=camera.lateral_m)
    return RoadView(seen, len(each), np.array([u, v]), spread, gaps * height_m, lanes)


def doubts_of(view: RoadView) -> str:
    """Return the doubts about a view in one line, or nothing:

    - a height that cars and lorries do not have, or gaps of twice a lane's width that outnumber the
      lanes, where half the height is usual
    - few gaps that are lanes
    - lines that meet in points far apart
    - a width that lanes do not have
    """
    camera = view.camera
    assert camera.lane_width_m is not None
    high = camera.height_m
    low, most = USUAL_HEIGHTS
    one = camera.lane_width_m
    n_gaps = len(view.gaps_m)
    n_lanes = int(view.is_lane.sum())
    n_double = int((np.abs(view.gaps_m / one - 2) < 2 * _SAME_GAP).sum())
    if not low <= high <= most or (high / 2 >= low and n_double > n_lanes):
        taken, other = ("two lanes were", 2 * high) if high < low else ("half a lane was", high / 2)
        return (
            f"doubtful: with lanes of {one:g} m {said_height(camera)} ({n_lanes} gaps between"
            f" lines are lanes, {n_double} twice as wide). If {taken} taken for a lane, it is at"
            f" {other:.2f} m: leave out lines that do not bound a lane (ignore), or give other"
            " pictures"
        )
    if n_lanes < max(_LEAST_LANES, _LEAST_SHARE * n_gaps):
        return (
            f"doubtful: only {n_lanes} of {n_gaps} gaps between lines are as wide as most, so the"
            f" height of {high:.2f} m may be wrong: give more pictures, of free road"
        )
    du, dv = view.spread_px
    if du > _DOUBTED_SPREAD[0] * camera.fx or dv > _DOUBTED_SPREAD[1] * camera.fy:
        return (
            f"doubtful: the lines of {view.n_frames} pictures meet in points that differ by"
            f" ({du:.0f}, {dv:.0f}) px, so the pitch may be wrong: give pictures of straight, even"
            " road"
        )
    if not LANE_WIDTHS[0] <= one <= LANE_WIDTHS[1]:
        return (
            "doubtful: lanes are {:g} to {:g} m wide almost everywhere,".format(*LANE_WIDTHS)
            + f" not {one:g} m; the height follows from this width"
        )
    return ""


# --- lines in stills ----------------------------------------------------------------------------

#: The largest offset of the fan to either side, in heights of the camera.
_SIDE = 5.0

#: The step between the rays of the fan, in heights of the camera.
_STEP = 0.025
_ROWS = 120

#: The widest marking, in heights of the camera (block markings are 0.6 m wide and more).
_MARKING = 0.8

#: The widest dark seam, and the widest gap of a double line, in heights of the camera.
_SEAM = 0.15

#: A pixel is paint if it is brighter than its surroundings by more than this, grey levels, ...
_CONTRAST = 12.0

#: ... and by more than this number of times the mean difference in its row.
_SCATTERS = 4.0

#: The smallest share of a line's length in the picture that paint covers.
_COVERED = 0.08

#: A streak whose middle deviates by more than this (median, in heights of the camera) is grass or a
#: car, not paint.
_RAGGED = 0.06

#: The turns (a) and bends (c) of the fan that are tried for each still.
_TURNS = np.linspace(-0.025, 0.025, 11)
_BENDS = np.linspace(-0.0015, 0.0015, 7)

#: The largest difference in heading and pitch between stills of one drive (a, b).
_STILLS_DIFFER = np.array([0.1, 0.03])

#: An edge votes for a point if the sine of the angle between them is below this.
_NEAR = 0.02

#: Shorter edges do not vote, share of the picture's width.
_SHORTEST = 0.025

#: Flatter edges do not vote, b per a: they are not lines of the road ahead.
_FLATTEST = 0.12

#: The share of the length of all edges that must vote for the point where they meet. With edges in
#: random directions it is about a twentieth.
_AGREE = 0.08


#: How many random pairs of edges are tried over all stills.
_PAIRS = 3000


@dataclass(frozen=True)
class Fan:
    """A still, resampled along rays through the point where lines meet.

    - paint: (R, S) how much brighter a pixel is than both sides of it, grey levels
    - seen: (R, S) whether it is in the picture and not masked
    - below: (R,) b - b0 of each row
    - side: (S,) offset of each column, in heights of the camera
    """

    paint: FloatArray
    seen: BoolArray
    below: FloatArray
    side: FloatArray


def seen_mask(camera: Camera) -> BoolArray:
    """The pixels, (H, W), that may show road: all outside the camera's `ignore` rectangles."""
    return is_shown(camera, np.arange(camera.width), np.arange(camera.height)[:, None])


def edges(camera: Camera, image: Image, mask: BoolArray) -> FloatArray:
    """The straight edges of a picture, (M, 4): a, b of the upper end, then a, b of the lower end.

    mask: (H, W) pixels that may show road.
    """
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0)
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    if found is None:
        return np.zeros((0, 4))
    found = found.reshape(-1, 4).astype(np.float64)
    middle = np.rint((found[:, :2] + found[:, 2:]) / 2).astype(int)
    rows = np.clip(middle[:, 1], 0, mask.shape[0] - 1)
    columns = np.clip(middle[:, 0], 0, mask.shape[1] - 1)
    found = found[mask[rows, columns]]
    ends = to_level(camera, found[:, [0, 2]], found[:, [1, 3]])
    order = np.argsort(ends[..., 1], axis=1)
    ends = np.take_along_axis(ends, order[..., None], axis=1)
    along = ends[:, 1] - ends[:, 0]
    is_long = np.hypot(along[:, 0], along[:, 1]) > _SHORTEST * camera.width / camera.fx
    keep = is_long & (along[:, 1] > _FLATTEST * np.abs(along[:, 0]))
    return ends[keep].reshape(-1, 4)


def _length(lines: FloatArray) -> FloatArray:
    """The lengths (M,) of edges (M, 4)."""
    return np.asarray(np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1]))


def _votes(points: FloatArray, lines: FloatArray) -> FloatArray:
    """The total length (P,) of the edges (M, 4) that point at each of the points (P, 2) from
    below."""
    upper = lines[:, :2]
    along = lines[:, 2:] - lines[:, :2]
    length = _length(lines)
    to = points[:, None, :] - (lines[:, :2] + lines[:, 2:])[None] / 2
    reach = np.hypot(to[..., 0], to[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = np.abs(to[..., 0] * along[:, 1] - to[..., 1] * along[:, 0]) / (reach * length)
    good = (sine < _NEAR) & (upper[None, :, 1] > points[:, None, 1])
    return np.asarray(np.where(good, length * (1 - sine / _NEAR), 0.0).sum(axis=1))


def _crossings(lines: FloatArray, tries: int, rng: np.random.Generator) -> FloatArray:
    """The points (P, 2) where random pairs of edges (M, 4) meet; long edges come more often."""
    weight = _length(lines)
    first, second = rng.choice(len(lines), (2, tries), p=weight / weight.sum())
    p = lines[first, :2]
    r = lines[first, 2:] - lines[first, :2]
    q = lines[second, :2]
    s = lines[second, 2:] - lines[second, :2]
    cross = r[:, 0] * s[:, 1] - r[:, 1] * s[:, 0]
    is_sharp = np.abs(cross) > 0.1 * np.hypot(*r.T) * np.hypot(*s.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = ((q - p)[:, 0] * s[:, 1] - (q - p)[:, 1] * s[:, 0]) / cross
    return np.asarray((p + along[:, None] * r)[is_sharp])


def _winner(candidates: FloatArray, votes: FloatArray) -> FloatArray:
    best: FloatArray = candidates[np.argmax(votes)]
    for _ in range(3):
        near = np.hypot(*(candidates - best).T) < 0.03
        best = np.average(candidates[near], axis=0, weights=votes[near] ** 2 + 1e-12)
    return best


def meeting_of_stills(stills: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """The point (2,) where most edges of all stills meet, and the points (F, 2) near it where the
    edges of each still meet (NaN where they do not).

    stills: the edges (M, 4) of each of the F stills.

    Raises InputError if the edges do not meet in one point.
    """
    rng = np.random.default_rng(0)
    n = max(60, _PAIRS // max(len(stills), 1))
    crossings = [
        _crossings(lines, n, rng) if len(lines) >= 2 else np.zeros((0, 2)) for lines in stills
    ]
    candidates = np.concatenate(crossings)
    if not len(candidates):
        raise InputError("no straight edges that meet; are they of a road ahead?")
    votes = np.sum([_votes(candidates, lines) for lines in stills], axis=0)
    if votes.max() < _AGREE * np.concatenate([_length(lines) for lines in stills]).sum():
        raise InputError(
            "their straight edges do not meet in one point; choose pictures of a"
            " straight road, and leave out bonnet and mirror (ignore)"
        )
    every = _winner(candidates, votes)
    each = np.full((len(stills), 2), np.nan)
    for i, (points, lines) in enumerate(zip(crossings, stills, strict=True)):
        near = points[(np.abs(points - every) < _STILLS_DIFFER).all(axis=1)]
        votes = _votes(near, lines)
        if votes.any():
            each[i] = _winner(near, votes)
    return every, each


def fan(
    camera: Camera, grey: FloatArray, mask: BoolArray, point: FloatArray, bend: float = 0.0
) -> Fan:
    """Resample a picture along rays through a point, so that paint along the road stands upright.

    - grey: (H, W) brightness, grey levels
    - mask: (H, W) pixels that may show road
    - point: (2,) the point a, b where lines meet
    - bend: c, half the road's curvature times the camera's height
    """
    lowest = to_level(camera, np.array([camera.width / 2]), np.array([camera.height - 1.0]))[0, 1]
    # The rows are denser far away, where dashes are shorter in the picture.
    farthest = NEAREST_TO_HORIZON
    nearest = max(lowest - point[1], 2 * NEAREST_TO_HORIZON)
    below = np.geomspace(farthest, nearest, _ROWS)
    side = np.arange(-_SIDE, _SIDE + _STEP / 2, _STEP)
    rays = _rays(point, bend, side[None, :], below[:, None])
    free_u, free_v = from_level(camera, rays)
    u, v = distorted(camera, free_u, free_v)
    # Far outside the picture the distortion formula folds points back into it.
    inside = (np.abs(free_u - camera.cx) < 0.75 * camera.width) & (free_v < 1.25 * camera.height)
    u = u.astype(np.float32)
    v = v.astype(np.float32)
    bright = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST, borderValue=0)
    kernel = rectangle(1, round(_MARKING / _STEP) | 1)
    # The road between two dark seams is not paint, and the gap in a double line is closed.
    seam = rectangle(1, round(_SEAM / _STEP) | 1)
    bright = cv2.morphologyEx(bright, cv2.MORPH_CLOSE, seam)
    paint = cv2.morphologyEx(bright, cv2.MORPH_TOPHAT, kernel)
    shown = cv2.erode(seen, kernel) * inside > 0
    return Fan(np.where(shown, paint, 0.0), shown, below, side)


def _rays(point: FloatArray, bend: float, side: FloatArray, below: ArrayLike) -> FloatArray:
    side, below = np.broadcast_arrays(side, below)
    return np.stack([point[0] + side * below + bend / below, point[1] + below], axis=-1)


def is_paint(found: Fan) -> BoolArray:
    """Mark the pixels of a fan, (R, S), that are paint."""
    n_seen = np.maximum(found.seen.sum(axis=1, keepdims=True), 1)
    scatter = found.paint.sum(axis=1, keepdims=True) / n_seen
    is_bright: BoolArray = found.paint > np.maximum(_CONTRAST, _SCATTERS * scatter)
    return is_bright & found.seen


def _profile(found: Fan) -> FloatArray:
    """The share of each ray that is paint, (S,); 0 where too little of the ray is seen."""
    n_seen = found.seen.sum(axis=0)
    share = is_paint(found).sum(axis=0) / np.maximum(n_seen, 1)
    return np.where(n_seen > 0.25 * len(found.below), share, 0.0)


def grey_of(image: Image) -> FloatArray:
    """The mean of green and red, (H, W), float32, in which white and yellow paint are bright."""
    return np.asarray(image[..., 1:].mean(axis=-1, dtype=np.float32))


def find_lines(
    camera: Camera, grey: FloatArray, mask: BoolArray, about: FloatArray
) -> list[FloatArray]:
    """The points (N, 2), pixels, of each line painted on the road in a still.

    - grey: (H, W) brightness, grey levels
    - mask: (H, W) pixels that may show road
    - about: (2,) the point a, b where the lines roughly meet
    """

    def sharpness(tried: tuple[FloatArray, float]) -> float:
        profile = _profile(fan(camera, grey, mask, *tried))
        return float(np.sum(profile**2) * (1 - 0.05 * abs(tried[1]) / _BENDS[-1]))

    turned = [(about + np.array([da, 0.0]), c) for c in _BENDS for da in _TURNS]
    point, bend = max(turned, key=sharpness)
    found = fan(camera, grey, mask, point, bend)
    lines = []
    for side, below in _streaks(found):
        pixels = distorted(camera, *from_level(camera, _rays(point, bend, side, below)))
        lines.append(np.stack(pixels, axis=-1))
    return lines


def _streaks(found: Fan) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the upright streaks of paint in a fan, the most covered one first.

    Each is `side` and `below` of the rows with paint, (N,)."""
    paint = is_paint(found)
    profile = _profile(found)
    smooth = np.convolve(profile, np.ones(3) / 3, mode="same")
    taken = np.zeros(len(smooth), dtype=bool)
    reach = round(0.5 * _MARKING / _STEP)
    for peak in np.argsort(-smooth):
        if smooth[peak] < _COVERED:
            break
        if taken[peak]:
            continue
        window = slice(max(0, peak - reach), peak + reach + 1)
        taken[max(0, peak - 2 * reach) : peak + 2 * reach + 1] = True
        weight = found.paint[:, window] * paint[:, window]
        rows = weight.sum(axis=1) > 0
        side = (weight[rows] @ found.side[window]) / weight[rows].sum(axis=1)
        if rows.sum() >= 5 and np.median(np.abs(side - np.median(side))) < _RAGGED:
            yield side, found.below[rows]


@dataclass(frozen=True)
class FoundLines:
    """The lines found in the stills of a drive.

    - ahead: (2,) the point a, b where the edges of all stills meet
    - each: (F, 2) the same for single stills, if found
    - lines: for each still, the points (N, 2) of its lines, pixels
    - fits: the fits of the stills with at least two lines
    """

    ahead: FloatArray
    each: FloatArray
    lines: list[list[FloatArray]]
    fits: list[FrameFit]


def find_in_stills(camera: Camera, stills: Iterable[tuple[str, Load]]) -> FoundLines:
    """Find the lines in stills that one camera took of a road. Damaged stills are left out.

    - stills: the name of each, and a function that reads it; `camera.ignore` are the parts that
      never show road

    Raises InputError, naming the still, if it has another size than the camera, and if the edges
    do not meet in one point.
    """
    mask = seen_mask(camera)
    straight = []
    # Bytes, so that thirty large pictures fit into memory.
    greys: list[Image] = []
    for name, load in bar(stills, desc="horizon", unit="picture", total=MOST_STILLS):
        try:
            image = load()
        except InputError:
            continue
        with problems_in(name):
            check_size(image, camera.width, camera.height)
        straight.append(edges(camera, image, mask))
        greys.append(grey_of(image).round().astype(np.uint8))
    try:
        ahead, each = meeting_of_stills(straight)
    except InputError:
        # If they do not meet upside down either, this raises the same error.
        meeting_of_stills([-lines[:, [2, 3, 0, 1]] for lines in straight])
        raise InputError("the pictures are upside down: turn them by 180 degrees first") from None
    fits = []
    lines = []
    looked = zip(greys, each, strict=True)
    for grey, point in bar(looked, desc="lines", unit="picture", total=len(greys)):
        about = point if np.isfinite(point).all() else ahead
        found = find_lines(camera, grey.astype(np.float32), mask, about)
        lines.append(found)
        rays = [to_level(camera, line[:, 0], line[:, 1]) for line in found]
        fit = fit_frame(rays, float(ahead[1]))
        if fit and (np.abs(fit.vanishing_point - ahead) < _STILLS_DIFFER).all():
            fits.append(fit)
    return FoundLines(ahead, each[np.isfinite(each).all(axis=1)], lines, fits)
