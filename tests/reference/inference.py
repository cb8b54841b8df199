"""Filters, smoothers, the most probable path and expected counts in plain NumPy.

The recursions stand here as the books write them, frame by frame on (prior, transition,
likelihood); what `egolane_pgm.inference` computes is held to them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.expected_counts import FREE, Expected
from egolane_pgm.inference.filtering import joint_input
from egolane_pgm.inference.kernels.filter import LEAST
from egolane_pgm.types import Beliefs, BoolArray, Evidence, FloatArray, IntArray

#: The largest likelihood of a frame: those that matter have the whole range of numbers.
MOST = 1e300


def filter_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    method: str = "exact",
    *,
    frame_id: IntArray | None = None,
) -> Beliefs:
    """As `egolane_pgm.inference.filtering.filter_beliefs`."""
    return _filter(compiled, evidence, method, None, frame_id)[1]


def step(
    compiled: Compiled,
    state: FloatArray | None,
    evidence: Evidence,
    method: str = "exact",
) -> tuple[FloatArray, Beliefs]:
    """As `egolane_pgm.inference.filtering.step`."""
    return _filter(compiled, evidence, method, state, None)


def _filter(
    compiled: Compiled,
    evidence: Evidence,
    method: str,
    state: FloatArray | None,
    frame_id: IntArray | None,
) -> tuple[FloatArray, Beliefs]:
    likelihood, log_scale = state_likelihood(compiled, evidence)
    index = joint_input(compiled, evidence)
    filtered, log_evidence, is_impossible, last = forward(
        compiled, likelihood, log_scale, index, method, state
    )
    ids = np.arange(len(evidence)) if frame_id is None else frame_id
    marginals = marginals_of(compiled, filtered)
    return last, Beliefs(ids, marginals, log_evidence, is_impossible)


def state_likelihood(compiled: Compiled, evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """P(evidence of the frame | joint state), (T, S), the largest entry being MOST and what is then
    below LEAST zero, and the logarithm of what it was divided by, (T,)."""
    log_likelihood = np.zeros((len(evidence), compiled.n_states))
    for group, block in zip(compiled.groups, log_blocks(compiled, evidence), strict=True):
        log_likelihood += _log_sum(block[:, None, :] + logarithms(group.emission), axis=2)
    largest = log_likelihood.max(axis=1)
    largest[largest == -np.inf] = 0.0
    shares = log_likelihood - largest[:, None]
    # What is far from zero keeps its digits where it is not added to what is small.
    likelihood = np.where(shares > -600, MOST * np.exp(shares), np.exp(shares + math.log(MOST)))
    return _kept(likelihood), largest - math.log(MOST)


def log_blocks(compiled: Compiled, evidence: Evidence) -> list[FloatArray]:
    """The logarithm of the evidence of each group, (T, K)."""
    logs = [logarithms(evidence.likelihoods[group.observed]) for group in compiled.groups]
    return [log.reshape(len(log), math.prod(log.shape[1:])) for log in logs]


def logarithms(values: FloatArray) -> FloatArray:
    """Natural logarithms, minus infinity of zero."""
    with np.errstate(divide="ignore"):
        return np.log(values)


def _kept(values: FloatArray) -> FloatArray:
    """Zero below LEAST."""
    return np.where(values < LEAST, 0.0, values)


def _log_sum(logs: FloatArray, axis: int | None = None) -> FloatArray:
    """The logarithm of the sum of what these are logarithms of."""
    largest = logs.max(axis=axis, keepdims=True)
    largest = np.where(largest == -np.inf, 0.0, largest)
    total = np.exp(logs - largest).sum(axis=axis, keepdims=True)
    return np.asarray(np.squeeze(largest + logarithms(total), axis=axis))


def _log_predicted(compiled: Compiled, u: int, joint: FloatArray | None) -> FloatArray:
    """The logarithm of the belief (S,) before a frame's evidence."""
    if joint is None:
        return logarithms(compiled.prior[u])
    return _log_sum(logarithms(joint)[:, None] + logarithms(compiled.transition[u]), axis=0)


