"""Assigned lanes, confusion matrices and the scores of the paper's tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.scoring.confusion import (
    assigned_lane,
    confusion,
    frames_off,
    scores_from_confusion,
)
from egolane_pgm.types import TIE_TOLERANCE

PUBLISHED = Path(__file__).parents[2] / "experiments" / "paper" / "published.yaml"


@pytest.mark.parametrize(
    ("belief", "lanes"),
    [
        ([[0.7, 0.2, 0.1], [0.1, 0.2, 0.7], [0.2, 0.5, 0.3]], [1, 3, 2]),
        # A maximum that is not unique.
        ([[0.4, 0.4, 0.2], [0.2, 0.4, 0.4], [1 / 3, 1 / 3, 1 / 3], [0.0, 0.0, 0.0]], [0, 0, 0, 0]),
        ([[1.0], [0.0]], [1, 1]),
        (np.zeros((0, 3)), []),
    ],
)
def test_the_most_probable_lane_is_assigned(belief: Any, lanes: list[int]) -> None:
    assert assigned_lane(belief).tolist() == lanes


def test_frames_off_is_half_the_cell_differences_rounded_up() -> None:
    a = [[5, 1], [0, 4], [0, 0]]
    one_moved = [[4, 1], [0, 4], [1, 0]]
    one_missing = [[4, 1], [0, 4], [0, 0]]
    one_moved_one_missing = [[4, 1], [0, 3], [1, 0]]
    assert frames_off(a, a) == 0
    assert frames_off(a, one_moved) == 1
    assert frames_off(a, one_missing) == 1
    assert frames_off(a, one_moved_one_missing) == 2
    assert frames_off(one_missing, a) == 1


def _is_printed_as(value: float, printed: float) -> bool:
    """The paper truncates its scores to two digits."""
    return math.floor(value * 100 + 1e-9) == round(printed * 100)


def test_the_published_matrices_give_the_published_scores() -> None:
    runs = yaml.safe_load(PUBLISHED.read_text(encoding="utf-8"))["runs"]
    compared = 0
    for run in runs:
        for kind in ("detector_only", "model"):
            scores = scores_from_confusion(run[kind]["confusion"])
            assert len(scores["per_lane"]["f1"]) == run["n_lanes"]
            for name in ("precision", "recall", "f1", "accuracy"):
                value, printed = scores[name], run[kind]["metrics"][name]
                assert _is_printed_as(value, printed), (run["run"], kind, name, value, printed)
                compared += 1
    assert compared == 80


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.sampled_from([0.0, 0.3, 0.5]))
def test_frames_are_assigned_and_counted_as_one_by_one(
    seed: int, n_lanes: int, below: float
) -> None:
    rng = np.random.default_rng(seed)
    # Few distinct values, so that ties, within and just outside the tolerance, are frequent.
    near = np.array([0.0, 0.25, 0.5, 0.5 * (1 - 1e-10), 0.5 * (1 - 1e-8)])
    belief = rng.choice(near, (50, n_lanes))
    lane, is_crossing = rng.integers(1, n_lanes + 1, 50), rng.uniform(size=50) < 0.2
    counts = np.zeros((n_lanes + 1, n_lanes), dtype=np.int64)
    for row, actual, crossing in zip(belief, lane, is_crossing, strict=True):
        top = max(row)
        close = [k for k in range(n_lanes) if row[k] >= top - TIE_TOLERANCE * top]
        row_of = close[0] if len(close) == 1 and top >= below else n_lanes
        if not crossing:
            counts[row_of, actual - 1] += 1
    found = confusion(assigned_lane(belief, below), lane, is_crossing, n_lanes)
    np.testing.assert_array_equal(found, counts)
