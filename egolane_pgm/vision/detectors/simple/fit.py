"""Find the lines in one picture: those that cover the most contour area (paper, section
`section:simple-line-detector`).

All lines of a road share heading and curvature. These are found first, as the values with which the
contours gather most sharply at a few offsets; the offsets follow. The lines also share the squeeze
q: when the car pitches, lateral distances grow or shrink with the distance ahead, y = o (1 + q x),
with q the change of pitch over the height of the camera. The rate of a clothoid's curvature moves a
line by centimetres only: the search keeps its predicted value, and least squares find it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.camera.model import USUAL_LANE_M, Camera
from egolane_pgm.vision.camera.picture import Image, as_image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look, make_view
from egolane_pgm.vision.detectors.simple.contours import Strips, find_strips
from egolane_pgm.vision.detectors.simple.kernels import common_scores
from egolane_pgm.vision.detectors.simple.markings import (
    NOISE,
    RAIN,
    SMOOTH_ALONG_M,
    marking_mask,
    streak_cover,
    without_streaks,
)
from egolane_pgm.vision.detectors.simple.parameters import CURVES
from egolane_pgm.vision.detectors.simple.upright import free_road, is_daylight

#: Far edge of the view for straight lines, metres: roads bend.
_STRAIGHT_TO_M = 25.0

#: Pixel size of that view along the road, metres.
_ALONG_M = 0.1

#: Pixel size of that view across the road, metres.
_ACROSS_M = 0.05

#: Maximum number of lines per frame.
_LINES = 8

#: Least distance of two lines, metres.
APART_M = 2.2

#: Half the width of the strip that a line covers, metres.
_REACH_M = 0.125

#: Width of a full marking, metres.
_STRIPE_M = 0.1

#: Standard deviation of lane widths, metres.
_LANE_WIDTH_SD_M = 0.2

#: Weight of a neighbouring line's score.
_NEIGHBOUR_BONUS = 0.5

#: Largest score of a neighbouring line that counts.
_MOST_SUPPORT = 0.5

#: Standard deviations and limits of the values that all lines of a frame share: heading (m/m),
#: curvature (1/m), squeeze (1/m) and rate (1/m^2), which is not searched: its value
#: follows from 110 km/h on the shortest transition curve of AASHTO's Green Book (section 3.3.8).
_SD = np.array([0.03, 0.001, 0.004, 4e-5])
_MOST = np.array([0.15, 0.003, 0.008])

#: Factor on these standard deviations (not the rate's) around the previous frame's values.
_PRIOR_SHARE = 0.3

#: Standard deviation of the direction of a line's contours, m/m.
_SLOPE_SD = 0.05

#: `least_rise` in rain, whose remains add to the mean contrast.
_STREAKY_RISE = 3.0

#: Side of the blur of a picture in noise, pixels. This and the other values for noise were chosen
#: on the first 55 stills with noise of a standard deviation of 15 to 60.
_NOISY_BLUR = (5, 5)

#: Blur of the view along the road in noise, metres.
_NOISY_ALONG_M = 0.9

#: `SMOOTH_ALONG_M` in noise, metres.
_NOISY_SMOOTH_M = 1.5

#: Thresholds in noise.
_NOISY = {"least_rise": 3.4, "least_score": 0.22}

#: Grid sizes of the coarse search for heading, curvature and squeeze.
_COARSE = (41, 9, 5)

#: Grid sizes of the fine search around the best point of the coarse one.
_FINE = (7, 5, 5)

#: Bin size of the coarse search, metres.
_COARSE_BIN_M = 0.1

#: Bin size of the fine search, metres.
_FINE_BIN_M = 0.07

#: Length of a piece of contour in the search, metres.
_PIECE_M = 0.8

#: Bin size of the search for offsets, metres.
_BIN_M = 0.05

#: Distance from a line within which runs count, in `_REACH_M`, for each round of least squares.
_REFINE = (2.5, 2.0, 1.5)

#: Standard deviation of the distance of a run, one metre wide, from its line: larger than the
#: scatter of runs, because neighbouring runs are not independent.
_RUN_SD_M = 0.02

#: Weight of an offset's previous value (1/m^2), for lines without runs nearby.
_WEAK = 1e-3

#: Lower bound of the visible length that a score is divided by, metres.
_LEAST_VISIBLE_M = 5.0


@dataclass(frozen=True)
class Found:
    """The M lines of one frame, left to right.

    - shape: (M, 4) as in FrameLines
    - score: (M,) share of the visible length covered by contours, plus support from neighbours; for
      a network's lines, their probability
    - likely: (M,) probability of each line, None if unknown
    - solid: (M,) share of the line that is continuous, NaN if unknown, None for all
    """

    shape: FloatArray
    score: FloatArray
    likely: FloatArray | None = None
    solid: FloatArray | None = None


def view_for(camera: Camera, parameters: Parameters) -> BirdsEye:
    """Make the bird's-eye view of these parameters. Raises InputError as `make_view` does."""
    side = number(parameters, "side_m")
    far = number(parameters, "x_max_m")
    if parameters["curve"] == "line":
        far = min(far, _STRAIGHT_TO_M)
    near = number(parameters, "x_min_m")
    return make_view(camera, near, far, -side, side, _ALONG_M, _ACROSS_M)


