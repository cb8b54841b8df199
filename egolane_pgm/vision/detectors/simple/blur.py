"""Finds pictures that are smeared up and down or to the side, as a shaking camera does, and
sharpens them; also those that are nothing but noise.

A smear widens a line the more, the more it is slanted in the picture: those beside the own lane
become wider than any marking.
"""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.vision.camera.picture import Image

#: The distance of the pixels of a row or column that are compared.
_APART = 8

#: The sharpness below which a picture is smeared. Pictures of four cameras have 0.23 to 0.47, but
#: for a few with less; after a blur of 15 pixels it is 0.14 to 0.16.
_SMEARED = 0.2

#: What is smeared is sharpened by this multiple of its difference from a blur of this share of the
#: picture's width. Chosen on the first 55 stills with a blur of 11, 15 and 21 pixels.
_GAIN, _WIDE = 2.0, 0.012

#: Noise is averaged over blocks of this many pixels a side. What is nothing but noise then has at
#: least this sharpness; a road with noise of a standard deviation of 60 has at most 0.79.
_BLOCK, _NOTHING = 8, 0.85


def sharpness(image: Image, axis: int, every: int = 16) -> float:
    """How much neighbouring pixels of a picture's lower half differ, over how much those eight
    apart do: an eighth where it is smeared over more, 1 in noise.

    - image: (H, W, 3) or (H, W)
    - axis: 0 for neighbours up and down, 1 for those to the side
    - every: the distance of the rows or columns that are looked at
    """
    lower = image[image.shape[0] // 2 :]
    red = lower if lower.ndim == 2 else lower[:, :, 2]
    lines = (red[:, ::every] if axis == 0 else red[::every].T).astype(np.int16, order="C")
    if len(lines) <= _APART:
        return 1.0
    apart = float(np.abs(lines[_APART:] - lines[:-_APART]).mean())
    return float(np.abs(lines[1:] - lines[:-1]).mean()) / apart if apart else 1.0


def sharpened(image: Image) -> tuple[Image, bool]:
    """The picture, sharpened along the axes along which it is smeared, and whether it was smeared
    up and down."""
    wide = 2 * round(_WIDE * image.shape[1] / 2) + 1
    smeared = [sharpness(image, axis) < _SMEARED for axis in (0, 1)]
    for is_smeared, size in zip(smeared, ((1, wide), (wide, 1)), strict=True):
        if is_smeared:
            sharp = cv2.addWeighted(image, 1 + _GAIN, cv2.blur(image, size), -_GAIN, 0)
            image = sharp.astype(np.uint8, copy=False)
    return image, smeared[0]


def is_nothing_but_noise(image: Image) -> bool:
    """Whether a picture, (H, W, 3) or (H, W), stays noise where blocks of it are averaged."""
    share = 1 / _BLOCK
    small = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return sharpness(small.astype(np.uint8, copy=False), 0, every=1) > _NOTHING
