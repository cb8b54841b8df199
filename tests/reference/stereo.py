"""What the stereo kernels of `detectors.simple.kernels` compute, in plain NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray, IntArray


def full_disparity(
    found: NDArray[np.float32],
    flat: FloatArray,
    u: FloatArray,
    below_px: int,
    n_disparities: int,
    scale: int,
    edge_px: int,
) -> FloatArray:
    """(H, W): disparities of the full pictures, as `kernels.full_disparity`."""
    kept = np.where((found >= 0) & (found < n_disparities), found.astype(np.float64), np.nan)
    disparity = scale * (kept - below_px) + flat
    disparity[u - np.maximum(disparity, flat) < edge_px] = np.nan
    return disparity


def off_the_plane(
    disparity: FloatArray,
    plane: FloatArray,
    u: FloatArray,
    v: FloatArray,
    least_share: float,
    least_px: float,
) -> NDArray[np.uint8]:
    """(H, W): what is not on the plane, as `kernels.off_the_plane`."""
    flat = plane[0] * u + plane[1] * v + plane[2]
    off = np.abs(1 - flat / disparity) > least_share
    return (off & (np.abs(disparity - flat) > least_px)).astype(np.uint8)


def count_near(
    tilts: FloatArray, points: FloatArray, values: FloatArray, tolerance: float
) -> IntArray:
    """(K,): how many values lie near each plane, as `kernels.count_near`."""
    away = tilts[:, :2] @ points + tilts[:, 2:] - values
    return (np.abs(away) <= tolerance).sum(axis=1)
