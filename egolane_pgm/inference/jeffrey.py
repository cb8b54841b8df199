"""Soft evidence read by Jeffrey's rule (Jeffrey 1965): how probable each value of an observed node
is *after* the frame, not how likely the frame is given each value.

Let P(x) be the belief over the joint state that is predicted for a frame, and q(o) the probability
that the frame gives to the value o of an observed node. The belief after the frame is

    P'(x) = sum over o of q(o) P(x | o)

so that the node then has the distribution q, whatever was believed before. A likelihood of
q(o) / P(o) would give the same belief. It depends on the prediction P(o), which is why this reading
has a recursion of its own.

Several observed nodes are taken one after the other, in the order of `Compiled.observed`: as
declared, those with a common table next to each other. The order matters: the last node is
distributed as its evidence says, the earlier ones only nearly so.

A value that the prediction rules out (P(o) = 0) stays impossible, and the others share its q(o) in
proportion to their own. Where the others have nothing the frame is flagged and keeps its
prediction. The log evidence of a frame is the sum over the observed nodes of the logarithm of
(sum over o of q(o) P(o)), which for hard evidence is that of the other readings.
"""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.kernels.sweeps import jeffrey_frames
from egolane_pgm.inference.layout import PosteriorEvidence, joint_input, layout
from egolane_pgm.types import BoolArray, FloatArray, IntArray


def run_jeffrey(
    compiled: Compiled,
    evidence: PosteriorEvidence,
    begins: BoolArray,
    joint: FloatArray,
    is_factored: bool,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The filter's recursion with this update: arguments and what it gives as in
    `filtering.forward`."""
    index = joint_input(compiled, evidence)
    rows, is_said = _posterior_rows(compiled, evidence)
    start, group, value = _key_columns(compiled)
    n_frames = len(evidence)
    beliefs = np.empty((n_frames, compiled.n_states))
    log_evidence = np.empty(n_frames)
    is_impossible = np.empty(n_frames, dtype=bool)
    jeffrey_frames(
        joint,
        begins,
        is_factored,
        compiled.prior,
        compiled.transition,
        index,
        np.concatenate([g.emission for g in compiled.groups], axis=1),
        np.array([0, *accumulate(g.emission.shape[1] for g in compiled.groups)], dtype=np.int64),
        rows,
        is_said,
        start,
        group,
        value,
        layout(compiled).column,
        beliefs,
        log_evidence,
        is_impossible,
    )
    return beliefs, log_evidence, is_impossible


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
        # The largest first: the sum of huge numbers is no number.
        for most in (np.max, np.sum):
            total = most(flat, axis=1, keepdims=True)
            flat = flat / np.where(total > 0, total, 1.0)
        rows.append(flat)
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
