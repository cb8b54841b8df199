"""Kernels of backward smoothing and of the most probable path."""

from __future__ import annotations

import numpy as np

from egolane_pgm.inference.kernels.filter import LEAST
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray


@kernel(fastmath={"reassoc", "contract"})
def _look_ahead(
    filtered: FloatArray, transition: FloatArray, weight: FloatArray, onward: FloatArray
) -> None:
    """onward (S,): written, the transition times weight (S,), for the states that are possible."""
    n_states = filtered.shape[0]
    for r in range(n_states):
        total = 0.0
        if filtered[r] > 0.0:
            for s in range(n_states):
                total += transition[r, s] * weight[s]
        onward[r] = total


@kernel()
def _look_back(
    filtered: FloatArray,
    transition: FloatArray,
    likelihood: FloatArray,
    ahead: FloatArray,
    weight: FloatArray,
    onward: FloatArray,
    moves: FloatArray,
) -> None:
    """One frame back. filtered (S,): the belief after it. transition (S, S): out of it.

    ahead (S,): P(evidence after the later frame | its state), divided by the largest one;
        overwritten by the values of the earlier frame.
    likelihood (S,): of the later frame's evidence.
    weight, onward (S,): room for intermediate results.
    moves (S, S): P(state before, state now | all evidence) is added, unless it is (0, 0).

    Later evidence that no state of the filter can lead to, in floating-point numbers, is ignored.
    """
    n_states = filtered.shape[0]
    for s in range(n_states):
        weight[s] = likelihood[s] * ahead[s]
    _look_ahead(filtered, transition, weight, onward)
    largest, total = 0.0, 0.0
    for r in range(n_states):
        largest = max(largest, onward[r])
        total += filtered[r] * onward[r]
    for r in range(n_states):
        ahead[r] = onward[r] / largest if largest > 0.0 else 1.0
    if moves.shape[0] > 0 and total >= LEAST:
        for r in range(n_states):
            share = filtered[r] / total
            for s in range(n_states):
                moves[r, s] += transition[r, s] * weight[s] * share


@kernel()
def _combine(filtered: FloatArray, ahead: FloatArray, smoothed: FloatArray) -> None:
    """smoothed (S,): filtered times ahead, normalised; filtered if the product is zero."""
    total = 0.0
    for s in range(filtered.shape[0]):
        smoothed[s] = filtered[s] * ahead[s]
        total += smoothed[s]
    for s in range(filtered.shape[0]):
        smoothed[s] = smoothed[s] / total if total > 0.0 else filtered[s]


@kernel()
def smooth_frames(
    filtered: FloatArray,
    likelihood: FloatArray,
    transition: FloatArray,
    index: IntArray,
    begins: BoolArray,
    smoothed: FloatArray,
    moves: FloatArray,
) -> None:
    """Smooth T frames backwards, given all frames of their sequence.

    filtered (T, S): the joint belief after each frame. likelihood (T, S): of each frame's evidence,
        any scale; one in frames whose evidence is ignored.
    transition (U, S, S); index (T,): which of the U leads into a frame.
    begins (T,): True where a sequence begins.
    smoothed (T, S): written, the joint belief about each frame.
    moves (S, S): the expected number of moves between states is added; (0, 0) to count none.
    """
    n_frames, n_states = filtered.shape
    ahead, weight, onward = np.ones(n_states), np.empty(n_states), np.empty(n_states)
    for t in range(n_frames - 1, -1, -1):
        _combine(filtered[t], ahead, smoothed[t])
        if begins[t]:
            ahead[:] = 1.0
        elif t > 0:
            into = transition[index[t]]
            _look_back(filtered[t - 1], into, likelihood[t], ahead, weight, onward, moves)


@kernel()
def fixed_lag_frames(
    lag: int,
    filtered: FloatArray,
    likelihood: FloatArray,
    transition: FloatArray,
    index: IntArray,
    begins: BoolArray,
    smoothed: FloatArray,
) -> None:
    """As `smooth_frames`, frame t given the evidence up to frame t + lag."""
    n_frames, n_states = filtered.shape
    ahead, weight, onward = np.ones(n_states), np.empty(n_states), np.empty(n_states)
    nothing = np.empty((0, 0))
    stop = n_frames
    for t in range(n_frames - 1, -1, -1):
        for s in range(n_states):
            ahead[s] = 1.0
        for k in range(min(t + lag, stop - 1), t, -1):
            into = transition[index[k]]
            _look_back(filtered[k - 1], into, likelihood[k], ahead, weight, onward, nothing)
        _combine(filtered[t], ahead, smoothed[t])
        if begins[t]:
            stop = t


@kernel()
def best_path(
    log_prior: FloatArray,
    log_transition: FloatArray,
    log_likelihood: FloatArray,
    index: IntArray,
    path: IntArray,
) -> float:
    """The most probable joint states (T,), the lowest-numbered one in a tie, and the logarithm of
    their probability with the evidence. log_prior (U, S), log_transition (U, S, S),
    log_likelihood (T, S)."""
    n_frames, n_states = log_likelihood.shape
    score = log_prior[index[0]] + log_likelihood[0]
    before = np.empty(n_states)
    came_from = np.zeros((n_frames, n_states), dtype=np.int64)
    for t in range(1, n_frames):
        move = log_transition[index[t]]
        before[:] = score
        for s in range(n_states):
            best = -np.inf
            for r in range(n_states):
                value = before[r] + move[r, s]
                if value > best:
                    best = value
                    came_from[t, s] = r
            score[s] = best + log_likelihood[t, s]
    state = 0
    for s in range(n_states):
        if score[s] > score[state]:
            state = s
    total = float(score[state])
    for t in range(n_frames - 1, -1, -1):
        path[t] = state
        state = came_from[t, state]
    return total
