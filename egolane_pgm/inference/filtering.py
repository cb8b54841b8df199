"""Filters: the belief over the hidden nodes after each frame, given the evidence so far.

The evidence of a frame becomes, once, its likelihood given each joint state (`state_likelihood`).
All that follows stands on one recursion over that (`forward`): filters, online steps, smoothers,
the most probable path and the expected counts of learning.

`exact` carries the belief over the joint state from frame to frame. `assumed_density` carries the
product of the marginals of the nodes in it (Boyen and Koller 1998), which is what the paper's
equations in section "Inference" do: each marginal is propagated by its own table.

Each belief is divided by its sum, so that the length of a drive does not matter. Floating-point
numbers have their limits: a probability that is 300 decades smaller than another one of its frame
is zero, and so is a frame's likelihood below 2.2e-308.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.kernels.banded import Band, forward_banded
from egolane_pgm.inference.kernels.filter import forward_kernel, likelihood_kernel, multiply_chosen
from egolane_pgm.inference.layout import (
    evidence_blocks,
    joint_input,
    layout,
    marginals_of,
)
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

#: Kernels are compiled for the sizes of networks with at most this many joint states, ...
MAX_FIXED_STATES = 16
#: ... of groups with at most this many columns, and for recordings of at least this many frames.
MAX_FIXED_COLUMNS = 24
MIN_FIXED_FRAMES = 1000

#: The filter takes frames in pieces of about this many numbers: they stay in the processor's cache.
PIECE = 2**16


def filter_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    method: str = "exact",
    *,
    frame_id: IntArray | None = None,
) -> Beliefs:
    """P(node | evidence so far) for every hidden node and frame, and the log evidence.

    - evidence: T frames.
    - method: "exact", or "assumed_density" as the paper does it.
    - frame_id (T,): the beliefs' frame ids, 0, 1, ... by default.

    A frame whose joint likelihood is zero keeps its prediction and is flagged. Raises InputError
    for an unknown method and for evidence that does not fit the network (both named).

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> ego.filter_beliefs(run.model.compiled, run.evidence)
    Beliefs(300 frames, ids 0 to 299: SensorState (2), Lane (4))
    """
    _, beliefs = step(compiled, None, evidence, method)
    return beliefs if frame_id is None else replace(beliefs, frame_id=frame_id)


def step(
    compiled: Compiled, state: FloatArray | None, evidence: Evidence, method: str = "exact"
) -> tuple[FloatArray, Beliefs]:
    """Filter one more frame (or several) online: the new state and the beliefs of these frames.

    - state (S,): what the call before gave: the belief after its last frame, under assumed density
      the product of its marginals; None before the first frame; it is not changed.
    - evidence, method, errors: as in `filter_beliefs`.
    """
    if method not in METHODS:
        raise InputError(f"filter '{method}'{suggestion(method, METHODS)}")
    is_factored = method == "assumed_density"
    n_frames = len(evidence)
    ids = np.arange(n_frames)
    joint = np.zeros(compiled.n_states) if state is None else state.copy()
    begins = np.zeros(n_frames, dtype=bool)
    begins[:1] = state is None
    index = joint_input(compiled, evidence)
    done = []
    # A drive that is cut at a multiple of this gives the same beliefs to the last digit, but for
    # less than half of it at the end: a remainder is done with the piece before it.
    size = max(1, PIECE // compiled.n_states)
    starts = [*range(0, max(1, n_frames - size // 2), size), n_frames]
    for piece in map(slice, starts, starts[1:]):
        likelihood = state_likelihood(compiled, evidence, piece)
        beliefs, log_evidence, is_impossible = forward(
            compiled, likelihood, index[piece], begins[piece], joint, is_factored, out=likelihood
        )
        marginals = marginals_of(compiled, beliefs)
        done.append(Beliefs(ids[piece], marginals, log_evidence, is_impossible, compiled.values))
    return joint, Beliefs.joined(done)


def read_evidence(evidence: Evidence, reading: str) -> Evidence:
    """The evidence as the filter takes it (section "Inference"): `soft` as it is, a likelihood;
    `hard` only its most probable value. A tie has no most probable value: all that share it are
    kept as equals.
    """
    if reading == "soft":
        return evidence
    hard: dict[Observed, FloatArray] = {}
    for key, values in evidence.likelihoods.items():
        flat = values.reshape(len(values), math.prod(values.shape[1:]))
        largest = flat.max(axis=1, keepdims=True)
        hard[key] = (flat >= largest * (1 - 1e-9)).astype(np.float64).reshape(values.shape)
    return Evidence(hard, evidence.inputs)


def state_likelihood(
    compiled: Compiled, evidence: Evidence, frames: slice = slice(None)
) -> FloatArray:
    """P(evidence of the frame | joint state), (T, S), of some frames. Raises InputError as
    `evidence_blocks`."""
    blocks = evidence_blocks(compiled, evidence, frames)
    arrays, n_frames, n_states = layout(compiled), len(blocks[0]), compiled.n_states
    likelihood = np.ones((n_frames, n_states))
    is_fixed = n_frames >= MIN_FIXED_FRAMES and n_states <= MAX_FIXED_STATES
    for block, emission, only in zip(blocks, arrays.emissions, arrays.only, strict=True):
        if only is not None:
            multiply_chosen(block, only, likelihood)
        else:
            sizes = (n_states, len(emission))
            is_small = is_fixed and len(emission) <= MAX_FIXED_COLUMNS
            run = likelihood_kernel(*sizes) if is_small else likelihood_kernel()
            run(block, emission, likelihood)
    return likelihood


def forward(
    compiled: Compiled,
    likelihood: FloatArray,
    index: IntArray,
    begins: BoolArray,
    joint: FloatArray | None = None,
    is_factored: bool = False,
    out: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The forward recursion: the joint belief after each frame (T, S), the log evidence of each
    frame given those before (T,), and where the evidence was impossible and left out (T,).

    - likelihood (T, S): of the evidence, as `state_likelihood` makes it.
    - index (T,): the joint value of the inputs.
    - begins (T,): True where a sequence begins.
    - joint (S,): the belief before the first frame, overwritten by that after the last one. None
      where a sequence begins with the first frame.
    - is_factored: True for assumed density, False for the exact recursion.
    - out (T, S): where the beliefs are written. It may be `likelihood`, which is then lost: new
      memory takes a search as long as the recursion.
    """
    n_frames, n_states = likelihood.shape
    arrays = layout(compiled)
    if joint is None:
        joint = np.zeros(n_states)
    beliefs = np.empty((n_frames, n_states)) if out is None else out
    total, is_impossible = np.empty(n_frames), np.empty(n_frames, dtype=bool)
    run: Any
    transition: Band | FloatArray
    # The banded one knows the product of two marginals, not of more.
    if arrays.band is not None and (not is_factored or len(compiled.state_nodes) <= 2):
        run, transition = forward_banded, arrays.band
    else:
        is_fixed = n_frames >= MIN_FIXED_FRAMES and n_states <= MAX_FIXED_STATES
        run, transition = forward_kernel(arrays.columns if is_fixed else ()), compiled.transition
    run(
        joint, begins, is_factored, compiled.prior, transition, index, likelihood, arrays.column,
        beliefs, total, is_impossible,
    )  # fmt: skip
    return beliefs, np.log(np.where(is_impossible, 1.0, total)), is_impossible
