"""The reject option: how often an answer is given, and how often it is then right, as the
probability that an answer needs (`unassigned_below`) is raised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.checks import as_belief, as_lanes, as_mask, check_range
from egolane_pgm.types import UNASSIGNED, FloatArray, IntArray


@dataclass(frozen=True)
class CoverageCurve:
    """The accuracy-coverage curve over the non-crossing frames, one point per distinct threshold.

    threshold (K,): the least probability that is answered, falling. answered (K,): frames with an
    answer. right (K,): those of them that are right. frames_scored: all non-crossing frames.
    Frames without a unique most probable lane are never answered.
    """

    threshold: FloatArray
    answered: IntArray
    right: IntArray
    frames_scored: int

    @property
    def coverage(self) -> FloatArray:
        """(K,): share of the non-crossing frames that get an answer."""
        return np.asarray(self.answered / max(self.frames_scored, 1), dtype=np.float64)

    @property
    def accuracy(self) -> FloatArray:
        """(K,): share of the answers that are right (not of all frames)."""
        return np.asarray(self.right / self.answered, dtype=np.float64)

    def at(self, unassigned_below: float) -> tuple[float, float]:
        """(coverage, accuracy of the answers) with that reject option; accuracy is NaN where
        nothing is answered."""
        k = int(np.count_nonzero(self.threshold >= unassigned_below)) - 1
        if k < 0:
            return 0.0, float("nan")
        return float(self.coverage[k]), float(self.accuracy[k])


def coverage_curve(belief: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike) -> CoverageCurve:
    """The curve of a belief (T, n), rows summing to 1, against lane (T,) and is_crossing (T,).

    Raises InputError for a belief that does not sum to 1, or lanes outside 1..n on a non-crossing
    frame.
    """
    values = as_belief(belief, normalised=True)
    n_frames, n_lanes = values.shape
    actual = as_lanes(lane, n_frames)
    is_scored = ~as_mask(is_crossing, n_frames)
    check_range(actual, is_scored, 1, n_lanes, "ground truth")
    assigned = assigned_lane(values)
    is_answered = is_scored & (assigned != UNASSIGNED)
    largest = values[is_answered].max(axis=1) if is_answered.any() else np.zeros(0)
    is_right = (assigned == actual)[is_answered]
    order = np.argsort(-largest, kind="stable")
    largest, right = largest[order], np.cumsum(is_right[order])
    # The last of equal probabilities: they are answered together or not at all.
    last = np.flatnonzero(np.append(largest[1:] != largest[:-1], largest.size > 0))
    return CoverageCurve(
        threshold=largest[last],
        answered=(last + 1).astype(np.int64),
        right=right[last].astype(np.int64),
        frames_scored=int(is_scored.sum()),
    )
