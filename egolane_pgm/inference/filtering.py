"""Filters: the belief over the hidden nodes after each frame, given the evidence so far.

`exact` carries the joint hidden state from frame to frame. `assumed_density` carries the product
of the persistent nodes' marginals (Boyen and Koller 1998), which is what the paper's equations in
section "Inference" do: each marginal is propagated by its own table.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from egolane_pgm.inference.compile import Compiled, Group
from egolane_pgm.inference.kernels.banded import Banded, banded
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
READINGS = ("soft", "hard", "jeffrey")


@dataclass(frozen=True)
class PosteriorEvidence(Evidence):
    """Evidence that is read by Jeffrey's rule (`jeffrey`). A row says how probable each value of
    the observed node is after the frame, up to a factor; one of nothing but ones says nothing."""

    def take(self, frames: slice | IntArray | BoolArray) -> PosteriorEvidence:
        """The evidence of some frames, in order."""
        some = super().take(frames)
        return PosteriorEvidence(some.likelihoods, some.inputs)


@dataclass(frozen=True)
class FilterState:
    """What an online filter carries: joint (S,), the belief after the last frame (its product of
    marginals under assumed density)."""

    joint: FloatArray


def filter_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    method: str = "assumed_density",
    *,
    frame_id: IntArray | None = None,
    kernel: bool = True,
) -> Beliefs:
    """P(node | evidence so far) for every hidden node and frame, and the log evidence.

    A frame whose joint likelihood is zero keeps its prediction and is flagged. `kernel=False`
    runs the NumPy twin. Raises InputError for an unknown method and for evidence that does not
    fit the network (both named).
    """
    ids = np.arange(len(evidence)) if frame_id is None else frame_id
    _, marginals, log_evidence, is_impossible = _run(compiled, evidence, method, None, kernel)
    return Beliefs(ids, _split(compiled, marginals), log_evidence, is_impossible)


def step(
    compiled: Compiled,
    state: FilterState | None,
    evidence: Evidence,
    method: str = "assumed_density",
    *,
    kernel: bool = True,
) -> tuple[FilterState, Beliefs]:
    """One more frame (or several) online: the new state and the beliefs of these frames.

    state: None before the first frame.
    """
    joint, marginals, log_evidence, is_impossible = _run(compiled, evidence, method, state, kernel)
    ids = np.arange(len(evidence))
    beliefs = Beliefs(ids, _split(compiled, marginals), log_evidence, is_impossible)
    return FilterState(joint), beliefs


def read_evidence(evidence: Evidence, reading: str) -> Evidence:
    """The evidence as the filter takes it (section "Inference"): `soft` as it is, a likelihood;
    `hard` only its most probable value; `jeffrey` as the posterior of the observed node. A tie has
    no most probable value: all that share it are kept as equals.
    """
    if reading == "soft":
        return evidence
    if reading == "jeffrey":
        return PosteriorEvidence(evidence.likelihoods, evidence.inputs)
    if reading != "hard":
        raise InputError(f"evidence reading '{reading}'{suggestion(reading, READINGS)}")
    hard: dict[Observed, FloatArray] = {}
    for key, values in evidence.likelihoods.items():
        flat = values.reshape(len(values), math.prod(values.shape[1:]))
        largest = flat.max(axis=1, keepdims=True)
        hard[key] = (flat >= largest * (1 - 1e-9)).astype(np.float64).reshape(values.shape)
    return Evidence(hard, evidence.inputs)


def _run(
    compiled: Compiled, evidence: Evidence, method: str, state: FilterState | None, kernel: bool
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    if method not in METHODS:
        raise InputError(f"filter '{method}'{suggestion(method, METHODS)}")
    if isinstance(evidence, PosteriorEvidence):
        from egolane_pgm.inference.jeffrey import run_jeffrey

        return run_jeffrey(compiled, evidence, method, state, kernel)
    if kernel:
        found = banded(compiled, node_columns)
        # Of more than two nodes the product of all marginals would be needed.
        if found is not None and (method == "exact" or len(compiled.state_nodes) <= 2):
            return _run_banded(compiled, found, evidence, method, state)
    blocks, start, emission = evidence_blocks(compiled, evidence)
    input_index = joint_input(compiled, evidence)
    node_column, n_columns = node_columns(compiled)
    n_frames = len(evidence)
    joint = np.zeros(compiled.n_states) if state is None else state.joint.copy()
    log_evidence = np.empty(n_frames)
    is_impossible = np.empty(n_frames, dtype=bool)
    run: Any
    values: Any
    if kernel:
        from egolane_pgm.inference.kernels.filter import filter_blocks as run

        values, marginals = blocks, np.empty((n_frames, n_columns))
    else:
        run = _filter_frames_numpy
        values, marginals = np.concatenate(blocks, axis=1), np.zeros((n_frames, n_columns))
    run(
        joint,
        state is None,
        method == "assumed_density",
        compiled.prior,
        compiled.transition,
        input_index,
        emission,
        start,
        values,
        node_column,
        len(compiled.state_nodes),
        marginals,
        log_evidence,
        is_impossible,
    )
    return joint, marginals, log_evidence, is_impossible


def _run_banded(
    compiled: Compiled, found: Banded, evidence: Evidence, method: str, state: FilterState | None
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    from egolane_pgm.inference.kernels.banded import filter_banded

    n_frames = len(evidence)
    joint = np.zeros(compiled.n_states) if state is None else state.joint.copy()
    marginals = np.empty((n_frames, found.n_columns))
    log_evidence = np.empty(n_frames)
    is_impossible = np.empty(n_frames, dtype=bool)
    check_keys(compiled, evidence)
    blocks = [_group_evidence(group, evidence.likelihoods) for group in compiled.groups]
    values = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)
    filter_banded(
        joint,
        state is None,
        method == "assumed_density",
        found.state,
        found.prior,
        found.others,
        found.half,
        found.floor,
        found.band,
        found.column,
        found.by_wide,
        found.by_others,
        found.by_both,
        joint_input(compiled, evidence),
        found.group_start,
        np.ascontiguousarray(values, dtype=np.float64),
        marginals,
        log_evidence,
        is_impossible,
    )
    return joint, marginals, log_evidence, is_impossible


def _filter_frames_numpy(
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
    """The NumPy twin of `kernels.filter_frames`, same arguments."""
    groups = [slice(a, b) for a, b in pairwise(group_start)]
    for t, row in enumerate(evidence):
        u = input_index[t]
        predicted = prior[u] if is_first and t == 0 else joint @ transition[u]
        log_scale = 0.0
        weighted = predicted.copy()
        for g in groups:
            largest = row[g].max()
            if largest > 0:
                weighted *= emission[:, g] @ (row[g] / largest)
                log_scale += math.log(largest)
            else:
                weighted *= 0.0
        total = weighted.sum()
        is_impossible[t] = not total > 0
        if total > 0:
            joint[:] = weighted / total
            log_evidence[t] = math.log(total) + log_scale
        else:
            joint[:] = predicted / predicted.sum()
            log_evidence[t] = 0.0
        for columns in node_column:
            np.add.at(marginals[t], columns, joint)
        if is_factored:
            joint[:] = marginals[t][node_column[:n_persistent]].prod(axis=0)


def evidence_blocks(
    compiled: Compiled, evidence: Evidence
) -> tuple[list[FloatArray], IntArray, FloatArray]:
    """The evidence of each group (T, K), where each group's columns start (G + 1,) in the emission
    (S, K), which has those of all groups side by side.

    Raises InputError naming an observed node without evidence, evidence without a node, or a
    wrong shape.
    """
    if isinstance(evidence, PosteriorEvidence):
        raise InputError(
            "evidence read by Jeffrey's rule is no likelihood: only the filters exact and"
            " assumed_density take it; use evidence_reading soft or hard here"
        )
    check_keys(compiled, evidence)
    blocks = [
        np.ascontiguousarray(_group_evidence(group, evidence.likelihoods), dtype=np.float64)
        for group in compiled.groups
    ]
    layout = _layout(compiled)
    return blocks, layout.start, layout.emission


def check_keys(compiled: Compiled, evidence: Evidence) -> None:
    """Raise InputError, naming the node, where evidence and network do not fit each other."""
    observed, n_frames = compiled.observed, len(evidence)
    for key in observed:
        if key not in evidence.likelihoods:
            raise InputError(f"observed node {key}: the evidence has nothing for it")
    for key, values in evidence.likelihoods.items():
        if key not in observed:
            raise InputError(f"evidence for {key}: the graph does not observe such a node")
        names = (key,) if isinstance(key, str) else key
        shape = (n_frames, *[compiled.cardinality[n] for n in names])
        if values.shape != shape:
            raise InputError(f"evidence for {key}: shape {values.shape}, the graph needs {shape}")
    for name in compiled.inputs:
        if name not in evidence.inputs:
            raise InputError(f"input node {name}: the evidence has nothing for it")
    for name, index in evidence.inputs.items():
        if name not in compiled.inputs:
            raise InputError(f"input {name}: the graph has no such input node")
        ends = index if len(index) < 2 else (index.min(), index.max())
        if not all(0 <= end < compiled.cardinality[name] for end in ends):
            raise InputError(f"input {name}: outside 0..{compiled.cardinality[name] - 1}")


def _group_evidence(group: Group, likelihoods: Mapping[Observed, FloatArray]) -> FloatArray:
    """(T, K): the product of the group's evidence over all its nodes' values."""
    if len(group.observed) == 1:
        values = likelihoods[group.observed[0]]
        return values.reshape(len(values), math.prod(group.sizes))
    n_frames = len(likelihoods[group.observed[0]])
    product = np.ones((n_frames, *group.sizes))
    for key, axes in zip(group.observed, group.axes, strict=True):
        values = likelihoods[key]
        # The evidence's axes in the order of the group's, then 1 where it says nothing.
        ordered = values.transpose(0, *(1 + np.argsort(axes)))
        shape = [size if k in axes else 1 for k, size in enumerate(group.sizes)]
        product *= ordered.reshape(n_frames, *shape)
    return product.reshape(n_frames, math.prod(group.sizes))


def joint_input(compiled: Compiled, evidence: Evidence) -> IntArray:
    """(T,): which joint value of the input nodes each frame has; 0 without inputs."""
    if not compiled.inputs:
        return np.zeros(len(evidence), dtype=np.int64)
    if len(compiled.inputs) == 1:
        return np.ascontiguousarray(evidence.inputs[compiled.inputs[0]], dtype=np.int64)
    sizes = [compiled.cardinality[name] for name in compiled.inputs]
    parts = [evidence.inputs[name] for name in compiled.inputs]
    return np.asarray(np.ravel_multi_index(parts, sizes), dtype=np.int64)


def node_columns(compiled: Compiled) -> tuple[IntArray, int]:
    """(H, S): which column of the marginals each node's value in each state adds to; persistent
    nodes first, then functions; and the number of columns."""
    layout = _layout(compiled)
    return layout.node_column, layout.n_columns


@dataclass(frozen=True)
class _Layout:
    """What `evidence_blocks` and `node_columns` say of a network, whatever the evidence."""

    start: IntArray
    emission: FloatArray
    node_column: IntArray
    n_columns: int


_layouts: dict[int, tuple[weakref.ref[Compiled], _Layout]] = {}


def _layout(compiled: Compiled) -> _Layout:
    """Made once per network: with a kernel this quick it would be a tenth of the time."""
    key = id(compiled)
    if key not in _layouts:
        column = 0
        rows = []
        for name in _node_order(compiled):
            rows.append(column + compiled.node_value[compiled.hidden.index(name)])
            column += compiled.cardinality[name]
        widths = [group.emission.shape[1] for group in compiled.groups]
        layout = _Layout(
            np.array([0, *accumulate(widths)], dtype=np.int64),
            np.ascontiguousarray(np.concatenate([g.emission for g in compiled.groups], axis=1)),
            np.array(rows, dtype=np.int64),
            column,
        )
        _layouts[key] = (weakref.ref(compiled, lambda _: _layouts.pop(key, None)), layout)
    return _layouts[key][1]


def _node_order(compiled: Compiled) -> list[str]:
    functions = [name for name in compiled.hidden if name not in compiled.state_nodes]
    return [*compiled.state_nodes, *functions]


def _split(compiled: Compiled, marginals: FloatArray) -> dict[str, FloatArray]:
    start = 0
    nodes = {}
    for name in _node_order(compiled):
        size = compiled.cardinality[name]
        nodes[name] = marginals[:, start : start + size]
        start += size
    return nodes
