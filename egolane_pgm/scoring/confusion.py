"""Assigned lanes, confusion matrices with an Unassigned row, and the scores of the paper's tables.

Rows are the predicted lane 1..n, then Unassigned; columns are the actual lane 1..n; crossing frames
are left out.

Zero divided by zero is 0, so every score is a number. A lane that is never driven or never
predicted scores 0 and pulls the mean down. Without any scored frame all scores are 0: look at the
number of scored frames.

Unassigned frames count as wrong: they are in the support, hence in recall and accuracy, but in no
lane's precision.

In the formulas C[i, k] is the number of frames in which lane i is answered (n + 1: Unassigned) and
the car is in lane k, and N is their sum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import TIE_TOLERANCE, UNASSIGNED, FloatArray, InputError, IntArray


def assigned_lane(belief: ArrayLike, min_confidence: float = 0.0) -> IntArray:
    """The most probable lane of each frame, 1..n, or UNASSIGNED (0) where it is not unique.

    belief (T, n): non-negative; need not be normalised (a tentative vector will do). The maximum
        is not unique when the runner-up is within TIE_TOLERANCE of it, relative; so a row of zeros
        is Unassigned. One lane (n = 1) is always lane 1.
    min_confidence: a row whose maximum is less than this is Unassigned too (the reject option,
        for normalised beliefs; 0 for none).

    Returns (T,).
    """
    values = np.ascontiguousarray(belief, dtype=np.float64)
    lane = np.empty(len(values), dtype=np.int64)
    _assign(values, min_confidence, lane)
    return lane


@kernel()
def _assign(values: FloatArray, below: float, lane: IntArray) -> None:
    """Fills lane (T,); see `assigned_lane`."""
    for t in range(len(values)):
        top = values[t].max()
        lane[t] = UNASSIGNED
        n_near = 0
        for k in range(values.shape[1]):
            if top >= below and values[t, k] >= top - TIE_TOLERANCE * top:
                lane[t] = k + 1 if n_near == 0 else UNASSIGNED
                n_near += 1


@dataclass(frozen=True)
class ConfusionScores:
    """The scores of one confusion matrix.

    confusion (n + 1, n): counts of frames.
    precision, recall, f1 (n,): per lane.
    mean_precision, mean_recall, mean_f1: plain means over the lanes (mean_f1 is the macro F1: the
        mean of the lanes' F1, not the F1 of the means).
    accuracy: right frames over all scored frames.
    coverage: share of the scored frames that get an answer.
    frames_scored: number of non-crossing frames.
    """

    confusion: IntArray
    precision: FloatArray
    recall: FloatArray
    f1: FloatArray
    mean_precision: float
    mean_recall: float
    mean_f1: float
    accuracy: float
    coverage: float
    frames_scored: int


def confusion_cell(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, n_lanes: int
) -> IntArray:
    """The cell of the flattened confusion matrix that each frame falls into, -1 if it is crossing.

    assigned (T,): 1..n or UNASSIGNED.
    lane (T,): 1..n; not looked at in crossing frames.
    is_crossing (T,): marks crossing frames.

    Returns (T,): row * n + column.
    """
    predicted, actual = np.asarray(assigned), np.asarray(lane)
    row = np.where(predicted == UNASSIGNED, n_lanes, predicted - 1)
    return np.where(np.asarray(is_crossing), -1, row * n_lanes + actual - 1)


def confusion(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, n_lanes: int
) -> IntArray:
    """The confusion matrix (n + 1, n) of counts; arguments as `confusion_cell`."""
    cell = confusion_cell(assigned, lane, is_crossing, n_lanes)
    # Crossing frames, -1, are counted in front of the first cell, and left out.
    counts = np.bincount(cell + 1, minlength=1 + (n_lanes + 1) * n_lanes)[1:]
    return counts.reshape(n_lanes + 1, n_lanes)


def on_widest(matrices: Sequence[IntArray]) -> IntArray:
    """D confusion matrices, of roads with different numbers of lanes, as one array (D, n + 1, n),
    n of the widest; lane 1 is the leftmost of each."""
    most = max(matrix.shape[1] for matrix in matrices)
    found = np.zeros((len(matrices), most + 1, most), dtype=np.int64)
    for each, matrix in zip(found, matrices, strict=True):
        n = matrix.shape[1]
        each[:n, :n], each[most, :n] = matrix[:n], matrix[n]
    return found


def _ratio(numerator: IntArray | FloatArray, denominator: IntArray | FloatArray) -> FloatArray:
    """numerator / denominator, 0 where the denominator is 0 (the numerator is then 0 as well)."""
    return np.asarray(numerator / np.where(denominator == 0, 1, denominator), dtype=np.float64)


def _right(matrix: IntArray) -> IntArray:
    """Frames that are answered with the lane that they are in: (..., n + 1, n) -> (..., n)."""
    return np.diagonal(matrix[..., :-1, :], axis1=-2, axis2=-1)


def precision(matrix: ArrayLike) -> FloatArray:
    """Per lane, right over predicted as that lane: (..., n + 1, n) -> (..., n).

    `precision[k] = C[k, k] / sum_j C[k, j]`
    """
    m = np.asarray(matrix)
    return _ratio(_right(m), m[..., :-1, :].sum(axis=-1))


def recall(matrix: ArrayLike) -> FloatArray:
    """Per lane, right over actual, Unassigned included: (..., n + 1, n) -> (..., n).

    `recall[k] = C[k, k] / sum_i C[i, k]`, i from 1 to n + 1
    """
    m = np.asarray(matrix)
    return _ratio(_right(m), m.sum(axis=-2))


def f1(matrix: ArrayLike) -> FloatArray:
    """Per lane, the harmonic mean of precision and recall: (..., n + 1, n) -> (..., n).

    `f1[k] = 2 C[k, k] / (sum_j C[k, j] + sum_i C[i, k])`
    """
    m = np.asarray(matrix)
    return _ratio(2 * _right(m), m[..., :-1, :].sum(axis=-1) + m.sum(axis=-2))


def macro_f1(matrix: ArrayLike) -> FloatArray:
    """The plain mean of F1 over the lanes: (..., n + 1, n) -> (...).

    `macro_f1 = sum_k f1[k] / n`
    """
    return np.asarray(f1(matrix).mean(axis=-1))


def accuracy(matrix: ArrayLike) -> FloatArray:
    """Right over all scored frames, Unassigned included: (..., n + 1, n) -> (...).

    `accuracy = sum_k C[k, k] / N`
    """
    m = np.asarray(matrix)
    return _ratio(_right(m).sum(axis=-1), m.sum(axis=(-2, -1)))


def coverage(matrix: ArrayLike) -> FloatArray:
    """Share of the scored frames that get an answer: (..., n + 1, n) -> (...).

    `coverage = 1 - sum_k C[n + 1, k] / N`
    """
    m = np.asarray(matrix)
    return _ratio(m[..., :-1, :].sum(axis=(-2, -1)), m.sum(axis=(-2, -1)))


#: The scores of confusion matrices (..., n + 1, n) -> (...) by the names that results give them.
SCORES: Mapping[str, Callable[[IntArray], FloatArray]] = {
    "accuracy": accuracy,
    "f1": macro_f1,
    "precision": lambda m: np.asarray(precision(m).mean(axis=-1)),
    "recall": lambda m: np.asarray(recall(m).mean(axis=-1)),
    "coverage": coverage,
}


def is_maximised(score: str) -> bool:
    """Whether larger is better: for the scores of confusion matrices, but not for any other
    (`log_loss`, `brier`, `delay`, ...)."""
    return score in SCORES


def scores_from_confusion(matrix: ArrayLike) -> ConfusionScores:
    """All scores of one confusion matrix (n + 1, n); see the module for the rules."""
    m = np.asarray(matrix)
    precisions, recalls, f1s = precision(m), recall(m), f1(m)
    return ConfusionScores(
        confusion=m,
        precision=precisions,
        recall=recalls,
        f1=f1s,
        mean_precision=float(precisions.mean()),
        mean_recall=float(recalls.mean()),
        mean_f1=float(f1s.mean()),
        accuracy=float(accuracy(m)),
        coverage=float(coverage(m)),
        frames_scored=int(m.sum()),
    )


def frames_off(a: ArrayLike, b: ArrayLike) -> int:
    """The number of frames by which two confusion matrices (n + 1, n) differ.

    Half the sum of the absolute cell differences, rounded up, Unassigned row included: a frame
    that moves from one cell to another changes two cells, one that is missing changes one. Raises
    InputError where the shapes differ.
    """
    first, second = np.asarray(a), np.asarray(b)
    if first.shape != second.shape:
        raise InputError(
            f"confusion matrices of shapes {first.shape} and {second.shape} cannot be compared;"
            " is n_lanes the same?"
        )
    return int(np.abs(first - second).sum() + 1) // 2
