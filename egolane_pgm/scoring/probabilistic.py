"""Scores of the posterior: log-loss, Brier score, calibration, coverage.

Without frames to score they are NaN (None in JSON); 0 would be a perfect score.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.types import UNASSIGNED, FloatArray

#: Smaller probabilities count as this in the log-loss: a certain error costs 34.5, not infinity.
SMALLEST_PROBABILITY = 1e-15

#: Equal-width bins of the maximum in the calibration curve.
N_BINS = 15


def log_loss_per_frame(belief: ArrayLike, lane: ArrayLike) -> FloatArray:
    """(T,): minus the natural log of the probability given to the annotated lane.

    `log_loss = -(1 / T) sum_t ln belief[t, lane[t]]`

    belief (T, n), rows sum to 1; lane (T,). The log-loss is the mean over ALL frames, crossing ones
    included, as in the paper's tables. Probabilities are clipped below at SMALLEST_PROBABILITY.
    """
    values = np.asarray(belief)
    given = values[np.arange(len(values)), np.asarray(lane) - 1]
    return np.asarray(-np.log(np.maximum(given, SMALLEST_PROBABILITY)))


def brier(belief: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike) -> float:
    """Multi-class Brier score, the mean over the non-crossing frames.

    `brier = (1 / N) sum_t sum_k (belief[t, k] - [k = lane[t]])^2`, over N frames

    0 is perfect, 2 the worst. belief (T, n), rows sum to 1; lane (T,), is_crossing (T,). NaN
    without a non-crossing frame.
    """
    values = np.asarray(belief)
    truth = np.asarray(lane)[:, None] == np.arange(1, values.shape[1] + 1)
    scored = ((values - truth) ** 2).sum(axis=1)[~np.asarray(is_crossing)]
    return float(scored.mean()) if scored.size else float("nan")


def calibration_curve(
    belief: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, n_bins: int = N_BINS
) -> dict[str, Any]:
    """The calibration curve over the non-crossing frames, equal-width bins of the maximum.

    Arguments as `brier`. Bin k has the frames whose largest probability lies in
    (k / n_bins, (k + 1) / n_bins]. An Unassigned frame counts as wrong, as everywhere.

    Keys, (n_bins,) each: `confidence` (mean of the largest probability), `accuracy` (share of
    frames with the right lane; both NaN in an empty bin), `count` (frames).
    """
    is_scored = ~np.asarray(is_crossing)
    values, actual = np.asarray(belief)[is_scored], np.asarray(lane)[is_scored]
    largest = values.max(axis=1)
    is_right = assigned_lane(values) == actual
    k = np.clip(np.ceil(largest * n_bins).astype(np.int64) - 1, 0, n_bins - 1)
    count = np.bincount(k, minlength=n_bins)
    divisor = np.where(count == 0, np.nan, count)
    return {
        "confidence": np.bincount(k, weights=largest, minlength=n_bins) / divisor,
        "accuracy": np.bincount(k, weights=is_right, minlength=n_bins) / divisor,
        "count": count,
    }


def expected_calibration_error(
    belief: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, n_bins: int = N_BINS
) -> float:
    """Mean over the non-crossing frames of |confidence - accuracy| of their bin, 0 to 1.

    `ece = sum_b (N_b / N) |accuracy_b - confidence_b|`, over bins b of N_b frames

    Arguments and the treatment of ties as `calibration_curve`. NaN without a non-crossing frame.
    """
    curve = calibration_curve(belief, lane, is_crossing, n_bins)
    count = curve["count"]
    filled = count > 0
    if not filled.any():
        return float("nan")
    gap = np.abs(curve["confidence"][filled] - curve["accuracy"][filled])
    return float((gap * count[filled]).sum() / count.sum())


def coverage_curve(belief: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike) -> dict[str, Any]:
    """The accuracy-coverage curve over the non-crossing frames, one point per distinct threshold.

    Arguments as `brier`. Frames without a unique most probable lane are never answered.

    Keys, (K,) each: `threshold` (the least probability that is answered, decreasing), `coverage`
    (share of the frames with an answer), `accuracy` (share of the answers that are right).
    """
    values, is_scored = np.asarray(belief), ~np.asarray(is_crossing)
    assigned = assigned_lane(values)
    is_answered = is_scored & (assigned != UNASSIGNED)
    confidence = values.max(axis=1)[is_answered]
    order = np.argsort(-confidence, kind="stable")
    threshold = confidence[order]
    right = np.cumsum((assigned == np.asarray(lane))[is_answered][order])
    # The last of equal probabilities: they are answered together or not at all.
    last = np.flatnonzero(np.append(threshold[1:] != threshold[:-1], threshold.size > 0))
    return {
        "threshold": threshold[last],
        "coverage": (last + 1) / max(int(is_scored.sum()), 1),
        "accuracy": right[last] / (last + 1),
    }
