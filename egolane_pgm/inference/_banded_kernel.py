"""The numba kernel for the networks of `_banded`; `filtering` has the NumPy twin of all kernels."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from egolane_pgm.inference.kernels.unrolled import HUGE, TINY
from egolane_pgm.types import BoolArray, FloatArray, IntArray


@njit(cache=True, fastmath={"reassoc", "contract"})
def filter_banded(
    joint: FloatArray,
    is_first: bool,
    is_factored: bool,
    state: IntArray,
    prior: FloatArray,
    others: FloatArray,
    half: IntArray,
    floor: FloatArray,
    band: FloatArray,
    column: IntArray,
    by_wide: IntArray,
    by_others: IntArray,
    by_both: IntArray,
    input_index: IntArray,
    group_start: IntArray,
    evidence: FloatArray,
    marginals: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """As `kernels.filter_frames`, with the arrays of a `Banded` for the network's.

    joint (S,): overwritten by the belief after the last frame. evidence (T, K). With is_factored
    the others are one node. Written: marginals (T, M), log_evidence (T,), is_impossible (T,).
    """
    n_others, n_wide = state.shape
    n_groups = column.shape[0]
    widest = band.shape[1] // 2
    # Zeros on both sides, so that the band never leaves the array.
    before = np.zeros(n_wide + 2 * widest)
    predicted = np.zeros((n_others, n_wide))
    belief = np.zeros((n_others, n_wide))
    of_wide = np.zeros(n_wide)
    of_others = np.zeros(n_others)
    for q in range(n_others):
        for r in range(n_wide):
            belief[q, r] = joint[state[q, r]]
    for t in range(evidence.shape[0]):
        u = input_index[t]
        if is_first and t == 0:
            for q in range(n_others):
                for r in range(n_wide):
                    predicted[q, r] = prior[u, q, r]
        else:
            for q in range(n_others):
                mixed = before[widest : widest + n_wide]
                mixed[:] = 0.0
                for p in range(n_others):
                    source = belief[p]
                    weight = others[u, p, q]
                    for r in range(n_wide):
                        mixed[r] += source[r] * weight
                total = 0.0
                for r in range(n_wide):
                    total += mixed[r]
                target = predicted[q]
                target[:] = total * floor[u]
                # Slices, so that the compiler sees that it may do several r at once.
                for d in range(-half[u], half[u] + 1):
                    source = before[widest - d : widest - d + n_wide]
                    row = band[u, widest + d]
                    for r in range(n_wide):
                        target[r] += source[r] * row[r]
        total = 0.0
        for q in range(n_others):
            for r in range(n_wide):
                likelihood = 1.0
                for g in range(n_groups):
                    likelihood *= evidence[t, column[g, q, r]]
                belief[q, r] = predicted[q, r] * likelihood
                total += belief[q, r]
        log_scale = 0.0
        # Too small or too large to trust: scale the evidence first.
        if not TINY < total < HUGE:
            total = 0.0
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = predicted[q, r]
            for g in range(n_groups):
                largest = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    largest = max(largest, evidence[t, k])
                if largest > 0.0:
                    log_scale += math.log(largest)
                for q in range(n_others):
                    for r in range(n_wide):
                        share = 0.0
                        if largest > 0.0:
                            share = evidence[t, column[g, q, r]] / largest
                        belief[q, r] *= share
            for q in range(n_others):
                for r in range(n_wide):
                    total += belief[q, r]
        is_impossible[t] = not total > 0.0
        if total > 0.0:
            log_evidence[t] = math.log(total) + log_scale
            scale = 1.0 / total
            # The inverse of a number near the smallest one is infinite.
            if scale > HUGE:
                for q in range(n_others):
                    for r in range(n_wide):
                        belief[q, r] /= total
                scale = 1.0
        else:
            log_evidence[t] = 0.0
            scale = 0.0
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = predicted[q, r]
                    scale += predicted[q, r]
            scale = 1.0 / scale
        for r in range(n_wide):
            of_wide[r] = 0.0
        for q in range(n_others):
            total = 0.0
            for r in range(n_wide):
                belief[q, r] *= scale
                of_wide[r] += belief[q, r]
                total += belief[q, r]
            of_others[q] = total
        for k in range(marginals.shape[1]):
            marginals[t, k] = 0.0
        for k in range(by_wide.shape[0]):
            marginals[t, by_wide[k, 1]] += of_wide[by_wide[k, 0]]
        for k in range(by_others.shape[0]):
            marginals[t, by_others[k, 1]] += of_others[by_others[k, 0]]
        for k in range(by_both.shape[0]):
            e = by_both[k, 0]
            marginals[t, by_both[k, 1]] += belief[e // n_wide, e % n_wide]
        if is_factored:
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = of_others[q] * of_wide[r]
    for q in range(n_others):
        for r in range(n_wide):
            joint[state[q, r]] = belief[q, r]
