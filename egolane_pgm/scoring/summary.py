"""All scores of one belief against one ground truth, as a plain dict."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.scoring.confusion import confusion, scores_from_confusion
from egolane_pgm.scoring.probabilistic import brier, expected_calibration_error, log_loss
from egolane_pgm.scoring.stability import delay_after_lane_change, false_switches_per_minute

if TYPE_CHECKING:
    import pandas as pd


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
    """
    values, lane, crossing = map(np.asarray, (belief, truth_lane, is_crossing))
    n_frames, n_lanes = values.shape
    if assigned is None:
        assigned = assigned_lane(values, unassigned_below)
    scores = scores_from_confusion(confusion(assigned, lane, crossing, n_lanes))
    return {
        "precision": scores.mean_precision,
        "recall": scores.mean_recall,
        "f1": scores.mean_f1,
        "accuracy": scores.accuracy,
        "log_loss": _or_none(log_loss(values, lane)),
        "brier": _or_none(brier(values, lane, crossing)),
        "expected_calibration_error": _or_none(expected_calibration_error(values, lane, crossing)),
        "coverage": scores.coverage,
        **stability_scores(assigned, lane, crossing, frame_id, frame_rate),
        "per_lane": {
            "precision": scores.precision.tolist(),
            "recall": scores.recall.tolist(),
            "f1": scores.f1.tolist(),
        },
        "confusion": scores.confusion.tolist(),
        "frames": n_frames,
        "frames_scored": int(np.count_nonzero(~crossing)),
    }


def stability_scores(
    assigned: ArrayLike,
    truth_lane: ArrayLike,
    is_crossing: ArrayLike,
    frame_id: ArrayLike,
    frame_rate: float,
) -> dict[str, Any]:
    """The scores of `score_all` that look from frame to frame: `false_switches_per_minute` and
    `delay`. Parameters as there."""
    delay = delay_after_lane_change(assigned, truth_lane, is_crossing, frame_id)
    switches = false_switches_per_minute(assigned, truth_lane, is_crossing, frame_rate)
    return {
        "false_switches_per_minute": _or_none(switches),
        "delay": {
            "median_frames": _or_none(delay.median_frames),
            "p90_frames": _or_none(delay.p90_frames),
            "share_missed": _or_none(delay.share_missed),
            "changes": delay.changes,
        },
    }


def score_with_intervals(
    belief: ArrayLike,
    truth: pd.DataFrame,
    frame_rate: float,
    unassigned_below: float = 0.0,
    assigned: ArrayLike | None = None,
) -> dict[str, Any]:
    """`score_all` of a belief (T, n) over the frames of the ground truth, and `intervals`: 95 %
    block-bootstrap intervals [low, high] of `accuracy` and `f1`, None for a short drive."""
    lane, is_crossing = truth["true_lane"].to_numpy(), truth["is_crossing"].to_numpy()
    answers = (unassigned_below, assigned)
    scores = score_all(belief, lane, is_crossing, truth.index, frame_rate, *answers)
    found = score_intervals([score_counts(belief, lane, is_crossing, *answers)])
    intervals = {name: found[name] for name in ("accuracy", "f1")}
    bounds = {k: None if i.low is None else [i.low, i.high] for k, i in intervals.items()}
    return {**scores, "intervals": bounds}


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