def find_lines(
    view: BirdsEye,
    image: Image,
    parameters: Parameters,
    *,
    prior_shape: FloatArray | None = None,
    on_road: BoolArray | None = None,
    mask: NDArray[np.uint8] | None = None,
) -> Found:
    """Find the lines in a picture.

    - image: (H, W, 3), blue green red
    - prior_shape: (P, 4) lines predicted from earlier frames; shared values are searched near
      theirs
    - on_road: (R, C) pixels of the view on the road plane; marking elsewhere is dropped
    - mask: (R, C) the marking, if a network has found it (usually wider than the paint)

    Raises InputError for a picture of another size than the calibration.
    """
    is_given = mask is not None
    smooth_m = SMOOTH_ALONG_M
    if mask is None:
        cover = streak_cover(image)
        if cover > NOISE:
            # Bends and distant markings drown first.
            near = view.x_m <= _STRAIGHT_TO_M
            view = replace(view, valid=view.valid & near[:, None])
            image = as_image(cv2.GaussianBlur(image, _NOISY_BLUR, 0))
            parameters = {**parameters, **_NOISY, "curve": "line"}
            smooth_m = _NOISY_SMOOTH_M
        elif cover > RAIN:
            image = without_streaks(image)
            parameters = {**parameters, "least_rise": _STREAKY_RISE}
        above = from_above(view, image)
        if cover > NOISE:
            rows = max(round(_NOISY_ALONG_M / view.along_m), 1)
            above = as_image(cv2.blur(above, (1, rows)))
        if not is_daylight(view.camera, image):
            parameters = {**parameters, "shadow_share": 0.0}
        view = replace(view, valid=view.valid & free_road(view, above, parameters))
        mask = marking_mask(view, above, parameters, smooth_m)
    if on_road is not None:
        mask[~on_road] = 0
    strips = find_strips(view, mask)
    if is_given:
        strips = replace(strips, width_m=np.full_like(strips.width_m, _STRIPE_M))
    if len(strips.row) == 0:
        return Found(np.zeros((0, 4)), np.zeros(0))
    prior = _prior(prior_shape)
    n_values = CURVES[str(parameters["curve"])]
    has = np.array([True, n_values > 2, True, n_values > 3])
    side_m = number(parameters, "side_m")
    common = _find_common(view, strips, has, side_m, prior)
    centre, score = _scores(view, strips, common, side_m)
    peaks = _peaks(centre, score, number(parameters, "least_score"))
    common, found = _refine(strips, common, centre[peaks], has, prior)
    order = np.argsort(found, kind="stable")
    return Found(_shapes(common, found[order]), score[peaks][order])


def from_above(view: BirdsEye, image: Image) -> Image:
    """Return the red channel of a picture, (H, W, 3), from above, (R, C).

    In red, yellow paint is as bright as white paint and brighter than concrete.
    """
    # The view has fewer pixels than the picture, so the channel is taken last.
    return as_image(cv2.extractChannel(look(view, image), 2))


def _shapes(common: FloatArray, offset: FloatArray) -> FloatArray:
    """Return the shapes (M, 4) of lines with the shared values (4,) and offsets (M,)."""
    heading, curvature, squeeze, rate = common
    shape = np.empty((len(offset), 4))
    shape[:, 0] = offset
    shape[:, 1] = heading + squeeze * offset
    shape[:, 2:] = curvature, rate
    return shape


