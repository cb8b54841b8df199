"""Kernel of the adjoint recursion: the gradient of a function of the filtered beliefs."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: The log-loss of a smaller probability is constant.
SMALLEST = 1e-12


@lru_cache(maxsize=64)
def adjoint_kernel(n_states: int = 0) -> Any:
    """The adjoint of the forward recursion.

    n_states: number of joint states that it is compiled for; 0 for any number.
    """

    @kernel(fastmath={"contract"}, error_model="numpy")
    def adjoint(
        filtered: FloatArray,
        likelihood: FloatArray,
        total: FloatArray,
        is_known: BoolArray,
        weight: FloatArray,
        transition: FloatArray,
        index: IntArray,
        begins: BoolArray,
        probability: FloatArray,
        states: FloatArray,
        moves: FloatArray,
    ) -> None:
        """Differentiate the sum of weight times log P(known values) of T frames, backwards.

        filtered (T, S): the joint belief after each frame. likelihood (T, S): of each frame's
            evidence; one in frames whose evidence is ignored. total (T,): the mass of the
            prediction times the likelihood.
        is_known (T, S): the states that agree with the known values; all if none is known.
        weight (T,): of each frame.
        transition (U, S, S); index (T,): which of the U leads into a frame.
        begins (T,): True where a sequence begins, as in the first frame.
        probability (T,): written, of the known values.
        states (T, S): written, derivative by the logarithm of each likelihood (in first frames
            also of the prior).
        moves (U, S, S): the derivatives by the logarithm of each transition are added.
        """
        n = n_states if n_states else filtered.shape[1]
        # One array, so that the compiler sees that its parts do not overlap. `backward` is the
        # transposed transition; `slope` the derivative by the belief of a frame.
        work = np.zeros(2 * n * n + 2 * n)
        backward = work[: n * n]
        used = work[n * n : 2 * n * n]
        slope = work[2 * n * n : 2 * n * n + n]
        share = work[2 * n * n + n :]
        held = -1
        for t in range(filtered.shape[0] - 1, -1, -1):
            mass = 0.0
            n_agree = 0
            for s in range(n):
                if is_known[t, s]:
                    mass += filtered[t, s]
                    n_agree += 1
            probability[t] = mass if n_agree < n else 1.0
            if n_agree < n and mass > SMALLEST:
                for s in range(n):
                    if is_known[t, s]:
                        slope[s] += weight[t] / mass
            mean = 0.0
            for s in range(n):
                mean += slope[s] * filtered[t, s]
            for s in range(n):
                slope[s] -= mean
                states[t, s] = slope[s] * filtered[t, s]
            if begins[t]:
                for s in range(n):
                    slope[s] = 0.0
                continue
            if index[t] != held:
                if held >= 0:
                    for r in range(n):
                        for s in range(n):
                            moves[held, r, s] += transition[held, r, s] * used[r * n + s]
                held = index[t]
                for r in range(n):
                    for s in range(n):
                        backward[s * n + r] = transition[held, r, s]
                        used[r * n + s] = 0.0
            scale = 1.0 / total[t]
            for s in range(n):
                share[s] = slope[s] * likelihood[t, s] * scale
            for s in range(n):
                slope[s] = 0.0
            for s in range(n):
                for r in range(n):
                    slope[r] += backward[s * n + r] * share[s]
            for r in range(n):
                before = filtered[t - 1, r]
                for s in range(n):
                    used[r * n + s] += before * share[s]
        if held >= 0:
            for r in range(n):
                for s in range(n):
                    moves[held, r, s] += transition[held, r, s] * used[r * n + s]

    return adjoint
