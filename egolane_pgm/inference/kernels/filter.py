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

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: The smallest normal floating-point number. A probability below it has lost digits: it is zero.
LEAST = 2.0**-1022

#: What the recursions carry is multiplied by this power of two, so that numbers down to LEAST keep
#: their digits while the sum stays between 1 and HUGE.
UP = 2.0**800
HUGE = 1e300

#: A frame's likelihood is multiplied out where all that is not zero is in this range, that of each
#: group and the product; else it is done in logarithms.
RANGE = (1e-150, 1e150)


@kernel()
def log_moved(before: FloatArray, moves: FloatArray, s: int) -> float:
    """The logarithm of the sum over r of before[r] moves[r, s], however small."""
    total = 0.0
    for r in range(before.shape[0]):
        total += before[r] * UP * moves[r, s]
    if total > 1.0:
        return math.log(total) - math.log(UP)
    largest = -math.inf
    for r in range(before.shape[0]):
        if before[r] > 0.0 and moves[r, s] > 0.0:
            largest = max(largest, math.log(before[r]) + math.log(moves[r, s]))
    if largest == -math.inf:
        return largest
    total = 0.0
    for r in range(before.shape[0]):
        if before[r] > 0.0 and moves[r, s] > 0.0:
            total += math.exp(math.log(before[r]) + math.log(moves[r, s]) - largest)
    return largest + math.log(total)


@kernel()
def normalise_logs(belief: FloatArray) -> float:
    """belief (S,): logarithms, not all of them of zero; it becomes what they are of, normalised,
    zero below LEAST. Returns the logarithm of their sum."""
    largest: float = belief.max()
    total = 0.0
    for s in range(belief.shape[0]):
        belief[s] = math.exp(belief[s] - largest)
        total += belief[s]
    for s in range(belief.shape[0]):
        belief[s] /= total
        if belief[s] < LEAST:
            belief[s] = 0.0
    return largest + math.log(total)


@kernel()
def settle(before: FloatArray, moves: FloatArray, given: FloatArray, belief: FloatArray) -> float:
    """One frame of the recursion, in logarithms: what the plain products cannot hold.

    before (R,): the belief after the frame before. moves (R, S): the transition. given (S,): the
    likelihood of the frame's evidence. belief (S,): written, the belief after the frame. Where the
    evidence is impossible it is left out, and the belief is the prediction. Returns the logarithm
    of the evidence's probability.
    """
    is_possible = False
    for s in range(given.shape[0]):
        belief[s] = log_moved(before, moves, s)
        is_possible = is_possible or (given[s] > 0.0 and belief[s] > -math.inf)
    if not is_possible:
        normalise_logs(belief)
        return -math.inf
    for s in range(given.shape[0]):
        belief[s] += math.log(given[s]) if given[s] > 0.0 else -math.inf
    found: float = normalise_logs(belief)
    return found


@kernel()
def product_of_marginals(belief: FloatArray, column: IntArray) -> FloatArray:
    """(S,): the product of the marginals of the state's nodes; column (N, S) as in `Layout`."""
    share = np.zeros(column.max() + 1)
    for p in range(column.shape[0]):
        for s in range(belief.shape[0]):
            share[column[p, s]] += belief[s]
    product = np.ones(belief.shape[0])
    for s in range(belief.shape[0]):
        for p in range(column.shape[0]):
            product[s] *= share[column[p, s]]
        if product[s] < LEAST:
            product[s] = 0.0
    return product


