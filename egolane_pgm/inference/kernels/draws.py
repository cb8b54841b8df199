"""Kernels that draw paths of the joint state."""

from __future__ import annotations

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray


@kernel()
def _chosen(cumulative: FloatArray, uniform: float) -> int:
    """The first index whose cumulative weight is above the uniform share of the total."""
    goal = uniform * cumulative[-1]
    low = 0
    high = cumulative.shape[0] - 1
    while low < high:
        middle = (low + high) // 2
        if cumulative[middle] > goal:
            high = middle
        else:
            low = middle + 1
    return low


@kernel()
def draw_forward(
    prior: FloatArray,
    transition: FloatArray,
    index: IntArray,
    uniform: FloatArray,
    paths: IntArray,
) -> None:
    """Draw n paths of T frames from the model.

    prior (U, S), transition (U, S, S): cumulative along the last axis.
    index (T,): which of the U holds in a frame.
    uniform (n, T): in [0, 1).
    paths (n, T): written.
    """
    for k in range(paths.shape[0]):
        paths[k, 0] = _chosen(prior[index[0]], uniform[k, 0])
        for t in range(1, paths.shape[1]):
            paths[k, t] = _chosen(transition[index[t], paths[k, t - 1]], uniform[k, t])


@kernel()
def draw_backward(
    filtered: FloatArray,
    transition: FloatArray,
    index: IntArray,
    begins: BoolArray,
    uniform: FloatArray,
    paths: IntArray,
) -> None:
    """Draw n paths of T frames from the posterior, given the filter's beliefs, backwards.

    filtered (T, S): the joint belief after each frame.
    transition (U, S, S); index (T,): which of the U leads into a frame.
    begins (T,): True where a sequence begins.
    uniform (n, T): in [0, 1).
    paths (n, T): written.
    """
    n_frames, n_states = filtered.shape
    cumulative = np.empty((n_states, n_states))
    # The frame whose weights are in `cumulative`, for each next state.
    known = np.full(n_states, -1, dtype=np.int64)
    for t in range(n_frames - 1, -1, -1):
        is_last = t == n_frames - 1 or begins[t + 1]
        for k in range(paths.shape[0]):
            after = 0 if is_last else paths[k, t + 1]
            if known[after] != t:
                known[after] = t
                total = 0.0
                for r in range(n_states):
                    move = 1.0 if is_last else transition[index[t + 1], r, after]
                    total += filtered[t, r] * move
                    cumulative[after, r] = total
            paths[k, t] = _chosen(cumulative[after], uniform[k, t])
