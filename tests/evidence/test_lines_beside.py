"""The number of lanes, from the lines that are seen beside the car."""

from __future__ import annotations

import numpy as np
import pytest

from egolane_pgm.evidence.lines_beside import fit_of_counts, off_by
from egolane_pgm.types import LineLog

WIDTH = 3.75


def seen_from(lane: int, n_lanes: int, flagged: bool = True) -> LineLog:
    """All lines of a road, from the middle of a lane, with continuous ones at its edges."""
    line = np.arange(n_lanes + 1)
    offset_m = (line - lane + 0.5) * WIDTH
    edge = (line == 0) | (line == n_lanes)
    yes = np.ones(n_lanes + 1, dtype=bool)
    frame = np.zeros(n_lanes + 1, dtype=int)
    lri = np.full(n_lanes + 1, 10.0)
    return LineLog.from_rows(np.arange(1), 10.0, frame, offset_m, yes, edge & flagged, lri)


@pytest.mark.parametrize("flagged", [True, False])
@pytest.mark.parametrize(
    ("lane", "n_lanes"), [(1, 1), (1, 2), (2, 2), (1, 3), (2, 3), (3, 3), (2, 4), (3, 5)]
)
def test_a_road_whose_lines_are_all_seen_fits_best(lane: int, n_lanes: int, flagged: bool) -> None:
    fit = fit_of_counts(seen_from(lane, n_lanes, flagged), 6, WIDTH)
    assert fit.shape == (1, 6)
    assert fit[0].argmax() + 1 == n_lanes
    assert fit.max() == 1.0


def test_from_the_leftmost_lane_of_a_wide_road_its_right_edge_is_not_told() -> None:
    fit = fit_of_counts(seen_from(1, 6), 6, WIDTH)[0]
    np.testing.assert_allclose(fit[3:], 1.0)
    assert (fit[:3] < 1.0).all()


def test_frames_without_lines_and_a_road_of_one_lane_are_taken() -> None:
    none = LineLog.from_rows(
        np.arange(2), 10.0, *(np.zeros(0, dtype=kind) for kind in (int, float, bool, bool, float))
    )
    assert np.isfinite(fit_of_counts(none, 4, WIDTH)).all()
    assert (fit_of_counts(seen_from(1, 1), 1, WIDTH) == 1).all()


def test_a_guess_is_left_once_the_lines_have_told_and_taken_anew_where_another_begins() -> None:
    fit = np.ones((40, 3))
    fit[5:15, 2] = 1.5  # a lane more, ten frames long: 1.5^n > 6 in the fifth of them
    fit[25:, 0] = 2.0
    goes_on = np.ones(40, dtype=bool)
    goes_on[[0, 20]] = False
    off = off_by(fit, goes_on, 0.25, 1.0)
    np.testing.assert_array_equal(off, [0] * 9 + [1] * 11 + [0] * 7 + [-1] * 13)
    fit[:, 0] = 0.0  # a road without lanes
    assert off_by(fit, goes_on, 1.0, 1.0).min() == 0
    assert not off_by(fit, goes_on, 0.0, 1.0).any()
