"""The numba kernel of the filters; `filtering` has its NumPy twin."""

from __future__ import annotations

import math

from numba import njit

from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Below this a frame's joint likelihood is computed again from scaled evidence.
TINY = 1e-250


@njit(cache=True)
def filter_frames(
    joint: FloatArray,
    is_first: bool,
    is_factored: bool,
    prior: FloatArray,
    transition: FloatArray,
    input_index: IntArray,
    emission: FloatArray,
    group_start: IntArray,
    evidence: FloatArray,
    node_column: IntArray,
    n_persistent: int,
    marginals: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """Filter T frames, starting from `joint` (S,), which is overwritten by the belief after the
    last one.

    is_first: the first frame takes `prior`, with no transition before it. is_factored: the
    product of the persistent nodes' marginals is carried on, not the joint belief.
    emission (S, K) and evidence (T, K): the groups' columns side by side, group g in
    group_start[g]:group_start[g + 1]. node_column (H, S): the column of `marginals` that each
    node's value in each joint state adds to; the first n_persistent nodes make up the state.
    Written: marginals (T, M), log_evidence (T,), is_impossible (T,).
    """
    n_states = joint.shape[0]
    n_groups = group_start.shape[0] - 1
    n_nodes = node_column.shape[0]
    predicted = joint.copy()
    for t in range(evidence.shape[0]):
        u = input_index[t]
        if is_first and t == 0:
            for s in range(n_states):
                predicted[s] = prior[u, s]
        else:
            for s in range(n_states):
                predicted[s] = 0.0
            for r in range(n_states):
                weight = joint[r]
                for s in range(n_states):
                    predicted[s] += weight * transition[u, r, s]
        total = 0.0
        for s in range(n_states):
            likelihood = 1.0
            for g in range(n_groups):
                term = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    term += emission[s, k] * evidence[t, k]
                likelihood *= term
            joint[s] = predicted[s] * likelihood
            total += joint[s]
        log_scale = 0.0
        if total < TINY:
            total = 0.0
            for g in range(n_groups):
                largest = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    largest = max(largest, evidence[t, k])
                if largest > 0.0:
                    log_scale += math.log(largest)
            for s in range(n_states):
                likelihood = 1.0
                for g in range(n_groups):
                    largest = 0.0
                    for k in range(group_start[g], group_start[g + 1]):
                        largest = max(largest, evidence[t, k])
                    term = 0.0
                    if largest > 0.0:
                        for k in range(group_start[g], group_start[g + 1]):
                            term += emission[s, k] * (evidence[t, k] / largest)
                    likelihood *= term
                joint[s] = predicted[s] * likelihood
                total += joint[s]
        if total > 0.0:
            for s in range(n_states):
                joint[s] /= total
            log_evidence[t] = math.log(total) + log_scale
            is_impossible[t] = False
        else:
            for s in range(n_states):
                joint[s] = predicted[s]
            log_evidence[t] = 0.0
            is_impossible[t] = True
        for h in range(n_nodes):
            for s in range(n_states):
                marginals[t, node_column[h, s]] += joint[s]
        if is_factored:
            for s in range(n_states):
                product = 1.0
                for h in range(n_persistent):
                    product *= marginals[t, node_column[h, s]]
                joint[s] = product
