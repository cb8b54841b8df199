"""Finds pictures full of thin bright streaks, such as rain leaves, and takes the streaks out.

A streak is a few pixels wide whatever its distance, and streaks are everywhere in a picture; paint
is as thin only far ahead, and is in few places. Where most parts of the lower half of a picture
show thin bright strips, all strips as thin are taken out (a morphological opening along the rows),
faint markings far ahead with them. Where they cover a tenth of a picture and more, it is noise,
which an opening would turn into dark blots.
"""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.vision.camera.picture import Image

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

#: Noise is averaged over blocks of so many pixels a side. In what is nothing but noise rows beside
#: each other then differ by more than the second number times as much as those eight apart; on a
#: road with noise of a standard deviation of 60 by at most 0.79 times.
_BLOCK, _NOTHING, _APART = 8, 0.85, 8


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


def is_nothing_but_noise(image: Image) -> bool:
    """Whether a picture, (H, W, 3) or (H, W), stays noise if blocks of it are averaged."""
    share = 1 / _BLOCK
    small = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    lower = small[small.shape[0] // 2 :].astype(np.int16)
    rows = lower if lower.ndim == 2 else lower[:, :, 2]
    apart = float(np.abs(rows[_APART:] - rows[:-_APART]).mean()) if len(rows) > _APART else 0.0
    return not apart or float(np.abs(rows[1:] - rows[:-1]).mean()) > _NOTHING * apart


def _width(image: Image) -> int:
    """How many pixels wide a streak is at most."""
    return round(_WIDEST * float(image.shape[1]))


def _strip(image: Image) -> Image:
    return np.ones((1, _width(image) + 1), dtype=np.uint8)
