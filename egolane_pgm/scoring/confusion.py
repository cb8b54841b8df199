"""Assigned lanes, confusion matrices and their scores, log-loss of single frames.

Rows of a confusion matrix are the predicted lane 1..n, then Unassigned; columns are the actual lane
1..n. Crossing frames are left out.

Zero divided by zero is 0, so every score is a number. A lane that is never driven or never
predicted scores 0 and pulls the mean down. If no frame is scored, all scores are 0: check the
number of scored frames.

Unassigned frames count as wrong: they are in the support, and so in recall and accuracy, but in no
lane's precision. If no frame is scored, scores of the posterior are NaN (None in JSON): 0 would be
perfect.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import TIE_TOLERANCE, UNASSIGNED, FloatArray, InputError, IntArray

#: Smaller probabilities count as this in the log-loss: a certain error costs 34.5, not infinity.
SMALLEST_PROBABILITY = 1e-15


def assigned_lane(belief: ArrayLike, min_confidence: float = 0.0) -> IntArray:
    """The most probable lane of each frame, 1..n, or UNASSIGNED (0) if it is not unique.

    - belief (T, n): non-negative; need not be normalised (a tentative vector will do). The maximum
      is not unique when the runner-up is within TIE_TOLERANCE of it, relative; so a row of zeros
      is Unassigned. One lane (n = 1) is always lane 1.
    - min_confidence: a row whose maximum is less than this is Unassigned too (the reject option,
      for normalised beliefs; 0 for none).

    Returns (T,).
    """
    values = np.ascontiguousarray(belief, dtype=np.float64)
    lane = np.empty(len(values), dtype=np.int64)
    _assign(values, min_confidence, lane)
    return lane


@kernel()
def _assign(values: FloatArray, below: float, lane: IntArray) -> None:
    """Fill lane (T,); see `assigned_lane`."""
    for t in range(len(values)):
        # A loop: compiling `max` takes a second.
        top = values[t, 0]
        for k in range(1, values.shape[1]):
            top = max(top, values[t, k])
        lane[t] = UNASSIGNED
        n_near = 0
        for k in range(values.shape[1]):
            if top >= below and values[t, k] >= top - TIE_TOLERANCE * top:
                lane[t] = k + 1 if n_near == 0 else UNASSIGNED
                n_near += 1


def confusion_cell(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, n_lanes: int
) -> IntArray:
    """(T,): each frame's cell in the flattened confusion matrix, row * n + column; -1 if crossing.

    - assigned (T,): 1..n or UNASSIGNED.
    - lane (T,): 1..n; ignored in crossing frames.
    - is_crossing (T,): marks crossing frames.
    """
    predicted = np.asarray(assigned)
    actual = np.asarray(lane)
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


def scores_from_confusion(matrix: ArrayLike) -> dict[str, Any]:
    """All scores of a confusion matrix (n + 1, n), or of several, (..., n + 1, n).

    C[i, k] is the number of frames in which lane i is answered (n + 1: Unassigned) and the car is
    in lane k; N is their sum:

        precision[k] = C[k, k] / sum_j C[k, j]
        recall[k] = C[k, k] / sum_i C[i, k]        (i from 1 to n + 1)
        f1[k] = 2 C[k, k] / (sum_j C[k, j] + sum_i C[i, k])
        accuracy = sum_k C[k, k] / N
        coverage = 1 - sum_k C[n + 1, k] / N

    Keys: `precision`, `recall`, `f1` (plain means over the lanes; `f1` is the macro F1: the mean of
    the lanes' F1, not the F1 of the means), `accuracy` (Unassigned counts as wrong), `coverage`
    (share of the scored frames with an answer), `per_lane` {`precision`, `recall`, `f1`: (..., n)},
    `confusion`, `frames_scored` (N). Leading dimensions of the matrix are kept.
    """
    m = np.asarray(matrix)
    right = np.diagonal(m[..., :-1, :], axis1=-2, axis2=-1)
    predicted = m[..., :-1, :].sum(axis=-1)
    actual = m.sum(axis=-2)
    total = m.sum(axis=(-2, -1))
    per_lane = {
        "precision": _ratio(right, predicted),
        "recall": _ratio(right, actual),
        "f1": _ratio(2 * right, predicted + actual),
    }
    return {
        **{name: values.mean(axis=-1) for name, values in per_lane.items()},
        "accuracy": _ratio(right.sum(axis=-1), total),
        "coverage": _ratio(predicted.sum(axis=-1), total),
        "per_lane": per_lane,
        "confusion": m,
        "frames_scored": total,
    }


def _ratio(numerator: IntArray, denominator: IntArray) -> FloatArray:
    """numerator / denominator, 0 for a denominator of 0 (the numerator is then 0 as well)."""
    ratio: FloatArray = numerator / np.where(denominator == 0, 1, denominator)
    return ratio


def frames_off(a: ArrayLike, b: ArrayLike) -> int:
    """The number of frames by which two confusion matrices (n + 1, n) differ.

    Half the sum of the absolute cell differences, rounded up, Unassigned row included: a frame
    that moves from one cell to another changes two cells, one that is missing changes one. Raises
    InputError if the shapes differ.
    """
    first = np.asarray(a)
    second = np.asarray(b)
    if first.shape != second.shape:
        raise InputError(
            f"confusion matrices of shapes {first.shape} and {second.shape} cannot be compared;"
            " is n_lanes the same?"
        )
    return int(np.abs(first - second).sum() + 1) // 2


# --- posterior -----------------------------------------------------------------------------------


def log_loss_per_frame(belief: ArrayLike, lane: ArrayLike) -> FloatArray:
    """(T,): minus the natural log of the probability given to the annotated lane.

    `log_loss = -(1 / T) sum_t ln belief[t, lane[t]]`

    belief (T, n), rows sum to 1; lane (T,). The log-loss is the mean over ALL frames, crossing ones
    included, as in the paper's tables. Probabilities are clipped below at SMALLEST_PROBABILITY.
    """
    values = np.asarray(belief)
    given = values[np.arange(len(values)), np.asarray(lane) - 1]
    return np.asarray(-np.log(np.maximum(given, SMALLEST_PROBABILITY)))
