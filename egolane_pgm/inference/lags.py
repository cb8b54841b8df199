"""Fixed-lag smoothing for many lags at once: how much better a belief becomes by waiting.

The likelihood of the k + 1 frames after frame t, given its state, is that of the k frames after
frame t + 1, given that one's, taken one frame back. So each step looks one frame further ahead from
all frames together, and all lags up to the largest cost no more than the largest alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.layout import marginals_of
from egolane_pgm.inference.smoothing import Passed, check_lag, pass_forward, smooth_beliefs
from egolane_pgm.types import Beliefs, Evidence, FloatArray, IntArray


def beliefs_by_lag(
    compiled: Compiled,
    evidence: Evidence,
    lags: Sequence[int],
    *,
    frame_id: IntArray | None = None,
) -> Iterator[tuple[int, Beliefs]]:
    """Yield each lag, in increasing order, with what `smoothing.fixed_lag_beliefs` gives for it.

    - lags: frames, not negative.
    - frame_id (T,): the beliefs' frame ids, 0, 1, ... by default.

    Raises InputError as `fixed_lag_beliefs`.
    """
    for lag in lags:
        check_lag(lag)
    passed = pass_forward(compiled, evidence)
    ids = np.arange(len(evidence)) if frame_id is None else frame_id
    into = passed.index[1:]
    frames_into = [(u, np.flatnonzero(into == u)) for u in np.unique(into)]
    ahead = np.ones_like(passed.filtered)
    seen = 0
    for lag in sorted(set(lags)):
        if lag >= len(evidence) - 1:
            yield lag, smooth_beliefs(compiled, evidence, frame_id=frame_id)
            continue
        for _ in range(lag - seen):
            _look_further(compiled, passed, frames_into, ahead)
        seen = lag
        smoothed = passed.filtered * ahead
        total = smoothed.sum(axis=1, keepdims=True)
        smoothed = np.divide(smoothed, total, out=passed.filtered.copy(), where=total > 0)
        marginals = marginals_of(compiled, smoothed)
        flags = passed.is_impossible
        yield lag, Beliefs(ids, marginals, passed.log_evidence, flags, compiled.values)


def _look_further(
    compiled: Compiled,
    passed: Passed,
    frames_into: Sequence[tuple[int, IntArray]],
    ahead: FloatArray,
) -> None:
    """Let `ahead` (T, S), how probable what follows is given each state, over the largest one, be
    about the next k + 1 frames instead of k. The last frame has none after it.

    frames_into: each joint value of the inputs, and from which frames t it leads into t + 1.
    """
    weight = passed.likelihood[1:] * ahead[1:]
    onward = np.empty_like(weight)
    for u, frames in frames_into:
        onward[frames] = weight[frames] @ compiled.transition[u].T
    # As in the kernels: states that are impossible set no scale, and what follows is ignored where
    # nothing leads to it.
    onward[passed.filtered[:-1] == 0.0] = 0.0
    largest = onward.max(axis=1, keepdims=True)
    ahead[:-1] = np.where(largest > 0, onward / np.where(largest > 0, largest, 1.0), 1.0)
