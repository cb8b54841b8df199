"""Many parameter sets on one recording: only their confusions, never their beliefs.

What a parameter search asks for: the sets are filtered side by side, a few at a time, and each
frame is counted as soon as its belief is known.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import (
    METHODS,
    evidence_blocks,
    filter_beliefs,
    node_columns,
)
from egolane_pgm.types import (
    TIE_TOLERANCE,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    suggestion,
)


def confusions_many(
    compiled: Sequence[Compiled],
    evidence: Evidence,
    truth_lane: IntArray,
    is_crossing: BoolArray,
    method: str = "assumed_density",
    *,
    node: str = "Lane",
) -> IntArray:
    """The confusion matrix of each of P networks of one structure, (P, n + 1, n), int64.

    Rows are the most probable lane, then Unassigned (the runner-up is within TIE_TOLERANCE,
    relative); columns are the actual lane; crossing frames are filtered, not counted. truth_lane
    (T,): 1..n where not crossing. is_crossing (T,). node: the hidden node that is scored.

    Raises InputError for networks of different structure, an unknown method, lanes out of range,
    and evidence that does not fit.
    """
    if method not in METHODS:
        raise InputError(f"filter '{method}'{suggestion(method, METHODS)}")
    if not compiled:
        raise InputError("confusions of no parameter set at all: give at least one")
    model = compiled[0]
    if node not in model.hidden:
        raise InputError(f"node '{node}' is not a hidden one{suggestion(node, model.hidden)}")
    for other in compiled[1:]:
        if not _same_structure(model, other):
            raise InputError("the networks differ in structure, not only in parameter values")
    n_lanes = model.cardinality[node]
    column = _true_column(truth_lane, is_crossing, len(evidence), n_lanes)
    counts = _side_by_side(compiled, evidence, column, method, node)
    if counts is not None:
        return counts
    return np.stack(
        [_counted(filter_beliefs(c, evidence, method).marginals[node], column) for c in compiled]
    )


def _side_by_side(
    compiled: Sequence[Compiled], evidence: Evidence, column: IntArray, method: str, node: str
) -> IntArray | None:
    """None where the kernel for many sets cannot do it: inputs, size, zero likelihoods, evidence
    of a kind that is read in another way."""
    from egolane_pgm.inference.kernels.filter import confusion_counts, kernel_size

    if type(evidence) is not Evidence:
        return None
    model = compiled[0]
    blocks, start, _ = evidence_blocks(model, evidence)
    columns, _ = node_columns(model)
    size = kernel_size(start, columns, len(model.state_nodes), method == "assumed_density")
    if model.inputs or not size.is_small or len(column) < 2:
        return None
    ordered = [name for name in model.hidden if name in model.state_nodes]
    ordered += [name for name in model.hidden if name not in model.state_nodes]
    first = sum(model.cardinality[name] for name in ordered[: ordered.index(node)])
    lanes = tuple(range(first, first + model.cardinality[node]))
    tables = np.empty((len(compiled), size.n_rows, size.n_states))
    for k, one in enumerate(compiled):
        tables[k, : size.n_states] = one.transition[0]
        row = size.n_states
        for group in one.groups:
            tables[k, row : row + group.emission.shape[1]] = group.emission.T
            row += group.emission.shape[1]
    prior = np.stack([one.prior[0] for one in compiled])
    return confusion_counts(size, lanes, prior, tables, blocks, column, TIE_TOLERANCE)


def _same_structure(a: Compiled, b: Compiled) -> bool:
    return (
        (a.hidden, a.state_nodes, a.inputs) == (b.hidden, b.state_nodes, b.inputs)
        and dict(a.cardinality) == dict(b.cardinality)
        and [(g.observed, g.nodes) for g in a.groups] == [(g.observed, g.nodes) for g in b.groups]
        and a.node_value.tobytes() == b.node_value.tobytes()
    )


def _true_column(
    truth_lane: IntArray, is_crossing: BoolArray, n_frames: int, n_lanes: int
) -> IntArray:
    """The index of the true lane, -1 in crossing frames."""
    for name, array in (("truth_lane", truth_lane), ("is_crossing", is_crossing)):
        if np.shape(array) != (n_frames,):
            raise InputError(f"{name} has shape {np.shape(array)}, needs ({n_frames},)")
    column = np.where(is_crossing, -1, truth_lane - 1).astype(np.int64)
    bad = ~np.asarray(is_crossing, dtype=bool) & ((column < 0) | (column >= n_lanes))
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(f"ground truth: row {k} has lane {truth_lane[k]}, outside 1..{n_lanes}")
    return column


def _counted(belief: FloatArray, column: IntArray) -> IntArray:
    """The confusion (n + 1, n) of one belief (T, n)."""
    n_lanes = belief.shape[1]
    top = belief.max(axis=1, keepdims=True)
    is_near = belief >= top - TIE_TOLERANCE * top
    row = np.where(is_near.sum(axis=1) == 1, belief.argmax(axis=1), n_lanes)
    scored = column >= 0
    cell = row[scored] * n_lanes + column[scored]
    counts = np.bincount(cell, minlength=(n_lanes + 1) * n_lanes)
    return counts.astype(np.int64).reshape(n_lanes + 1, n_lanes)
