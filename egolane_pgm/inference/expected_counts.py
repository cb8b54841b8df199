"""Expected counts of the tables' entries, given soft evidence and known values of hidden nodes: the
E step of EM (Baum-Welch; Rabiner 1989, section III.C).

A frame whose evidence and known values have joint likelihood zero given the previous frames is
flagged, and both are ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode
from egolane_pgm.inference.compile import Compiled, Group, counted_tables, takes_any_model
from egolane_pgm.inference.filtering import (
    evidence_blocks,
    first_frames,
    forward,
    joint_input,
    state_likelihood,
)
from egolane_pgm.inference.kernels.filter import LEAST
from egolane_pgm.inference.kernels.sweeps import smooth_frames
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
    index = joint_input(compiled, evidence)
    n_frames = len(evidence)
    n_states = compiled.n_states
    likelihood, log_scale = state_likelihood(compiled, evidence)
    for node, value in (known or {}).items():
        if node not in compiled.hidden:
            meant = suggestion(node, compiled.hidden)
            raise InputError(f"known values of {node}, which is no hidden node{meant}")
        likelihood *= (value[:, None] == compiled.node_value[node]) | (value == FREE)[:, None]
    begins = first_frames(n_frames, is_first)
    filtered, log_evidence, is_impossible = forward(compiled, likelihood, log_scale, index, begins)
    likelihood[is_impossible] = 1.0
    smoothed = np.empty((n_frames, n_states))
    moves = np.zeros((n_states, n_states))
    smooth_frames(filtered, likelihood, compiled.transition, index, begins, smoothed, moves)
    array_of: dict[str | int, FloatArray] = {
        "prior": smoothed[begins].sum(axis=0)[None],
        "transition": moves[None],
    }
    smoothed[is_impossible] = 0.0
    blocks = zip(compiled.groups, evidence_blocks(compiled, evidence), strict=True)
    # Evidence of a node in the joint state has no table.
    targets = {place.target for place in compiled.places.values()}
    array_of |= {g: _seen(*each, smoothed) for g, each in enumerate(blocks) if g in targets}
    tables = counted_tables(compiled)
    counts = {of: np.zeros(table.values.shape) for of, table in tables.items()}
    for (name, s), place in compiled.places.items():
        counted = (name, 1) if name in compiled.one_table else (name, s)
        if counted in counts:
            array = array_of[place.target]
            indices = tuple(np.broadcast_to(index, array.shape) for index in place.indices)
            np.add.at(counts[counted], indices, array)
    return Expected(counts, float(log_evidence.sum()), is_impossible)


def _seen(group: Group, block: FloatArray, smoothed: FloatArray) -> FloatArray:
    """How often each joint state is expected to show each value of a group, (S, K).

    P(state, value | all) = P(state | all) P(value | state) e(value) / P(evidence | state).
    """
    # Faster than `max` over a short axis.
    largest = reduce(np.maximum, block.T)[:, None]
    shares = block / np.where(largest > 0, largest, 1.0)
    of_state = shares @ group.emission.T
    weight = np.divide(smoothed, of_state, out=np.zeros_like(smoothed), where=of_state >= LEAST)
    return np.asarray(group.emission * (weight.T @ shares))
