"""Networks in which one node moves only to values near its own, and all else moves by itself: what
the filter needs to know of them, read off the compiled arrays.

The joint transition of such a network is, for each value of the inputs, the product of the wide
node's table (a band around the diagonal, and one small number everywhere outside of it) and the
other nodes' table; and every emission table says of each joint state which one value it has. The
cost of a frame is then the number of states times the width of the band.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.kernels.unrolled import HUGE, TINY
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Networks with fewer joint states are as quick with the plain recursion.
MIN_STATES = 32

#: Entries that differ by less than this are equal: products of tables are rounded.
_EQUAL = 1e-14


@dataclass(frozen=True)
class Banded:
    """R values of the wide node, Q joint values of the others, U of the inputs.

    state (Q, R): number of the joint state. prior (U, Q, R). others (U, Q, Q): their transition,
    row is the value before. half (U,): half-width of the band. floor (U,): what the wide node's
    transition has outside of it, and is left out of the band. band (U, 2 max(half) + 1, R): entry
    [u, max(half) + d, r] is the transition to r from r - d. column (G, Q, R): the column of the
    evidence that is each joint state's likelihood, per group.
    by_wide, by_others, by_both (M, 2): what adds to the marginals of nodes that depend on the wide
    node, the others, both: (index of the value, or of the entry of `state`; column).
    group_start (G + 1,): where each group's columns of the evidence start. n_columns: M of the
    marginals.
    """

    state: IntArray
    prior: FloatArray
    others: FloatArray
    half: IntArray
    floor: FloatArray
    band: FloatArray
    column: IntArray
    by_wide: IntArray
    by_others: IntArray
    by_both: IntArray
    group_start: IntArray
    n_columns: int


_known: dict[int, tuple[weakref.ref[Compiled], Banded | None]] = {}


def banded(
    compiled: Compiled, node_columns: Callable[[Compiled], tuple[IntArray, int]]
) -> Banded | None:
    """The structure of a compiled network, or None where it has none or is too small to gain by
    it. node_columns: as in `filtering`. Looked for once per network."""
    if compiled.n_states < MIN_STATES:
        return None
    key = id(compiled)
    if key not in _known:
        found = _find(compiled, *node_columns(compiled))
        _known[key] = (weakref.ref(compiled, lambda _: _known.pop(key, None)), found)
    return _known[key][1]


def _find(compiled: Compiled, node_column: IntArray, n_columns: int) -> Banded | None:
    column = _columns(compiled)
    if column is None:
        return None
    sizes = [compiled.cardinality[name] for name in compiled.state_nodes]
    wide = int(np.argmax(sizes))
    n_wide, n_others = sizes[wide], math.prod(sizes) // sizes[wide]
    numbers = np.arange(compiled.n_states).reshape(sizes)
    state = np.moveaxis(numbers, wide, -1).reshape(n_others, n_wide)
    flat = state.reshape(-1)
    n_inputs = len(compiled.prior)
    own = np.empty((n_inputs, n_wide, n_wide))
    others = np.empty((n_inputs, n_others, n_others))
    # Both states' wide node behind the others of the same state.
    order = [k for k in range(len(sizes)) if k != wide] + [wide]
    axes = [*order, *(len(sizes) + k for k in order)]
    for u in range(n_inputs):
        whole = compiled.transition[u].reshape(*sizes, *sizes).transpose(axes)
        whole = whole.reshape(n_others, n_wide, n_others, n_wide)
        own[u] = sum(whole[0, :, q] for q in range(n_others))
        others[u] = whole[:, 0].sum(axis=2)
        rest = others[u][:, None, :, None] * own[u][:, None, :] - whole
        if np.abs(rest).max() > _EQUAL:
            return None
    half, floor, band = _bands(own)
    prior = np.ascontiguousarray(compiled.prior[:, flat].reshape(n_inputs, n_others, n_wide))
    return Banded(
        np.ascontiguousarray(state),
        prior,
        others,
        half,
        floor,
        band,
        np.ascontiguousarray(column[:, state]),
        *_marginal_rows(node_column, state),
        np.cumsum([0] + [g.emission.shape[1] for g in compiled.groups]).astype(np.int64),
        n_columns,
    )


def _columns(compiled: Compiled) -> IntArray | None:
    """(G, S): the one column of each group's evidence that a state selects."""
    columns = []
    start = 0
    for group in compiled.groups:
        if not (np.isin(group.emission, (0.0, 1.0)).all() and (group.emission.sum(1) == 1).all()):
            return None
        columns.append(start + group.emission.argmax(axis=1))
        start += group.emission.shape[1]
    return np.stack(columns).astype(np.int64)


