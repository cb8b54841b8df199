"""What `detectors.simple.kernels` computes about vehicles' feet, in plain NumPy."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from egolane_pgm.types import BoolArray, FloatArray


def feet_on_rays(
    above: NDArray[np.uint8],
    valid: BoolArray,
    far_m: float,
    left_m: float,
    along_m: float,
    across_m: float,
    rays: FloatArray,
    x: FloatArray,
    share: float,
    n_dark: int,
    n_edge: int,
    n_road: int,
) -> NDArray[np.uint8]:
    """(K, A): where rays meet the dark foot of a vehicle, as `kernels.feet_on_rays`."""
    row = np.trunc((far_m - x) / along_m + 0.5).astype(int)[:, None]
    column = np.floor((x[:, None] * rays - left_m) / across_m + 0.5).astype(int)
    inside = (row >= 0) & (row < above.shape[0]) & (column >= 0) & (column < above.shape[1])
    at = np.where(inside, row, 0), np.where(inside, column, 0)
    seen = inside & valid[at]
    along = np.where(seen, above[at].astype(float), np.nan)
    windows = sliding_window_view(along, n_road + n_edge + n_dark, axis=0)
    road, dark = windows[..., :n_road].mean(-1), windows[..., n_road + n_edge :].mean(-1)
    known = ~np.isnan(windows).any(-1)
    out = np.zeros((len(x), len(rays)), dtype=np.uint8)
    first = n_road + n_edge
    out[first : first + len(windows)] = known & (dark < share * road)
    return out


def in_front(
    ends: FloatArray, x: FloatArray, y: FloatArray, first: float, step: float
) -> BoolArray:
    """(R, C): which pixels are nearer than the end of their ray, as `kernels.in_front`."""
    ray = np.floor((y / x[:, None] - first) / step + 0.5).astype(int)
    inside = (ray >= 0) & (ray < len(ends))
    out: BoolArray = ~inside | (x[:, None] < ends[np.where(inside, ray, 0)])
    return out
