"""Health scores: the area under the ROC curve against counting pairs, and what counts as wrong."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.scoring.health import detector_errors, doubt, roc_auc


@given(
    st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=2, max_size=40).filter(
        lambda pairs: 0 < sum(p for _, p in pairs) < len(pairs)
    )
)
def test_the_area_is_the_share_of_pairs_in_the_right_order(pairs: list[tuple[int, bool]]) -> None:
    score, positive = (np.array(column) for column in zip(*pairs, strict=True))
    wins = [
        1.0 if a > b else 0.5 if a == b else 0.0 for a in score[positive] for b in score[~positive]
    ]
    assert roc_auc(score, positive) == pytest.approx(np.mean(wins))
    assert roc_auc(-score, positive) == pytest.approx(1 - np.mean(wins))


def test_the_area_of_extremes() -> None:
    positive = np.array([False, True, False, True])
    assert roc_auc(positive, positive) == 1.0
    assert roc_auc(np.zeros(4), positive) == 0.5
    assert np.isnan(roc_auc(np.arange(4), np.zeros(4, dtype=bool)))
    assert np.isnan(roc_auc(np.arange(4), np.ones(4, dtype=bool)))
    assert np.isnan(roc_auc(np.zeros(0), np.zeros(0, dtype=bool)))


def test_committed_are_frames_with_a_lane_that_are_not_crossing() -> None:
    tentative = [[0.7, 0.3], [0.5, 0.5], [0.1, 0.9], [0.2, 0.8]]
    errors = detector_errors(tentative, [1, 1, 1, 1], [False, False, False, True])
    assert errors.assigned.tolist() == [1, 0, 2, 2]
    assert errors.is_committed.tolist() == [True, False, True, False]
    assert errors.is_scored.tolist() == [True, True, True, False]
    assert errors.is_wrong.tolist() == [False, True, True, True]


def test_doubt_is_what_the_belief_leaves_to_other_lanes() -> None:
    belief = np.array([[0.7, 0.3], [0.5, 0.5], [0.1, 0.9]])
    assert doubt(belief, [1, 0, 1]) == pytest.approx([0.3, 1.0, 0.9])
