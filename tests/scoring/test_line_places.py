"""Lines against hand labels."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.scoring.line_places import (
    line_counts,
    line_f1,
    line_precision,
    line_recall,
    matched,
)

PLACES = st.lists(st.floats(-8, 8), max_size=4).map(np.array)


def greedy(label_m, line_m, tolerance_m):
    """Pairs in the order of their distance, by plain loops."""
    pairs = sorted(
        (abs(a - b), i, j)
        for (i, a), (j, b) in itertools.product(enumerate(label_m), enumerate(line_m))
    )
    label, line = set(), set()
    for away, i, j in pairs:
        if away <= tolerance_m and i not in label and j not in line:
            label.add(i)
            line.add(j)
    return label, line


@given(label_m=PLACES, line_m=PLACES, tolerance_m=st.floats(0.05, 2))
def test_pairs_are_made_nearest_first(label_m, line_m, tolerance_m):
    label, line = matched(label_m, line_m, tolerance_m)
    expected = greedy(label_m, line_m, tolerance_m)
    assert (set(np.flatnonzero(label)), set(np.flatnonzero(line))) == expected
    assert label.sum() == line.sum()


@given(label_m=PLACES, line_m=PLACES)
def test_a_mirrored_road_has_the_same_scores(label_m, line_m):
    mine, mirrored = (line_counts(s * label_m, s * line_m, 6.0, 0.35) for s in (1, -1))
    assert mine.tolist() == mirrored.tolist()


def test_only_what_is_near_counts_but_its_partner_may_lie_farther_out():
    counts = line_counts(np.array([-1.8, 5.9]), np.array([-1.7, 2.0, 6.1]), 6.0, 0.35)
    assert counts.tolist() == [2, 2, 1, 2]
    assert line_recall(counts) == 1.0
    assert line_precision(counts) == 0.5
    assert np.isclose(line_f1(counts), 2 / 3)


def test_nothing_found_is_an_f1_of_nought():
    assert line_f1(np.array([0, 3, 0, 0])) == 0.0
    assert np.isnan(line_recall(np.zeros(4)))
