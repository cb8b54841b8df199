"""Finds the lines in one picture: a given number of lines or clothoids that cover the most contour
area (paper, section `section:simple-line-detector`).

All lines of a road share heading and curvature. These are found first: the right values are those
with which the contours gather most sharply at a few offsets. The offsets follow. The lines also
share a third value, the squeeze q. When the car pitches, distances to the side appear to grow or
shrink with the distance ahead, y = o (1 + q x), where q is the change of pitch over the height of
the camera. A clothoid's fourth value, the rate of its curvature, moves a line by centimetres only,
so the search leaves it where it is expected and least squares find it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.camera.model import USUAL_LANE_M, Camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look, make_view
from egolane_pgm.vision.detectors.simple.contours import Strips, find_strips
from egolane_pgm.vision.detectors.simple.kernels import (
    common_scores,
    line_equations,
)
from egolane_pgm.vision.detectors.simple.markings import (
    NOISE,
    RAIN,
    SMOOTH_ALONG_M,
    is_nothing_but_noise,
    marking_mask,
    streak_cover,
    without_streaks,
)
from egolane_pgm.vision.detectors.simple.parameters import CURVES
from egolane_pgm.vision.detectors.simple.upright import free_road, is_daylight

#: The far edge of the view for straight lines, as roads bend, and the size of its pixels along and
#: across the road, metres.
_STRAIGHT_TO_M, _ALONG_M, _ACROSS_M = 25.0, 0.1, 0.05

#: The most lines per frame, and the least distance between them, metres.
_LINES, APART_M = 8, 2.2

#: Half the width of the strip that a line covers, and the width of a marking that counts in full,
#: metres.
_REACH_M, _STRIPE_M = 0.125, 0.1

#: Standard deviation of the width of lanes, metres, and the share of a line's score that it lends
#: to its neighbours.
_LANE_WIDTH_SD_M, _NEIGHBOUR_BONUS = 0.2, 0.5

#: The values that all lines of a frame share: heading (m/m), curvature (1/m), squeeze (radians over
#: height, 1/m) and rate (1/m^2). First their usual sizes, standard deviations, then the largest
#: ones; the rate is not searched for. It is what a car at 110 km/h meets on the shortest transition
#: curve that AASHTO's Green Book allows (section 3.3.8: lateral acceleration grows by 1.2 m/s^3 at
#: most, so 1.2 over the cube of the speed: a clothoid parameter of 155 m).
_SD = np.array([0.03, 0.001, 0.004, 4e-5])
_MOST = np.array([0.15, 0.003, 0.008])

#: The factor on these standard deviations (but the rate's) once the frame before is known.
_PRIOR_SHARE = 0.3

#: How much contours of a line differ in direction, m/m.
_SLOPE_SD = 0.05

#: `least_rise` in a picture full of streaks: what is left of these adds to the contrast around.
_STREAKY_RISE = 3.0

#: In noise the picture is blurred over some pixels, and its view over some metres along the road;
#: what is left of the noise must not be taken for a line. These values were chosen on the first 55
#: stills with noise of a standard deviation of 15 to 60.
_NOISY_BLUR, _NOISY_ALONG_M, _NOISY_SMOOTH_M = (5, 5), 0.9, 1.5
_NOISY = {"least_rise": 3.4, "least_score": 0.22}

#: Grid sizes for heading, curvature and squeeze: of the coarse search, and of the fine one around
#: the best point.
_COARSE = (41, 9, 5)
_FINE = (7, 5, 5)

#: Bins of the coarse and the fine search, metres.
_COARSE_BIN_M, _FINE_BIN_M = 0.1, 0.07

#: Length of the pieces of contours that are one point of the search, metres.
_PIECE_M = 0.8

#: Size of the bins of the search for offsets, metres.
_BIN_M = 0.05

#: For each round of least squares, how near a run must be to a line to count, in `_REACH_M`.
_REFINE = (2.5, 2.0, 1.5)

#: Standard deviation of the distance of a run, one metre wide, from its line. It is larger than the
#: scatter of runs, because neighbouring runs are far from independent.
_RUN_SD_M = 0.02

#: Weight of an offset's previous value (1/m^2), which keeps the equations solvable for a line
#: without runs near it.
_WEAK = 1e-3

#: The visible length that the covered one is at least divided by, metres: a shorter one says too
#: little.
_LEAST_VISIBLE_M = 5.0

#: The largest share of a neighbour's own score that counts as support.
_MOST_SUPPORT = 0.5


@dataclass(frozen=True)
class Found:
    """The M lines found in one frame, left to right.

    - shape: (M, 4) as in FrameLines
    - score: (M,) share of the visible length that contours cover, plus support from neighbours; of
      a network's own lines how likely each is
    - likely, solid: (M,) how likely each is, and how much of it is continuous, NaN where nobody
      says; both None but for a network's own lines
    """

    shape: FloatArray
    score: FloatArray
    likely: FloatArray | None = None
    solid: FloatArray | None = None


@dataclass(frozen=True)
class _Common:
    """The values that all lines of a frame share: heading (m/m), curvature and squeeze (1/m), and
    the curvature's rate (1/m^2)."""

    heading: float
    curvature: float
    squeeze: float
    rate: float = 0.0

    def shape(self, offset: FloatArray) -> FloatArray:
        """The shapes (M, 4) of the lines with offsets (M,)."""
        out = np.zeros((len(offset), 4))
        out[:, 0] = offset
        out[:, 1] = self.heading + self.squeeze * offset
        out[:, 2] = self.curvature
        out[:, 3] = self.rate
        return out


