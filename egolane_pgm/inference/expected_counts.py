"""Expected counts of the tables' entries, given soft evidence and known values of hidden nodes: the
E step of EM (Baum-Welch; Rabiner 1989, section III.C).

A frame whose evidence and known values have joint likelihood zero given the previous frames is
flagged, and both are ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode
from egolane_pgm.inference.compile import Compiled, counted_tables, takes_any_model
from egolane_pgm.inference.filtering import (
    evidence_blocks,
    first_frames,
    fixed_states,
    forward,
    joint_input,
    state_likelihood,
)
from egolane_pgm.inference.kernels.sweeps import count_kernel, smooth_kernel
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray, suggestion

#: Marks a frame in which the node's value is unknown.
FREE = -1


@dataclass(frozen=True)
class Expected:
    """counts: per table of `counted_tables` an array of its shape, how often each of its entries
    is expected to be used. log_evidence: natural log of P(evidence and known values), over the
    frames that are not flagged. is_impossible (T,): the flags."""

    counts: Mapping[SliceNode, FloatArray]
    log_evidence: float
    is_impossible: BoolArray


@takes_any_model
def expected_counts(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
) -> Expected:
    """The expected counts of a recording, or of several one behind the other.

    - evidence: T frames.
    - known: per hidden node the index of its value in each frame (T,), -1 (FREE) where it is not
      known.
    - is_first (T,): True where a sequence begins; by default the first frame only.

    Raises InputError for evidence that does not fit the network, and for known values of a node
    that is not hidden.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> expected = ego.expected_counts(run.model.compiled, run.evidence)
    >>> round(expected.counts["Lane", 1].sum())  # the steps between 300 frames
    299
    """
    found = all_counts(compiled, evidence, known or {}, is_first)
    return replace(found, counts={node: found.counts[node] for node in counted_tables(compiled)})


def all_counts(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray],
    is_first: BoolArray | None,
) -> Expected:
    """Return the `expected_counts`, and those of tables that an input selects."""
    index = joint_input(compiled, evidence)
    n_frames = len(evidence)
    n_states = compiled.n_states
    likelihood, log_scale = state_likelihood(compiled, evidence)
    likelihood *= known_states(compiled, known, n_frames)
    begins = first_frames(n_frames, is_first)
    filtered, log_evidence, is_impossible = forward(compiled, likelihood, log_scale, index, begins)
    likelihood[is_impossible] = 1.0
    smoothed = np.empty((n_frames, n_states))
    moves = np.zeros_like(compiled.transition)
    smooth_kernel(fixed_states(compiled, n_frames))(
        filtered, likelihood, compiled.transition, index, begins, smoothed, moves
    )
    counts = counts_of_tables(compiled, evidence, index, smoothed, moves, begins, is_impossible)
    return Expected(counts, float(log_evidence.sum()), is_impossible)


def known_states(compiled: Compiled, known: Mapping[str, IntArray], n_frames: int) -> BoolArray:
    """Mark the joint states that agree with the known values in each frame, (T, S).

    Raises InputError for known values of a node that is not hidden.
    """
    agrees = np.ones((n_frames, compiled.n_states), dtype=bool)
    for node, value in known.items():
        if node not in compiled.hidden:
            meant = suggestion(node, compiled.hidden)
            raise InputError(f"known values of {node}, which is no hidden node{meant}")
        states = compiled.node_value[node] == np.arange(compiled.cardinality[node] + 1)[:, None]
        # The last row is that of FREE.
        states[FREE] = True
        agrees &= states[np.asarray(value)]
    return agrees


def counts_of_tables(
    compiled: Compiled,
    evidence: Evidence,
    index: IntArray,
    states: FloatArray,
    moves: FloatArray,
    begins: BoolArray,
    is_impossible: BoolArray,
) -> dict[SliceNode, FloatArray]:
    """Count how often each entry of each table is used, from the counts of joint states.

    - index (T,): the joint value of the inputs.
    - states (T, S): how often each frame has each joint state. moves (U, S, S): how often each
      joint value of the inputs leads from one to another.
    - begins, is_impossible (T,): the first frames of sequences, and the frames without evidence.

    Returns an array per table, of its shape: of both slices of a node with two tables, else of
    slice 1. Functions have none.
    """
    prior = np.zeros_like(compiled.prior)
    np.add.at(prior, index[begins], states[begins])
    array_of: dict[str | int, FloatArray] = {"prior": prior, "transition": moves}
    shown = np.where(is_impossible[:, None], 0.0, states)
    # Evidence of a node in the joint state has no table.
    targets = {place.target for place in compiled.places.values()}
    for g, block in enumerate(evidence_blocks(compiled, evidence)):
        if g in targets:
            emission = np.ascontiguousarray(compiled.groups[g].emission.T)
            count = np.zeros_like(emission)
            is_fixed = fixed_states(compiled, len(block)) > 0
            sizes = emission.shape if is_fixed else (0, 0)
            count_kernel(*sizes)(block, emission, shown, count)
            array_of[g] = count.T
    counts: dict[SliceNode, FloatArray] = {}
    for (name, s), place in compiled.places.items():
        node = (name, 1) if name in compiled.one_table else (name, s)
        count = counts.setdefault(node, np.zeros(compiled.tables[node].values.shape))
        array = array_of[place.target]
        np.add.at(count, tuple(np.broadcast_to(i, array.shape) for i in place.indices), array)
    return counts
