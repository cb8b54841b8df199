"""Kernels of backward smoothing and of the most probable path."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from egolane_pgm.inference.kernels.filter import LEAST
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray


@lru_cache(maxsize=64)
def smooth_kernel(n_states: int = 0) -> Any:
    """The backward recursion, compiled for a number of joint states; 0 for any number."""

    # Of fast arithmetic only the fusing of a multiplication with an addition, as in the filter.
    @kernel(fastmath={"contract"}, error_model="numpy")
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

        filtered (T, S): the joint belief after each frame. likelihood (T, S): of each frame's
            evidence, any scale; one in frames whose evidence is ignored.
        transition (U, S, S); index (T,): which of the U leads into a frame.
        begins (T,): True where a sequence begins.
        smoothed (T, S): written, the joint belief about each frame.
        moves (U, S, S): the expected number of moves between states is added; empty to count none.

        Later evidence that no state of the filter can lead to, in floating-point numbers, is
        ignored.
        """
        n_frames = filtered.shape[0]
        n = n_states if n_states else filtered.shape[1]
        # One array, so that the compiler sees that its parts do not overlap. `backward` is the
        # transposed transition, whose rows are added up as vectors; `ahead` is P(evidence after the
        # frame | its state), divided by the largest one.
        work = np.ones(n * n + 3 * n)
        backward = work[: n * n]
        ahead = work[n * n : n * n + n]
        weight = work[n * n + n : n * n + 2 * n]
        onward = work[n * n + 2 * n :]
        held = -1
        for t in range(n_frames - 1, -1, -1):
            total = 0.0
            for s in range(n):
                onward[s] = filtered[t, s] * ahead[s]
                total += onward[s]
            for s in range(n):
                smoothed[t, s] = onward[s] / total if total > 0.0 else filtered[t, s]
            if begins[t] or t == 0:
                ahead[:] = 1.0
                continue
            if index[t] != held:
                held = index[t]
                for r in range(n):
                    for s in range(n):
                        backward[s * n + r] = transition[held, r, s]
            onward[:] = 0.0
            for s in range(n):
                weight[s] = likelihood[t, s] * ahead[s]
                for r in range(n):
                    onward[r] += backward[s * n + r] * weight[s]
            largest = 0.0
            total = 0.0
            for r in range(n):
                if filtered[t - 1, r] <= 0.0:
                    onward[r] = 0.0
                largest = max(largest, onward[r])
                total += filtered[t - 1, r] * onward[r]
            for r in range(n):
                ahead[r] = onward[r] / largest if largest > 0.0 else 1.0
            if moves.shape[0] > 0 and total >= LEAST:
                for r in range(n):
                    share = filtered[t - 1, r] / total
                    for s in range(n):
                        moves[held, r, s] += transition[held, r, s] * weight[s] * share

    return smooth_frames


#: The backward recursion for any number of joint states.
smooth_frames = smooth_kernel()


@lru_cache(maxsize=64)
def count_kernel(known_values: int = 0, known_states: int = 0) -> Any:
    """The counts of a group's values, compiled for its sizes; 0 for any size."""

    @kernel(fastmath={"contract"}, error_model="numpy")
    def count_values(
        block: FloatArray, emission: FloatArray, states: FloatArray, counts: FloatArray
    ) -> None:
        """Count how often each joint state shows each value of a group.

        block (T, K): the group's evidence e. emission (K, S). states (T, S): counts of joint
            states.
        counts (K, S): states * P(value | state) e(value) / P(e | state) is added.
        """
        n_values = known_values if known_values else emission.shape[0]
        n_states = known_states if known_states else emission.shape[1]
        # One array, so that the compiler sees that its parts do not overlap.
        work = np.zeros(n_values * n_states + n_states)
        shown = work[: n_values * n_states]
        weight = work[n_values * n_states :]
        for t in range(block.shape[0]):
            largest = 0.0
            for k in range(n_values):
                largest = max(largest, block[t, k])
            if largest <= 0.0:
                continue
            for s in range(n_states):
                weight[s] = 0.0
            for k in range(n_values):
                share = block[t, k] / largest
                for s in range(n_states):
                    weight[s] += share * emission[k, s]
            for s in range(n_states):
                weight[s] = states[t, s] / weight[s] if weight[s] >= LEAST else 0.0
            for k in range(n_values):
                share = block[t, k] / largest
                for s in range(n_states):
                    shown[k * n_states + s] += share * weight[s]
        for k in range(n_values):
            for s in range(n_states):
                counts[k, s] += emission[k, s] * shown[k * n_states + s]

    return count_values


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
    window = np.empty((min(lag + 1, n_frames), n_states))
    nothing = np.empty((0, 0, 0))
    end = n_frames
    for t in range(n_frames - 1, -1, -1):
        part = slice(t, min(t + lag + 1, end))
        smooth_frames(
            filtered[part], likelihood[part], transition, index[part], begins[part], window, nothing
        )
        smoothed[t] = window[0]
        if begins[t]:
            end = t


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
