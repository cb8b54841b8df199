"""Filters: the posterior over the hidden nodes after each frame, given the evidence so far.

The evidence of a frame becomes its likelihood given each joint state (`state_likelihood`). One
recursion (`forward`) takes these likelihoods; filters, online steps, smoothers, the most probable
path and the expected counts of learning all use it.

`exact` propagates the posterior over the joint state. `assumed_density` propagates the product of
the marginals of its nodes (Boyen and Koller 1998), as the paper's equations in section "Inference"
do: each marginal is propagated by its table.

Each posterior is normalised, so the length of a drive does not matter. A probability that is 300
decades smaller than another one of its frame is zero, and so is a frame's likelihood below
2.2e-308. Evidence of several groups is scaled first, so that this concerns each group alone and not
their product.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from egolane_pgm.inference.compile import Compiled, takes_any_model
from egolane_pgm.inference.kernels.banded import MIN_STATES, Band, find_band, forward_banded
from egolane_pgm.inference.kernels.filter import forward_kernel, multiply_likelihood
from egolane_pgm.types import (
    Beliefs,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    Observed,
    suggestion,
)

METHODS = ("assumed_density", "exact")

#: The recursion is compiled for the sizes of a network with at most this many joint states, if a
#: recording has at least this many frames.
MAX_FIXED_STATES = 16
MIN_FIXED_FRAMES = 1000

#: With several groups, the likelihoods of a group are divided by a power of two in frames whose
#: largest one has an exponent (of two) farther from 0 than this: the product of ten groups then
#: neither underflows nor overflows.
LARGEST_EXPONENT = 100

#: The filter works on chunks of about this many numbers, which fit the processor's cache.
PIECE = 2**16


@takes_any_model
def filter_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    method: str = "exact",
    *,
    frame_id: IntArray | None = None,
    is_first: BoolArray | None = None,
) -> Beliefs:
    """Return P(node | evidence so far) for every hidden node and frame, and the log evidence.

    - evidence: T frames.
    - method: "exact", or "assumed_density" (the paper's).
    - frame_id (T,): the beliefs' frame ids, 0, 1, ... by default.
    - is_first (T,): True where a sequence begins; by default the first frame only.

    A frame whose joint likelihood is zero keeps its prediction and is flagged. Raises InputError
    for an unknown method and for evidence that does not fit the network (both named).

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> ego.filter_beliefs(run.model.compiled, run.evidence)
    Beliefs(300 frames, ids 0 to 299: SensorState (2), Lane (4))
    """
    _, beliefs = step(compiled, None, evidence, method, is_first=is_first)
    return beliefs if frame_id is None else replace(beliefs, frame_id=frame_id)


def step(
    compiled: Compiled,
    state: FloatArray | None,
    evidence: Evidence,
    method: str = "exact",
    *,
    is_first: BoolArray | None = None,
) -> tuple[FloatArray, Beliefs]:
    """Filter one more frame (or several) online; return the new state and the frames' beliefs.

    - state (S,): the state that the previous call returned (not modified), None at the start: the
      belief after the last frame, under assumed density the product of its marginals.
    - evidence, method, is_first, errors: as in `filter_beliefs`.
    """
    if method not in METHODS:
        raise InputError(f"filter '{method}'{suggestion(method, METHODS)}")
    is_factored = method == "assumed_density"
    n_frames = len(evidence)
    ids = np.arange(n_frames)
    joint = np.zeros(compiled.n_states) if state is None else state.copy()
    begins = first_frames(n_frames, is_first, starts=state is None)
    index = joint_input(compiled, evidence)
    done = []
    # A drive that is cut at a multiple of this size gives bit-identical beliefs. A last chunk of
    # less than half the size is joined to the one before.
    size = max(1, PIECE // compiled.n_states)
    starts = [*range(0, max(1, n_frames - size // 2), size), n_frames]
    for piece in map(slice, starts, starts[1:]):
        likelihood, log_scale = state_likelihood(compiled, evidence, piece)
        beliefs, log_evidence, is_impossible = forward(
            compiled, likelihood, log_scale, index[piece], begins[piece], joint, is_factored,
            out=likelihood,
        )  # fmt: skip
        rows = beliefs @ compiled.indicator
        marginals = {name: rows[:, columns] for name, columns in compiled.parts.items()}
        done.append(Beliefs(ids[piece], marginals, log_evidence, is_impossible, compiled.values))
    return joint, Beliefs.concat(done)


def first_frames(n_frames: int, is_first: BoolArray | None, *, starts: bool = True) -> BoolArray:
    """Return where sequences begin, (T,).

    - starts: whether one begins with the first frame in any case.

    Raises InputError for an array of another length.
    """
    begins = np.zeros(n_frames, dtype=bool) if is_first is None else np.array(is_first, dtype=bool)
    if begins.shape != (n_frames,):
        raise InputError(f"is_first: shape {begins.shape}, the evidence has {n_frames} frames")
    begins[:1] |= starts
    return begins


def harden(evidence: Evidence) -> Evidence:
    """Replace each likelihood by 1 for its largest value and 0 for all others (evidence mode
    `hard`, section "Inference"). Values that tie for the largest are all kept."""
    hard: dict[Observed, FloatArray] = {}
    for key, values in evidence.likelihoods.items():
        flat = values.reshape(len(values), math.prod(values.shape[1:]))
        largest = flat.max(axis=1, keepdims=True)
        hard[key] = (flat >= largest * (1 - 1e-9)).astype(np.float64).reshape(values.shape)
    return Evidence(hard, evidence.inputs)


def joint_input(compiled: Compiled, evidence: Evidence) -> IntArray:
    """Return the joint value of the input nodes in each frame, (T,); 0 without inputs.

    Raises InputError, naming the node, for evidence that does not fit the network.
    """
    if not isinstance(evidence, Evidence):
        raise InputError(
            f"evidence: needs an Evidence, not a {type(evidence).__name__}: Evidence(...) of"
            " likelihoods, or Evidence.hard(...) of observed values"
        )
    joint = np.zeros(len(evidence), dtype=np.int64)
    for what, needed, given in (
        ("observed", compiled.observed, evidence.likelihoods),
        ("input", compiled.inputs, evidence.inputs),
    ):
        for key in needed:
            if key not in given:
                raise InputError(f"{what} node {key}: the evidence has nothing for it")
        for key in given:
            if key not in needed:
                raise InputError(f"evidence for {key}: the graph has no such {what} node")
    for key, values in evidence.likelihoods.items():
        names = (key,) if isinstance(key, str) else key
        needs = (len(evidence), *(compiled.cardinality[name] for name in names))
        if values.shape != needs:
            raise InputError(f"evidence for {key}: shape {values.shape}, the graph needs {needs}")
    for name in compiled.inputs:
        index = evidence.inputs[name]
        size = compiled.cardinality[name]
        if len(index) and not 0 <= index.min() <= index.max() < size:
            raise InputError(f"input {name}: outside 0..{size - 1}")
        joint = joint * size + index
    return joint


def evidence_blocks(
    compiled: Compiled, evidence: Evidence, frames: slice = slice(None)
) -> list[FloatArray]:
    """Return the evidence of each group in some frames, (T, K). `joint_input` has checked it."""
    blocks = []
    for group in compiled.groups:
        values = evidence.likelihoods[group.observed][frames]
        rows = values.reshape(len(values), math.prod(values.shape[1:]))
        blocks.append(np.ascontiguousarray(rows, dtype=np.float64))
    return blocks


def state_likelihood(
    compiled: Compiled, evidence: Evidence, frames: slice = slice(None)
) -> tuple[FloatArray, FloatArray]:
    """Return P(evidence of the frame | joint state) of some frames, divided by a scale.

    Returns the likelihoods (T, S) and the natural logarithm of the scale (T,), which is 0 in
    ordinary frames.
    """
    blocks = evidence_blocks(compiled, evidence, frames)
    likelihood = np.ones((len(blocks[0]), compiled.n_states))
    log_scale = np.zeros(len(likelihood))
    for block, group in zip(blocks, compiled.groups, strict=True):
        if len(blocks) > 1:
            exponent = np.frexp(reduce(np.maximum, block.T))[1]
            exponent[np.abs(exponent) <= LARGEST_EXPONENT] = 0
            if exponent.any():
                # A power of two changes no digit.
                block = np.ldexp(block, -exponent[:, None])
                log_scale += exponent * math.log(2)
        if group.only is not None:
            likelihood *= block[:, group.only]
        else:
            multiply_likelihood(block, np.ascontiguousarray(group.emission.T), likelihood)
    return likelihood, log_scale


def fixed_states(compiled: Compiled, n_frames: int) -> int:
    """The number of joint states that a backward recursion is compiled for; 0 for any number."""
    is_fixed = n_frames >= MIN_FIXED_FRAMES and compiled.n_states <= MAX_FIXED_STATES
    return compiled.n_states if is_fixed else 0


def forward(
    compiled: Compiled,
    likelihood: FloatArray,
    log_scale: FloatArray,
    index: IntArray,
    begins: BoolArray,
    joint: FloatArray | None = None,
    is_factored: bool = False,
    out: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Run the forward recursion.

    - likelihood (T, S), log_scale (T,): from `state_likelihood`.
    - index (T,): the joint value of the inputs.
    - begins (T,): True in the first frame of each sequence.
    - joint (S,): the belief before the first frame, overwritten by the belief after the last one;
      None if a sequence begins with the first frame.
    - is_factored: True for assumed density, False for the exact recursion.
    - out (T, S): output array for the beliefs; may be `likelihood`, which saves as much time as the
      recursion takes.

    Returns the joint belief after each frame (T, S), the log evidence of each frame given the
    previous ones (T,), and whether the frame's evidence was impossible and ignored (T,).
    """
    n_frames, n_states = likelihood.shape
    if joint is None:
        joint = np.zeros(n_states)
    beliefs = np.empty((n_frames, n_states)) if out is None else out
    total = np.empty(n_frames)
    is_impossible = np.empty(n_frames, dtype=bool)
    run: Any
    transition: Band | FloatArray
    band = find_band(compiled) if n_states >= MIN_STATES else None
    # The banded recursion takes the product of at most two marginals.
    if band is not None and (not is_factored or len(compiled.state_nodes) <= 2):
        run = forward_banded
        transition = band
    else:
        is_fixed = n_frames >= MIN_FIXED_FRAMES and n_states <= MAX_FIXED_STATES
        columns = tuple(map(tuple, compiled.column.tolist())) if is_fixed else ()
        run = forward_kernel(columns)
        transition = compiled.transition
    run(
        joint, begins, is_factored, compiled.prior, transition, index, likelihood, compiled.column,
        beliefs, total, is_impossible,
    )  # fmt: skip
    log_evidence = np.log(np.where(is_impossible, 1.0, total)) + log_scale * ~is_impossible
    return beliefs, log_evidence, is_impossible
