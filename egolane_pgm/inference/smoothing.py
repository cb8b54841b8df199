"""Smoothing: the belief about each frame, given later evidence as well.

`smooth_beliefs` knows the whole sequence (forward-backward), `fixed_lag_beliefs` the next `lag`
frames; `lag_step` does the latter online, `lag` frames late. All start from the exact filter. What
is carried backwards is scaled frame by frame, so that long sequences do not underflow.

A frame whose evidence has joint likelihood zero given the frames before it is flagged by the
filter, and its evidence is ignored by the smoothers too. `log_evidence` is the filter's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import (
    METHODS,
    FilterState,
    evidence_blocks,
    filter_beliefs,
    joint_input,
    step,
)
from egolane_pgm.types import (
    Beliefs,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    suggestion,
)

#: How an experiment may ask for its beliefs.
FILTERS = (*METHODS, "smoothed", "fixed_lag")

#: A name that no node of a network has: the joint hidden state.
_JOINT = " joint"


def infer_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    filter: str = "assumed_density",
    lag: int | None = None,
    *,
    frame_id: IntArray | None = None,
    kernel: bool = True,
) -> Beliefs:
    """The beliefs by name: a filter of `filtering`, `smoothed` or `fixed_lag` (needs `lag`).

    Raises InputError for an unknown name, a missing lag and evidence that does not fit.
    """
    if filter == "smoothed":
        return smooth_beliefs(compiled, evidence, frame_id=frame_id, kernel=kernel)
    if filter == "fixed_lag":
        if lag is None:
            raise InputError("filter 'fixed_lag' needs a lag, in frames")
        return fixed_lag_beliefs(compiled, evidence, lag, frame_id=frame_id, kernel=kernel)
    if filter not in METHODS:
        raise InputError(f"filter '{filter}'{suggestion(filter, FILTERS)}")
    return filter_beliefs(compiled, evidence, filter, frame_id=frame_id, kernel=kernel)


def smooth_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    *,
    frame_id: IntArray | None = None,
    kernel: bool = True,
) -> Beliefs:
    """P(node | evidence of all frames) for every hidden node and frame (Rabiner 1989, section
    III.B, on the joint hidden state). `kernel=False` runs the NumPy twin.

    Raises InputError as `filter_beliefs`, and for evidence that is read by Jeffrey's rule.
    """
    beliefs, filtered, likelihood = _forward(compiled, evidence, frame_id, kernel)
    run: Any = _smooth_frames_numpy
    if kernel:
        from egolane_pgm.inference.kernels.sweeps import smooth_frames as run
    smoothed = np.empty_like(filtered)
    index = joint_input(compiled, evidence)
    run(filtered, likelihood, compiled.transition, index, smoothed)
    return replace(beliefs, marginals=node_marginals(compiled, smoothed))


def fixed_lag_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    lag: int,
    *,
    frame_id: IntArray | None = None,
    kernel: bool = True,
) -> Beliefs:
    """P(node at t | evidence up to frame t + lag) for every hidden node and frame; near the end
    there are fewer later frames. With lag 0 this is the exact filter. Raises as `smooth_beliefs`.
    """
    _check_lag(lag)
    beliefs, filtered, likelihood = _forward(compiled, evidence, frame_id, kernel)
    run: Any = _fixed_lag_frames_numpy
    if kernel:
        from egolane_pgm.inference.kernels.sweeps import fixed_lag_frames as run
    smoothed = np.empty_like(filtered)
    index = joint_input(compiled, evidence)
    run(lag, filtered, likelihood, compiled.transition, index, smoothed)
    return replace(beliefs, marginals=node_marginals(compiled, smoothed))


@dataclass(frozen=True)
class LagState:
    """What an online fixed-lag smoother carries of its last K <= lag + 1 frames.

    filtered (K, S): the joint belief after each. likelihood (K, S): of each one's evidence.
    index (K,): the value of the inputs. log_evidence, is_impossible (K,). count: frames so far.
    due: how many of the frames are still to be answered.
    """

    last: FilterState
    filtered: FloatArray
    likelihood: FloatArray
    index: IntArray
    log_evidence: FloatArray
    is_impossible: BoolArray
    count: int
    due: int


def lag_step(
    compiled: Compiled,
    state: LagState | None,
    evidence: Evidence,
    lag: int,
    *,
    kernel: bool = True,
) -> tuple[LagState, Beliefs]:
    """One more frame online: the new state, and the belief about the frame `lag` frames ago, which
    is now as good as it gets; no frame as long as there was none. `frame_id` of the belief counts
    from 0, the first frame. `lag_rest` has the last frames at the end.

    state: None before the first frame. evidence: one frame.
    """
    _check_lag(lag)
    if len(evidence) != 1:
        raise InputError(f"lag_step takes one frame at a time, got {len(evidence)}")
    last, beliefs = step(compiled, state.last if state else None, evidence, "exact", kernel=kernel)
    likelihood, _ = state_likelihood(compiled, evidence, beliefs.is_impossible)
    new = LagState(
        last,
        last.joint[None],
        likelihood,
        joint_input(compiled, evidence),
        beliefs.log_evidence,
        beliefs.is_impossible,
        1,
        1,
    )
    if state is not None:
        kept = slice(max(0, len(state.filtered) - lag), None)
        new = LagState(
            last,
            np.concatenate([state.filtered[kept], new.filtered]),
            np.concatenate([state.likelihood[kept], new.likelihood]),
            np.concatenate([state.index[kept], new.index]),
            np.concatenate([state.log_evidence[kept], new.log_evidence]),
            np.concatenate([state.is_impossible[kept], new.is_impossible]),
            state.count + 1,
            state.due + 1,
        )
    if new.due <= lag:
        return new, _lagged(compiled, new, 0, kernel)
    return replace(new, due=new.due - 1), _lagged(compiled, new, 1, kernel)


def lag_rest(compiled: Compiled, state: LagState, *, kernel: bool = True) -> Beliefs:
    """The beliefs about the frames that `lag_step` has not answered yet, at the end."""
    return _lagged(compiled, state, state.due, kernel)


def _lagged(compiled: Compiled, state: LagState, n_frames: int, kernel: bool) -> Beliefs:
    """The first of the frames that are due, given all that was seen."""
    run: Any = _smooth_frames_numpy
    if kernel:
        from egolane_pgm.inference.kernels.sweeps import smooth_frames as run
    first = len(state.filtered) - state.due
    here = slice(first, first + n_frames)
    smoothed = np.empty_like(state.filtered[first:])
    if n_frames:
        run(
            state.filtered[first:],
            state.likelihood[first:],
            compiled.transition,
            state.index[first:],
            smoothed,
        )
    return Beliefs(
        np.arange(state.count - state.due, state.count - state.due + n_frames),
        node_marginals(compiled, smoothed[:n_frames]),
        state.log_evidence[here],
        state.is_impossible[here],
    )


def _check_lag(lag: int) -> None:
    if lag < 0:
        raise InputError(f"lag {lag}: must not be negative")


def _forward(
    compiled: Compiled, evidence: Evidence, frame_id: IntArray | None, kernel: bool
) -> tuple[Beliefs, FloatArray, FloatArray]:
    """The exact filter's beliefs, its joint belief after each frame (T, S), and the likelihood of
    each frame's evidence (T, S)."""
    with_joint = replace(
        compiled,
        hidden=(*compiled.hidden, _JOINT),
        cardinality={**compiled.cardinality, _JOINT: compiled.n_states},
        node_value=np.vstack([compiled.node_value, np.arange(compiled.n_states)]),
    )
    beliefs = filter_beliefs(with_joint, evidence, "exact", frame_id=frame_id, kernel=kernel)
    likelihood, _ = state_likelihood(compiled, evidence, beliefs.is_impossible)
    return beliefs, np.ascontiguousarray(beliefs.marginals[_JOINT]), likelihood


