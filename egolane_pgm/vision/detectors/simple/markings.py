"""Finds the pixels of the bird's-eye view that may be road marking.

A marking is a narrow strip that is brighter than the road on both sides of it; a top-hat filter
across the road keeps such strips (paper, section `section:simple-line-detector`). The threshold
rises with the brightness around a pixel, so that worn dots in the shade of a bridge are kept. It
also rises with the contrast around it, so that rough concrete in the sun is not. Where the whole
picture has little contrast, it is lower. Dots and paint stand out by a multiple of the threshold,
tracks of tyres by little, so what is kept is weighted by how far it is above.

In pictures full of thin bright streaks, such as rain leaves, these are taken out first. A streak is
a few pixels wide whatever its distance, and streaks are everywhere in a picture; paint is as thin
only far ahead, and is in few places. Where most parts of the lower half of a picture show thin
bright strips, all strips as thin are taken out (a morphological opening along the rows), faint
markings far ahead with them. Where they cover a tenth of a picture and more, it is noise, which an
opening would turn into dark blots.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye

#: The length over which contrast is averaged, and the side of the patch over which brightness and
#: contrast are, metres.
SMOOTH_ALONG_M, _AROUND_M = 0.7, 4.0

#: Added to the local brightness, 0 to 255.
_BRIGHTNESS_FLOOR = 40.0

#: The least contrast of marking over brightness, and the same where the whole picture has little
#: contrast, as when it is blurred or dim.
_LEAST_CONTRAST, _BLURRED_CONTRAST = 0.02, 0.0125

#: The largest contrast that enters the mean, so that one bright line does not hide its neighbours.
_MOST_CONTRAST = 0.2

#: The least contrast of marking over the mean contrast of the whole view, in pictures in which that
#: is low. Blur and dim light lower the contrast of the road's texture as they do that of paint.
_OVER_MEAN = 3.0

#: The multiple of the threshold from which on a pixel weighs in full, so that one bright line does
#: not outweigh several worn ones.
_IN_FULL = 3


def marking_mask(
    view: BirdsEye, above: Image, parameters: Parameters, smooth_along_m: float = SMOOTH_ALONG_M
) -> NDArray[np.uint8]:
    """Where a bird's-eye view of one colour, (R, C), may show marking, (R, C): 255 where it stands
    out clearly, less where it is fainter, a third of that at the threshold, and 0 below it."""
    wide = _odd(number(parameters, "marking_width_m") / view.across_m)
    seen = _seen(view, above, wide)
    count = _blur(seen, view)
    np.maximum(count, np.float32(1e-3), out=count)
    share = _contrast(view, above, wide, smooth_along_m)
    local = _blur(above, view) / count
    share /= local + np.float32(_BRIGHTNESS_FLOOR + 1e-3)
    share *= seen
    limited = np.minimum(share, np.float32(_MOST_CONTRAST))
    usual = _blur(limited, view) / count
    usual *= np.float32(number(parameters, "least_rise"))
    everywhere = float(limited.sum()) / max(int(np.count_nonzero(seen)), 1)
    least = min(max(_OVER_MEAN * everywhere, _BLURRED_CONTRAST), _LEAST_CONTRAST)
    np.maximum(usual, np.float32(least), out=usual)
    share /= usual
    full = 255
    strength = cv2.convertScaleAbs(share, alpha=full / _IN_FULL)
    strength = cv2.threshold(strength, full // _IN_FULL, 0, cv2.THRESH_TOZERO)[1]
    return strength.astype(np.uint8, copy=False)


def _seen(view: BirdsEye, above: Image, wide: int) -> NDArray[np.uint8]:
    """1 where the view shows road on both sides of a pixel as well, (R, C). It is 0 at the edge of
    the picture, and at the edge of a black part of it (a covered lens, a blanked half)."""
    patch = np.ones((wide, wide), dtype=np.uint8)
    lit = cv2.morphologyEx((above > 0).astype(np.uint8), cv2.MORPH_CLOSE, patch)
    lit[~view.valid] = 0
    # One pixel more than the strip, because pixels at the edge are half dark.
    beside = np.ones((1, 2 * wide + 1), dtype=np.uint8)
    seen = cv2.erode(lit, beside, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return seen.astype(np.uint8, copy=False)


def _contrast(
    view: BirdsEye, above: Image, wide: int, smooth_along_m: float
) -> NDArray[np.float32]:
    """How much brighter, in grey levels, strips narrower than `wide` pixels are than the road
    beside them, (R, C)."""
    strip = np.ones((1, wide), dtype=np.uint8)
    bright = cv2.morphologyEx(above, cv2.MORPH_TOPHAT, strip)
    long = _odd(smooth_along_m / view.along_m)
    return cv2.boxFilter(bright, cv2.CV_32F, (1, long)).astype(np.float32, copy=False)


def _blur(values: NDArray[Any], view: BirdsEye) -> NDArray[np.float32]:
    """The mean over the patch around each pixel; values beyond the edges count as 0. Bytes are
    summed as whole numbers, which is faster."""
    patch = (_odd(_AROUND_M / view.across_m), _odd(_AROUND_M / view.along_m))
    blurred = cv2.boxFilter(values, cv2.CV_32F, patch, borderType=cv2.BORDER_CONSTANT)
    return blurred.astype(np.float32, copy=False)


def _odd(pixels: float) -> int:
    return 2 * max(round((pixels - 1) / 2), 0) + 1


# --- streaks -------------------------------------------------------------------------------------

#: Width of the widest streak, as a share of the picture's.
_WIDEST = 0.0025

#: The distance of the rows that are looked at.
_ROW_STEP = 8

#: Number of parts, from top to bottom and from left to right, into which the lower half is cut.
_PARTS = (6, 20)

#: A pixel of a streak is brighter than its surroundings by more than this share plus this number of
#: grey levels, the noise of a camera.
_BRIGHTER, _NOISE = 0.1, 4.0

#: The quantile of the parts' covers that is compared: three out of four are covered at least so.
_QUARTILE = 0.25

#: The cover from which on a picture is full of streaks (900 of them: 0.02), and from which on it is
#: full of noise (of a standard deviation of 10: 0.16).
RAIN, NOISE = 0.01, 0.1


def streak_cover(image: Image) -> float:
    """The share of a picture, (H, W, 3) or (H, W), that thin bright strips cover, in each of three
    parts out of four of its lower half; 0 in a picture too small for streaks."""
    rows = image[image.shape[0] // 2 :: _ROW_STEP]
    if not _width(image) or rows.shape[0] < _PARTS[0] or rows.shape[1] < _PARTS[1]:
        return 0.0
    # OpenCV copies a channel faster than NumPy does.
    rows = np.ascontiguousarray(rows)
    rows = rows if rows.ndim == 2 else cv2.extractChannel(rows, 2).astype(np.uint8, copy=False)
    thin = cv2.morphologyEx(rows, cv2.MORPH_TOPHAT, _strip(image))
    least = cv2.addWeighted(rows, _BRIGHTER, rows, 0.0, _NOISE)
    is_streak = cv2.compare(thin, least, cv2.CMP_GT)
    # The mean over each part; the parts need not have the same number of pixels.
    covered = cv2.resize(is_streak, _PARTS[::-1], interpolation=cv2.INTER_AREA)
    return float(np.quantile(covered, _QUARTILE)) / 255


def without_streaks(image: Image) -> Image:
    """The picture without the strips that are as thin as streaks."""
    opened = cv2.morphologyEx(image, cv2.MORPH_OPEN, _strip(image))
    return opened.astype(np.uint8, copy=False)


def _width(image: Image) -> int:
    """How many pixels wide a streak is at most."""
    return round(_WIDEST * float(image.shape[1]))


def _strip(image: Image) -> Image:
    return np.ones((1, _width(image) + 1), dtype=np.uint8)
