"""Log-loss, Brier score, calibration, and the reject option."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.scoring.confusion import (
    assigned_lane,
    brier,
    calibration_curve,
    confusion,
    expected_calibration_error,
    log_loss_per_frame,
    scores_from_confusion,
)
from tests.kits.drives import run

Drive = tuple[np.ndarray, np.ndarray, np.ndarray]


@st.composite
def drives(draw: st.DrawFn) -> Drive:
    """belief (T, n), lane (T,), is_crossing (T,), at least one frame not crossing."""
    n = draw(st.integers(1, 5))
    size = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    belief = rng.dirichlet(np.full(n, draw(st.sampled_from([0.05, 1.0]))), size)
    is_crossing = rng.random(size) < 0.3
    is_crossing[rng.integers(size)] = False
    return belief, rng.integers(1, n + 1, size), is_crossing


def test_a_lane_held_impossible_costs_the_log_of_the_smallest_probability() -> None:
    assert log_loss_per_frame([[0.0, 1.0]], [1]) == pytest.approx([15 * math.log(10)])
    assert log_loss_per_frame([[0.0, 1.0]], [2]) == pytest.approx([0])


def test_calibration_error_of_two_bins_is_the_one_worked_out_by_hand() -> None:
    # (13 / 15, 14 / 15]: 0.88 and 0.9 right, 0.92 wrong; (14 / 15, 1]: 0.98 right, 1.0 wrong.
    belief = np.array([[p, 1 - p] for p in (0.88, 0.9, 0.92, 0.98, 1.0)])
    lane, none = [1, 1, 2, 1, 2], np.zeros(5, dtype=bool)
    curve = calibration_curve(belief, lane, none)
    assert curve["count"].tolist() == [0] * 13 + [3, 2]
    np.testing.assert_allclose(curve["confidence"][13:], [0.9, 0.99])
    np.testing.assert_allclose(curve["accuracy"][13:], [2 / 3, 1 / 2])
    assert np.isnan(curve["accuracy"][:13]).all()
    error = expected_calibration_error(belief, lane, none)
    assert error == pytest.approx((3 * (0.9 - 2 / 3) + 2 * 0.49) / 5)


def test_a_tie_counts_as_wrong_in_the_calibration_whichever_lane_is_true() -> None:
    for lane in (1, 2):
        curve = calibration_curve([[0.5, 0.5]], [lane], [False])
        assert curve["accuracy"][curve["count"] > 0].tolist() == [0]
        assert expected_calibration_error([[0.5, 0.5]], [lane], [False]) == 0.5


def test_without_a_frame_to_score_the_scores_are_nan_and_not_perfect() -> None:
    assert math.isnan(brier([[0.5, 0.5]], [1], [True]))
    assert math.isnan(expected_calibration_error([[0.5, 0.5]], [1], [True]))
    assert calibration_curve([[0.5, 0.5]], [1], [True])["count"].tolist() == [0] * 15


@given(drives())
def test_the_scores_equal_those_of_plain_loops(drive: Drive) -> None:
    belief, lane, is_crossing = drive
    n = belief.shape[1]
    losses, squares = [], []
    bins: dict[int, list[tuple[float, bool]]] = {}
    for row, actual, crossing in zip(belief, lane, is_crossing, strict=True):
        losses.append(-math.log(max(row[actual - 1], 1e-15)))
        if crossing:
            continue
        squares.append(sum((row[k] - (k == actual - 1)) ** 2 for k in range(n)))
        k = next(k for k in range(15) if row.max() * 15 <= k + 1 or k == 14)
        tied = sum(row.max() - p <= 1e-9 * row.max() for p in row) > 1
        is_right = not tied and int(np.argmax(row)) == actual - 1
        bins.setdefault(k, []).append((row.max(), is_right))
    error = sum(
        abs(sum(p for p, _ in members) - sum(right for _, right in members))
        for members in bins.values()
    ) / len(squares)
    assert log_loss_per_frame(belief, lane) == pytest.approx(losses)
    assert brier(belief, lane, is_crossing) == pytest.approx(sum(squares) / len(squares))
    assert expected_calibration_error(belief, lane, is_crossing) == pytest.approx(error)


# --- the reject option ---------------------------------------------------------------------------


def test_a_run_rejects_the_models_answers_only(drive: Path) -> None:
    plain, careful = run(drive), run(drive, {"min_confidence": 0.9})
    assert careful.scores["detector"] == plain.scores["detector"]
    before, after = plain.scores["model"], careful.scores["model"]
    assert after["coverage"] < before["coverage"]
    for key in ("log_loss", "brier", "expected_calibration_error"):
        assert after[key] == before[key]
    rejected = assigned_lane(careful.node("Lane"), 0.9)
    assert careful.frames["assigned_lane"].tolist() == rejected.tolist()
    assert 0 < (rejected == 0).sum() < len(rejected)
    truth = careful.truth
    assert truth is not None
    matrix = confusion(rejected, truth["true_lane"], truth["is_crossing"], 3)
    assert after["accuracy"] == scores_from_confusion(matrix)["accuracy"]