def forward(
    compiled: Compiled,
    likelihood: FloatArray,
    log_scale: FloatArray,
    index: IntArray,
    method: str = "exact",
    joint: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray]:
    """The forward recursion: the joint belief after each frame (T, S), the log evidence (T,), the
    flags (T,), and what is carried on after the last frame (S,)."""
    filtered = np.empty_like(likelihood)
    log_evidence = np.zeros(len(likelihood))
    is_impossible = np.zeros(len(likelihood), dtype=bool)
    for t, u in enumerate(index):
        predicted = _log_predicted(compiled, u, joint)
        weighted = predicted + logarithms(likelihood[t])
        total = _log_sum(weighted)
        is_impossible[t] = total == -np.inf
        if is_impossible[t]:
            weighted, total = predicted, _log_sum(predicted)
        else:
            log_evidence[t] = total + log_scale[t]
        joint = filtered[t] = _kept(np.exp(weighted - total))
        if method == "assumed_density":
            joint = product_of_marginals(compiled, joint)
    return filtered, log_evidence, is_impossible, np.zeros(0) if joint is None else joint.copy()


def product_of_marginals(compiled: Compiled, joint: FloatArray) -> FloatArray:
    """The product (S,) of the marginals of the joint state's nodes, of a joint belief (S,)."""
    product = np.ones(compiled.n_states)
    for name in compiled.state_nodes:
        value = compiled.node_value[name]
        product *= np.bincount(value, joint, compiled.cardinality[name])[value]
    return _kept(product)


def marginals_of(compiled: Compiled, joint: FloatArray) -> dict[str, FloatArray]:
    """Per hidden node (T, cardinality), from beliefs over the joint state (T, S)."""
    return {
        name: joint @ np.eye(compiled.cardinality[name])[compiled.node_value[name]]
        for name in compiled.hidden
    }


def smooth_beliefs(compiled: Compiled, evidence: Evidence) -> Beliefs:
    """As `egolane_pgm.inference.smoothing.smooth_beliefs`."""
    return fixed_lag_beliefs(compiled, evidence, max(0, len(evidence) - 1))


def fixed_lag_beliefs(compiled: Compiled, evidence: Evidence, lag: int) -> Beliefs:
    """As `egolane_pgm.inference.smoothing.fixed_lag_beliefs`."""
    likelihood, log_scale = state_likelihood(compiled, evidence)
    index = joint_input(compiled, evidence)
    filtered, log_evidence, is_impossible, _ = forward(compiled, likelihood, log_scale, index)
    likelihood[is_impossible] = 1.0
    smoothed = smooth(filtered, likelihood, compiled.transition, index, lag)
    marginals = marginals_of(compiled, smoothed)
    return Beliefs(np.arange(len(evidence)), marginals, log_evidence, is_impossible)


def smooth(
    filtered: FloatArray,
    likelihood: FloatArray,
    transition: FloatArray,
    index: IntArray,
    lag: int,
) -> FloatArray:
    """The joint belief (T, S) about each frame given `lag` later ones, from the filter's (T, S)."""
    n_frames = len(filtered)
    smoothed = np.empty_like(filtered)
    whole = lag >= n_frames - 1
    ahead = np.zeros(filtered.shape[1])
    for t in range(n_frames - 1, -1, -1):
        if not whole:
            ahead = np.zeros_like(ahead)
        last = min(t + lag, n_frames - 1)
        for k in range(min(last, t + 1) if whole else last, t, -1):
            moved = logarithms(transition[index[k]]) + logarithms(likelihood[k]) + ahead
            ahead = np.where(filtered[k - 1] > 0, _log_sum(moved, axis=1), -np.inf)
            if ahead.max() == -np.inf:
                # Floating-point numbers end here: what comes later is ignored.
                ahead = np.zeros_like(ahead)
        log_product = logarithms(filtered[t]) + ahead
        smoothed[t] = np.exp(log_product - _log_sum(log_product))
    return smoothed


def best_path(compiled: Compiled, evidence: Evidence) -> tuple[IntArray, float]:
    """The most probable joint states (T,), and the logarithm of their probability."""
    log_prior, log_transition, log_likelihood, index, log_scale = _logarithms(compiled, evidence)
    score = log_prior[index[0]] + log_likelihood[0]
    came_from = np.zeros(log_likelihood.shape, dtype=np.int64)
    for t in range(1, len(log_likelihood)):
        moved = score[:, None] + log_transition[index[t]]
        came_from[t] = moved.argmax(axis=0)
        score = moved.max(axis=0) + log_likelihood[t]
    path = np.empty(len(log_likelihood), dtype=np.int64)
    state = int(score.argmax())
    total = float(score[state])
    for t in range(len(path) - 1, -1, -1):
        path[t] = state
        state = int(came_from[t, state])
    return path, total + log_scale


