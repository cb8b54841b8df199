"""The numba kernel that goes from beliefs to a confusion matrix in one pass.

`assign.assigned_lane` and `confusion.confusion` say the same with NumPy, and check their input.
"""

from __future__ import annotations

from numba import njit

from egolane_pgm.types import BoolArray, FloatArray, IntArray


@njit(cache=True)
def count_confusion(
    belief: FloatArray,
    lane: IntArray,
    is_crossing: BoolArray,
    tolerance: float,
    counts: IntArray,
) -> None:
    """Add the frames of a belief (T, n) to counts (n + 1, n).

    lane (T,): the true lane, 1..n where is_crossing (T,) is False; crossing frames are left out.
    The row is the most probable lane, or n (Unassigned) where another is within `tolerance` of
    it, relative.
    """
    n_lanes = belief.shape[1]
    for t in range(belief.shape[0]):
        if is_crossing[t]:
            continue
        top = belief[t, 0]
        row = 0
        for k in range(1, n_lanes):
            if belief[t, k] > top:
                top = belief[t, k]
                row = k
        bound = top - tolerance * top
        for k in range(n_lanes):
            if k != row and belief[t, k] >= bound:
                row = n_lanes
                break
        counts[row, lane[t] - 1] += 1
