"""The types of a picture: an image, and one frame of a drive with one or two images; and the
check of its size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import InputError

#: (H, W, 3), blue green red, the order of OpenCV.
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Picture:
    """One frame of a drive. right: the image of the second camera of a rectified stereo pair."""

    frame_id: int
    image: Image
    right: Image | None = None


def as_image(values: NDArray[Any]) -> Image:
    """Type the result of an OpenCV function on pictures of 8 bits, which its stubs do not know."""
    return values.astype(np.uint8, copy=False)


def rectangle(height: int, width: int) -> Image:
    """The neighbourhood (height, width) of a morphological filter, pixels."""
    return np.ones((height, width), dtype=np.uint8)


def check_size(image: Image, width: int, height: int) -> None:
    """Raise InputError for a picture of another size than the camera was calibrated for."""
    if image.shape[:2] != (height, width):
        raise InputError(
            f"a picture of {image.shape[1]}x{image.shape[0]} pixels, but the camera was calibrated"
            f" for {width}x{height}; calibrate with pictures of this size"
        )
