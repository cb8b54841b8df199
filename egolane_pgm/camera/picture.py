"""The types of a picture: an image, and one frame of a drive with one or two images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: (H, W, 3), blue green red, as OpenCV has it.
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Picture:
    """One frame of a drive. right: the image of the second camera of a rectified stereo pair."""

    frame_id: int
    image: Image
    right: Image | None = None
