"""The forward recursion and the likelihood that it takes, compiled.

Each is written once and compiled for networks of any size, and again for networks of few states
with their sizes as constants: the compiler then writes the loops over states out, which is up to
three times as fast.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from egolane_pgm.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Numbers outside of this range are scaled before they are multiplied with others.
TINY, HUGE = 1e-60, 1e60


@kernel()
def settle(joint: FloatArray, predicted: FloatArray) -> float:
    """Normalise a belief, or keep the prediction.

    joint (S,): the prediction times the likelihood of the evidence; it becomes the belief after
    the frame. Where it is zero for every state the evidence is left out, and `joint` becomes
    `predicted` (S,), normalised. Returns what joint summed to before.
    """
    total = 0.0
    for s in range(joint.shape[0]):
        total += joint[s]
    if total > 0.0:
        # Not times one over the total: of the smallest numbers that is infinite.
        for s in range(joint.shape[0]):
            joint[s] /= total
        return total
    before = 0.0
    for s in range(joint.shape[0]):
        before += predicted[s]
    for s in range(joint.shape[0]):
        joint[s] = predicted[s] / before
    return 0.0


@lru_cache(maxsize=64)
def forward_kernel(columns: tuple[tuple[int, ...], ...] = ()) -> Any:
    """The forward recursion.

    columns: `Layout.columns` of the network that it is compiled for; empty for any network.
    """
    known = np.array(columns, dtype=np.int64, ndmin=2)
    n_states = known.shape[1]
    n_known, width = len(columns), int(known.max(initial=-1)) + 1

    # Of fast arithmetic only the fusing of a multiplication with an addition: infinity and NaN
    # stay. Without the checks for a division by zero the compiler has more freedom.
    @kernel(fastmath={"contract"}, error_model="numpy")
    def forward(
        joint: FloatArray,
        begins: BoolArray,
        is_factored: bool,
        prior: FloatArray,
        transition: FloatArray,
        index: IntArray,
        likelihood: FloatArray,
        column: IntArray,
        beliefs: FloatArray,
        total: FloatArray,
        is_impossible: BoolArray,
    ) -> None:
        """Filter T frames (Rabiner 1989, section III.A, scaled frame by frame).

        joint (S,): the belief after the frame before; overwritten by that after the last frame.
        begins (T,): True where a sequence begins: the frame takes `prior` (U, S) and what was
            before it does not matter.
        is_factored: the product of the marginals of the state's nodes is carried on, not the joint
            belief. column (N, S): as in `Layout`; it says which states share a node's value.
        transition (U, S, S), row is the state before; index (T,): which of the U holds in a frame.
        likelihood (T, S): of each frame's evidence given the joint state, any scale.
        beliefs (T, S): written, the joint belief after each frame.
        total (T,): written, the likelihood of each frame given those before; 1 if impossible.
        is_impossible (T,): written, True where that is zero and the prediction was kept.
        """
        n = n_states if n_states else joint.shape[0]
        given, written = likelihood.ravel(), beliefs.ravel()
        # One array for all that the inner loops write, and for the transition that they read: the
        # compiler then sees that the parts do not overlap.
        carried, predicted, share = n * n, n * n + n, n * n + 2 * n
        n_nodes = n_known if n_states else column.shape[0]
        n_columns = width if n_states else column.max() + 1
        work = np.zeros(share + n_columns)
        for s in range(n):
            work[carried + s] = joint[s]
        # What is carried, times this, is the belief. It is multiplied in only where numbers leave
        # the range that is safe, so that the next frame does not wait for the division.
        scale = 1.0
        held = -1
        for t in range(begins.shape[0]):
            u = index[t]
            if u != held:
                held = u
                for r in range(n):
                    for s in range(n):
                        work[r * n + s] = transition[u, r, s]
            if begins[t]:
                scale = 1.0
                for s in range(n):
                    work[predicted + s] = prior[u, s]
            else:
                for s in range(n):
                    work[predicted + s] = 0.0
                for r in range(n):
                    weight = work[carried + r]
                    for s in range(n):
                        work[predicted + s] += weight * work[r * n + s]
            mass = 0.0
            for s in range(n):
                work[carried + s] = work[predicted + s] * given[t * n + s]
            for s in range(n):
                mass += work[carried + s]
            is_impossible[t] = False
            if TINY < mass < HUGE:
                total[t] = mass * scale
                scale = 1.0 / mass
            else:
                for s in range(n):
                    work[predicted + s] *= scale
                    work[carried + s] = work[predicted + s] * given[t * n + s]
                total[t] = settle(work[carried : carried + n], work[predicted : predicted + n])
                if total[t] == 0.0:
                    is_impossible[t] = True
                    total[t] = 1.0
                scale = 1.0
            for s in range(n):
                written[t * n + s] = work[carried + s] * scale
            if is_factored:
                for c in range(n_columns):
                    work[share + c] = 0.0
                for p in range(n_nodes):
                    for s in range(n):
                        c = known[p, s] if n_states else column[p, s]
                        work[share + c] += work[carried + s]
                for s in range(n):
                    product = 1.0
                    for p in range(n_nodes):
                        c = known[p, s] if n_states else column[p, s]
                        product *= work[share + c] * scale
                    work[carried + s] = product
                scale = 1.0
        for s in range(n):
            joint[s] = work[carried + s] * scale

    return forward


@lru_cache(maxsize=64)
def likelihood_kernel(n_states: int = 0, n_columns: int = 0) -> Any:
    """The likelihood of one group's evidence, compiled for these sizes; 0 stands for any."""

    @kernel(fastmath={"contract"}, error_model="numpy")
    def multiply_likelihood(
        block: FloatArray, emission: FloatArray, likelihood: FloatArray, log_scale: FloatArray
    ) -> None:
        """Multiply `likelihood` (T, S) by P(evidence of the group | joint state).

        block (T, K): the group's evidence. emission (K, S). A frame in which numbers might not
        survive being multiplied is scaled first, and the logarithm of the factor goes to
        log_scale (T,).
        """
        n = n_states if n_states else emission.shape[1]
        m = n_columns if n_columns else emission.shape[0]
        given, table, written = block.ravel(), emission.ravel(), likelihood.ravel()
        seen = np.zeros(m)
        for k in range(m):
            for s in range(n):
                seen[k] += table[k * n + s]
        is_safe = np.empty(block.shape[0], dtype=np.bool_)
        for t in range(block.shape[0]):
            total = 0.0
            for k in range(m):
                total += given[t * m + k] * seen[k]
            is_safe[t] = TINY < total < HUGE
        # A choice of values in place of a condition: the loop is done several frames at a time.
        for t in range(block.shape[0]):
            for s in range(n):
                term = 0.0
                for k in range(m):
                    term += given[t * m + k] * table[k * n + s]
                written[t * n + s] *= term if is_safe[t] else 1.0
        for t in range(block.shape[0]):
            if is_safe[t]:
                continue
            # First the evidence is divided by its largest entry, then what the states make of it.
            largest, likeliest = 0.0, 0.0
            for k in range(m):
                largest = max(largest, given[t * m + k])
            if largest > 0.0:
                for s in range(n):
                    term = 0.0
                    for k in range(m):
                        term += given[t * m + k] / largest * table[k * n + s]
                    likeliest = max(likeliest, term)
            if likeliest > 0.0:
                log_scale[t] += math.log(largest) + math.log(likeliest)
            for s in range(n):
                term = 0.0
                if likeliest > 0.0:
                    for k in range(m):
                        term += given[t * m + k] / largest * table[k * n + s]
                    term /= likeliest
                written[t * n + s] *= term

    return multiply_likelihood


@kernel(fastmath={"contract", "nnan", "nsz"}, error_model="numpy")
def multiply_chosen(
    block: FloatArray, only: IntArray, likelihood: FloatArray, log_scale: FloatArray
) -> None:
    """As `multiply_likelihood`, for states that show one column each: only (S,)."""
    for t in range(block.shape[0]):
        largest = 0.0
        for k in range(block.shape[1]):
            largest = max(largest, block[t, k])
        if TINY < largest < HUGE or not largest > 0.0:
            for s in range(only.shape[0]):
                likelihood[t, s] *= block[t, only[s]]
        else:
            log_scale[t] += math.log(largest)
            for s in range(only.shape[0]):
                likelihood[t, s] *= block[t, only[s]] / largest
