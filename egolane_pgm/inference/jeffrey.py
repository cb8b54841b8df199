"""Soft evidence read by Jeffrey's rule: the *posterior* of the observed node, not a likelihood.

For evidence q over the values o of an observed node and a belief P from before,
P'(x) = sum_o q(o) P(x | o) (Jeffrey 1965): afterwards the node is distributed as q says, whatever
was believed before. That is virtual evidence with the likelihood q(o) / P(o), P(o) the predicted
marginal of the node, so every frame needs its prediction.

Several observed nodes are taken one after the other, in the order of `Compiled.observed`: as
declared, those with a common table next to each other. Jeffrey's rule does not commute: the last
node is distributed as its evidence says, the earlier ones only nearly so.

Values that were impossible before (P(o) = 0) stay so, and q is shared out among the others in
proportion; where q gives the others nothing the frame is flagged and keeps its prediction. The log
evidence is the sum over the observed nodes of log sum_o q(o) P(o), which for hard evidence is that
of the other readings.
"""

from __future__ import annotations

import math
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import (
    FilterState,
    PosteriorEvidence,
    check_keys,
    joint_input,
    node_columns,
)
from egolane_pgm.types import BoolArray, FloatArray, IntArray


def run_jeffrey(
    compiled: Compiled,
    evidence: PosteriorEvidence,
    method: str,
    state: FilterState | None,
    kernel: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """The filter's recursion: the joint belief after the last frame (S,), and for each frame the
    marginals (T, M), the log evidence and the flag (T,)."""
    check_keys(compiled, evidence)
    rows, is_said = _posterior_rows(compiled, evidence)
    start, group, value = _key_columns(compiled)
    node_column, n_columns = node_columns(compiled)
    n_frames = len(evidence)
    joint = np.zeros(compiled.n_states) if state is None else state.joint.copy()
    marginals = np.zeros((n_frames, n_columns))
    log_evidence = np.empty(n_frames)
    is_impossible = np.empty(n_frames, dtype=bool)
    run: Any = _jeffrey_frames_numpy
    if kernel:
        from egolane_pgm.inference.kernels.sweeps import jeffrey_frames as run
    run(
        joint,
        state is None,
        method == "assumed_density",
        compiled.prior,
        compiled.transition,
        joint_input(compiled, evidence),
        np.ascontiguousarray(np.concatenate([g.emission for g in compiled.groups], axis=1)),
        np.array([0, *accumulate(g.emission.shape[1] for g in compiled.groups)], dtype=np.int64),
        rows,
        is_said,
        start,
        group,
        value,
        node_column,
        len(compiled.state_nodes),
        marginals,
        log_evidence,
        is_impossible,
    )
    return joint, marginals, log_evidence, is_impossible


def _posterior_rows(
    compiled: Compiled, evidence: PosteriorEvidence
) -> tuple[FloatArray, BoolArray]:
    """Per observed node its evidence, rows summing to one (or all zero), side by side (T, V); and
    whether a frame says anything about it (T, N): a row of nothing but ones does not."""
    rows, said = [], []
    for key in compiled.observed:
        values = evidence.likelihoods[key]
        flat = values.reshape(len(values), math.prod(values.shape[1:])).astype(np.float64)
        said.append(~(flat == 1.0).all(axis=1) | (flat.shape[1] == 1))
        # Over the largest first: the sum of huge numbers overflows.
        largest = flat.max(axis=1, keepdims=True)
        flat = flat / np.where(largest > 0, largest, 1.0)
        total = flat.sum(axis=1, keepdims=True)
        rows.append(flat / np.where(total > 0, total, 1.0))
    return np.concatenate(rows, axis=1), np.stack(said, axis=1)


def _key_columns(compiled: Compiled) -> tuple[IntArray, IntArray, IntArray]:
    """Per observed node: where its values start (N + 1,), its group (N,), and its value in each
    column of the emissions (N, K), 0 in other groups'."""
    starts, groups, values = [0], [], []
    n_columns = sum(g.emission.shape[1] for g in compiled.groups)
    first = 0
    for g, group in enumerate(compiled.groups):
        size = group.emission.shape[1]
        columns = np.indices(group.sizes).reshape(len(group.sizes), -1)
        for axes in group.axes:
            sizes = [group.sizes[k] for k in axes]
            row = np.zeros(n_columns, dtype=np.int64)
            row[first : first + size] = np.ravel_multi_index([columns[k] for k in axes], sizes)
            starts.append(starts[-1] + math.prod(sizes))
            groups.append(g)
            values.append(row)
        first += size
    return np.array(starts), np.array(groups), np.stack(values)


def _jeffrey_frames_numpy(
    joint: FloatArray,
    is_first: bool,
    is_factored: bool,
    prior: FloatArray,
    transition: FloatArray,
    input_index: IntArray,
    emission: FloatArray,
    group_start: IntArray,
    posterior: FloatArray,
    is_said: BoolArray,
    key_start: IntArray,
    key_group: IntArray,
    key_value: IntArray,
    node_column: IntArray,
    n_persistent: int,
    marginals: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """The NumPy twin of `_kernels.jeffrey_frames`, same arguments."""
    groups = [slice(a, b) for a, b in pairwise(group_start)]
    keys = [slice(a, b) for a, b in pairwise(key_start)]
    for t, row in enumerate(posterior):
        u = input_index[t]
        predicted = prior[u] if is_first and t == 0 else joint @ transition[u]
        factor = np.ones(emission.shape[1])
        of_group = np.ones((len(groups), len(joint)))
        log_total = 0.0
        is_impossible[t] = False
        for i in np.flatnonzero(is_said[t]):
            g, columns = key_group[i], groups[key_group[i]]
            q, value = row[keys[i]], key_value[i, columns]
            others = predicted * np.delete(of_group, g, axis=0).prod(axis=0)
            mass = (others @ emission[:, columns]) * factor[columns]
            expected = np.bincount(value, mass, minlength=len(q))
            expected = expected / expected.sum()
            agreement = float(q @ expected)
            if not agreement > 0:
                is_impossible[t] = True
                break
            log_total += math.log(agreement)
            possible = expected > 0
            ratio = np.zeros(len(q))
            ratio[possible] = q[possible] / q[possible].sum() / expected[possible]
            factor[columns] *= ratio[value]
            of_group[g] = emission[:, columns] @ factor[columns]
        weighted = predicted if is_impossible[t] else predicted * of_group.prod(axis=0)
        joint[:] = weighted / weighted.sum()
        log_evidence[t] = 0.0 if is_impossible[t] else log_total
        for columns in node_column:
            np.add.at(marginals[t], columns, joint)
        if is_factored:
            joint[:] = marginals[t][node_column[:n_persistent]].prod(axis=0)
