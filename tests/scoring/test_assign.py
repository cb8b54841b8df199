"""The reject option: answers below a probability become Unassigned, in scores and runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from egolane_pgm.scoring.confusion import assigned_lane, confusion, scores_from_confusion
from egolane_pgm.scoring.probabilistic import coverage_curve
from egolane_pgm.types import InputError
from egolane_pgm.views.figures import MARKED, coverage_curves, coverage_figure
from tests.kits.drives import run
from tests.kits.tiny_result import a_result, without_truth

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
    result = a_result()
    curves = coverage_curves(result.frames)
    assert list(curves) == ["Detector", "Model"]
    (ax,) = coverage_figure(result.frames).axes
    line = next(line for line in ax.lines if line.get_label() == "Model")
    assert np.asarray(line.get_xdata()).tolist() == curves["Model"]["coverage"].tolist()
    assert np.asarray(line.get_ydata()).tolist() == curves["Model"]["accuracy"].tolist()
    labels = {t.get_text() for t in ax.texts}
    assert labels <= {f"{below:g}" for below in MARKED}
    assert "0.5" in labels
    with pytest.raises(InputError, match="no annotated frame"):
        coverage_figure(without_truth().frames)
