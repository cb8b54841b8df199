"""How right the beliefs are that wait: accuracy over the delay with which they are given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.drive import Drive, evidence_on
from egolane_pgm.inference.smoothing import fixed_lag_beliefs
from egolane_pgm.learning import Found, with_found
from egolane_pgm.scoring.held_out import HeldOut
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import BoolArray, FloatArray, InputError

#: The scores for each lag.
SCORES = ("accuracy", "f1", "log_loss")


@dataclass(frozen=True)
class Lagged:
    """The beliefs that wait for a number of later frames.

    seconds: how long they were asked to wait at most.
    frames: how many later frames they know; fewer at the end of the recording.
    lane (K, n): the beliefs over the lanes in the annotated frames.
    """

    seconds: float
    frames: int
    lane: FloatArray


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


def lagged_beliefs(drive: Drive, held_out: HeldOut[Found], lags: Sequence[float]) -> list[Lagged]:
    """The beliefs about a drive with what was found without each block, for each lag. The evidence
    is made once for all lags, and only once where nothing is fitted.

    lags: seconds.

    Raises InputError where the evidence is not a likelihood (`evidence_reading: jeffrey`).
    """
    experiment = drive.experiment
    frames = [whole_frames(lag, experiment.recording.frame_rate) for lag in lags]
    # Without a fit all blocks have the same parameters.
    founds = held_out.parameters[:1] if experiment.fit == "none" else held_out.parameters
    lanes: dict[int, FloatArray] = {}
    for b, found in enumerate(founds):
        model = with_found(drive.model, found, experiment)
        evidence = evidence_on(drive, model).filtered
        mine = held_out.block == b if len(founds) > 1 else slice(None)
        try:
            for lag in frames:
                lane = fixed_lag_beliefs(model.compiled, evidence, lag).lane[drive.rows]
                lanes.setdefault(lag, np.empty_like(lane))[mine] = lane[mine]
        except InputError as error:
            raise InputError(f"{experiment.source}: lags: {error}") from error
    return [Lagged(lag, n, lanes[n]) for lag, n in zip(lags, frames, strict=True)]


def lag_notes(drive: Drive, lags: Sequence[float]) -> list[str]:
    """What a reader must know of lags in seconds: those that are no whole number of frames, and the
    gaps of a recording."""
    rate, ids = drive.experiment.recording.frame_rate, drive.recorded.log.frame_id
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


def lag_scores(drive: Drive, lagged: Sequence[Lagged], kept: BoolArray) -> dict[str, Any]:
    """`lag_s`, `frames`, `accuracy`, `f1` and `log_loss`, a list with a value for each lag, and
    `intervals`, of accuracy and F1, with a list of [low, high] each, None for a short drive.

    kept (K,): the annotated frames that are scored.
    """
    experiment, truth = drive.experiment, drive.truth.take(kept)
    rate, below = experiment.recording.frame_rate, experiment.unassigned_below
    found: list[Mapping[str, Any]] = [
        score_with_intervals(each.lane[kept], truth, rate, below) for each in lagged
    ]
    return {
        "lag_s": [each.seconds for each in lagged],
        "frames": [each.frames for each in lagged],
        **{name: [scores[name] for scores in found] for name in SCORES},
        "intervals": {
            name: [scores["intervals"][name] for scores in found] for name in ("accuracy", "f1")
        },
    }
