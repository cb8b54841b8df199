"""The types of a picture: an image, and one frame of a drive with one or two images; and the
check of its size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import InputError

#: (H, W, 3), blue green red, as OpenCV has it.
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Picture:
    """One frame of a drive. right: the image of the second camera of a rectified stereo pair."""

    frame_id: int
    image: Image
    right: Image | None = None


#: Bytes that have to be free before anything is decoded, beside the pictures.
_ROOM = 64 << 20


def check_room(n_pixels: float = 0) -> None:
    """Raises MemoryError where there may be too little memory to decode what has so many pixels.
    OpenCV and FFmpeg take a picture for which they find none for a damaged one, leave it out, or
    end the video before it."""
    # It is not written to, so nothing but addresses is taken.
    np.empty(_ROOM + int(3 * n_pixels), dtype=np.uint8)


def check_size(image: Image, width: int, height: int) -> None:
    """Raises InputError for a picture of another size than the camera was calibrated for."""
    if image.shape[:2] != (height, width):
        raise InputError(
            f"a picture of {image.shape[1]}x{image.shape[0]} pixels, but the camera was calibrated"
            f" for {width}x{height}; calibrate with pictures of this size"
        )
