"""The forward recursion for networks in which one node moves only to values near its own.

For each value of the inputs, the joint transition is the product of the wide node's table (a band
around the diagonal, and outside of it one small number per column) and the other nodes' table. The
cost of a frame is the number of states times the width of the band.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.kernels.filter import LEAST, MOST
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Networks with fewer joint states are as quick with the plain recursion.
MIN_STATES = 32

#: Entries that differ by less than this, relative, are equal: products of tables are rounded.
_EQUAL = 1e-11


class Band(NamedTuple):
    """A banded transition, of R values of the wide node, Q of the others and U of the inputs. Joint
    state q R + r has value r of the wide node.

    others (U, Q, Q): the transition of the other nodes, row is the previous value.
    half (U,): the half-width of the band.
    floor (U, R): the wide node's transition to r outside of the band; subtracted from the band.
    band (U, 2 max(half) + 1, R): entry [u, max(half) + d, r] is the transition to r from r - d.
    """

    others: FloatArray
    half: IntArray
    floor: FloatArray
    band: FloatArray


@lru_cache(maxsize=16)
def find_band(compiled: Compiled) -> Band | None:
    """Return the banded form of a network's transition, or None; cached for online filters."""
    sizes = [compiled.cardinality[name] for name in compiled.state_nodes]
    n_wide = sizes[-1]
    n_others = math.prod(sizes[:-1])
    n_inputs = len(compiled.transition)
    own = np.empty((n_inputs, n_wide, n_wide))
    others = np.empty((n_inputs, n_others, n_others))
    for u in range(n_inputs):
        whole = compiled.transition[u].reshape(n_others, n_wide, n_others, n_wide)
        own[u] = sum(whole[0, :, q] for q in range(n_others))
        others[u] = whole[:, 0].sum(axis=2)
        product = others[u][:, None, :, None] * own[u][:, None, :]
        if (np.abs(product - whole) > _EQUAL * whole).any():
            return None
    to = np.arange(n_wide)
    distance = np.abs(to[:, None] - to)
    floor = own.min(axis=1)
    is_more = own - floor[:, None, :] > _EQUAL * floor[:, None, :]
    half = np.array([distance[each].max(initial=0) for each in is_more], dtype=np.int64)
    widest = int(half.max())
    source = to - np.arange(-widest, widest + 1)[:, None]
    inside = (source >= 0) & (source < n_wide)
    entry = np.where(inside, source, 0) * n_wide + to
    band = own.reshape(n_inputs, -1)[:, entry.ravel()].reshape(n_inputs, *entry.shape)
    band -= floor[:, None, :]
    band *= inside
    # Indexing leaves the axes in another order in memory, which costs the kernel half its speed.
    return Band(others, half, floor, np.ascontiguousarray(band))


@kernel(fastmath={"reassoc", "contract"}, error_model="numpy")
def forward_banded(
    joint: FloatArray,
    begins: BoolArray,
    is_factored: bool,
    prior: FloatArray,
    transition: Band,
    index: IntArray,
    likelihood: FloatArray,
    column: IntArray,
    beliefs: FloatArray,
    total: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """As the recursion of `forward_kernel`, but for a `Band` in place of the transition. With
    is_factored the others are one node."""
    others, half, floor, band = transition
    n_others = others.shape[1]
    n_wide = band.shape[2]
    widest = band.shape[1] // 2
    # Zeros on both sides, so that the band never leaves the array.
    before = np.zeros(n_wide + 2 * widest)
    predicted = np.zeros((n_others, n_wide))
    belief = np.empty((n_others, n_wide))
    for q in range(n_others):
        for r in range(n_wide):
            belief[q, r] = joint[q * n_wide + r]
    of_wide = np.zeros(n_wide)
    of_others = np.zeros(n_others)
    for t in range(begins.shape[0]):
        u = index[t]
        if begins[t]:
            for q in range(n_others):
                for r in range(n_wide):
                    predicted[q, r] = prior[u, q * n_wide + r]
        else:
            for q in range(n_others):
                mixed = before[widest : widest + n_wide]
                for r in range(n_wide):
                    mixed[r] = 0.0
                for p in range(n_others):
                    source = belief[p]
                    weight = others[u, p, q]
                    for r in range(n_wide):
                        mixed[r] += source[r] * weight
                mass = 0.0
                for r in range(n_wide):
                    mass += mixed[r]
                target = predicted[q]
                for r in range(n_wide):
                    target[r] = mass * floor[u, r]
                # Slices, so that the compiler sees that it may do several r at once.
                for d in range(-half[u], half[u] + 1):
                    source = before[widest - d : widest - d + n_wide]
                    row = band[u, widest + d]
                    for r in range(n_wide):
                        target[r] += source[r] * row[r]
        mass = 0.0
        for q in range(n_others):
            given = likelihood[t, q * n_wide : (q + 1) * n_wide]
            source = predicted[q]
            target = belief[q]
            for r in range(n_wide):
                target[r] = source[r] * given[r]
            for r in range(n_wide):
                mass += target[r]
        total[t] = mass
        is_impossible[t] = not LEAST <= mass <= MOST
        if is_impossible[t]:
            mass = _copy(predicted, belief)
        scale = 1.0 / mass
        for q in range(n_others):
            target = belief[q]
            row = beliefs[t, q * n_wide : (q + 1) * n_wide]
            for r in range(n_wide):
                target[r] *= scale
                row[r] = target[r]
        if is_factored:
            for r in range(n_wide):
                of_wide[r] = 0.0
            for q in range(n_others):
                mass = 0.0
                for r in range(n_wide):
                    of_wide[r] += belief[q, r]
                    mass += belief[q, r]
                of_others[q] = mass
            for q in range(n_others):
                for r in range(n_wide):
                    belief[q, r] = of_others[q] * of_wide[r]
    for q in range(n_others):
        for r in range(n_wide):
            joint[q * n_wide + r] = belief[q, r]


@kernel(no_cpython_wrapper=True)
def _copy(source: FloatArray, target: FloatArray) -> float:
    """Copy an array of two axes; return its sum."""
    total = 0.0
    for q in range(source.shape[0]):
        for r in range(source.shape[1]):
            target[q, r] = source[q, r]
            total += source[q, r]
    return total
