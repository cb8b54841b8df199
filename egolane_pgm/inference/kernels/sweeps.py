"""What goes over the frames besides the forward recursion, compiled: smoothing backwards, the most
probable path, and the filter that reads evidence by Jeffrey's rule."""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.inference.kernels.filter import settle
from egolane_pgm.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Products of probabilities below this have lost digits.
TINY = 1e-280


@kernel(fastmath={"reassoc", "contract"})
def _look_ahead(
    filtered: FloatArray,
    transition: FloatArray,
    likelihood: FloatArray,
    ahead: FloatArray,
    weight: FloatArray,
) -> None:
    """One frame back: `ahead` (S,) is the likelihood of all later evidence given the state, up to
    a factor; `likelihood` that of the frame after, `transition` (S, S) into it. States that are
    impossible here are left out, so that those that matter set the scale."""
    n_states = filtered.shape[0]
    for s in range(n_states):
        weight[s] = likelihood[s] * ahead[s]
    largest = 0.0
    for r in range(n_states):
        total = 0.0
        if filtered[r] > 0.0:
            for s in range(n_states):
                total += transition[r, s] * weight[s]
        ahead[r] = total
        largest = max(largest, total)
    for r in range(n_states):
        # Zero everywhere only where floating-point numbers end: what comes later is ignored.
        ahead[r] = ahead[r] / largest if largest > 0.0 else 1.0


@kernel()
def _combine(filtered: FloatArray, ahead: FloatArray, smoothed: FloatArray) -> None:
    """smoothed (S,): filtered times ahead, normalised."""
    n_states = filtered.shape[0]
    total = 0.0
    for s in range(n_states):
        smoothed[s] = filtered[s] * ahead[s]
        total += smoothed[s]
    if not total > TINY:
        # Each factor is a number, their product is not: add logarithms.
        largest = -np.inf
        for s in range(n_states):
            if filtered[s] > 0.0 and ahead[s] > 0.0:
                largest = max(largest, math.log(filtered[s]) + math.log(ahead[s]))
        total = 0.0
        for s in range(n_states):
            smoothed[s] = 0.0
            if filtered[s] > 0.0 and ahead[s] > 0.0:
                smoothed[s] = math.exp(math.log(filtered[s]) + math.log(ahead[s]) - largest)
            total += smoothed[s]
    for s in range(n_states):
        smoothed[s] /= total


