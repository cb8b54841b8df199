"""Lane markings, row by row, and the seeds that they make: short runs of markings below one
another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.classic.multilane.road import Road, flattened
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.camera.model import is_shown

#: Half width of the edge filter, pixels: far away, and how much more at the bottom.
FILTER = (3.0, 9.0)

#: An edge is a step of more than this share of the darker side, plus this number of grey levels.
EDGE = (0.2, 5.0)

#: Largest squared distance of a marking that continues a seed, square pixels.
NEAR = 90.0

#: Largest change of direction of a marking that continues a seed, radians.
TURN = 0.8

#: Weight of a seed's direction so far against its last step.
KEPT = 0.8

#: Markings of the shortest seed.
LEAST = 5


@dataclass(frozen=True)
class Markings:
    """The N markings of a picture, grouped by seed, each seed from top to bottom.

    - row, left, right: (N,) pixels
    - starts: (S + 1,) where each of the S seeds begins, and N
    """

    row: FloatArray
    left: FloatArray
    right: FloatArray
    starts: IntArray

    @property
    def u(self) -> FloatArray:
        """The column of each marking's centre, (N,)."""
        return (self.left + self.right) / 2

    def points(self, road: Road) -> tuple[FloatArray, FloatArray]:
        """Return t and the column, (N,) each, of the markings, without lens distortion."""
        return flattened(road, self.row, self.u)

    @property
    def seed(self) -> IntArray:
        """The seed of each marking, (N,)."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def __len__(self) -> int:
        return len(self.starts) - 1


def grouped(row: FloatArray, left: FloatArray, right: FloatArray, group: IntArray) -> Markings:
    """Sort markings (N,) by their groups (N,) and leave out negative groups."""
    order = np.lexsort((row, group))
    order = order[group[order] >= 0]
    starts = np.flatnonzero(np.diff(group[order], prepend=-1, append=-1))
    if not len(order):
        starts = np.zeros(1, dtype=np.int64)
    return Markings(row[order], left[order], right[order], starts)


def find_markings(grey: NDArray[np.uint8], road: Road) -> Markings:
    """The markings of a picture, (H, W), that make seeds."""
    row, left, right = edge_pairs(grey, road.top, road.narrowest, road.widest, road.scale)
    is_road = is_shown(road.camera, (left + right) / 2, row)
    row = row[is_road]
    left = left[is_road]
    right = right[is_road]
    seed = seeds_of(row, left, right, NEAR * road.scale**2)
    is_long = np.bincount(seed, minlength=1)[seed] >= max(2, round(LEAST * road.row_scale))
    return grouped(row.astype(np.float64), left, right, np.where(is_long, seed, -1))


@kernel()
def edge_pairs(
    grey: NDArray[np.uint8], top: int, narrowest: FloatArray, widest: FloatArray, scale: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Find the rows and the left and right edges, (N,) each, pixels, of stripes that are brighter
    than both sides and as wide as a marking.

    - grey: (H, W)
    - top: the first row that is searched
    - narrowest, widest: (R,) limits of a marking's width in the rows from `top` on, pixels
    - scale: of the filter's size
    """
    width = grey.shape[1]
    n_rows = len(narrowest)
    most = n_rows * (width // 2 + 1)
    row = np.empty(most, dtype=np.int64)
    left = np.empty(most)
    right = np.empty(most)
    total = np.zeros(width + 1, dtype=np.int64)
    n = 0
    for k in range(n_rows):
        v = top + k
        h = max(1, int(scale * (FILTER[0] + FILTER[1] * k / max(1, n_rows - 1)) + 0.5))
        for x in range(width):
            total[x + 1] = total[x] + grey[v, x]
        rising = -1.0
        begin = 0
        sign = 0
        for x in range(h, width - h + 2):
            here = 0
            if x <= width - h:
                before = (total[x] - total[x - h]) / h
                after = (total[x + h] - total[x]) / h
                if abs(after - before) > EDGE[0] * min(before, after) + EDGE[1]:
                    here = 1 if after > before else -1
            if here == sign:
                continue
            middle = (begin + x - 1) / 2 - 0.5
            if sign == 1:
                rising = middle
            elif sign == -1 and rising >= 0:
                if narrowest[k] <= middle - rising <= widest[k]:
                    row[n] = v
                    left[n] = rising
                    right[n] = middle
                    n += 1
                rising = -1.0
            begin = x
            sign = here
    return row[:n].copy(), left[:n].copy(), right[:n].copy()


@kernel()
def seeds_of(row: IntArray, left: FloatArray, right: FloatArray, near: float) -> IntArray:
    """The seed, (N,), numbered from 0, that each marking belongs to.

    - row, left, right: (N,) the markings, top to bottom
    - near: the largest squared distance from a seed's last marking, pixels
    """
    n = len(row)
    seed = np.empty(n, dtype=np.int64)
    last = np.empty(n, dtype=np.int64)
    direction = np.empty(n)
    count = np.zeros(n, dtype=np.int64)
    # Seeds before `oldest` are too far above to be continued; they are in the order of their start,
    # not of their end, so this only shortens the search.
    oldest = 0
    n_seeds = 0
    for i in range(n):
        while oldest < n_seeds and (row[i] - row[last[oldest]]) ** 2 >= near:
            oldest += 1
        best = -1
        least = near
        leans = 0.0
        for s in range(oldest, n_seeds):
            j = last[s]
            down = float(row[i] - row[j])
            if down <= 0.0 or left[i] > right[j] or left[j] > right[i]:
                continue
            across = (left[i] + right[i] - left[j] - right[j]) / 2
            square = across * across + down * down
            lean = math.atan2(across, down)
            if square < least and (count[s] < 2 or abs(lean - direction[s]) < TURN):
                best = s
                least = square
                leans = lean
        if best < 0:
            best = n_seeds
            n_seeds += 1
        elif count[best] == 1:
            direction[best] = leans
        else:
            direction[best] = KEPT * direction[best] + (1.0 - KEPT) * leans
        last[best] = i
        count[best] += 1
        seed[i] = best
    return seed
