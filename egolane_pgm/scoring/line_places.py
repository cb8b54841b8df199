"""Scores of lines against hand labels: where they lie at one distance ahead, matched one to one."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import BoolArray, FloatArray, IntArray


def matched(
    label_m: FloatArray, line_m: FloatArray, tolerance_m: float
) -> tuple[BoolArray, BoolArray]:
    """Match lines with labels one to one, nearest first: which labels (A,), which lines (B,) are.

    - label_m (A,), line_m (B,): their places, metres to the right
    - tolerance_m: largest distance of a pair
    """
    label, line = np.zeros(len(label_m), dtype=bool), np.zeros(len(line_m), dtype=bool)
    away = np.abs(label_m[:, None] - line_m)
    for flat in np.argsort(away, axis=None, kind="stable"):
        a, b = np.unravel_index(flat, away.shape)
        if away[a, b] > tolerance_m:
            break
        if not (label[a] or line[b]):
            label[a] = line[b] = True
    return label, line


def line_counts(
    label_m: FloatArray, line_m: FloatArray, side_m: float, tolerance_m: float
) -> IntArray:
    """Count in one picture, (4,): labels found, labels, lines that are labelled, lines.

    Only what is within `side_m` to either side is counted; its partner may lie farther out.
    """
    label, line = matched(label_m, line_m, tolerance_m)
    near_label, near_line = np.abs(label_m) <= side_m, np.abs(line_m) <= side_m
    pairs = (label, near_label), (line, near_line)
    return np.array([n for hit, near in pairs for n in ((hit & near).sum(), near.sum())])


def line_recall(counts: NDArray[np.generic]) -> FloatArray:
    """The share of labels that are found, of summed counts (..., 4); NaN without labels."""
    return _share(counts, 0)


def line_precision(counts: NDArray[np.generic]) -> FloatArray:
    """The share of lines that are labelled, of summed counts (..., 4); NaN without lines."""
    return _share(counts, 2)


def line_f1(counts: NDArray[np.generic]) -> FloatArray:
    """The harmonic mean of recall and precision, (..., 4) -> (...,): 0 where nothing is found, NaN
    without labels."""
    recall, precision = line_recall(counts), np.nan_to_num(line_precision(counts))
    total = recall + precision
    return np.asarray(2 * recall * precision / np.where(total == 0, 1, total))


#: The scores by name; more is better.
LINE_SCORES: Mapping[str, Callable[[NDArray[np.generic]], FloatArray]] = {
    "line_f1": line_f1,
    "line_recall": line_recall,
    "line_precision": line_precision,
}


def _share(counts: NDArray[np.generic], first: int) -> FloatArray:
    array = np.asarray(counts, dtype=np.float64)
    of = array[..., first + 1]
    return np.asarray(array[..., first] / np.where(of == 0, np.nan, of))
