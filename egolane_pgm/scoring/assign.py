"""From a belief to an answer: the lane that a frame is assigned to, or Unassigned."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import TIE_TOLERANCE, UNASSIGNED, FloatArray, IntArray


def assigned_lane(belief: ArrayLike, unassigned_below: float = 0.0) -> IntArray:
    """The most probable lane of each frame, 1..n, or UNASSIGNED (0) where it is not unique.

    belief (T, n): non-negative; need not be normalised (a tentative vector will do). The maximum
        is not unique when the runner-up is within TIE_TOLERANCE of it, relative; so a row of zeros
        is Unassigned. One lane (n = 1) is always lane 1.
    unassigned_below: a row whose maximum is less than this is Unassigned too (the reject option,
        for normalised beliefs; 0 for none).

    Returns (T,).
    """
    values = np.ascontiguousarray(belief, dtype=np.float64)
    lane = np.empty(len(values), dtype=np.int64)
    _assign(values, unassigned_below, lane)
    return lane


@kernel()
def _assign(values: FloatArray, below: float, lane: IntArray) -> None:
    """Fills lane (T,); see `assigned_lane`."""
    for t in range(len(values)):
        top = values[t].max()
        lane[t] = UNASSIGNED
        n_near = 0
        for k in range(values.shape[1]):
            if top >= below and values[t, k] >= top - TIE_TOLERANCE * top:
                lane[t] = k + 1 if n_near == 0 else UNASSIGNED
                n_near += 1