@kernel()
def settle_frame(
    t: int,
    joint: FloatArray,
    begins: BoolArray,
    is_factored: bool,
    prior: FloatArray,
    transition: FloatArray,
    index: IntArray,
    given: FloatArray,
    column: IntArray,
    beliefs: FloatArray,
    total: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> FloatArray:
    """`settle` for frame t of `forward_kernel`, whose arguments these are, but for given (S,), the
    likelihood of this frame. Returns the belief after it (S,)."""
    belief = np.empty(given.shape[0])
    if begins[t]:
        found = settle(np.ones(1), prior[index[t] : index[t] + 1], given, belief)
    else:
        before = joint if t == 0 else beliefs[t - 1]
        if t > 0 and is_factored:
            before = product_of_marginals(before, column)
        found = settle(before, transition[index[t]], given, belief)
    total[t] = 1.0
    is_impossible[t] = found == -math.inf
    if not is_impossible[t]:
        log_evidence[t] += found
    return belief


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
        log_evidence: FloatArray,
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
        beliefs (T, S): written, the joint belief after each frame; zero below LEAST.
        total (T,): written, the likelihood of each frame given those before; 1 where its logarithm
            was added to log_evidence (T,), and if impossible.
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
            work[carried + s] = joint[s] * UP
        # What is carried, times this, is the belief. It is multiplied in only where numbers leave
        # the range that is safe, so that the next frame does not wait for the division.
        scale = 1.0 / UP
        held = -1
        for t in range(begins.shape[0]):
            u = index[t]
            if u != held:
                held = u
                for r in range(n):
                    for s in range(n):
                        work[r * n + s] = transition[u, r, s]
            if begins[t]:
                scale = 1.0 / UP
                for s in range(n):
                    work[predicted + s] = prior[u, s] * UP
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
            if 1.0 < mass < HUGE:
                total[t] = mass * scale
            else:
                mass = 0.0
                for s in range(n):
                    work[predicted + s] *= scale * UP
                    work[carried + s] = work[predicted + s] * given[t * n + s]
                    mass += work[carried + s]
                total[t] = mass / UP
                if not 1.0 < mass < HUGE:
                    mass = UP
                    belief = settle_frame(
                        t, joint, begins, is_factored, prior, transition, index, likelihood[t],
                        column, beliefs, total, log_evidence, is_impossible,
                    )  # fmt: skip
                    for s in range(n):
                        work[carried + s] = belief[s] * UP
            scale = 1.0 / mass
            for s in range(n):
                written[t * n + s] = work[carried + s] * scale
            if is_factored:
                for c in range(n_columns):
                    work[share + c] = 0.0
                for p in range(n_nodes):
                    for s in range(n):
                        c = known[p, s] if n_states else column[p, s]
                        work[share + c] += work[carried + s]
                upwards = UP / mass
                for s in range(n):
                    product = work[share + (known[0, s] if n_states else column[0, s])] * upwards
                    for p in range(1, n_nodes):
                        c = known[p, s] if n_states else column[p, s]
                        product *= work[share + c] * scale
                    work[carried + s] = product
                mass, scale = UP, 1.0 / UP
            # Whether any is zero or should be is known before it matters which.
            low = mass
            for s in range(n):
                low = work[carried + s] if work[carried + s] < low else low
            if low < LEAST * mass:
                for s in range(n):
                    if work[carried + s] < LEAST * mass:
                        work[carried + s] = 0.0
                        if not is_factored:
                            written[t * n + s] = 0.0
        for s in range(n):
            joint[s] = work[carried + s] * scale

    return forward


@lru_cache(maxsize=64)
def likelihood_kernel(n_states: int = 0, n_columns: int = 0) -> Any:
    """The likelihood of one group's evidence, compiled for these sizes; 0 stands for any."""

    @kernel(fastmath={"contract"}, error_model="numpy")
    def multiply_likelihood(
        block: FloatArray,
        emission: FloatArray,
        likelihood: FloatArray,
        least: FloatArray,
        most: FloatArray,
    ) -> None:
        """Multiply `likelihood` (T, S) by P(evidence of the group | joint state).

        block (T, K): the group's evidence. emission (K, S). least, most (T,): multiplied by the
        smallest and largest of these that is not zero; least by zero where one has lost digits or
        seems to be zero and may not be.
        """
        n = n_states if n_states else emission.shape[1]
        m = n_columns if n_columns else emission.shape[0]
        given, table, written = block.ravel(), emission.ravel(), likelihood.ravel()
        lows = np.empty(block.shape[0])
        # A choice of values in place of a condition: the loop is done several frames at a time.
        for t in range(block.shape[0]):
            low, high = math.inf, 0.0
            for s in range(n):
                term = 0.0
                for k in range(m):
                    term += given[t * m + k] * table[k * n + s]
                written[t * n + s] *= term
                low = term if term < low else low
                high = term if term > high else high
            lows[t] = low
            least[t] *= low if low > RANGE[0] else (1.0 if low == 0.0 else 0.0)
            most[t] *= high if high < RANGE[1] else math.inf
        if lows.size == 0 or lows.min() > 0.0:
            return
        smallest = math.inf
        for k in range(m * n):
            if 0.0 < table[k] < smallest:
                smallest = table[k]
        for t in range(block.shape[0]):
            if lows[t] == 0.0:
                # Which are zero, and which only seem so?
                low = math.inf
                for k in range(m):
                    if 0.0 < given[t * m + k] < low:
                        low = given[t * m + k]
                low *= smallest
                least[t] *= low if low > RANGE[0] else 0.0

    return multiply_likelihood


@kernel(fastmath={"contract"}, error_model="numpy")
def multiply_chosen(
    block: FloatArray, only: IntArray, likelihood: FloatArray, least: FloatArray, most: FloatArray
) -> None:
    """As `multiply_likelihood`, for states that show one column each: only (S,)."""
    for t in range(block.shape[0]):
        for s in range(only.shape[0]):
            likelihood[t, s] *= block[t, only[s]]
        low, high = math.inf, 0.0
        for k in range(block.shape[1]):
            if 0.0 < block[t, k] < low:
                low = block[t, k]
            high = max(high, block[t, k])
        least[t] *= low if low > RANGE[0] else 0.0
        most[t] *= high if high < RANGE[1] else math.inf
