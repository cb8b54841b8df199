"""Checks of what the scores are given: one entry per frame, lanes in range, rows that sum to 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

#: Rows of a belief may miss a sum of one by this much (rounding, single precision on disk).
SUM_TOLERANCE = 1e-5


def as_belief(belief: ArrayLike, *, normalised: bool) -> FloatArray:
    """The belief as (T, n) float64; InputError for another shape or for rows that are no belief.

    Not negative and finite; with `normalised` each row also sums to 1.
    """
    values = np.asarray(belief, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] < 1:
        raise InputError(f"belief has shape {values.shape}, needs (frames, lanes)")
    is_fine = np.isfinite(values) & (values >= 0)
    if not is_fine.all():
        row = int(np.argmin(is_fine.all(axis=1)))
        raise InputError(f"belief: row {row} has a negative, NaN or infinite value")
    if normalised:
        total = values.sum(axis=1)
        bad = np.abs(total - 1) > SUM_TOLERANCE
        if bad.any():
            k = int(np.argmax(bad))
            raise InputError(f"belief: row {k} sums to {total[k]:.6g}, not 1; normalise it first")
    return values


def as_lanes(lane: ArrayLike, n_frames: int, what: str = "lane") -> IntArray:
    """The lanes as (T,) int64; InputError where there is not one whole number per frame."""
    values = np.asarray(lane)
    if values.shape != (n_frames,):
        raise InputError(f"{what} has shape {values.shape}, needs ({n_frames},): one per frame")
    if n_frames and values.dtype.kind not in "iu":
        raise InputError(f"{what} is of type {values.dtype}, needs whole numbers")
    return values.astype(np.int64, copy=False)


def as_mask(mask: ArrayLike, n_frames: int, what: str = "is_crossing") -> BoolArray:
    """The mask as (T,) bool; InputError for another shape."""
    values = np.asarray(mask)
    if values.shape != (n_frames,):
        raise InputError(f"{what} has shape {values.shape}, needs ({n_frames},): one per frame")
    return values.astype(np.bool_, copy=False)


def check_range(lane: IntArray, among: BoolArray, lowest: int, n_lanes: int, what: str) -> None:
    """InputError naming the first row in `among` whose lane is outside lowest..n_lanes."""
    bad = among & ((lane < lowest) | (lane > n_lanes))
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(
            f"{what}: row {k} has lane {int(lane[k])}, outside {lowest}..{n_lanes};"
            " is n_lanes right?"
        )


def scored_frames(
    belief: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, *, normalised: bool = True
) -> tuple[FloatArray, IntArray, BoolArray]:
    """The belief (T, n), the true lanes (T,) and which frames are scored (T,): those not crossing.
    InputError for a belief that is none, or lanes outside 1..n in a scored frame."""
    values = as_belief(belief, normalised=normalised)
    n_frames, n_lanes = values.shape
    actual = as_lanes(lane, n_frames)
    is_scored = ~as_mask(is_crossing, n_frames)
    check_range(actual, is_scored, 1, n_lanes, "ground truth")
    return values, actual, is_scored


def check_frame_rate(frame_rate: float) -> None:
    """InputError for a frame rate that is not a positive, finite number."""
    if not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"frame_rate: {frame_rate} must be greater than 0 (frames per second)")
