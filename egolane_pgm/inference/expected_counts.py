"""Expected counts: how often each row of each table is used in a recording, given soft evidence and
what is known of the hidden nodes. The E step of EM (Baum-Welch; Rabiner 1989, section III.C).

Everything is scaled frame by frame, so that long recordings do not underflow. A frame whose
evidence, together with what is known, has joint likelihood zero given the frames before it is
flagged; both are left out there, as the filters leave out evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import evidence_blocks, joint_input
from egolane_pgm.inference.smoothing import over_largest
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray

#: The value of a node that is known in a frame, where it is not.
FREE = -1

#: A state with less than this of the largest likelihood is not seen with it: one over it is no
#: number any more.
_LEAST = 1e-300


@dataclass(frozen=True)
class Expected:
    """counts: per table of `counted_tables` an array of its shape, how often each of its entries
    is expected to be used. log_evidence: natural log of P(evidence and what is known), over the
    frames that are not flagged. is_impossible (T,): the flags."""

    counts: Mapping[SliceNode, FloatArray]
    log_evidence: float
    is_impossible: BoolArray


def counted_tables(compiled: Compiled, tables: Iterable[Table]) -> dict[SliceNode, Table]:
    """The tables that can be counted, with their axes in the compiled order: those of the first
    frame (slice 0) and of later ones (slice 1) of the nodes that persist, and those of observed
    nodes, once (slice 1). Functions and tables that an input selects are not among them."""
    by_node = {table.node: table for table in tables}
    found = {}
    for node, place in compiled.places.items():
        if not any(parent in compiled.inputs for parent, _ in place.parents):
            table = by_node[node]
            order = [table.parents.index(p) for p in place.parents]
            values = table.values.transpose(*order, len(order))
            found[node] = Table(node, place.parents, np.ascontiguousarray(values))
    return found


def expected_counts(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
    *,
    kernel: bool = True,
) -> Expected:
    """The expected counts of a recording, or of several one behind the other.

    known: per hidden node its value in each frame (T,), FREE where it is not known. is_first (T,):
    where a sequence begins, default the first frame only. `kernel=False` runs the NumPy twin.
    Raises InputError for evidence that does not fit the network, or read by Jeffrey's rule.
    """
    blocks, _, _ = evidence_blocks(compiled, evidence)
    n_frames, n_states = len(evidence), compiled.n_states
    shares, by_group = [], []
    likelihood = np.ones((n_frames, n_states))
    log_scale = np.zeros(n_frames)
    for group, block in zip(compiled.groups, blocks, strict=True):
        scaled, log_largest = over_largest(block)
        of_state, log_factor = over_largest(scaled @ group.emission.T)
        likelihood *= of_state
        log_scale += log_largest + log_factor
        shares.append(scaled / np.exp(log_factor)[:, None])
        by_group.append(of_state)
    for node, value in (known or {}).items():
        in_state = compiled.node_value[compiled.hidden.index(node)]
        likelihood *= (value[:, None] == in_state) | (value == FREE)[:, None]
    begins = np.zeros(n_frames, dtype=bool) if is_first is None else is_first.copy()
    begins[:1] = True

    smoothed = np.empty((n_frames, n_states))
    first, moves = np.zeros(n_states), np.zeros((n_states, n_states))
    log_evidence = np.empty(n_frames)
    is_impossible = np.empty(n_frames, dtype=bool)
    run: Any = _expect_frames_numpy
    if kernel:
        from egolane_pgm.inference.kernels.sweeps import expect_frames as run
    run(
        compiled.prior,
        compiled.transition,
        joint_input(compiled, evidence),
        begins,
        likelihood,
        smoothed,
        first,
        moves,
        log_evidence,
        is_impossible,
    )
    smoothed[is_impossible] = 0.0
    seen = []
    for group, scaled, of_state in zip(compiled.groups, shares, by_group, strict=True):
        # P(state, value | all) = P(state | all) P(value | state) e(value) / P(evidence | state).
        weight = np.divide(smoothed, of_state, out=np.zeros_like(smoothed), where=of_state > _LEAST)
        seen.append(group.emission * (weight.T @ scaled))

    counts: dict[SliceNode, FloatArray] = {}
    for counted, place in compiled.places.items():
        if any(parent in compiled.inputs for parent, _ in place.parents):
            continue
        of = {"prior": first[None], "transition": moves[None]}
        array = seen[place.group] if place.kind == "emission" else of[place.kind]
        counts[counted] = count = np.zeros(place.shape)
        indices = tuple(np.broadcast_to(index, array.shape) for index in place.indices)
        np.add.at(count, indices, array)
    kept = ~is_impossible
    return Expected(counts, float((log_evidence + log_scale)[kept].sum()), is_impossible)


def _expect_frames_numpy(
    prior: FloatArray,
    transition: FloatArray,
    input_index: IntArray,
    is_first: BoolArray,
    likelihood: FloatArray,
    smoothed: FloatArray,
    first: FloatArray,
    moves: FloatArray,
    log_evidence: FloatArray,
    is_impossible: BoolArray,
) -> None:
    """The NumPy twin of `_kernels.expect_frames`, same arguments; in logarithms."""
    n_frames = len(likelihood)
    with np.errstate(divide="ignore"):
        log_prior, log_transition = np.log(prior), np.log(transition)
        log_filtered = np.empty_like(likelihood)
        for t, u in enumerate(input_index):
            if is_first[t]:
                now = log_prior[u]
            else:
                now = _log_sum(log_filtered[t - 1][:, None] + log_transition[u])
            both = now + np.log(likelihood[t])
            total = _log_sum(both)
            is_impossible[t] = total == -np.inf
            log_evidence[t] = 0.0 if is_impossible[t] else total
            if is_impossible[t]:
                likelihood[t] = 1.0
                both, total = now, _log_sum(now)
            log_filtered[t] = both - total
        log_ahead = np.zeros(likelihood.shape[1])
        for t in range(n_frames - 1, -1, -1):
            both = log_filtered[t] + log_ahead
            smoothed[t] = np.exp(both - _log_sum(both))
            if is_first[t]:
                first += smoothed[t]
                log_ahead = np.zeros(likelihood.shape[1])
                continue
            onward = log_transition[input_index[t]] + np.log(likelihood[t]) + log_ahead
            pairs = log_filtered[t - 1][:, None] + onward
            moves += np.exp(pairs - _log_sum(pairs.ravel()))
            log_ahead = _log_sum(onward.T)


def _log_sum(values: FloatArray) -> Any:
    """log(sum(exp(values))) over the first axis; minus infinity for nothing but zeros."""
    largest = values.max(axis=0)
    safe = np.where(np.isfinite(largest), largest, 0.0)
    return safe + np.log(np.exp(values - safe).sum(axis=0))
