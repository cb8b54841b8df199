"""The table of scores: each against its definition, by hand, and in parts; the reject option."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.scoring.confusion import (
    assigned_lane,
    confusion,
    scores_from_confusion,
)
from egolane_pgm.scoring.scores import SCORES, Answers, Score, calibration_curve
from tests.kits.drives import run

TABLE = pytest.mark.parametrize("score", SCORES.values(), ids=SCORES)

#: Hz.
RATE = 12.5


def answers_of(belief: Any, lane: Any, is_crossing: Any = None, **more: Any) -> Answers:
    """The answers of sure lanes."""
    values = np.asarray(belief, dtype=float)
    crossing = np.zeros(len(values), dtype=bool) if is_crossing is None else np.array(is_crossing)
    given = {"assigned": assigned_lane(values), "frame_rate": RATE, **more}
    return Answers(values, np.array(lane), crossing, **given)


@st.composite
def drives(draw: st.DrawFn) -> Answers:
    """Short random drives, empty ones included, some frames of which are not used."""
    n = draw(st.integers(1, 4))
    size = draw(st.integers(0, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    belief = rng.dirichlet(np.full(n, draw(st.sampled_from([0.05, 1.0]))), size)
    # Ties, and one lane for some frames in a row.
    belief[rng.random(size) < 0.1] = 1 / n
    return answers_of(
        belief,
        np.repeat(rng.integers(1, n + 1, size), 4)[:size],
        rng.random(size) < draw(st.sampled_from([0.0, 0.3, 1.0])),
        assigned=assigned_lane(belief, draw(st.sampled_from([0.0, 0.6]))),
        is_used=rng.random(size) < draw(st.sampled_from([0.0, 0.7, 1.0])),
        log_evidence=rng.normal(size=size),
    )


# --- definitions ---------------------------------------------------------------------------------


def of_lanes(score: str) -> Callable[[Answers], float]:
    """The mean over the lanes of precision, recall or F1."""

    def direct(a: Answers) -> float:
        pairs = [(a.assigned[t], a.lane[t]) for t in scored(a)]
        values = []
        for lane in range(1, a.belief.shape[1] + 1):
            right = sum(x == y == lane for x, y in pairs)
            predicted = sum(x == lane for x, _ in pairs)
            actual = sum(y == lane for _, y in pairs)
            sizes = {"precision": predicted, "recall": actual, "f1": (predicted + actual) / 2}
            values.append(right / sizes[score] if sizes[score] else 0.0)
        return float(np.mean(values))

    return direct


def scored(a: Answers) -> list[int]:
    """The frames that are used and not crossing."""
    return [t for t in range(len(a.lane)) if a.is_used[t] and not a.is_crossing[t]]


def used(a: Answers) -> list[int]:
    return [t for t in range(len(a.lane)) if a.is_used[t]]


def mean(values: list[Any]) -> float:
    return sum(values) / len(values) if values else math.nan


def calibration_error(a: Answers) -> float:
    bins: dict[int, list[float]] = {}
    for t in scored(a):
        row = a.belief[t]
        k = next(k for k in range(15) if row.max() * 15 <= k + 1 or k == 14)
        is_tied = sum(row.max() - p <= 1e-9 * row.max() for p in row) > 1
        is_right = not is_tied and int(np.argmax(row)) == a.lane[t] - 1
        bins.setdefault(k, []).append(row.max() - is_right)
    gaps = sum(abs(sum(each)) for each in bins.values())
    return gaps / len(scored(a)) if bins else math.nan


def false_switches(a: Answers) -> float:
    pairs = [(t - 1, t) for t in scored(a) if t - 1 in scored(a) and a.lane[t] == a.lane[t - 1]]
    false = sum(a.assigned[s] != a.assigned[t] for s, t in pairs)
    return false / (len(pairs) / RATE / 60) if pairs else math.nan


def squared_error(a: Answers, t: int) -> float:
    return sum((p - (k == a.lane[t])) ** 2 for k, p in enumerate(a.belief[t], 1))


#: The definition of each score, in plain loops.
DIRECT: dict[str, Callable[[Answers], float]] = {
    "accuracy": lambda a: mean([a.assigned[t] == a.lane[t] for t in scored(a)] or [0.0]),
    "coverage": lambda a: mean([a.assigned[t] > 0 for t in scored(a)] or [0.0]),
    **{name: of_lanes(name) for name in ("precision", "recall", "f1")},
    "log_loss": lambda a: mean(
        [-math.log(max(a.belief[t, a.lane[t] - 1], 1e-15)) for t in used(a)]
    ),
    "log_evidence": lambda a: mean([a.log_evidence[t] for t in used(a)]),
    "brier": lambda a: mean([squared_error(a, t) for t in scored(a)]),
    "expected_calibration_error": calibration_error,
    "false_switches_per_minute": false_switches,
}


@TABLE
@given(drives())
def test_the_statistic_of_the_summed_summands_is_the_definition(
    score: Score, answers: Answers
) -> None:
    expected = DIRECT[score.name](answers)
    summands = score.summands(answers)
    assert score.statistic(summands.sum(axis=0)) == pytest.approx(expected, nan_ok=True)
    assert score.of(answers) == pytest.approx(expected, nan_ok=True)
    # Several sums at once, as of resamples.
    twice = np.stack([summands.sum(axis=0)] * 2)
    np.testing.assert_array_equal(score.statistic(twice), [score.of(answers)] * 2)


@TABLE
@given(drives(), st.integers(0, 2**32 - 1))
def test_frames_that_are_not_used_neither_count_nor_matter(
    score: Score, answers: Answers, seed: int
) -> None:
    is_used = np.asarray(answers.is_used)
    summands = score.summands(answers)
    assert not summands[~is_used].any()
    rng = np.random.default_rng(seed)
    n_lanes = answers.belief.shape[1]
    lane = np.where(is_used, answers.lane, rng.integers(1, n_lanes + 1, len(is_used)))
    np.testing.assert_array_equal(score.summands(replace(answers, lane=lane)), summands)


@TABLE
def test_a_better_drive_scores_better_in_the_direction_of_the_score(score: Score) -> None:
    lane = np.repeat([1, 2, 3], 10)
    good = np.eye(3)[lane - 1] * 0.94 + 0.02
    bad = good.copy()
    # Wrong lanes that switch, and a tie.
    bad[1::3] = np.roll(good[1::3], 1, axis=1)
    bad[0] = [0.4, 0.4, 0.2]
    better, worse = (
        score.of(answers_of(belief, lane, log_evidence=belief.max(axis=1)))
        for belief in (good, bad)
    )
    assert (better > worse) is score.is_maximised
    assert (better < worse) is not score.is_maximised


@TABLE
def test_a_drive_of_fewer_lanes_can_be_added_to_one_of_more(score: Score) -> None:
    """On a road of more lanes, of which the first are driven."""
    belief = np.random.default_rng(3).dirichlet(np.ones(2), 50)
    lane = np.arange(50) // 25 + 1
    narrow = answers_of(belief, lane, log_evidence=np.arange(50.0), n_lanes=4)
    wide = replace(narrow, belief=np.hstack([belief, np.zeros((50, 2))]), n_lanes=0)
    assert score.of(narrow) == pytest.approx(score.of(wide))
    np.testing.assert_allclose(score.summands(narrow), score.summands(wide))


# --- by hand -------------------------------------------------------------------------------------


def test_calibration_error_of_two_bins_is_the_one_worked_out_by_hand() -> None:
    # (13 / 15, 14 / 15]: 0.88 and 0.9 right, 0.92 wrong; (14 / 15, 1]: 0.98 right, 1.0 wrong.
    answers = answers_of([[p, 1 - p] for p in (0.88, 0.9, 0.92, 0.98, 1.0)], [1, 1, 2, 1, 2])
    curve = calibration_curve(answers)
    assert curve["count"].tolist() == [0] * 13 + [3, 2]
    np.testing.assert_allclose(curve["confidence"][13:], [0.9, 0.99])
    np.testing.assert_allclose(curve["accuracy"][13:], [2 / 3, 1 / 2])
    assert np.isnan(curve["accuracy"][:13]).all()
    error = SCORES["expected_calibration_error"].of(answers)
    assert error == pytest.approx((3 * (0.9 - 2 / 3) + 2 * 0.49) / 5)


@pytest.mark.parametrize("lane", [1, 2])
def test_a_tie_counts_as_wrong_in_the_calibration_whichever_lane_is_true(lane: int) -> None:
    curve = calibration_curve(answers_of([[0.5, 0.5]], [lane]))
    assert curve["accuracy"][curve["count"] > 0].tolist() == [0]


def test_without_a_frame_to_score_the_scores_are_nan_and_not_perfect() -> None:
    answers = answers_of([[0.5, 0.5]], [1], [True])
    for name in ("brier", "expected_calibration_error", "false_switches_per_minute"):
        assert math.isnan(SCORES[name].of(answers))
    assert calibration_curve(answers)["count"].tolist() == [0] * 15


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
