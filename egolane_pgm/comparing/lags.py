"""How right the beliefs are that wait: accuracy over the delay with which they are given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.drive import evidence_on, load_drive
from egolane_pgm.inference.smoothing import fixed_lag_beliefs
from egolane_pgm.learning import with_found
from egolane_pgm.results import Result
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import BoolArray, FloatArray, InputError

#: The scores for each lag.
SCORES = ("accuracy", "f1", "log_loss")


def check_lags(lags: ArrayLike) -> tuple[float, ...]:
    """One or several lags, seconds, in increasing order and each once. Raises InputError for what
    is no number of seconds that one can wait."""
    try:
        seconds = np.unique(np.asarray(lags, dtype=np.float64))
    except (TypeError, ValueError):
        seconds = np.array([np.nan])
    if not np.isfinite(seconds).all():
        raise InputError(f"lags: {lags!r} are no numbers of seconds, as 0, 0.5, 1 are")
    if (seconds < 0).any():
        raise InputError(f"lags: {seconds[0]:g} s must not be negative")
    return tuple(seconds.tolist())


def whole_frames(seconds: float, frame_rate: float) -> int:
    """How many frames come within that time."""
    # A thousandth of a frame is rounding: 0.29 s are 29 frames of a hundredth.
    return math.floor(seconds * frame_rate + 1e-3)


def lagged_beliefs(result: Result, lags: Sequence[float]) -> list[FloatArray]:
    """The beliefs over the lanes (K, n) in the annotated frames that wait for each of some lags,
    seconds, with what was found without each block. The recording is read for it; the evidence is
    made once for all lags, and only once where nothing is fitted.

    Raises InputError where the recording cannot be read.
    """
    drive = load_drive(result.experiment, needs_truth="a comparison scores against it")
    experiment, rate = drive.experiment, result.run["frame_rate"]
    frames = [whole_frames(lag, rate) for lag in lags]
    founds = result.run.get("parameters_per_block") or [{}]
    # Without a fit all blocks have the same parameters.
    founds = founds[:1] if experiment.fit == "none" else founds
    lanes: dict[int, FloatArray] = {}
    for b, found in enumerate(founds):
        model = with_found(drive.model, found, experiment)
        evidence = evidence_on(drive, model).filtered
        mine = slice(None) if len(founds) == 1 else result.block == b
        try:
            for lag in frames:
                lane = fixed_lag_beliefs(model.compiled, evidence, lag).lane[drive.rows]
                lanes.setdefault(lag, np.empty_like(lane))[mine] = lane[mine]
        except InputError as error:
            raise InputError(f"{experiment.source}: lags: {error}") from error
    return [lanes[n] for n in frames]


def lag_notes(result: Result, lags: Sequence[float]) -> list[str]:
    """What a reader must know of lags in seconds: those that are no whole number of frames, and the
    gaps of a recording."""
    rate, ids = result.run["frame_rate"], result.frame_id
    notes = []
    for lag in lags:
        n = whole_frames(lag, rate)
        if abs(n / rate - lag) > 1e-3 / rate:
            notes.append(
                f"lags: {lag:g} s is no whole number of frames at {rate:g} a second; the belief"
                f" waits for {n}, {n / rate:g} s"
            )
    gaps = int(np.count_nonzero(np.diff(ids) > 1))
    if gaps and lags[-1] > 0:
        notes.append(f"lags: frame ids jump {gaps} times; a lag across a jump lasts longer")
    return notes


def lag_scores(
    result: Result, lanes: Sequence[FloatArray], lags: Sequence[float], kept: BoolArray
) -> dict[str, Any]:
    """`lag_s`, `frames` (how many later ones a belief knows), `accuracy`, `f1` and `log_loss`, a
    list with a value for each lag, and `intervals`, of accuracy and F1, with a list of [low, high]
    each, None for a short drive.

    - lanes: for each lag, as `lagged_beliefs` gives them.
    - kept (K,): the annotated frames that are scored.
    """
    assert result.truth is not None
    truth, rate = result.truth.take(kept), result.run["frame_rate"]
    below = result.experiment.unassigned_below
    found: list[Mapping[str, Any]] = [
        score_with_intervals(lane[kept], truth, rate, below) for lane in lanes
    ]
    return {
        "lag_s": list(lags),
        "frames": [whole_frames(lag, rate) for lag in lags],
        **{name: [scores[name] for scores in found] for name in SCORES},
        "intervals": {
            name: [scores["intervals"][name] for scores in found] for name in ("accuracy", "f1")
        },
    }
