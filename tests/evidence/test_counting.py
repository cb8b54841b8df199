"""The paper's evidence rule, against the NumPy reference and by hand; the one of levels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence import counting
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import LineLog
from tests.reference import counting as reference

W = 3.5

# (offset_m, is_valid, is_continuous, lri)
Line = tuple[float, bool, bool, float]


def resolved(n_lanes: int, **given: object) -> Parameters:
    return resolve_parameters(counting.PARAMETERS, given, n_lanes)


def line_log(frames: list[list[Line]]) -> LineLog:
    width = max([len(lines) for lines in frames], default=0)
    padded = [
        lines + [(math.nan, False, False, math.nan)] * (width - len(lines)) for lines in frames
    ]
    fields = np.array(padded, dtype=float).reshape(len(frames), width, 4)
    ids = np.arange(len(frames))
    return LineLog(
        ids,
        ids / 10,
        fields[:, :, 0],
        fields[:, :, 1] == 1,
        fields[:, :, 2] == 1,
        fields[:, :, 3],
    )


def seen(frames: list[list[Line]], n_lanes: int, **given: object) -> tuple[np.ndarray, np.ndarray]:
    evidence = counting.evidence(line_log(frames), n_lanes, resolved(n_lanes, **given))
    assert set(evidence.likelihoods) == set(counting.PROVIDES)
    return evidence.likelihoods["DetectorOutput"], evidence.likelihoods["WOR"]


offsets = st.one_of(
    st.floats(-30, 30),
    st.integers(-8, 8).map(lambda k: k * W),
    st.integers(-8, 8).map(lambda k: math.nextafter(k * W, 100.0)),
    st.sampled_from([0.0, -0.0, 1e30, -1e30, 3e38, 1e-300]),
)
lris = st.one_of(
    st.integers(0, 10).map(float), st.just(math.nan), st.sampled_from([-1.0, 1e9, -2147483648.0])
)
lines = st.tuples(offsets, st.booleans(), st.booleans(), lris)
frames = st.lists(st.lists(lines, max_size=6), min_size=1, max_size=8)


@settings(max_examples=200, deadline=None)
@given(
    frames=frames,
    n_lanes=st.integers(1, 6),
    bonus_value=st.sampled_from([0, 1, 2, 9, 0.5]),
    max_lri=st.sampled_from([10, 7]),
    lane_width_m=st.sampled_from([3.5, 3.75, 2.02, 1.0]),
    tentative_noise=st.sampled_from([0.001, 0.1]),
)
def test_any_lines_are_counted_as_in_plain_numpy(
    frames: list[list[Line]], n_lanes: int, **given: object
) -> None:
    tentative, wor = seen(frames, n_lanes, **given)
    right = reference.evidence(line_log(frames), n_lanes, resolved(n_lanes, **given)).likelihoods
    np.testing.assert_allclose(tentative, right["DetectorOutput"], rtol=1e-12)
    np.testing.assert_allclose(wor, right["WOR"], rtol=1e-9, atol=1e-12)
    assert tentative.shape == (len(frames), n_lanes)
    assert (tentative > 0).all()
    assert (wor >= 0).all()
    np.testing.assert_allclose(tentative.sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(wor.sum(axis=1), 1, rtol=1e-12)


def noisy(counts: list[float]) -> list[float]:
    total = sum(counts) + 0.001 * len(counts)
    return [(c + 0.001) / total for c in counts]


# Worked by hand, n = 3 and W = 3.5 m: (line, counts)
BY_HAND = [
    # The arrow of the paper's example: a dashed line between one and two lanes to the left.
    ((-5.0, True, False, 10), [0, 1, 1]),
    ((-5.0, True, True, 10), [0, 2, 1]),
    ((-9.15, True, True, 10), [0, 0, 2]),
    ((-2.15, True, True, 7), [1, 0, 0]),
    ((0.0, True, True, 7), [0, 0, 1]),
    ((3.5, True, True, 7), [0, 0, 1]),
    ((-3.5, True, True, 7), [1, 0, 0]),
    ((7.0, True, False, 7), [1, 0, 0]),
    ((-7.0, True, True, 7), [0, 0, 2]),
    ((10.5, True, True, 7), [1, 1, 1]),
    ((1e30, True, True, 7), [1, 1, 1]),
    ((-5.0, False, True, 10), [1, 1, 1]),
]


@pytest.mark.parametrize(("line", "counts"), BY_HAND)
def test_single_lines_worked_by_hand(line: Line, counts: list[float]) -> None:
    tentative, _ = seen([[line]], 3)
    np.testing.assert_allclose(tentative[0], noisy(counts), rtol=1e-12)


def test_the_paper_s_example_of_one_line_limits_the_lane_to_2_or_3() -> None:
    """Figure `fig:teaser`: one line, Lane 1, 2, 3 have {0, 0.5, 0.5}; tentative [0;1;1]."""
    tentative, _ = seen([[(-5.0, True, False, 10.0)]], 3, tentative_noise=0)
    np.testing.assert_allclose(tentative[0], [0, 0.5, 0.5])


def test_the_paper_s_box_of_four_lines() -> None:
    """Box `box:box1`, lines 1 and 3 valid: line 1 votes for lane 3 and has the bonus there, line
    3 is dashed and beside the vehicle; LRI 10 and 7 of 4 x 10."""
    box = [
        (-9.15, True, True, 10.0),
        (-6.47, False, False, 9.0),
        (-2.15, True, False, 7.0),
        (0.99, False, True, 0.0),
    ]
    tentative, wor = seen([box], 3)
    np.testing.assert_allclose(tentative[0], noisy([0, 0, 2]), rtol=1e-12)
    np.testing.assert_allclose(wor[0], [17 / 40 - 0.01, 1 - 17 / 40 + 0.01], rtol=1e-12)


def test_votes_of_several_lines_add_up_and_the_bonus_is_weighed() -> None:
    lines = [(-5.0, True, False, 5.0), (5.0, True, True, 5.0), (-1.0, True, True, 5.0)]
    # Left line: lanes 2, 3. Right line: lanes 2, 1 and the bonus for lane 2. Near left: lane 1.
    tentative, _ = seen([lines], 3, bonus_value=4)
    np.testing.assert_allclose(tentative[0], noisy([1 + 4, 2 + 4, 1]), rtol=1e-12)


@pytest.mark.parametrize(
    ("lris", "s"),
    [
        ([], 0.01),
        ([0.0], 0.01),
        ([1.0], 1 / 40 - 0.01),
        ([10.0] * 4, 0.99),
        ([10.0] * 5, 0.99),
        ([-1.0], 0.01),
        ([1e9], 0.99),
        ([math.nan, math.nan], 0.5 - 0.01),
    ],
)
def test_wor_is_the_share_of_the_expected_reliability(lris: list[float], s: float) -> None:
    _, wor = seen([[(1.0, True, False, lri) for lri in lris]], 3)
    np.testing.assert_allclose(wor[0], [s, 1 - s], rtol=1e-12)
