"""Log-loss, Brier score, calibration, and the reject option."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from egolane_pgm.scoring.confusion import (
    assigned_lane,
    brier,
    calibration_curve,
    confusion,
    coverage_curve,
    expected_calibration_error,
    log_loss_per_frame,
    scores_from_confusion,
)
from egolane_pgm.views.figures import coverage_figure
from tests.kits.drives import run
from tests.kits.tiny_result import MODEL, a_result

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

BELIEF = np.array([[0.6, 0.4], [0.95, 0.05], [0.5, 0.5], [0.2, 0.8], [0.9, 0.1]])
LANE = np.array([1, 1, 1, 1, 2])
NO_CROSSING = np.zeros(5, dtype=bool)


def test_the_curve_counts_answers_and_right_ones_from_the_surest_on() -> None:
    curve = coverage_curve(BELIEF, LANE, NO_CROSSING)
    assert curve["threshold"].tolist() == [0.95, 0.9, 0.8, 0.6]
    # The tie is never answered.
    assert curve["coverage"].tolist() == [0.2, 0.4, 0.6, 0.8]
    assert curve["accuracy"].tolist() == [1, 1 / 2, 1 / 3, 2 / 4]
    assert coverage_curve(BELIEF, LANE, ~NO_CROSSING)["threshold"].size == 0


@given(
    weights=hnp.arrays(
        np.int64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.integers(1, 6)
    ),
    below=st.floats(0, 1),
    seed=st.integers(0, 99),
)
def test_every_point_of_the_curve_is_what_the_reject_option_gives(
    weights: np.ndarray, below: float, seed: int
) -> None:
    belief = weights / weights.sum(axis=1, keepdims=True)
    rng = np.random.default_rng(seed)
    lane = rng.integers(1, 4, size=len(belief))
    crossing = rng.random(len(belief)) < 0.2
    matrix = confusion(assigned_lane(belief, below), lane, crossing, 3)
    curve = coverage_curve(belief, lane, crossing)
    k = np.count_nonzero(curve["threshold"] >= below) - 1
    answered = int(matrix[:-1].sum())
    assert (k >= 0) == (answered > 0)
    if answered:
        assert curve["coverage"][k] == pytest.approx(answered / (~crossing).sum())
        assert curve["accuracy"][k] == pytest.approx(np.trace(matrix[:-1]) / answered)


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


def test_the_figure_draws_the_curves_and_marks_the_thresholds() -> None:
    curve = coverage_curve(np.array(MODEL)[[0, 1, 4, 5]], [1, 1, 2, 2], [False] * 4)
    (ax,) = coverage_figure(a_result().frames).axes
    line = next(line for line in ax.lines if line.get_label() == "Model")
    assert np.asarray(line.get_xdata()).tolist() == curve["coverage"].tolist()
    assert np.asarray(line.get_ydata()).tolist() == curve["accuracy"].tolist()
    assert [t.get_text() for t in ax.texts].count("0.5") == 2
