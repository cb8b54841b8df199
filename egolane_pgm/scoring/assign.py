"""From a belief to an answer: the lane that a frame is assigned to, or Unassigned."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import TIE_TOLERANCE, UNASSIGNED, IntArray


def assigned_lane(belief: ArrayLike, unassigned_below: float = 0.0) -> IntArray:
    """The most probable lane of each frame, 1..n, or UNASSIGNED (0) where it is not unique.

    belief (T, n): non-negative; need not be normalised (a tentative vector will do). The maximum
        is not unique when the runner-up is within TIE_TOLERANCE of it, relative; so a row of zeros
        is Unassigned. One lane (n = 1) is always lane 1.
    unassigned_below: a row whose maximum is less than this is Unassigned too (the reject option,
        for normalised beliefs; 0 for none).

    Returns (T,).
    """
    values = np.asarray(belief, dtype=np.float64)
    n_lanes = values.shape[1]
    # A row per lane: NumPy reduces over a short last axis one frame at a time, which is slow.
    rows = np.ascontiguousarray(values.T)
    top = np.maximum.reduce(rows)
    is_near_top = rows >= top - TIE_TOLERANCE * top
    is_near_top &= top >= unassigned_below
    small = np.min_scalar_type(n_lanes)
    lane = np.maximum.reduce(is_near_top * np.arange(1, n_lanes + 1, dtype=small)[:, None])
    is_unique = np.add.reduce(is_near_top, dtype=small) == 1
    return np.where(is_unique, lane, UNASSIGNED).astype(np.int64)
