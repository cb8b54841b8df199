"""The numba kernels of the filters; `filtering` has their NumPy twin.

`filter_frames` is the recursion for networks of any size, one frame after the other. Long
recordings and small networks go through `filter_blocks`, which has a kernel compiled for the size
(`_unrolled`) do all frames whose likelihood is an ordinary number, and `filter_frames` the rest.
`confusion_counts` filters many parameter sets side by side and keeps only their confusions.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit

from egolane_pgm.inference.kernels import unrolled as _unrolled
from egolane_pgm.inference.kernels.unrolled import BATCH, HUGE, TINY, Size
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Shorter sequences are not worth loading a kernel that is compiled for the network's size.
MIN_FRAMES = 1000

# Of float64 numbers, read as integers.
_MANTISSA_BITS, _BIAS = np.uint64(52), np.uint64(1023)
_SQRT_HALF_TO_ONE = np.float64(1.0).view(np.uint64) - np.sqrt(0.5).view(np.uint64)
_LOG_2 = math.log(2.0)


@njit(cache=True)
def filter_frames(
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
    """Filter T frames, starting from `joint` (S,), which is overwritten by the belief after the
    last one.

    is_first: the first frame takes `prior`, with no transition before it. is_factored: the
    product of the persistent nodes' marginals is carried on, not the joint belief.
    emission (S, K) and evidence (T, K): the groups' columns side by side, group g in
    group_start[g]:group_start[g + 1]. node_column (H, S): the column of `marginals` that each
    node's value in each joint state adds to; the first n_persistent nodes make up the state.
    Written: marginals (T, M), log_evidence (T,), is_impossible (T,).
    """
    n_states = joint.shape[0]
    n_groups = group_start.shape[0] - 1
    n_nodes = node_column.shape[0]
    predicted = joint.copy()
    for t in range(evidence.shape[0]):
        u = input_index[t]
        if is_first and t == 0:
            for s in range(n_states):
                predicted[s] = prior[u, s]
        else:
            for s in range(n_states):
                predicted[s] = 0.0
            for r in range(n_states):
                weight = joint[r]
                for s in range(n_states):
                    predicted[s] += weight * transition[u, r, s]
        total = 0.0
        for s in range(n_states):
            likelihood = 1.0
            for g in range(n_groups):
                term = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    term += emission[s, k] * evidence[t, k]
                likelihood *= term
            joint[s] = predicted[s] * likelihood
            total += joint[s]
        log_scale = 0.0
        # Too small or too large to trust, or NaN (infinity times zero): scale the evidence first.
        if not TINY < total < HUGE:
            total = 0.0
            for g in range(n_groups):
                largest = 0.0
                for k in range(group_start[g], group_start[g + 1]):
                    largest = max(largest, evidence[t, k])
                if largest > 0.0:
                    log_scale += math.log(largest)
            for s in range(n_states):
                likelihood = 1.0
                for g in range(n_groups):
                    largest = 0.0
                    for k in range(group_start[g], group_start[g + 1]):
                        largest = max(largest, evidence[t, k])
                    term = 0.0
                    if largest > 0.0:
                        for k in range(group_start[g], group_start[g + 1]):
                            term += emission[s, k] * (evidence[t, k] / largest)
                    likelihood *= term
                joint[s] = predicted[s] * likelihood
                total += joint[s]
        if total > 0.0:
            for s in range(n_states):
                joint[s] /= total
            log_evidence[t] = math.log(total) + log_scale
            is_impossible[t] = False
        else:
            # Normalised: the product of marginals would multiply rounding errors frame by frame.
            total = 0.0
            for s in range(n_states):
                total += predicted[s]
            for s in range(n_states):
                joint[s] = predicted[s] / total
            log_evidence[t] = 0.0
            is_impossible[t] = True
        for h in range(n_nodes):
            for s in range(n_states):
                marginals[t, node_column[h, s]] += joint[s]
        if is_factored:
            for s in range(n_states):
                product = 1.0
                for h in range(n_persistent):
                    product *= marginals[t, node_column[h, s]]
                joint[s] = product


@np.errstate(all="ignore")  # with the compiler switched off NumPy would warn of what is handled
def filter_blocks(
    joint: FloatArray,
    is_first: bool,
    is_factored: bool,
    prior: FloatArray,
    transition: FloatArray,
    input_index: IntArray,
    emission: FloatArray,
    group_start: IntArray,
    blocks: Sequence[FloatArray],
    node_column: IntArray,
    n_persistent: int,
    marginals: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """As `filter_frames`, with the evidence of each group in an array of its own, (T, K).

    Unlike there, what the last three arrays hold before does not matter.
    """
    n_frames = len(log_evidence)
    size = kernel_size(group_start, node_column, n_persistent, is_factored)

    def plain(start: int, stop: int) -> None:
        here = slice(start, stop)
        marginals[here] = 0.0
        filter_frames(
            joint,
            is_first and start == 0,
            is_factored,
            prior,
            transition,
            input_index[here],
            emission,
            group_start,
            np.concatenate([block[here] for block in blocks], axis=1),
            node_column,
            n_persistent,
            marginals[here],
            log_evidence[here],
            is_impossible[here],
        )

    if n_frames < MIN_FRAMES or len(transition) > 1 or not size.is_small:
        plain(0, n_frames)
        return
    is_impossible[:] = False
    run = _filter_kernel(size)
    model = (prior[0], transition[0], emission)
    written = (marginals, log_evidence)
    done, at_once = 0, 1
    while done < n_frames:
        starts = is_first and done == 0
        stop = run(joint, *model, starts, done, n_frames, *written, *blocks)
        if done < stop < n_frames:
            # Again up to there, for the belief that the next frame starts from.
            run(joint, *model, starts, done, stop, *written, *blocks)
        log_in_place(log_evidence[done:stop])
        # Where nearly all frames are out of range, more and more of them are done at once.
        at_once = 2 * at_once if stop == done else 1
        done = min(stop + at_once, n_frames)
        if stop < n_frames:
            plain(stop, done)


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def log_in_place(values: FloatArray) -> None:
    """Natural logarithms of positive normal numbers, in a third of the library's time.

    With x = m 2^e, m within sqrt(2) of 1, and r = (m - 1) / (m + 1), so |r| < 0.172:
    log x = e log 2 + 2 (r + r^3 / 3 + r^5 / 5 + ...). Two loops, for each to be vectorised.
    """
    bits = values.view(np.uint64)
    exponent = np.empty(values.shape[0])
    for t in range(values.shape[0]):
        biased = (bits[t] + _SQRT_HALF_TO_ONE) >> _MANTISSA_BITS
        exponent[t] = np.float64(np.int64(biased)) - 1023.0
        bits[t] -= (biased - _BIAS) << _MANTISSA_BITS
    for t in range(values.shape[0]):
        r = (values[t] - 1.0) / (values[t] + 1.0)
        q = r * r
        tail = 1 / 17 + q * (1 / 19 + q * (1 / 21 + q * (1 / 23)))
        tail = 1 / 9 + q * (1 / 11 + q * (1 / 13 + q * (1 / 15 + q * tail)))
        tail = 1 / 3 + q * (1 / 5 + q * (1 / 7 + q * tail))
        values[t] = exponent[t] * _LOG_2 + 2.0 * (r + r * q * tail)


def kernel_size(
    group_start: IntArray, node_column: IntArray, n_persistent: int, is_factored: bool
) -> Size:
    """The size that a kernel is compiled for."""
    return _size(
        tuple(group_start.tolist()),
        node_column.tobytes(),
        node_column.shape[1],
        n_persistent,
        bool(is_factored),
    )


@lru_cache(maxsize=64)
def _size(
    start: tuple[int, ...], columns: bytes, n_states: int, n_persistent: int, is_factored: bool
) -> Size:
    node_column = np.frombuffer(columns, dtype=np.int64).reshape(-1, n_states)
    sizes = tuple(b - a for a, b in pairwise(start))
    return Size(sizes, tuple(map(tuple, node_column.tolist())), n_persistent, is_factored)


@np.errstate(all="ignore")
def confusion_counts(
    size: Size,
    lanes: tuple[int, ...],
    prior: FloatArray,
    tables: FloatArray,
    blocks: Sequence[FloatArray],
    column: IntArray,
    tolerance: float,
) -> IntArray | None:
    """The confusions (P, n + 1, n) of P parameter sets, or None where a frame's likelihood is out
    of range for one of them.

    lanes: the columns of the marginals that are Lane's. prior (P, S). tables (P, R, S): each set's
    transition, then the columns of its emissions. blocks: per group its evidence (T, K). column
    (T,): the true lane's index, -1 where a frame is not scored. tolerance: a runner-up within it
    of the maximum, relative, makes a frame Unassigned, the last row.
    """
    run = _confusion_kernel(size, lanes)
    n_sets = len(prior)
    counts = np.zeros((n_sets, len(lanes) + 1, len(lanes)), dtype=np.int64)
    for start in range(0, n_sets, BATCH):
        # The last batch is filled up with the last set.
        chosen = np.minimum(np.arange(start, start + BATCH), n_sets - 1)
        later = np.ascontiguousarray(tables[chosen].transpose(1, 2, 0))
        # Before the first frame nothing moves.
        first = later.copy()
        first[: size.n_states] = np.eye(size.n_states)[:, :, None]
        joint = np.ascontiguousarray(prior[chosen].T)
        found = np.zeros((BATCH, *counts.shape[1:]), dtype=np.int64)
        parts = ((first, 0, 1), (later, 1, len(column)))
        for table, begin, stop in parts:
            evidence = [block[:stop] for block in blocks]
            if not run(joint, table.ravel(), begin, column[:stop], tolerance, found, *evidence):
                return None
        counts[start : start + BATCH] = found[: n_sets - start]
    return counts


def _compiled(kind: str, write: Callable[[str], str]) -> Any:
    """The function that `write(name)` is the source of, compiled, and cached on disk.

    numba tells cached functions apart by name and byte code, which leaves out the constants: the
    name has to be unique to the source. The file makes the cache notice an edit of it.
    """
    digest = hashlib.sha256(write(kind).encode()).hexdigest()[:16]
    name = f"{kind}_{digest}"
    namespace: dict[str, Any] = {"np": np, "__name__": __name__}
    exec(compile(write(name), _unrolled.__file__, "exec"), namespace)
    # Of fast arithmetic only fusing a multiplication with an addition: NaN and infinity stay. Code
    # that may raise ZeroDivisionError cannot be vectorised.
    compiled = njit(cache=True, fastmath={"contract"}, error_model="numpy")
    return compiled(namespace[name])


@lru_cache(maxsize=64)
def _filter_kernel(size: Size) -> Any:
    return _compiled("filter", lambda name: _unrolled.filter_source(name, size))


@lru_cache(maxsize=64)
def _confusion_kernel(size: Size, lanes: tuple[int, ...]) -> Any:
    return _compiled("confusion", lambda name: _unrolled.confusion_source(name, size, lanes))
