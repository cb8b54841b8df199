"""Smoothing: the posterior of each frame, given later evidence as well.

`smooth_beliefs` uses the whole sequence (forward-backward), `fixed_lag_beliefs` the next `lag`
frames; `lag_step` does the latter online, `lag` frames late. All use the exact recursion. The
backward messages are scaled frame by frame, so that long sequences do not underflow.

Evidence that the filter flags as impossible is ignored by the smoothers too. `log_evidence` is the
filter's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from egolane_pgm.inference.compile import Compiled, takes_any_model
from egolane_pgm.inference.filtering import first_frames, forward, joint_input, state_likelihood
from egolane_pgm.inference.kernels.sweeps import fixed_lag_frames, smooth_frames
from egolane_pgm.types import Beliefs, BoolArray, Evidence, FloatArray, InputError, IntArray


class Passed(NamedTuple):
    """The results of the exact forward recursion over T frames, which the smoothers take.

    filtered (T, S): the joint belief after each frame.
    likelihood (T, S): of each frame's evidence, divided by a scale; one if it is ignored.
    log_scale (T,): natural logarithm of this scale.
    input_index (T,): the joint value of the inputs.
    begins (T,): True in the first frame.
    log_evidence, is_impossible (T,): as in `Beliefs`.
    """

    filtered: FloatArray
    likelihood: FloatArray
    log_scale: FloatArray
    input_index: IntArray
    begins: BoolArray
    log_evidence: FloatArray
    is_impossible: BoolArray


def pass_forward(
    compiled: Compiled,
    evidence: Evidence,
    before: FloatArray | None = None,
    is_first: BoolArray | None = None,
) -> Passed:
    """Run the exact recursion over T frames.

    - before (S,): the joint belief after the previous frame, None at the start of a sequence.
    - is_first (T,): True where a sequence begins; by default the first frame only.

    Raises InputError for evidence that does not fit the network.
    """
    index = joint_input(compiled, evidence)
    begins = first_frames(len(evidence), is_first, starts=before is None)
    likelihood, log_scale = state_likelihood(compiled, evidence)
    filtered, log_evidence, is_impossible = forward(
        compiled, likelihood, log_scale, index, begins, None if before is None else before.copy()
    )
    likelihood[is_impossible] = 1.0
    log_scale[is_impossible] = 0.0
    return Passed(filtered, likelihood, log_scale, index, begins, log_evidence, is_impossible)


@takes_any_model
def smooth_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    *,
    frame_id: IntArray | None = None,
    is_first: BoolArray | None = None,
) -> Beliefs:
    """Return P(node | evidence of all frames) for every hidden node and frame (Rabiner 1989,
    section III.B, on the joint state).

    - frame_id (T,): the beliefs' frame ids, 0, 1, ... by default.
    - is_first: as for `pass_forward`.

    Raises InputError as `pass_forward`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> ego.smooth_beliefs(run.model.compiled, run.evidence)
    Beliefs(300 frames, ids 0 to 299: SensorState (2), Lane (4))
    """
    passed = pass_forward(compiled, evidence, is_first=is_first)
    return _beliefs(compiled, passed, _smoothed(compiled, passed), frame_id)


@takes_any_model
def fixed_lag_beliefs(
    compiled: Compiled,
    evidence: Evidence,
    lag: int,
    *,
    frame_id: IntArray | None = None,
    is_first: BoolArray | None = None,
) -> Beliefs:
    """Return P(node at t | evidence up to frame t + lag) for every hidden node and frame.

    With lag 0 this is the exact filter.

    - lag: frames, not negative.
    - frame_id (T,): the beliefs' frame ids, 0, 1, ... by default.
    - is_first: as for `pass_forward`.

    Raises InputError as `pass_forward`, and for a negative lag.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> ego.fixed_lag_beliefs(run.model.compiled, run.evidence, lag=5)
    Beliefs(300 frames, ids 0 to 299: SensorState (2), Lane (4))
    """
    if lag < 0:
        raise InputError(f"lag {lag}: must not be negative")
    passed = pass_forward(compiled, evidence, is_first=is_first)
    smoothed = np.empty_like(passed.filtered)
    fixed_lag_frames(
        lag, passed.filtered, passed.likelihood, compiled.transition, passed.input_index,
        passed.begins, smoothed,
    )  # fmt: skip
    return _beliefs(compiled, passed, smoothed, frame_id)


class LagState(NamedTuple):
    """The state of an online fixed-lag smoother.

    recent: the last frames, at most `lag`, whose beliefs are not final yet.
    joint (S,): the joint belief after the last frame.
    """

    recent: Passed
    joint: FloatArray


def lag_step(
    compiled: Compiled, state: LagState | None, evidence: Evidence, lag: int
) -> tuple[LagState, Beliefs]:
    """Take one more frame online; return the new state, and the belief of `lag` frames ago.

    There is no belief during the first `lag` frames.

    - state: the state that the previous call returned, None before the first frame.
    - evidence: one frame.
    - lag: frames, not negative.

    `lag_rest` gives the last frames at the end. Raises InputError as `pass_forward`.
    """
    recent = pass_forward(compiled, evidence, None if state is None else state.joint)
    joint = recent.filtered[-1]
    if state is not None:
        recent = Passed._make(map(np.concatenate, zip(state.recent, recent, strict=True)))
    n_known = int(len(recent.filtered) > lag)
    rest = Passed._make(array[n_known:] for array in recent)
    return LagState(rest, joint), _first(compiled, recent, n_known)


def lag_rest(compiled: Compiled, state: LagState) -> Beliefs:
    """Return the beliefs of the frames that `lag_step` has not returned, at the end."""
    return _first(compiled, state.recent, len(state.recent.filtered))


def _first(compiled: Compiled, recent: Passed, n_frames: int) -> Beliefs:
    """Return the beliefs of the first of the recent frames, given all of them."""
    here = Passed._make(array[:n_frames] for array in recent)
    smoothed = _smoothed(compiled, recent)[:n_frames] if n_frames else here.filtered
    return _beliefs(compiled, here, smoothed, None)


def _smoothed(compiled: Compiled, passed: Passed) -> FloatArray:
    smoothed = np.empty_like(passed.filtered)
    smooth_frames(
        passed.filtered, passed.likelihood, compiled.transition, passed.input_index, passed.begins,
        smoothed, np.zeros((0, 0, 0)),
    )  # fmt: skip
    return smoothed


def _beliefs(
    compiled: Compiled, passed: Passed, joint: FloatArray, frame_id: IntArray | None
) -> Beliefs:
    ids = np.arange(len(joint)) if frame_id is None else frame_id
    rows = joint @ compiled.indicator
    marginals = {name: rows[:, columns] for name, columns in compiled.parts.items()}
    return Beliefs(ids, marginals, passed.log_evidence, passed.is_impossible, compiled.values)