def shared_by(curve: str) -> BoolArray:
    """Which of the four shared values a curve has, (4,)."""
    n_values = CURVES[curve]
    return np.array([True, n_values > 2, True, n_values > 3])


def view_for(camera: Camera, parameters: Parameters) -> BirdsEye:
    """The bird's-eye view that the parameters ask for. Raises InputError as `make_view` does."""
    side, far = number(parameters, "side_m"), number(parameters, "x_max_m")
    if parameters["curve"] == "line":
        far = min(far, _STRAIGHT_TO_M)
    near = number(parameters, "x_min_m")
    return make_view(camera, near, far, -side, side, _ALONG_M, _ACROSS_M)


def lane_width_m(camera: Camera, parameters: Parameters) -> float:
    """The usual width of lanes, metres: as the parameter says, or as the camera does."""
    if parameters["lane_width_m"] == "auto":
        return USUAL_LANE_M if camera.lane_width_m is None else camera.lane_width_m
    return number(parameters, "lane_width_m")


def find_lines(
    view: BirdsEye,
    image: Image,
    parameters: Parameters,
    *,
    prior_shape: FloatArray | None = None,
    on_road: BoolArray | None = None,
    mask: NDArray[np.uint8] | None = None,
) -> Found:
    """Finds the lines in a picture.

    - image: (H, W, 3), blue green red
    - prior_shape: (P, 4) lines expected from the frames before; what all lines share is searched
      near theirs
    - on_road: (R, C) pixels of the view on the plane of the road; marking elsewhere is dropped
    - mask: (R, C) the marking, where it is known (of a network, which draws it wider than it is)

    Raises InputError for a picture of another size than the calibration.
    """
    is_given, smooth_m = mask is not None, SMOOTH_ALONG_M
    if mask is None:
        cover = streak_cover(image)
        if cover > NOISE:
            if is_nothing_but_noise(image):
                return _nothing()
            # Bends and what is far away drown first.
            near = view.x_m <= _STRAIGHT_TO_M
            view = replace(view, valid=view.valid & near[:, None])
            image = cv2.GaussianBlur(image, _NOISY_BLUR, 0).astype(np.uint8, copy=False)
            parameters = {**parameters, **_NOISY, "curve": "line"}
            smooth_m = _NOISY_SMOOTH_M
        elif cover > RAIN:
            image = without_streaks(image)
            parameters = {**parameters, "least_rise": _STREAKY_RISE}
        above = from_above(view, image)
        if cover > NOISE:
            rows = max(round(_NOISY_ALONG_M / view.along_m), 1)
            above = cv2.blur(above, (1, rows)).astype(np.uint8, copy=False)
        if not is_daylight(view.camera, image):
            parameters = {**parameters, "shadow_share": 0.0}
        view = replace(view, valid=view.valid & free_road(view, above, parameters))
        mask = marking_mask(view, above, parameters, smooth_m)
    if on_road is not None:
        mask[~on_road] = 0
    strips = find_strips(view, mask)
    if is_given:
        strips = replace(strips, width_m=np.full_like(strips.width_m, _STRIPE_M))
    return fit_lines(view, strips, parameters, prior_shape)


def from_above(view: BirdsEye, image: Image) -> Image:
    """The red channel of a picture (H, W, 3) from above, (R, C). In red, yellow paint is as bright
    as white paint and brighter than concrete. A grey picture (H, W) is taken as it is."""
    above = look(view, image)
    # The view has fewer pixels than the picture, so the channel is taken last.
    red = above if above.ndim == 2 else cv2.extractChannel(above, 2)
    return red.astype(np.uint8, copy=False)


