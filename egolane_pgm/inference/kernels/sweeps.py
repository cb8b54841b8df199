"""What goes over the frames besides the forward recursion, compiled: smoothing backwards, the most
probable path, and the filter that reads evidence by Jeffrey's rule."""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.inference.kernels.filter import (
    log_moved,
    normalise_logs,
    product_of_marginals,
)
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Plain sums of products are right where they come to something in this range.
RANGE = (1e-10, 1e300)


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
def look_back(
    filtered: FloatArray,
    transition: FloatArray,
    likelihood: FloatArray,
    ahead: FloatArray,
    weight: FloatArray,
    onward: FloatArray,
    moves: FloatArray,
) -> None:
    """One frame back. filtered (S,): the belief after it. transition (S, S): out of it.

    ahead (S,): how many times more probable each state of the later frame is than it was after that
        frame, given all evidence; it becomes this of the earlier frame.
    likelihood (S,): of the later frame's evidence, which the factor contains.
    weight, onward (S,): room.
    moves (S, S): P(state before, state now | all evidence) is added, unless it is (0, 0).

    The sum of filtered times ahead is one. As filtered is zero or a normal number, so is each ahead
    that matters.
    """
    n_states = filtered.shape[0]
    is_counted = moves.shape[0] > 0
    for s in range(n_states):
        weight[s] = likelihood[s] * ahead[s]
    _look_ahead(filtered, transition, weight, onward)
    total = 0.0
    for r in range(n_states):
        total += filtered[r] * onward[r]
    if RANGE[0] < total < RANGE[1]:
        # Over the total, without a quotient that is no number: weight where it is above one.
        above = max(total, 1.0)
        for s in range(n_states):
            weight[s] /= above
        for r in range(n_states):
            ahead[r] = onward[r] / total
            if is_counted:
                share = filtered[r] / (total / above)
                for s in range(n_states):
                    moves[r, s] += transition[r, s] * weight[s] * share
        return
    # The factors are numbers, their products are not: add logarithms.
    log_move = np.full((n_states, n_states), -math.inf)
    for s in range(n_states):
        if likelihood[s] > 0.0 and ahead[s] > 0.0:
            log_weight = math.log(likelihood[s]) + math.log(ahead[s])
            for r in range(n_states):
                if filtered[r] > 0.0 and transition[r, s] > 0.0:
                    log_move[r, s] = math.log(filtered[r]) + math.log(transition[r, s]) + log_weight
    largest = log_move.max()
    if largest == -math.inf:
        # Floating-point numbers end here: what comes later is ignored.
        ahead[:] = 1.0
        return
    total = np.exp(log_move - largest).sum()
    for r in range(n_states):
        ahead[r] = 0.0
        if filtered[r] > 0.0:
            log_share = log_move[r] - (largest + math.log(total))
            if is_counted:
                moves[r] += np.exp(log_share)
            ahead[r] = np.exp(log_share - math.log(filtered[r])).sum()


