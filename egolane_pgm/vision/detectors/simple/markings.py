"""Find the pixels of the bird's-eye view that may be road marking.

A marking is a narrow strip that is brighter than the road on both sides; a top-hat filter across
the road keeps such strips (paper, section `section:simple-line-detector`). The threshold rises with
the brightness around a pixel, so that worn dots in the shade of a bridge are kept, and with the
contrast around it, so that rough concrete in the sun is not. It is lower in pictures with little
contrast. Dots and paint exceed it by far, tyre tracks by little, so pixels are weighted by their
excess.

In pictures full of thin bright streaks, such as rain leaves, these are removed first. Streaks are
everywhere and a few pixels wide at any distance; paint is as thin only far ahead, and in few
places. If most parts of the lower half of a picture have thin bright strips, all strips as thin are
removed by a morphological opening along the rows, and faint markings far ahead with them. If they
cover a tenth of the picture, it is noise, which an opening would turn into dark blots.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.vision.camera.picture import Image, as_image, rectangle
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, lit_and_seen

#: Length over which contrast is averaged, metres.
SMOOTH_ALONG_M = 0.7

#: Side of the patch for local brightness and contrast, metres.
_AROUND_M = 4.0

#: Added to the local brightness, 0 to 255.
_BRIGHTNESS_FLOOR = 40.0

#: Least contrast of a marking, as a share of brightness.
_LEAST_CONTRAST = 0.02

#: Lower bound of that contrast in pictures with little contrast (blurred or dim).
_BLURRED_CONTRAST = 0.0125

#: Least contrast in such pictures, as a multiple of the mean contrast of the view.
_OVER_MEAN = 3.0

#: Largest contrast that enters the mean, so that one bright line does not hide its neighbours.
_MOST_CONTRAST = 0.2

#: Multiple of the threshold at which the weight of a pixel is largest, so that one bright line does
#: not outweigh several worn ones.
_IN_FULL = 3


def marking_mask(
    view: BirdsEye, above: Image, parameters: Parameters, smooth_along_m: float = SMOOTH_ALONG_M
) -> NDArray[np.uint8]:
    """Return the weight of each pixel (R, C) of a one-colour view (R, C) as marking: a third of 255
    at the threshold, 255 well above it, and 0 below."""
    wide = _odd(number(parameters, "marking_width_m") / view.across_m)
    # One pixel more than the strip, because pixels at the edge are half dark.
    _, seen = lit_and_seen(view, above, wide, 2 * wide + 1)
    count = _blur(seen, view)
    np.maximum(count, np.float32(1e-3), out=count)
    strip = rectangle(1, wide)
    long = _odd(smooth_along_m / view.along_m)
    bright = cv2.morphologyEx(above, cv2.MORPH_TOPHAT, strip)
    share = cv2.boxFilter(bright, cv2.CV_32F, (1, long)).astype(np.float32, copy=False)
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
    return as_image(strength)


def _blur(values: NDArray[Any], view: BirdsEye) -> NDArray[np.float32]:
    """Return the mean over the patch around each pixel; values beyond the edges count as 0."""
    patch = (_odd(_AROUND_M / view.across_m), _odd(_AROUND_M / view.along_m))
    blurred = cv2.boxFilter(values, cv2.CV_32F, patch, borderType=cv2.BORDER_CONSTANT)
    return blurred.astype(np.float32, copy=False)


def _odd(pixels: float) -> int:
    return 2 * max(round((pixels - 1) / 2), 0) + 1


# --- streaks -------------------------------------------------------------------------------------

#: Width of the widest streak, as a share of the picture's.
_WIDEST = 0.0025

#: Distance of the rows that are searched for streaks.
_ROW_STEP = 8

#: Number of parts of the lower half from top to bottom and from left to right.
_PARTS = (6, 20)

#: A pixel of a streak is brighter than its surroundings by more than this share of theirs ...
_BRIGHTER = 0.1

#: ... plus this number of grey levels, the noise of a camera.
_NOISE = 4.0

#: Least cover of a picture full of streaks (900 of them: 0.02).
RAIN = 0.01

#: Least cover of a picture full of noise (with a standard deviation of 10: 0.16).
NOISE = 0.1


def streak_cover(image: Image) -> float:
    """Return the share of a picture, (H, W, 3), that thin bright strips cover in at least
    three of four parts of its lower half; 0 in a picture too small for streaks."""
    rows = image[image.shape[0] // 2 :: _ROW_STEP]
    if not _width(image) or rows.shape[0] < _PARTS[0] or rows.shape[1] < _PARTS[1]:
        return 0.0
    # OpenCV copies a channel faster than NumPy does.
    rows = as_image(cv2.extractChannel(np.ascontiguousarray(rows), 2))
    thin = cv2.morphologyEx(rows, cv2.MORPH_TOPHAT, _strip(image))
    least = cv2.addWeighted(rows, _BRIGHTER, rows, 0.0, _NOISE)
    is_streak = cv2.compare(thin, least, cv2.CMP_GT)
    # The mean over each part; the parts need not have the same number of pixels.
    covered = cv2.resize(is_streak, _PARTS[::-1], interpolation=cv2.INTER_AREA)
    return float(np.quantile(covered, 0.25)) / 255


def without_streaks(image: Image) -> Image:
    """Remove the strips of a picture that are as thin as streaks."""
    return as_image(cv2.morphologyEx(image, cv2.MORPH_OPEN, _strip(image)))


def _width(image: Image) -> int:
    """Return the width of the widest streak, pixels."""
    return round(_WIDEST * float(image.shape[1]))


def _strip(image: Image) -> Image:
    return rectangle(1, _width(image) + 1)
