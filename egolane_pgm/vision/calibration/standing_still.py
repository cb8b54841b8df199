"""Finds what stands still in every picture of a drive: a watermark, a bonnet, dirt on the screen.

Its edges are at the same pixels, in the same direction, in nearly all pictures. So are those of a
continuous line in a short drive, but these point at where the lines of the road meet.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from egolane_pgm.types import BoolArray, FloatArray
from egolane_pgm.vision.camera.picture import Image

#: The fewest pictures that show that something stands still.
LEAST_PICTURES = 8

#: An edge is a change of brightness by this many grey levels per pixel. It stands still if it is
#: there, and in the same direction, in this share of the pictures.
_EDGE, _ALWAYS = 6.0, 0.9

#: Edges this near to each other, pixels, are of one thing.
_NEAR_PX = 15

#: A thing is a line of the road if more than the second share of its edges points at where lines
#: meet, within the first value (the sine of the angle).
_POINTS_AT, _LINE = 0.15, 0.5


def edge_counter(
    width: int, height: int
) -> tuple[Callable[[Image], None], Callable[[FloatArray, BoolArray], BoolArray]]:
    """Makes two functions: one to call with each picture (H, W, 3), and one that takes the pixel
    (2,) at which the lines of the road meet and the pixels (H, W) that may show road, and gives
    these without those of things that stood still; with too few pictures, all."""
    total = np.zeros((2, height, width), dtype=np.float32)
    often = np.zeros((height, width), dtype=np.uint16)
    n = 0

    def add(image: Image) -> None:
        nonlocal n, often
        n += 1
        grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0)
        slope = np.stack([cv2.Sobel(grey, cv2.CV_32F, *to, scale=1 / 8) for to in ((1, 0), (0, 1))])
        size = np.hypot(*slope)
        total[:] += slope / np.maximum(size, 1e-3)
        often += size > _EDGE

    def moving(meeting: FloatArray, mask: BoolArray) -> BoolArray:
        if n < LEAST_PICTURES:
            return mask
        stands = mask & (often >= _ALWAYS * n) & (np.hypot(*total) >= _ALWAYS * n)
        things = cv2.dilate(stands.astype(np.uint8), np.ones((_NEAR_PX, _NEAR_PX), dtype=np.uint8))
        count, names, boxes, _ = cv2.connectedComponentsWithStats(things)
        v, u = np.nonzero(stands)
        to = np.stack([u - meeting[0], v - meeting[1]])
        across = np.abs((total[:, v, u] * to).sum(axis=0)) / n / np.maximum(np.hypot(*to), 1)
        thing = names[v, u]
        n_edges = np.maximum(np.bincount(thing, minlength=count), 1)
        is_line = np.bincount(thing, across < _POINTS_AT, count) / n_edges > _LINE
        # A vehicle ahead may keep its distance for the whole of a short drive.
        is_low = boxes[:, 1] + boxes[:, 3] / 2 > (meeting[1] + height) / 2
        is_low[0] = False
        moves: BoolArray = ~(is_low & ~is_line)[names]
        moves &= mask
        return moves

    return add, moving