@kernel()
def _combine(filtered: FloatArray, ahead: FloatArray, smoothed: FloatArray) -> None:
    """smoothed (S,): filtered times ahead, normalised."""
    total = 0.0
    for s in range(filtered.shape[0]):
        smoothed[s] = filtered[s] * ahead[s]
        total += smoothed[s]
    for s in range(filtered.shape[0]):
        smoothed[s] /= total


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
        any scale; one in frames whose evidence is left out.
    transition (U, S, S); index (T,): which of the U leads into a frame.
    begins (T,): True where a sequence begins.
    smoothed (T, S): written, the joint belief about each frame.
    moves (S, S): the expected number of moves from one state to the next is added to it; nothing
        is counted where it is (0, 0).
    """
    n_frames, n_states = filtered.shape
    ahead, weight, onward = np.ones(n_states), np.empty(n_states), np.empty(n_states)
    for t in range(n_frames - 1, -1, -1):
        _combine(filtered[t], ahead, smoothed[t])
        if begins[t]:
            ahead[:] = 1.0
        elif t > 0:
            into = transition[index[t]]
            look_back(filtered[t - 1], into, likelihood[t], ahead, weight, onward, moves)


@kernel()
def fixed_lag_frames(
    lag: int,
    filtered: FloatArray,
    likelihood: FloatArray,
    transition: FloatArray,
    index: IntArray,
    smoothed: FloatArray,
) -> None:
    """As `smooth_frames`, frame t given the evidence up to frame t + lag."""
    n_frames, n_states = filtered.shape
    ahead, weight, onward = np.ones(n_states), np.empty(n_states), np.empty(n_states)
    nothing = np.empty((0, 0))
    for t in range(n_frames):
        for s in range(n_states):
            ahead[s] = 1.0
        for k in range(min(t + lag, n_frames - 1), t, -1):
            into = transition[index[k]]
            look_back(filtered[k - 1], into, likelihood[k], ahead, weight, onward, nothing)
        _combine(filtered[t], ahead, smoothed[t])


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


@kernel()
def _log_add(a: float, b: float) -> float:
    """The logarithm of the sum of what two logarithms are of."""
    if b > a:
        a, b = b, a
    return a if b == -math.inf else a + math.log1p(math.exp(b - a))


@kernel()
def jeffrey_frames(
    joint: FloatArray,
    begins: BoolArray,
    is_factored: bool,
    prior: FloatArray,
    transition: FloatArray,
    index: IntArray,
    log_emission: FloatArray,
    group_start: IntArray,
    log_posterior: FloatArray,
    is_said: BoolArray,
    key_start: IntArray,
    key_group: IntArray,
    key_value: IntArray,
    column: IntArray,
    beliefs: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """Filter T frames, the evidence read by Jeffrey's rule, one observed node (of N) after the
    other. What is not named here is as in the recursion of `forward_kernel`. In logarithms: what is
    nearly certain over what is nearly impossible is no number.

    log_emission (S, K): the groups' tables side by side, group g in group_start[g]:
        group_start[g + 1].
    log_posterior (T, V): per node the probabilities of its values, in key_start[i]:
        key_start[i + 1], summing to one. is_said (T, N): False where the frame says nothing about
        the node.
    key_group (N,): which group the node belongs to. key_value (N, K): the node's value in each
        column of the emissions.
    log_evidence (T,): written; 0 in impossible frames.
    """
    n_states = joint.shape[0]
    n_groups = group_start.shape[0] - 1
    n_keys = key_group.shape[0]
    factor = np.empty(log_emission.shape[1])
    of_group = np.empty((n_groups, n_states))
    predicted, belief = np.empty(n_states), np.empty(n_states)
    start = np.ones(1)
    for t in range(log_posterior.shape[0]):
        u = index[t]
        for s in range(n_states):
            if begins[t]:
                predicted[s] = log_moved(start, prior[u : u + 1], s)
            else:
                predicted[s] = log_moved(joint, transition[u], s)
        factor[:] = 0.0
        of_group[:, :] = 0.0
        is_impossible[t] = False
        log_evidence[t] = 0.0
        for i in range(n_keys):
            if not is_said[t, i] or is_impossible[t]:
                continue
            g, first = key_group[i], key_start[i]
            expected = np.full(key_start[i + 1] - first, -math.inf)
            for s in range(n_states):
                weight = predicted[s]
                for h in range(n_groups):
                    if h != g:
                        weight += of_group[h, s]
                for k in range(group_start[g], group_start[g + 1]):
                    v = key_value[i, k]
                    expected[v] = _log_add(expected[v], weight + log_emission[s, k] + factor[k])
            total, agreement, possible = -math.inf, -math.inf, -math.inf
            for v in range(expected.shape[0]):
                if expected[v] > -math.inf:
                    said = log_posterior[t, first + v]
                    total = _log_add(total, expected[v])
                    agreement = _log_add(agreement, said + expected[v])
                    possible = _log_add(possible, said)
            if agreement == -math.inf:
                is_impossible[t] = True
                continue
            log_evidence[t] += agreement - total
            for k in range(group_start[g], group_start[g + 1]):
                v = key_value[i, k]
                if expected[v] > -math.inf:
                    factor[k] += log_posterior[t, first + v] - possible + total - expected[v]
                else:
                    factor[k] = -math.inf
            for s in range(n_states):
                of_group[g, s] = -math.inf
                for k in range(group_start[g], group_start[g + 1]):
                    of_group[g, s] = _log_add(of_group[g, s], log_emission[s, k] + factor[k])
        for s in range(n_states):
            belief[s] = predicted[s]
            if not is_impossible[t]:
                for g in range(n_groups):
                    belief[s] += of_group[g, s]
        if is_impossible[t]:
            log_evidence[t] = 0.0
        normalise_logs(belief)
        beliefs[t] = belief
        joint[:] = product_of_marginals(belief, column) if is_factored else belief
