"""The most probable path of the joint state, and where it is not to be trusted.

The path has, in every frame, one value for each node of the joint state (`compile`). The values of
plain emissions are no part of it: they are summed out. An observed node that is in the joint state
is a part of it, so that the path takes one of its values, however soft the evidence.

Many paths may share the probability, and the best of them may then be far from what each frame's
smoothed belief says. `disagreement` finds such stretches of frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.kernels.sweeps import best_path
from egolane_pgm.inference.smoothing import pass_forward
from egolane_pgm.types import (
    Beliefs,
    BoolArray,
    Evidence,
    InputError,
    IntArray,
    runs_of,
    suggestion,
)

#: Frames in a row that the path may disagree with the smoothed belief without a warning.
LIMIT = 50


@dataclass(frozen=True)
class Path:
    """The most probable path of T frames.

    - frame_id (T,).
    - values: per hidden node the index of its value in each frame (T,); lanes count from 0.
    - log_probability: natural logarithm of P(path of the joint state, evidence), each likelihood
      as given.
    - is_impossible (T,): the frame's evidence has joint likelihood zero and was ignored.
    """

    frame_id: IntArray
    values: Mapping[str, IntArray]
    log_probability: float
    is_impossible: BoolArray

    def __len__(self) -> int:
        return len(self.frame_id)

    @property
    def lane(self) -> IntArray:
        """(T,): the lane in each frame, 1 to n."""
        return self.values["Lane"] + 1


@dataclass(frozen=True)
class Disagreement:
    """The longest stretch of frames in which the path's value has a smoothed probability below
    1/2.

    - frames: its length, 0 if there is none.
    - first, last: its frame ids, or None.
    - warning: one line where it is longer than the limit, else None.
    """

    frames: int
    first: int | None
    last: int | None
    warning: str | None


def viterbi(compiled: Compiled, evidence: Evidence, *, frame_id: IntArray | None = None) -> Path:
    """The joint states of highest probability given all evidence (Rabiner 1989, section III.B, in
    logarithms). Of equally probable paths it is the one with the lowest-numbered state in the last
    frame, then in the one before, and so on.

    - frame_id (T,): the path's frame ids, 0, 1, ... by default.

    A frame of zero joint likelihood is flagged and ignored, as the exact filter does. Raises
    InputError as `smooth_beliefs`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> path = ego.viterbi(run.model.compiled, run.evidence)
    >>> path.lane[[0, -1]].tolist()
    [4, 2]
    """
    ids = np.arange(len(evidence)) if frame_id is None else frame_id
    passed = pass_forward(compiled, evidence)
    states = np.zeros(len(evidence), dtype=np.int64)
    total = 0.0
    if len(evidence):
        with np.errstate(divide="ignore"):
            log_likelihood = np.log(passed.likelihood)
            log_prior, log_transition = np.log(compiled.prior), np.log(compiled.transition)
        total = best_path(log_prior, log_transition, log_likelihood, passed.index, states)
    values = {name: compiled.node_value[name][states] for name in compiled.hidden}
    return Path(ids, values, total, passed.is_impossible)


def disagreement(
    path: Path, smoothed: Beliefs, *, node: str = "Lane", limit: int = LIMIT
) -> Disagreement:
    """The longest stretch of frames in which the path and the smoothed belief of a node disagree.

    limit: number of frames in a row that gets no warning. Raises InputError for a node that is not
    hidden, and where path and beliefs have different frames.
    """
    if node not in path.values:
        raise InputError(f"node '{node}' is not a hidden one{suggestion(node, path.values)}")
    if not np.array_equal(path.frame_id, smoothed.frame_id):
        raise InputError("the path and the smoothed beliefs are about different frames")
    chosen = path.values[node]
    doubted = smoothed.marginals[node][np.arange(len(path)), chosen] < 0.5
    runs = runs_of(doubted)
    if not runs:
        return Disagreement(0, None, None, None)
    start, stop = max(runs, key=lambda run: run[1] - run[0])
    frames = stop - start
    first, last = int(path.frame_id[start]), int(path.frame_id[stop - 1])
    warning = None
    if frames > limit:
        warning = (
            f"the most probable path holds a {node} that the smoothed belief gives less than 1/2"
            f" for {frames} frames ({first} to {last}); trust the smoothed belief there"
        )
    return Disagreement(frames, first, last, warning)
