"""Is the detector wrong in this frame? The area under the ROC curve measures how well a score says.

Only non-crossing frames count in which the detector commits to a lane (its tentative vector has a
unique maximum): no model is needed to know that a detector without an answer is no help.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class DetectorErrors:
    """Where the detector alone is wrong.

    assigned (T,): the detector's lane, 0 for Unassigned.
    is_committed (T,): marks the non-crossing frames with a lane.
    is_scored (T,): marks the non-crossing frames.
    is_wrong (T,): marks frames in which the lane is not the true one; Unassigned is wrong too.
    """

    assigned: IntArray
    is_committed: BoolArray
    is_scored: BoolArray
    is_wrong: BoolArray


def detector_errors(
    tentative: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike
) -> DetectorErrors:
    """The errors of a tentative vector (T, n) against lane (T,) and is_crossing (T,)."""
    assigned, is_scored = assigned_lane(tentative), ~np.asarray(is_crossing)
    is_committed = is_scored & (assigned != UNASSIGNED)
    return DetectorErrors(assigned, is_committed, is_scored, assigned != np.asarray(lane))


def doubt(belief: ArrayLike, assigned: ArrayLike) -> FloatArray:
    """A health score (T,): 1 - P(assigned lane), by a belief (T, n), for lanes that somebody else
    assigned (T,), 1..n; 1 where no lane is assigned (0)."""
    values, lanes = np.asarray(belief), np.asarray(assigned)
    given = values[np.arange(len(values)), np.maximum(lanes, 1) - 1]
    return np.asarray(1.0 - np.where(lanes == UNASSIGNED, 0.0, given))


def roc_auc(score: ArrayLike, is_positive: ArrayLike) -> float:
    """The area under the ROC curve: the probability that a positive frame has a larger score than
    a negative one, ties counting half (Hanley & McNeil 1982).

    score (T,), is_positive (T,). NaN without a positive or without a negative frame.
    """
    values, positive = np.asarray(score, dtype=np.float64), np.asarray(is_positive)
    n_positive = int(positive.sum())
    n_negative = len(values) - n_positive
    if not n_positive or not n_negative:
        return float("nan")
    _, index, count = np.unique(values, return_inverse=True, return_counts=True)
    # The mean rank of equal scores, counted from 1.
    rank = np.cumsum(count) - (count - 1) / 2
    total = float(rank[index][positive].sum())
    return (total - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative)