def state_likelihood(
    compiled: Compiled, evidence: Evidence, is_ignored: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """P(evidence of the frame | joint state), (T, S), over its largest entry, and the logarithm of
    that, (T,). Frames that are ignored (T,) have likelihood one."""
    blocks, _, _ = evidence_blocks(compiled, evidence)
    likelihood = np.ones((len(evidence), compiled.n_states))
    log_scale = np.zeros(len(evidence))
    for group, block in zip(compiled.groups, blocks, strict=True):
        # Scaled before and after: neither the likelihoods nor their product may underflow.
        shares, log_largest = over_largest(block)
        factor, log_factor = over_largest(shares @ group.emission.T)
        likelihood *= factor
        log_scale += log_largest + log_factor
    likelihood[is_ignored] = 1.0
    log_scale[is_ignored] = 0.0
    return likelihood, log_scale


def over_largest(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows (T, K) over their largest entry, and its logarithm (T,); zeros stay as they are."""
    largest = rows.max(axis=1, initial=0.0)
    largest[~(largest > 0)] = 1.0
    return rows / largest[:, None], np.log(largest)


def node_marginals(compiled: Compiled, joint: FloatArray) -> dict[str, FloatArray]:
    """Per hidden node (T, cardinality), from beliefs over the joint state (T, S)."""
    return {
        name: joint @ (value[:, None] == np.arange(compiled.cardinality[name])).astype(np.float64)
        for name, value in zip(compiled.hidden, compiled.node_value, strict=True)
    }


def _smooth_frames_numpy(
    filtered: FloatArray,
    likelihood: FloatArray,
    transition: FloatArray,
    input_index: IntArray,
    smoothed: FloatArray,
) -> None:
    """The NumPy twin of `_kernels.smooth_frames`, same arguments."""
    ahead = np.ones(filtered.shape[1])
    for t in range(len(filtered) - 1, -1, -1):
        if t < len(filtered) - 1:
            into = transition[input_index[t + 1]]
            ahead = _look_ahead_numpy(filtered[t], into, likelihood[t + 1] * ahead)
        smoothed[t] = _combined_numpy(filtered[t], ahead)


def _fixed_lag_frames_numpy(
    lag: int,
    filtered: FloatArray,
    likelihood: FloatArray,
    transition: FloatArray,
    input_index: IntArray,
    smoothed: FloatArray,
) -> None:
    """The NumPy twin of `_kernels.fixed_lag_frames`, same arguments."""
    for t in range(len(filtered)):
        ahead = np.ones(filtered.shape[1])
        for k in range(min(t + lag, len(filtered) - 1), t, -1):
            into = transition[input_index[k]]
            ahead = _look_ahead_numpy(filtered[k - 1], into, likelihood[k] * ahead)
        smoothed[t] = _combined_numpy(filtered[t], ahead)


def _look_ahead_numpy(filtered: FloatArray, into: FloatArray, weight: FloatArray) -> FloatArray:
    ahead = np.where(filtered > 0, into @ weight, 0.0)
    largest = ahead.max()
    # Zero everywhere only where floating-point numbers end: what comes later is ignored.
    return ahead / largest if largest > 0 else np.ones_like(ahead)


def _combined_numpy(filtered: FloatArray, ahead: FloatArray) -> FloatArray:
    both = (filtered > 0) & (ahead > 0)
    log_product = np.full(filtered.shape, -math.inf)
    log_product[both] = np.log(filtered[both]) + np.log(ahead[both])
    product = np.exp(log_product - log_product.max())
    return np.asarray(product / product.sum(), dtype=np.float64)