def _prior(prior_shape: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation, (4,) each, of the prior on the shared values."""
    if prior_shape is None or not len(prior_shape):
        return np.zeros(4), _SD
    offset = prior_shape[:, 0]
    slope = prior_shape[:, 1]
    heading = float(np.median(slope))
    squeeze = 0.0
    if len(prior_shape) > 1 and np.ptp(offset) > 1:
        # Regression of the slopes on the offsets.
        away = offset - offset.mean()
        squeeze = float(away @ slope / (away @ away))
        heading = float(slope.mean() - squeeze * offset.mean())
    curvature, rate = np.median(prior_shape[:, 2:], axis=0)
    # A clothoid begins and ends at a point, so the previous rate binds this one's no more closely.
    return (
        np.array([heading, curvature, squeeze, rate]),
        _SD * [_PRIOR_SHARE, _PRIOR_SHARE, _PRIOR_SHARE, 1.0],
    )


def _find_common(
    view: BirdsEye,
    strips: Strips,
    has: BoolArray,
    side_m: float,
    prior: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Search for the shared values (4,) on a coarse grid, then on a fine one around its best point.
    The rate is the predicted one."""
    rate = float(prior[0][3]) if has[3] else 0.0
    # Short pieces of the contours along the road.
    rows = max(round(_PIECE_M / view.along_m), 1)
    per_contour = len(view.x_m) // rows + 1
    key = strips.contour * per_contour + strips.row // rows
    width = np.bincount(key, strips.width_m)
    piece = np.flatnonzero(width)
    width = width[piece]
    x = np.bincount(key, strips.width_m * strips.x_m)[piece] / width
    y = np.bincount(key, strips.width_m * strips.y_m)[piece] / width - rate * x**3 / 6
    contour = piece // per_contour
    tolerance = np.hypot(_SLOPE_SD, strips.slope_sd)[contour]
    middle = strips.middle_m[contour]
    slope = strips.slope[contour] - rate * middle**2 / 2

    def best(grid: list[FloatArray], bin_m: float) -> FloatArray:
        if not has[1]:
            grid[1] = np.zeros(1)
        scores = common_scores(
            x, y, width * view.along_m, middle, slope, tolerance, *grid, side_m, bin_m
        )
        away = np.meshgrid(
            # `strict=False`: the rate is not searched for.
            *((values - c) / s for values, c, s in zip(grid, *prior, strict=False)),
            indexing="ij",
        )
        # The prior has heavy tails: a ramp is unusual, but enough contours can show one.
        scores = scores / (1 + sum(a * a for a in away) / 3)
        index = np.unravel_index(np.argmax(scores), scores.shape)
        return np.array([values[i] for values, i in zip(grid, index, strict=True)])

    first = best(
        [m * np.linspace(-1, 1, n) for m, n in zip(_MOST, _COARSE, strict=True)], _COARSE_BIN_M
    )
    step = 2 * _MOST / (np.array(_COARSE) - 1) * np.array([1.0, 0.75, 0.75])
    around = [at + s * np.linspace(-1, 1, n) for at, s, n in zip(first, step, _FINE, strict=True)]
    return np.append(best(around, _FINE_BIN_M), rate)


def _along(strips: Strips, common: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return for each run the offset (N,) of the line through it, and how well its contour's
    direction agrees with that line, (N,), from 1 down to 0."""
    heading, curvature, squeeze, rate = common
    x = strips.x_m
    middle = strips.middle_m
    straight = strips.y_m - x * (heading + x * (curvature / 2 + x * rate / 6))
    offset = straight / (1 + squeeze * x)
    expected = heading + middle * (curvature + middle * rate / 2)
    tolerance = np.hypot(_SLOPE_SD, strips.slope_sd)
    k = strips.contour
    off = (strips.slope[k] - (expected[k] + squeeze * offset)) / tolerance[k]
    return offset, np.maximum(1 - off * off, 0.0)


def _scores(
    view: BirdsEye, strips: Strips, common: FloatArray, side_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return offsets (B,) and the score (B,) of the line at each."""
    offset, agreement = _along(strips, common)
    n_bins = 2 * round(side_m / _BIN_M)
    centre = -side_m + (np.arange(n_bins, dtype=np.float64) + 0.5) * _BIN_M
    at = np.floor((offset + side_m) / _BIN_M).astype(int)
    inside = (at >= 0) & (at < n_bins)
    area = np.bincount(at[inside], (strips.width_m * agreement)[inside], n_bins) * view.along_m
    wide = 2 * round(_REACH_M / _BIN_M - 0.5) + 1
    # mode="same" would give as many values as the longer of the two arrays.
    covered = np.convolve(area, np.ones(wide))[wide // 2 : wide // 2 + n_bins]
    shown = _visible(view, _shapes(common, centre))
    full = np.maximum(shown, _LEAST_VISIBLE_M) * _STRIPE_M
    own = np.minimum(covered / full, 1.0)
    camera = view.camera
    support = _support(own, USUAL_LANE_M if camera.lane_width_m is None else camera.lane_width_m)
    return centre, np.where(own > 0.03, own + _NEIGHBOUR_BONUS * support, own)


def _support(own: FloatArray, width: float) -> FloatArray:
    """Return the best score (B,) one lane away on either side, less for an unusual width."""
    lag = np.arange(1, len(own))
    lag = lag[np.abs(lag * _BIN_M - width) <= 3 * _LANE_WIDTH_SD_M + _BIN_M]
    if not len(lag):
        return np.zeros(len(own))
    likely = np.exp(-0.5 * ((lag * _BIN_M - width) / _LANE_WIDTH_SD_M) ** 2)
    padded = np.pad(np.minimum(own, _MOST_SUPPORT), lag[-1])
    at = np.arange(len(own))[:, None] + lag[-1]
    return np.asarray((np.maximum(padded[at - lag], padded[at + lag]) * likely).max(axis=1))


def _visible(view: BirdsEye, shape: FloatArray) -> FloatArray:
    """Return the length of each line (M, 4) in the view, (M,), metres, from every fourth row."""
    x = view.x_m[::4]
    valid = view.valid[::4]
    s0, s1, s2, s3 = shape.T[:, :, None]
    column = (s0 + x * (s1 + x * (s2 / 2 + x * s3 / 6)) - view.y_m[0]) / view.across_m + 0.5
    inside = (column >= 0) & (column < valid.shape[1])
    is_shown = inside & valid[np.arange(len(x)), np.where(inside, column, 0).astype(np.int64)]
    return np.asarray(is_shown.sum(axis=1) * 4 * view.along_m)


def _peaks(centre: FloatArray, score: FloatArray, least_score: float) -> IntArray:
    """Return the indices of the best scores in turn, each at least `APART_M` from the others."""
    left = score.copy()
    peaks: list[int] = []
    while len(peaks) < _LINES:
        best = int(np.argmax(left))
        if left[best] < max(least_score, 1e-6):
            break
        peaks.append(best)
        left[np.abs(centre - centre[best]) < APART_M] = 0
    return np.array(peaks, dtype=np.int64)


def _refine(
    strips: Strips,
    common: FloatArray,
    found: FloatArray,
    has: BoolArray,
    prior: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Refine the shared values (4,) and the offsets (M,) by least squares over the runs near the
    lines.

    A run at x, y on a line with offset o is linearised around o and the squeeze q:
    h x + k x^2 / 2 + q' o x + r x^3 / 6 + o' (1 + q x) = y + q o x. The left side counts squeeze
    times offset twice, so the right side has it once.
    """
    n_lines = len(found)
    strength = np.array([*prior[1] ** -2.0, *np.full(n_lines, _WEAK)])
    for times in _REFINE if n_lines else ():
        squeeze = common[2]
        offset, agreement = _along(strips, common)
        line = np.argmin(np.abs(offset[:, None] - found), axis=1)
        distance = np.abs(offset - found[line])
        near = np.flatnonzero((agreement > 0) & (distance <= times * _REACH_M))
        line = line[near]
        x = strips.x_m[near]
        design = np.zeros((len(near), 4 + n_lines))
        design[:, :4] = has * np.stack([x, x**2 / 2, found[line] * x, x**3 / 6], axis=1)
        design[np.arange(len(near)), 4 + line] = 1 + squeeze * x
        weighted = design * (strips.width_m * agreement / _RUN_SD_M**2)[near, None]
        normal = design.T @ weighted + np.diag(strength)
        right = weighted.T @ (strips.y_m[near] + squeeze * found[line] * x)
        solution = np.linalg.solve(normal, right + strength * [*prior[0], *found])
        common = solution[:4] * has
        found = solution[4:]
    return common, found
