"""All scores of one belief against one ground truth, as a plain dict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.scoring.checks import as_belief, as_lanes, as_mask, check_frame_rate
from egolane_pgm.scoring.confusion import confusion, scores_from_confusion
from egolane_pgm.scoring.probabilistic import (
    N_BINS,
    brier_per_frame,
    calibration_error,
    calibration_sums,
    curve_of,
    log_loss_per_frame,
)
from egolane_pgm.scoring.stability import (
    NO_ROWS,
    Followed,
    delay_scores,
    followed,
    switch_rate,
)
from egolane_pgm.types import FloatArray, IntArray, LaneTruth


def score_all(
    belief: ArrayLike,
    truth_lane: ArrayLike,
    is_crossing: ArrayLike,
    frame_id: ArrayLike,
    frame_rate: float,
    unassigned_below: float = 0.0,
    assigned: ArrayLike | None = None,
) -> dict[str, Any]:
    """All scores, ready for JSON: plain numbers and lists, None where a score is undefined.

    belief (T, n), rows sum to 1; truth_lane (T,), 1..n; is_crossing (T,); frame_id (T,), strictly
    increasing; frame_rate in frames per second. unassigned_below: see `assigned_lane`; it changes
    the answers, not the scores of the belief itself (log-loss, Brier, calibration). assigned (T,):
    the answers where they are not those of the belief, 1..n or UNASSIGNED.

    Keys: `precision`, `recall`, `f1` (means over the lanes), `accuracy`, `log_loss` (over all
    frames), `brier`, `expected_calibration_error`, `coverage`, `false_switches_per_minute`,
    `delay` {`median_frames`, `p90_frames`, `share_missed`, `changes`}, `per_lane` {`precision`,
    `recall`, `f1`: a list each}, `confusion` (n + 1 rows of n counts), `frames` (T),
    `frames_scored` (those not crossing).

    Raises InputError as the single scores do.
    """
    check_frame_rate(frame_rate)
    n_lanes = as_belief(belief, normalised=True).shape[1]
    if assigned is None:
        assigned = assigned_lane(belief, unassigned_below)
    frames = (belief, truth_lane, is_crossing, frame_id, assigned)
    return scores_of(with_frames(no_frames(n_lanes), *frames), frame_rate)


@dataclass(frozen=True)
class ScoreSums:
    """What the scores of a belief are made of. It adds up: a drive may be cut anywhere, the scores
    are the same.

    frames: T, annotated frames so far.
    log_loss, brier: sums of the scores per frame.
    calibration (3, n_bins): see `probabilistic.calibration_sums`.
    confusion (n + 1, n): counts.
    rows: what the scores over time need.
    """

    frames: int
    log_loss: float
    brier: float
    calibration: FloatArray
    confusion: IntArray
    rows: Followed


def no_frames(n_lanes: int) -> ScoreSums:
    """The sums before the first frame."""
    counts = np.zeros((n_lanes + 1, n_lanes), dtype=np.int64)
    return ScoreSums(0, 0.0, 0.0, np.zeros((3, N_BINS)), counts, NO_ROWS)


def with_frames(
    sums: ScoreSums,
    belief: ArrayLike,
    truth_lane: ArrayLike,
    is_crossing: ArrayLike,
    frame_id: ArrayLike,
    assigned: ArrayLike,
) -> ScoreSums:
    """The sums with T more frames. Arguments and errors as `score_all`."""
    values = as_belief(belief, normalised=True)
    n_frames, n_lanes = values.shape
    lane, crossing = as_lanes(truth_lane, n_frames, "truth_lane"), as_mask(is_crossing, n_frames)
    counts = sums.confusion + confusion(assigned, lane, crossing, n_lanes)
    return ScoreSums(
        sums.frames + n_frames,
        running_sum(sums.log_loss, log_loss_per_frame(values, lane)),
        running_sum(sums.brier, brier_per_frame(values[~crossing], lane[~crossing])),
        calibration_sums(sums.calibration, values, lane, crossing),
        counts,
        followed(sums.rows, assigned, lane, crossing, frame_id),
    )


def running_sum(total: float, values: FloatArray) -> float:
    """The total and the values (T,), added one after the other: wherever a drive is cut, the same
    numbers are added in the same order."""
    return float(np.cumsum(np.append(total, values))[-1])


def scores_of(sums: ScoreSums, frame_rate: float) -> dict[str, Any]:
    """The scores, as `score_all` gives them."""
    scores = scores_from_confusion(sums.confusion)
    scored = scores.frames_scored
    return {
        "precision": scores.mean_precision,
        "recall": scores.mean_recall,
        "f1": scores.mean_f1,
        "accuracy": scores.accuracy,
        "log_loss": sums.log_loss / sums.frames if sums.frames else None,
        "brier": sums.brier / scored if scored else None,
        "expected_calibration_error": _or_none(calibration_error(curve_of(sums.calibration))),
        "coverage": scores.coverage,
        **_over_time(sums.rows, frame_rate),
        "per_lane": {
            "precision": scores.precision.tolist(),
            "recall": scores.recall.tolist(),
            "f1": scores.f1.tolist(),
        },
        "confusion": scores.confusion.tolist(),
        "frames": sums.frames,
        "frames_scored": scored,
    }


def stability_scores(
    assigned: ArrayLike,
    truth_lane: ArrayLike,
    is_crossing: ArrayLike,
    frame_id: ArrayLike,
    frame_rate: float,
) -> dict[str, Any]:
    """The scores of `score_all` that look from frame to frame: `false_switches_per_minute` and
    `delay`. Parameters and errors as there."""
    check_frame_rate(frame_rate)
    rows = followed(NO_ROWS, assigned, truth_lane, is_crossing, frame_id)
    return _over_time(rows, frame_rate)


def _over_time(rows: Followed, frame_rate: float) -> dict[str, Any]:
    delay = delay_scores(rows)
    return {
        "false_switches_per_minute": _or_none(switch_rate(rows.switches, frame_rate)),
        "delay": {
            "median_frames": _or_none(delay.median_frames),
            "p90_frames": _or_none(delay.p90_frames),
            "share_missed": _or_none(delay.share_missed),
            "changes": delay.changes,
        },
    }


def score_with_intervals(
    belief: ArrayLike,
    truth: LaneTruth,
    frame_rate: float,
    unassigned_below: float = 0.0,
    assigned: ArrayLike | None = None,
) -> dict[str, Any]:
    """`score_all` of a belief (T, n) over the frames of the ground truth, and `intervals`: 95 %
    block-bootstrap intervals [low, high] of `accuracy` and `f1`, None for a short drive."""
    lane, is_crossing = truth.lane, truth.is_crossing
    answers = (unassigned_below, assigned)
    scores = score_all(belief, lane, is_crossing, truth.frame_id, frame_rate, *answers)
    found = score_intervals([score_counts(belief, lane, is_crossing, *answers)])
    intervals = {name: found[name] for name in ("accuracy", "f1")}
    return {**scores, "intervals": {k: i and [i.low, i.high] for k, i in intervals.items()}}


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
