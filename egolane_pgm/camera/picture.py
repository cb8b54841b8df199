"""One frame of a camera, or of two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Picture:
    """One frame: image (H, W, 3), blue green red; right: the second camera's, rectified."""

    frame_id: int
    image: Image
    right: Image | None = None