@kernel(fastmath={"reassoc", "contract"})
def _add_moves(
    filtered: FloatArray, transition: FloatArray, weight: FloatArray, moves: FloatArray
) -> None:
    """Add P(state before, state now | all evidence) to `moves` (S, S). weight (S,): the likelihood
    of the evidence of this frame and of all later ones, given the state, up to a factor."""
    n_states = filtered.shape[0]
    total = 0.0
    for r in range(n_states):
        onward = 0.0
        for s in range(n_states):
            onward += transition[r, s] * weight[s]
        total += filtered[r] * onward
    if total > TINY:
        for r in range(n_states):
            share = filtered[r] / total
            for s in range(n_states):
                moves[r, s] += share * transition[r, s] * weight[s]
        return
    # Each factor is a number, their product is not: add logarithms.
    log_move = np.full((n_states, n_states), -np.inf)
    for r in range(n_states):
        for s in range(n_states):
            if filtered[r] > 0.0 and transition[r, s] > 0.0 and weight[s] > 0.0:
                log_move[r, s] = (
                    math.log(filtered[r]) + math.log(transition[r, s]) + math.log(weight[s])
                )
    largest = log_move.max()
    if largest == -np.inf:
        return
    share = np.exp(log_move - largest)
    moves += share / share.sum()


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
    ahead = np.ones(n_states)
    weight = np.empty(n_states)
    for t in range(n_frames - 1, -1, -1):
        _combine(filtered[t], ahead, smoothed[t])
        if begins[t]:
            ahead[:] = 1.0
        elif t > 0:
            into = transition[index[t]]
            _look_ahead(filtered[t - 1], into, likelihood[t], ahead, weight)
            if moves.shape[0] > 0:
                _add_moves(filtered[t - 1], into, weight, moves)


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
    ahead = np.ones(n_states)
    weight = np.empty(n_states)
    for t in range(n_frames):
        for s in range(n_states):
            ahead[s] = 1.0
        for k in range(min(t + lag, n_frames - 1), t, -1):
            _look_ahead(filtered[k - 1], transition[index[k]], likelihood[k], ahead, weight)
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
def jeffrey_frames(
    joint: FloatArray,
    begins: BoolArray,
    is_factored: bool,
    prior: FloatArray,
    transition: FloatArray,
    index: IntArray,
    emission: FloatArray,
    group_start: IntArray,
    posterior: FloatArray,
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
    other. What is not named here is as in the recursion of `forward_kernel`.

    emission (S, K): the groups' tables side by side, group g in group_start[g]:group_start[g + 1].
    posterior (T, V): per node the probabilities of its values, in key_start[i]:key_start[i + 1],
        summing to one. is_said (T, N): False where the frame says nothing about the node.
    key_group (N,): which group the node belongs to. key_value (N, K): the node's value in each
        column of the emissions.
    log_evidence (T,): written; 0 in impossible frames.
    """
    n_states = joint.shape[0]
    n_groups = group_start.shape[0] - 1
    n_keys = key_group.shape[0]
    factor = np.ones(emission.shape[1])
    of_group = np.ones((n_groups, n_states))
    predicted = joint.copy()
    share = np.empty(column.max() + 1)
    for t in range(posterior.shape[0]):
        u = index[t]
        for s in range(n_states):
            predicted[s] = 0.0
        if begins[t]:
            for s in range(n_states):
                predicted[s] = prior[u, s]
        else:
            for r in range(n_states):
                for s in range(n_states):
                    predicted[s] += joint[r] * transition[u, r, s]
        factor[:] = 1.0
        of_group[:, :] = 1.0
        is_impossible[t] = False
        log_evidence[t] = 0.0
        for i in range(n_keys):
            if not is_said[t, i] or is_impossible[t]:
                continue
            g, first = key_group[i], key_start[i]
            expected = np.zeros(key_start[i + 1] - first)
            for s in range(n_states):
                weight = predicted[s]
                for h in range(n_groups):
                    if h != g:
                        weight *= of_group[h, s]
                if weight > 0.0:
                    for k in range(group_start[g], group_start[g + 1]):
                        expected[key_value[i, k]] += weight * emission[s, k] * factor[k]
            total = expected.sum()
            agreement = 0.0
            possible = 0.0
            for v in range(expected.shape[0]):
                if expected[v] > 0.0:
                    agreement += posterior[t, first + v] * expected[v] / total
                    possible += posterior[t, first + v]
            if not agreement > 0.0:
                is_impossible[t] = True
                continue
            log_evidence[t] += math.log(agreement)
            for k in range(group_start[g], group_start[g + 1]):
                v = key_value[i, k]
                if expected[v] > 0.0:
                    factor[k] *= posterior[t, first + v] / possible * (total / expected[v])
                else:
                    factor[k] = 0.0
            for s in range(n_states):
                of_group[g, s] = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    of_group[g, s] += emission[s, k] * factor[k]
        for s in range(n_states):
            joint[s] = 0.0 if is_impossible[t] else predicted[s]
            for g in range(n_groups):
                joint[s] *= of_group[g, s]
        is_impossible[t] = settle(joint, predicted) == 0.0
        if is_impossible[t]:
            log_evidence[t] = 0.0
        beliefs[t] = joint
        if is_factored:
            share[:] = 0.0
            for p in range(column.shape[0]):
                for s in range(n_states):
                    share[column[p, s]] += joint[s]
            for s in range(n_states):
                joint[s] = 1.0
                for p in range(column.shape[0]):
                    joint[s] *= share[column[p, s]]