def path_probability(compiled: Compiled, evidence: Evidence, states: IntArray) -> float:
    """The logarithm of the probability of a path (T,) with the evidence."""
    log_prior, log_transition, log_likelihood, index, log_scale = _logarithms(compiled, evidence)
    moved = log_transition[index[1:], states[:-1], states[1:]].sum()
    seen = log_likelihood[np.arange(len(states)), states].sum()
    return float(log_prior[index[0], states[0]] + moved + seen + log_scale)


def _logarithms(
    compiled: Compiled, evidence: Evidence
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, float]:
    likelihood, log_scale = state_likelihood(compiled, evidence)
    index = joint_input(compiled, evidence)
    is_impossible = forward(compiled, likelihood, log_scale, index)[2]
    likelihood[is_impossible], log_scale[is_impossible] = 1.0, 0.0
    logs = map(logarithms, (compiled.prior, compiled.transition, likelihood))
    return *logs, index, float(log_scale.sum())


def expected_counts(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
) -> Expected:
    """As `egolane_pgm.inference.expected_counts.expected_counts`."""
    likelihood, log_scale = state_likelihood(compiled, evidence)
    for node, value in (known or {}).items():
        likelihood *= (value[:, None] == compiled.node_value[node]) | (value == FREE)[:, None]
    begins = np.arange(len(evidence)) == 0
    if is_first is not None:
        begins |= is_first
    smoothed, first, moves, log_evidence, is_impossible = expected_moves(
        compiled, likelihood, joint_input(compiled, evidence), begins
    )
    blocks = log_blocks(compiled, evidence)
    counts = {}
    for node, place in compiled.places.items():
        table = compiled.tables[node]
        if any(parent in compiled.inputs for parent, _ in table.parents):
            continue
        array = {"prior": first[None], "transition": moves[None]}.get(place.target)
        if array is None:
            group = compiled.groups[place.target]
            array = np.zeros_like(group.emission)
            for t in np.flatnonzero(~is_impossible):
                # P(value | state, evidence), for the states that the evidence allows.
                of_value = logarithms(group.emission) + blocks[place.target][t]
                of_state = _log_sum(of_value, axis=1)[:, None]
                of_state[of_state == -np.inf] = 0.0
                array += smoothed[t][:, None] * np.exp(of_value - of_state)
        used = np.zeros(table.values.shape)
        np.add.at(used, tuple(np.broadcast_to(i, array.shape) for i in place.indices), array)
        # A table that holds in the first frame and later is counted once.
        counted = (node[0], 1) if node[0] in compiled.one_table else node
        counts[counted] = counts.get(counted, 0.0) + used
    kept = ~is_impossible
    return Expected(counts, float((log_evidence + log_scale)[kept].sum()), is_impossible)


def expected_moves(
    compiled: Compiled, likelihood: FloatArray, index: IntArray, is_first: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
    """What EM counts, in logarithms: the smoothed joint belief (T, S), the states of first frames
    (S,), the moves from state to state (S, S), the log evidence and the flags (T,)."""
    n_frames, n_states = likelihood.shape
    likelihood = likelihood.copy()
    smoothed, filtered = np.empty_like(likelihood), np.empty_like(likelihood)
    first, moves = np.zeros(n_states), np.zeros((n_states, n_states))
    log_evidence, is_impossible = np.zeros(n_frames), np.zeros(n_frames, dtype=bool)
    for t, u in enumerate(index):
        now = _log_predicted(compiled, u, None if is_first[t] else filtered[t - 1])
        both = now + logarithms(likelihood[t])
        total = _log_sum(both)
        is_impossible[t] = total == -np.inf
        log_evidence[t] = 0.0 if is_impossible[t] else total
        if is_impossible[t]:
            likelihood[t] = 1.0
            both, total = now, _log_sum(now)
        filtered[t] = _kept(np.exp(both - total))
    ahead = np.zeros(n_states)
    for t in range(n_frames - 1, -1, -1):
        both = logarithms(filtered[t]) + ahead
        smoothed[t] = np.exp(both - _log_sum(both))
        if is_first[t]:
            first += smoothed[t]
            ahead = np.zeros(n_states)
            continue
        onward = logarithms(compiled.transition[index[t]]) + logarithms(likelihood[t]) + ahead
        pairs = logarithms(filtered[t - 1])[:, None] + onward
        moves += np.exp(pairs - _log_sum(pairs))
        ahead = np.where(filtered[t - 1] > 0, _log_sum(onward, axis=1), -np.inf)
    return smoothed, first, moves, log_evidence, is_impossible
