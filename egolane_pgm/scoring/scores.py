"""The table of scores: the summands of each frame, the statistic of their sums, the direction.

Each score is a statistic of sums over frames. The same summands give the score of a drive, of some
of its frames, of several drives together, and of the resamples of a bootstrap.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egolane_pgm.scoring.confusion import (
    assigned_lane,
    confusion_cell,
    log_loss_per_frame,
    scores_from_confusion,
)
from egolane_pgm.scoring.events import false_switches
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Sums (..., C) of summands -> the score, (...).
Statistic = Callable[[NDArray[Any]], FloatArray]

#: Number of equal-width bins of the largest probability in the calibration curve.
N_BINS = 15


@dataclass(frozen=True)
class Answers:
    """The beliefs and answers of T frames of a drive, and their ground truth.

    - belief: (T, n), rows sum to 1.
    - lane: (T,), 1..n. In crossing frames it counts for the log-loss only.
    - is_crossing: (T,), marks crossing frames.
    - assigned: (T,), 1..n or UNASSIGNED.
    - is_used: (T,), marks the frames that count; True for all.
    - frame_rate: frames per second, for the false switches.
    - log_evidence: (T,), nats.
    - n_lanes: size of the confusion matrix if it is larger than n; lane 1 is the leftmost.
    """

    belief: FloatArray
    lane: IntArray
    is_crossing: BoolArray
    assigned: IntArray
    is_used: BoolArray | bool = True
    frame_rate: float = math.nan
    log_evidence: FloatArray | float = math.nan
    n_lanes: int = 0

    @property
    def is_left_out(self) -> BoolArray:
        """(T,): marks the frames that are crossing or not used."""
        return self.is_crossing | np.logical_not(self.is_used)


@dataclass(frozen=True)
class Score:
    """A score of the posterior over lanes.

    - name: key in scores.json and in `fit.objective`.
    - label: name in a table; the short name is the part before the bracket.
    - summands: of each frame, (T, C); zeros in frames that do not count.
    - statistic: the score by the sums of its summands; NaN if undefined.
    - is_maximised: whether larger is better.
    """

    name: str
    label: str
    summands: Callable[[Answers], NDArray[Any]]
    statistic: Statistic
    is_maximised: bool = False

    def of(self, answers: Answers) -> float:
        """Compute the score of some answers."""
        return float(self.statistic(self.summands(answers).sum(axis=0)))

    @property
    def short_label(self) -> str:
        """The label without its bracket."""
        return self.label.partition(" (")[0]


def mean(sums: NDArray[Any]) -> FloatArray:
    """The mean by the sums (..., 2) of values and of the frames that count; NaN without frames."""
    return np.asarray(sums[..., 0] / np.where(sums[..., 1] == 0, np.nan, sums[..., 1]))


def _averaged(values: ArrayLike, is_counted: BoolArray | bool) -> FloatArray:
    """(T, 2): the value of each frame and 1; zeros in frames that do not count."""
    value, counted = np.broadcast_arrays(values, is_counted)
    # Contiguous columns: their sums are rounded as in `np.mean`.
    return np.array([np.where(counted, value, 0.0), counted]).T


def _losses(answers: Answers) -> FloatArray:
    return _averaged(log_loss_per_frame(answers.belief, answers.lane), answers.is_used)


def _log_evidence(answers: Answers) -> FloatArray:
    return _averaged(answers.log_evidence, answers.is_used)


def _squared_errors(answers: Answers) -> FloatArray:
    truth = answers.lane[:, None] == np.arange(1, answers.belief.shape[1] + 1)
    return _averaged(((answers.belief - truth) ** 2).sum(axis=1), ~answers.is_left_out)


def _cells(answers: Answers) -> BoolArray:
    """(T, (n + 1) n): marks the cell of each frame in the flattened confusion matrix."""
    n = max(answers.belief.shape[1], answers.n_lanes)
    cell = confusion_cell(answers.assigned, answers.lane, answers.is_left_out, n)
    return np.asarray(cell == np.arange((n + 1) * n)[:, None]).T


def _of_confusion(name: str) -> Statistic:
    def statistic(sums: NDArray[Any]) -> FloatArray:
        n = math.isqrt(sums.shape[-1])
        matrix = sums.reshape(*sums.shape[:-1], n + 1, n)
        return np.asarray(scores_from_confusion(matrix)[name])

    return statistic


def _bins(answers: Answers) -> FloatArray:
    """(T, 3 N_BINS): per bin the frame, its largest probability, and whether its lane is right."""
    largest = answers.belief.max(axis=1)
    is_right = assigned_lane(answers.belief) == answers.lane
    k = np.clip(np.ceil(largest * N_BINS) - 1, 0, N_BINS - 1)
    in_bin = (k == np.arange(N_BINS)[:, None]) & ~answers.is_left_out
    return np.concatenate([in_bin, in_bin * largest, in_bin & is_right]).T


def _calibration_error(sums: NDArray[Any]) -> FloatArray:
    count, confidence, right = np.split(sums, 3, axis=-1)
    gap = np.abs(confidence - right)
    return mean(np.stack([gap.sum(axis=-1), count.sum(axis=-1)], axis=-1))


def _switches(answers: Answers) -> FloatArray:
    """(T, 2): false switches from the frame before, and the minutes in which one is possible."""
    given = answers.assigned, answers.lane, answers.is_left_out
    is_false, is_counted = false_switches(*given)
    return np.array([is_false, is_counted / (60 * answers.frame_rate)]).T


def calibration_curve(answers: Answers) -> dict[str, FloatArray]:
    """The calibration curve over the non-crossing frames, equal-width bins of the maximum.

    Bin k has the frames whose largest probability lies in (k / N_BINS, (k + 1) / N_BINS]. An
    Unassigned frame counts as wrong, as everywhere.

    Keys, (N_BINS,) each: `confidence` (mean of the largest probability), `accuracy` (share of
    frames with the right lane; both NaN in an empty bin), `count` (frames).
    """
    count, confidence, right = np.split(_bins(answers).sum(axis=0), 3)
    divisor = np.where(count == 0, np.nan, count)
    return {"confidence": confidence / divisor, "accuracy": right / divisor, "count": count}


#: The scores by name, in the order of a table.
#:
#: - accuracy to f1, coverage: see `scores_from_confusion`.
#: - log_loss: mean over all frames, crossing ones included; see `log_loss_per_frame`.
#: - brier: mean over the non-crossing frames of sum_k (belief[t, k] - [k = lane[t]])^2; 0 is
#:   perfect, 2 the worst.
#: - expected_calibration_error: sum_b (N_b / N) |accuracy_b - confidence_b| over the bins b of
#:   `calibration_curve`, of N_b frames each.
#: - false_switches_per_minute: see `scoring.events`.
#: - log_evidence: mean over all frames, nats.
SCORES = {
    score.name: score
    for score in (
        Score("accuracy", "accuracy", _cells, _of_confusion("accuracy"), is_maximised=True),
        Score("precision", "precision (mean)", _cells, _of_confusion("precision"), True),
        Score("recall", "recall (mean)", _cells, _of_confusion("recall"), True),
        Score("f1", "F1 (mean)", _cells, _of_confusion("f1"), True),
        Score("log_loss", "log-loss (all frames)", _losses, mean),
        Score("brier", "Brier score", _squared_errors, mean),
        Score("expected_calibration_error", "calibration error", _bins, _calibration_error),
        Score("coverage", "coverage", _cells, _of_confusion("coverage"), True),
        Score("false_switches_per_minute", "false switches / min", _switches, mean),
        Score("log_evidence", "log evidence", _log_evidence, mean, True),
    )
}
