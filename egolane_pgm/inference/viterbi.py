"""The most probable path of the joint state.

The path has, in every frame, one value for each node of the joint state (`compile`). The values of
plain emissions are summed out. An observed node in the joint state has one value, even if its
evidence is soft.

If many paths share the probability, the best one may be far from the smoothed beliefs.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from egolane_pgm.inference.compile import Compiled, takes_any_model
from egolane_pgm.inference.kernels.sweeps import best_path
from egolane_pgm.inference.sampling import named_values
from egolane_pgm.inference.smoothing import pass_forward
from egolane_pgm.types import BoolArray, Evidence, IntArray


@dataclass(frozen=True)
class Path:
    """The most probable path of T frames.

    - states: a row per frame, by frame id, and a column per hidden node with the names of its
      values, as `sample`.
    - log_probability: natural logarithm of P(path of the joint state, evidence), each likelihood
      as given.
    - is_impossible (T,): the frame's evidence has joint likelihood zero and was ignored.
    """

    states: pd.DataFrame
    log_probability: float
    is_impossible: BoolArray

    @property
    def lane(self) -> IntArray:
        """(T,): the lane in each frame, 1 to n."""
        return np.asarray(self.states["Lane"].cat.codes, dtype=np.int64) + 1


@takes_any_model
def viterbi(
    compiled: Compiled,
    evidence: Evidence,
    *,
    frame_id: IntArray | None = None,
    is_first: BoolArray | None = None,
) -> Path:
    """The joint states of highest probability given all evidence (Rabiner 1989, section III.B, in
    logarithms). Of equally probable paths it is the one with the lowest-numbered state in the last
    frame, then in the one before, and so on.

    - frame_id (T,): the path's frame ids, 0, 1, ... by default.
    - is_first (T,): True where a sequence begins; by default the first frame only.

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
    passed = pass_forward(compiled, evidence, is_first=is_first)
    states = np.zeros(len(evidence), dtype=np.int64)
    total = float(passed.log_scale.sum())
    with np.errstate(divide="ignore"):
        log_likelihood = np.log(passed.likelihood)
        log_prior = np.log(compiled.prior)
        log_transition = np.log(compiled.transition)
    starts = np.flatnonzero(passed.begins).tolist()
    for first, stop in pairwise([*starts, len(states)]):
        here = slice(first, stop)
        index = passed.input_index[here]
        total += best_path(log_prior, log_transition, log_likelihood[here], index, states[here])
    values = {name: compiled.node_value[name][states] for name in compiled.hidden}
    named = named_values(compiled, values, pd.Index(ids, name="frame_id"))
    return Path(named, total, passed.is_impossible)
