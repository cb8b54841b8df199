"""The log-loss of known nodes under the filter, and its gradient by every table.

The filtered belief of a frame depends on all tables through the frames before. One pass of the
adjoint recursion backwards differentiates through all of them, at the cost of a smoother. By the
logarithm of a table's entry, the derivative is an expected count with a sign: how much more often
the entry is used if the known values are to be more probable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode
from egolane_pgm.inference.compile import Compiled, takes_any_model
from egolane_pgm.inference.expected_counts import counts_of_tables, known_states
from egolane_pgm.inference.filtering import (
    first_frames,
    fixed_states,
    forward,
    joint_input,
    state_likelihood,
)
from egolane_pgm.inference.kernels.adjoint import SMALLEST, adjoint_kernel
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray


@dataclass(frozen=True)
class LogLoss:
    """A log-loss and its gradient.

    - loss: sum over the frames of weight times -log P(known values | evidence so far), nats.
    - gradient: per table (of both slices of a node with two tables, else of slice 1) an array of
      its shape, the derivative of the loss by the logarithm of each entry, taken as free; 0 for
      entries that are zero.
    - probability (T,): P(known values | evidence so far); 1 in frames without known values.
    - is_impossible (T,): frames whose evidence is impossible and ignored.
    """

    loss: float
    gradient: Mapping[SliceNode, FloatArray]
    probability: FloatArray
    is_impossible: BoolArray


@takes_any_model
def log_loss_gradient(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray],
    is_first: BoolArray | None = None,
    *,
    weight: FloatArray | None = None,
) -> LogLoss:
    """Return the log-loss of known nodes under the exact filter, with its gradient.

    - evidence: T frames.
    - known: per hidden node the index of its value in each frame (T,), -1 if it is not known; of
      several nodes, their joint value counts.
    - is_first (T,): True where a sequence begins; by default the first frame only.
    - weight (T,): of each frame, 1 by default.

    The loss of a probability below 1e-12 is that of 1e-12, without a gradient. A frame whose
    evidence is impossible keeps its prediction, as in the filter. Raises InputError for evidence
    that does not fit the network, and for known values of a node that is not hidden.

    >>> import numpy as np
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> lane = run.frames["true_lane"].to_numpy() - 1
    >>> found = ego.log_loss_gradient(run, run.evidence, {"Lane": lane})
    >>> round(found.loss / 300, 2)
    0.33
    >>> sorted(found.gradient)[:2]
    [('DetectorOutput', 1), ('Lane', 0)]
    """
    n_frames = len(evidence)
    index = joint_input(compiled, evidence)
    begins = first_frames(n_frames, is_first)
    likelihood, log_scale = state_likelihood(compiled, evidence)
    filtered, log_evidence, is_impossible = forward(compiled, likelihood, log_scale, index, begins)
    likelihood[is_impossible] = 1.0
    total = np.exp(log_evidence - log_scale * ~is_impossible)
    is_known = known_states(compiled, known, n_frames)
    counted = np.ones(n_frames) if weight is None else np.asarray(weight, dtype=np.float64)
    probability = np.empty(n_frames)
    states = np.empty_like(filtered)
    moves = np.zeros_like(compiled.transition)
    adjoint_kernel(fixed_states(compiled, n_frames))(
        filtered, likelihood, total, is_known, counted, compiled.transition, index, begins,
        probability, states, moves,
    )  # fmt: skip
    loss = -float((counted * np.log(np.maximum(probability, SMALLEST))).sum())
    counts = counts_of_tables(compiled, evidence, index, states, moves, begins, is_impossible)
    gradient = {node: -count for node, count in counts.items()}
    return LogLoss(loss, gradient, probability, is_impossible)