def _bands(own: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    n_inputs, size, _ = own.shape
    distance = np.abs(np.arange(size)[:, None] - np.arange(size))
    floor = own.min(axis=(1, 2))
    half = np.array(
        [distance[np.abs(w - f) > _EQUAL].max(initial=0) for w, f in zip(own, floor, strict=True)],
        dtype=np.int64,
    )
    widest = int(half.max())
    to = np.arange(size)
    source = to - np.arange(-widest, widest + 1)[:, None]
    inside = (source >= 0) & (source < size)
    entry = np.where(inside, source, 0) * size + to
    band = own.reshape(n_inputs, -1)[:, entry.ravel()].reshape(n_inputs, *entry.shape)
    band -= floor[:, None, None]
    band *= inside
    # Indexing leaves the axes in another order in memory, which costs the kernel half its speed.
    return half, floor, np.ascontiguousarray(band)


def _marginal_rows(node_column: IntArray, state: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    rows: list[list[tuple[int, int]]] = [[], [], []]
    for columns in node_column:
        of = columns[state]
        if (of == of[:1]).all():
            rows[0] += list(enumerate(of[0].tolist()))
        elif (of == of[:, :1]).all():
            rows[1] += list(enumerate(of[:, 0].tolist()))
        else:
            rows[2] += list(enumerate(of.reshape(-1).tolist()))
    wide, others, both = (np.array(r, dtype=np.int64).reshape(-1, 2) for r in rows)
    return wide, others, both


@njit(cache=True, fastmath={"reassoc", "contract"})
def filter_banded(
    joint: FloatArray,
    is_first: bool,
    is_factored: bool,
    state: IntArray,
    prior: FloatArray,
    others: FloatArray,
    half: IntArray,
    floor: FloatArray,
    band: FloatArray,
    column: IntArray,
    by_wide: IntArray,
    by_others: IntArray,
    by_both: IntArray,
    input_index: IntArray,
    group_start: IntArray,
    evidence: FloatArray,
    marginals: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """As `kernels.filter_frames`, with the arrays of a `Banded` for the network's.

    joint (S,): overwritten by the belief after the last frame. evidence (T, K). With is_factored
    the others are one node. Written: marginals (T, M), log_evidence (T,), is_impossible (T,).
    """
    n_others, n_wide = state.shape
    n_groups = column.shape[0]
    widest = band.shape[1] // 2
    # Zeros on both sides, so that the band never leaves the array.
    before = np.zeros(n_wide + 2 * widest)
    predicted = np.zeros((n_others, n_wide))
    belief = np.zeros((n_others, n_wide))
    of_wide = np.zeros(n_wide)
    of_others = np.zeros(n_others)
    for q in range(n_others):
        for r in range(n_wide):
            belief[q, r] = joint[state[q, r]]
    for t in range(evidence.shape[0]):
        u = input_index[t]
        if is_first and t == 0:
            for q in range(n_others):
                for r in range(n_wide):
                    predicted[q, r] = prior[u, q, r]
        else:
            for q in range(n_others):
                mixed = before[widest : widest + n_wide]
                mixed[:] = 0.0
                for p in range(n_others):
                    source = belief[p]
                    weight = others[u, p, q]
                    for r in range(n_wide):
                        mixed[r] += source[r] * weight
                total = 0.0
                for r in range(n_wide):
                    total += mixed[r]
                target = predicted[q]
                target[:] = total * floor[u]
                # Slices, so that the compiler sees that it may do several r at once.
                for d in range(-half[u], half[u] + 1):
                    source = before[widest - d : widest - d + n_wide]
                    row = band[u, widest + d]
                    for r in range(n_wide):
                        target[r] += source[r] * row[r]
        total = 0.0
        for q in range(n_others):
            for r in range(n_wide):
                likelihood = 1.0
                for g in range(n_groups):
                    likelihood *= evidence[t, column[g, q, r]]
                belief[q, r] = predicted[q, r] * likelihood
                total += belief[q, r]
        log_scale = 0.0
        # Too small or too large to trust: scale the evidence first.
        if not TINY < total < HUGE:
            total = 0.0
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = predicted[q, r]
            for g in range(n_groups):
                largest = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    largest = max(largest, evidence[t, k])
                if largest > 0.0:
                    log_scale += math.log(largest)
                for q in range(n_others):
                    for r in range(n_wide):
                        share = 0.0
                        if largest > 0.0:
                            share = evidence[t, column[g, q, r]] / largest
                        belief[q, r] *= share
            for q in range(n_others):
                for r in range(n_wide):
                    total += belief[q, r]
        is_impossible[t] = not total > 0.0
        if total > 0.0:
            log_evidence[t] = math.log(total) + log_scale
            scale = 1.0 / total
            # The inverse of a number near the smallest one is infinite.
            if scale > HUGE:
                for q in range(n_others):
                    for r in range(n_wide):
                        belief[q, r] /= total
                scale = 1.0
        else:
            log_evidence[t] = 0.0
            scale = 0.0
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = predicted[q, r]
                    scale += predicted[q, r]
            scale = 1.0 / scale
        for r in range(n_wide):
            of_wide[r] = 0.0
        for q in range(n_others):
            total = 0.0
            for r in range(n_wide):
                belief[q, r] *= scale
                of_wide[r] += belief[q, r]
                total += belief[q, r]
            of_others[q] = total
        for k in range(marginals.shape[1]):
            marginals[t, k] = 0.0
        for k in range(by_wide.shape[0]):
            marginals[t, by_wide[k, 1]] += of_wide[by_wide[k, 0]]
        for k in range(by_others.shape[0]):
            marginals[t, by_others[k, 1]] += of_others[by_others[k, 0]]
        for k in range(by_both.shape[0]):
            e = by_both[k, 0]
            marginals[t, by_both[k, 1]] += belief[e // n_wide, e % n_wide]
        if is_factored:
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = of_others[q] * of_wide[r]
    for q in range(n_others):
        for r in range(n_wide):
            joint[state[q, r]] = belief[q, r]
