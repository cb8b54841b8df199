"""Kernels of the forward recursion and its likelihood.

The recursion is compiled for networks of any size, and again for small networks with their sizes as
constants: unrolled loops over states are up to three times as fast.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: A frame's likelihood outside of these limits counts as zero: its reciprocal would lose digits.
LEAST = 2.0**-1022
MOST = 2.0**1022


@lru_cache(maxsize=64)
def forward_kernel(columns: tuple[tuple[int, ...], ...] = ()) -> Any:
    """The forward recursion.

    columns: `Compiled.column` of the network that it is compiled for; empty for any network.
    """
    known = np.array(columns, dtype=np.int64, ndmin=2)
    n_states = known.shape[1]
    n_known = len(columns)
    width = int(known.max(initial=-1)) + 1

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

        joint (S,): the belief before the first frame; overwritten by the one after the last.
        begins (T,): True in the first frame of a sequence, whose prediction is `prior` (U, S).
        is_factored: propagate the product of the marginals of the state's nodes, not the joint
            belief. column (N, S): as in `Compiled`.
        transition (U, S, S): row is the previous state; index (T,): its entry in each frame.
        likelihood (T, S): of each frame's evidence given the joint state, any scale.
        beliefs (T, S): output, the joint belief after each frame.
        total (T,): output, the likelihood of each frame given the previous ones.
        is_impossible (T,): output, True if it is zero, so that the prediction is kept.
        """
        n = n_states if n_states else joint.shape[0]
        n_nodes = n_known if n_states else column.shape[0]
        n_columns = width if n_states else column.max() + 1
        # One array for all that the inner loops write, and for the transition that they read: the
        # compiler then sees that the parts do not overlap.
        work = np.empty(n * n + 2 * n + n_columns)
        moves = work[: n * n]
        carried = work[n * n : n * n + n]
        predicted = work[n * n + n : n * n + 2 * n]
        share = work[n * n + 2 * n :]
        for s in range(n):
            carried[s] = joint[s]
        # The carried vector, times this, is the belief. It is multiplied in after the next
        # prediction, which then does not wait for the division.
        scale = 1.0
        held = -1
        for t in range(begins.shape[0]):
            u = index[t]
            if u != held:
                held = u
                for r in range(n):
                    for s in range(n):
                        moves[r * n + s] = transition[u, r, s]
            if begins[t]:
                scale = 1.0
                for s in range(n):
                    predicted[s] = prior[u, s]
            else:
                for s in range(n):
                    predicted[s] = 0.0
                for r in range(n):
                    weight = carried[r]
                    for s in range(n):
                        predicted[s] += weight * moves[r * n + s]
            mass = 0.0
            for s in range(n):
                carried[s] = predicted[s] * scale * likelihood[t, s]
            for s in range(n):
                mass += carried[s]
            total[t] = mass
            is_impossible[t] = not LEAST <= mass <= MOST
            if is_impossible[t]:
                mass = 0.0
                for s in range(n):
                    carried[s] = predicted[s] * scale
                    mass += carried[s]
            scale = 1.0 / mass
            for s in range(n):
                beliefs[t, s] = carried[s] * scale
            if is_factored:
                for c in range(n_columns):
                    share[c] = 0.0
                for p in range(n_nodes):
                    for s in range(n):
                        c = known[p, s] if n_states else column[p, s]
                        share[c] += carried[s]
                for s in range(n):
                    product = share[known[0, s] if n_states else column[0, s]] * scale
                    for p in range(1, n_nodes):
                        c = known[p, s] if n_states else column[p, s]
                        product *= share[c] * scale
                    carried[s] = product
                scale = 1.0
        for s in range(n):
            joint[s] = carried[s] * scale

    return forward


@kernel(fastmath={"contract"}, error_model="numpy")
def multiply_likelihood(block: FloatArray, emission: FloatArray, likelihood: FloatArray) -> None:
    """Multiply `likelihood` (T, S) by P(evidence of the group | joint state).

    block (T, K): the group's evidence. emission (K, S).
    """
    term = np.empty(emission.shape[1])
    for t in range(block.shape[0]):
        for s in range(emission.shape[1]):
            term[s] = 0.0
        for k in range(emission.shape[0]):
            share = block[t, k]
            for s in range(emission.shape[1]):
                term[s] += share * emission[k, s]
        for s in range(emission.shape[1]):
            likelihood[t, s] *= term[s]
