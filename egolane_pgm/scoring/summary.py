"""All scores of one belief against one ground truth, as a plain dict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.scoring.confusion import assigned_lane, confusion, scores_from_confusion
from egolane_pgm.scoring.probabilistic import brier, expected_calibration_error, log_loss
from egolane_pgm.scoring.stability import delay_after_lane_change, false_switches_per_minute
from egolane_pgm.tools.files import plain

if TYPE_CHECKING:
    import pandas as pd


def score_all(
    belief: ArrayLike,
    truth_lane: ArrayLike,
    is_crossing: ArrayLike,
    frame_id: ArrayLike,
    frame_rate: float,
    assigned: ArrayLike | None = None,
) -> dict[str, Any]:
    """All scores, ready for JSON: plain numbers and lists, None where a score is undefined.

    belief (T, n), rows sum to 1; truth_lane (T,), 1..n; is_crossing (T,); frame_id (T,), strictly
    increasing; frame_rate in frames per second. assigned (T,): the answers where they are not those
    of the belief, 1..n or UNASSIGNED; they do not change the scores of the belief itself (log-loss,
    Brier, calibration).

    Keys: `precision`, `recall`, `f1` (means over the lanes), `accuracy`, `log_loss` (over all
    frames), `brier`, `expected_calibration_error`, `coverage`, `false_switches_per_minute`,
    `delay` {`median_frames`, `p90_frames`, `share_missed`, `changes`}, `per_lane` {`precision`,
    `recall`, `f1`: a list each}, `confusion` (n + 1 rows of n counts), `frames` (T),
    `frames_scored` (those not crossing).
    """
    values, lane, crossing = map(np.asarray, (belief, truth_lane, is_crossing))
    n_frames, n_lanes = values.shape
    if assigned is None:
        assigned = assigned_lane(values)
    scores = scores_from_confusion(confusion(assigned, lane, crossing, n_lanes))
    delay = delay_after_lane_change(assigned, lane, crossing, frame_id)
    found = {
        "precision": scores.mean_precision,
        "recall": scores.mean_recall,
        "f1": scores.mean_f1,
        "accuracy": scores.accuracy,
        "log_loss": log_loss(values, lane),
        "brier": brier(values, lane, crossing),
        "expected_calibration_error": expected_calibration_error(values, lane, crossing),
        "coverage": scores.coverage,
        "false_switches_per_minute": false_switches_per_minute(
            assigned, lane, crossing, frame_rate
        ),
        "delay": {
            "median_frames": delay.median_frames,
            "p90_frames": delay.p90_frames,
            "share_missed": delay.share_missed,
            "changes": delay.changes,
        },
        "per_lane": {
            "precision": scores.precision,
            "recall": scores.recall,
            "f1": scores.f1,
        },
        "confusion": scores.confusion,
        "frames": n_frames,
        "frames_scored": scores.frames_scored,
    }
    result: dict[str, Any] = plain(found)
    return result


def score_with_intervals(
    belief: ArrayLike,
    truth: pd.DataFrame,
    frame_rate: float,
    assigned: ArrayLike | None = None,
) -> dict[str, Any]:
    """`score_all` of a belief (T, n) over the frames of the ground truth, and `intervals`: 95 %
    block-bootstrap intervals [low, high] of `accuracy` and `f1`, None for a short drive."""
    lane, is_crossing = truth["true_lane"].to_numpy(), truth["is_crossing"].to_numpy()
    scores = score_all(belief, lane, is_crossing, truth.index, frame_rate, assigned)
    found = score_intervals([score_counts(belief, lane, is_crossing, assigned)])
    intervals = {name: found[name] for name in ("accuracy", "f1")}
    bounds = {k: None if i.low is None else [i.low, i.high] for k, i in intervals.items()}
    return {**scores, "intervals": bounds}