def fit_lines(
    view: BirdsEye, strips: Strips, parameters: Parameters, prior_shape: FloatArray | None = None
) -> Found:
    """Finds the lines that cover most of the contours; `prior_shape` as in `find_lines`."""
    if len(strips.row) == 0:
        return _nothing()
    prior = _prior(prior_shape)
    common = _find_common(view, strips, parameters, prior)
    offset, agreement = _along(strips, common)
    centre, score = _scores(view, strips, offset, agreement, common, parameters)
    peaks = _peaks(centre, score, parameters)
    common, found = _refine(strips, common, centre[peaks], parameters, prior)
    order = np.argsort(found, kind="stable")
    return Found(common.shape(found[order]), score[peaks][order])


def _nothing() -> Found:
    return Found(np.zeros((0, 4)), np.zeros(0))


def _prior(prior_shape: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation, (4,) each, of the prior on what the lines share."""
    if prior_shape is None or not len(prior_shape):
        return np.zeros(4), _SD
    offset, slope = prior_shape[:, 0], prior_shape[:, 1]
    heading, squeeze = float(np.median(slope)), 0.0
    if len(prior_shape) > 1 and np.ptp(offset) > 1:
        # The straight line through the slopes over the offsets.
        away = offset - offset.mean()
        squeeze = float(away @ slope / (away @ away))
        heading = float(slope.mean() - squeeze * offset.mean())
    curvature, rate = np.median(prior_shape[:, 2:], axis=0)
    centre = np.array([heading, curvature, squeeze, rate])
    # A clothoid begins and ends at a point: the rate of the frame before does not bind this one's.
    return centre, _SD * [_PRIOR_SHARE, _PRIOR_SHARE, _PRIOR_SHARE, 1.0]


def _find_common(
    view: BirdsEye, strips: Strips, parameters: Parameters, prior: tuple[FloatArray, FloatArray]
) -> _Common:
    """Searches for the values that the lines share, on a coarse grid, then on a fine one around the
    best point. The rate is the expected one."""
    has = shared_by(str(parameters["curve"]))
    rate = float(prior[0][3]) if has[3] else 0.0
    x, y, area, contour = _pieces(view, strips)
    y = y - rate * x**3 / 6
    tolerance = np.hypot(_SLOPE_SD, strips.slope_sd)[contour]
    middle = strips.middle_m[contour]
    slope = strips.slope[contour] - rate * middle**2 / 2
    side = number(parameters, "side_m")

    def best(grid: list[FloatArray], bin_m: float) -> FloatArray:
        if not has[1]:
            grid[1] = np.zeros(1)
        scores = common_scores(
            x, y, area, middle, slope, tolerance, grid[0], grid[1], grid[2], side, bin_m
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
    heading, curvature, squeeze = map(float, best(around, _FINE_BIN_M))
    return _Common(heading, curvature, squeeze, rate)


def _pieces(view: BirdsEye, strips: Strips) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Cuts the contours into short pieces along the road; gives x, y, area and contour of each."""
    rows = max(round(_PIECE_M / view.along_m), 1)
    per_contour = len(view.x_m) // rows + 1
    key = strips.contour * per_contour + strips.row // rows
    width: FloatArray = np.bincount(key, strips.width_m).astype(np.float64)
    piece: IntArray = np.flatnonzero(width).astype(np.int64)
    x: FloatArray = np.bincount(key, strips.width_m * strips.x_m)[piece] / width[piece]
    y: FloatArray = np.bincount(key, strips.width_m * strips.y_m)[piece] / width[piece]
    return x, y, width[piece] * view.along_m, piece // per_contour


def _along(strips: Strips, common: _Common) -> tuple[FloatArray, FloatArray]:
    """For each run, (N,): the offset of the line through it, and how well its contour's direction
    agrees with that line's, from 1 down to 0."""
    heading, curvature, squeeze, rate = (
        common.heading, common.curvature, common.squeeze, common.rate,
    )  # fmt: skip
    x, middle = strips.x_m, strips.middle_m
    straight = strips.y_m - x * (heading + x * (curvature / 2 + x * rate / 6))
    offset = straight / (1 + squeeze * x)
    expected = heading + middle * (curvature + middle * rate / 2)
    tolerance = np.hypot(_SLOPE_SD, strips.slope_sd)
    k = strips.contour
    off = (strips.slope[k] - (expected[k] + squeeze * offset)) / tolerance[k]
    return offset, np.maximum(1 - off * off, 0.0)


def _scores(
    view: BirdsEye,
    strips: Strips,
    offset: FloatArray,
    agreement: FloatArray,
    common: _Common,
    parameters: Parameters,
) -> tuple[FloatArray, FloatArray]:
    """Offsets (B,) and the score (B,) of the line at each."""
    side = number(parameters, "side_m")
    n_bins = 2 * round(side / _BIN_M)
    centre = -side + (np.arange(n_bins, dtype=np.float64) + 0.5) * _BIN_M
    at = np.floor((offset + side) / _BIN_M).astype(int)
    inside = (at >= 0) & (at < n_bins)
    area = np.bincount(at[inside], (strips.width_m * agreement)[inside], n_bins) * view.along_m
    wide = 2 * round(_REACH_M / _BIN_M - 0.5) + 1
    # mode="same" would give as many values as the longer of the two arrays.
    covered = np.convolve(area, np.ones(wide))[wide // 2 : wide // 2 + n_bins]
    shown = _visible(view, common.shape(centre))
    full = np.maximum(shown, _LEAST_VISIBLE_M) * _STRIPE_M
    own = np.minimum(covered / full, 1.0)
    support = _support(own, lane_width_m(view.camera, parameters))
    return centre, np.where(own > 0.03, own + _NEIGHBOUR_BONUS * support, own)


def _support(own: FloatArray, width: float) -> FloatArray:
    """The best score (B,) one lane away on either side, less if the lane's width is unusual."""
    lag = np.arange(1, len(own))
    lag = lag[np.abs(lag * _BIN_M - width) <= 3 * _LANE_WIDTH_SD_M + _BIN_M]
    if not len(lag):
        return np.zeros(len(own))
    likely = np.exp(-0.5 * ((lag * _BIN_M - width) / _LANE_WIDTH_SD_M) ** 2)
    padded = np.pad(np.minimum(own, _MOST_SUPPORT), lag[-1])
    at = np.arange(len(own))[:, None] + lag[-1]
    return np.asarray((np.maximum(padded[at - lag], padded[at + lag]) * likely).max(axis=1))


def _visible(view: BirdsEye, shape: FloatArray) -> FloatArray:
    """The length of each line (M, 4) in the view, (M,), metres, from every fourth row."""
    x, valid = view.x_m[::4], view.valid[::4]
    s0, s1, s2, s3 = shape.T[:, :, None]
    column = (s0 + x * (s1 + x * (s2 / 2 + x * s3 / 6)) - view.y_m[0]) / view.across_m + 0.5
    inside = (column >= 0) & (column < valid.shape[1])
    is_shown = inside & valid[np.arange(len(x)), np.where(inside, column, 0).astype(np.int64)]
    return np.asarray(is_shown.sum(axis=1) * 4 * view.along_m)


def _peaks(centre: FloatArray, score: FloatArray, parameters: Parameters) -> IntArray:
    """Indices of the best scores in turn, each at least `APART_M` from those before."""
    left = score.copy()
    peaks: list[int] = []
    least = max(number(parameters, "least_score"), 1e-6)
    while len(peaks) < _LINES:
        best = int(np.argmax(left))
        if left[best] < least:
            break
        peaks.append(best)
        left[np.abs(centre - centre[best]) < APART_M] = 0
    return np.array(peaks, dtype=np.int64)


def _refine(
    strips: Strips,
    common: _Common,
    found: FloatArray,
    parameters: Parameters,
    prior: tuple[FloatArray, FloatArray],
) -> tuple[_Common, FloatArray]:
    """Refines the shared values and the offsets (M,) by least squares over the runs near the
    lines."""
    has = shared_by(str(parameters["curve"]))
    for times in _REFINE:
        if not len(found):
            break
        offset, agreement = _along(strips, common)
        normal, right = line_equations(
            strips.x_m,
            strips.y_m,
            strips.width_m / _RUN_SD_M**2,
            offset,
            agreement,
            found,
            common.squeeze,
            has,
            times * _REACH_M,
        )
        strength = np.array([*prior[1] ** -2.0, *np.full(len(found), _WEAK)])
        normal[np.diag_indices(len(strength))] += strength
        right += strength * np.array([*prior[0], *found])
        now = np.linalg.solve(normal, right)
        common, found = _Common(*map(float, now[:4] * has)), now[4:]
    return common, found
