"""The steps from contours to lines, each on numbers made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.detectors.simple import fit as _fit
from egolane_pgm.detectors.simple.birdseye import BirdsEye
from egolane_pgm.detectors.simple.contours import Strips
from egolane_pgm.detectors.simple.parameters import FINDING
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import FloatArray
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA

DEFAULTS = resolve_parameters(FINDING, {}, 1)
VIEW = _fit.view_for(CAMERA, DEFAULTS)
SIDE, BIN = 9.0, 0.05
CENTRE = -SIDE + (np.arange(360) + 0.5) * BIN


def given_(**more: object) -> Parameters:
    return resolve_parameters(FINDING, more, 1)


def strips_along(
    common: _fit._Common, offsets: list[float], rows: list[slice], view: BirdsEye = VIEW
) -> Strips:
    """Contours 0.15 m wide that lie on the lines at these offsets, in some rows each."""
    row = np.concatenate([np.arange(len(view.x_m))[r] for r in rows])
    contour = np.repeat(np.arange(len(rows)), [len(view.x_m[r]) for r in rows])
    x = view.x_m[row]
    shape = common.shape(np.array(offsets))[contour]
    y = shape[:, 0] + x * (shape[:, 1] + x * shape[:, 2] / 2)
    middle = np.array([view.x_m[r].mean() for r in rows])
    slope = common.shape(np.array(offsets))[:, 1] + common.curvature * middle
    return Strips(
        row, x, y, np.full(len(x), 0.15), contour, middle, slope, np.full(len(rows), 0.02)
    )


@given(st.floats(-0.1, 0.1), st.floats(-0.003, 0.003), st.floats(-0.008, 0.008), st.floats(-8, 8))
def test_every_point_of_a_line_has_the_lines_offset(
    heading: float, curvature: float, squeeze: float, offset: float
) -> None:
    common = _fit._Common(heading, curvature, squeeze)
    x = np.linspace(4, 35, 9)
    (line,) = common.shape(np.array([offset]))
    y = line @ np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6])
    np.testing.assert_allclose(common.offset(x, y), offset, atol=1e-9)
    # Pitching makes distances to the side grow with the distance ahead.
    np.testing.assert_allclose(
        y, offset * (1 + squeeze * x) + heading * x + curvature * x**2 / 2, atol=1e-9
    )


def test_the_red_of_a_picture_is_looked_at_and_a_grey_one_as_it_is() -> None:
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    image[:] = 10, 90, 200
    assert (_fit.from_above(VIEW, image)[VIEW.valid] == 200).all()
    assert (_fit.from_above(VIEW, image[..., 1])[VIEW.valid] == 90).all()


# --- what the frames before say -------------------------------------------------------------------


def expected(*lines: tuple[float, float, float], **more: object) -> tuple[FloatArray, FloatArray]:
    shape = np.array([[*line, 0.0] for line in lines]).reshape(-1, 4)
    return _fit._prior(given_(**more), shape)


def test_without_lines_from_before_a_road_is_straight_ahead_give_or_take_the_usual() -> None:
    usual = {"heading_sd": 0.03, "curvature_sd": 0.001, "squeeze_sd": 0.004}
    for centre, sd in (_fit._prior(given_(**usual), None), expected(**usual)):
        assert centre.tolist() == [0, 0, 0]
        assert sd.tolist() == [0.03, 0.001, 0.004]


def test_lines_from_before_say_heading_curvature_and_squeeze_more_surely() -> None:
    lines = [(o, 0.02 + 0.003 * o, 0.0007) for o in (-5.4, -1.8, 1.9)]
    centre, sd = expected(*lines, prior_share=0.25)
    np.testing.assert_allclose(centre, [0.02, 0.0007, 0.003])
    np.testing.assert_allclose(sd, 0.25 * expected()[1])


def test_lines_near_to_each_other_say_nothing_of_the_squeeze() -> None:
    centre, _ = expected((1.8, 0.02, 0.001))
    np.testing.assert_allclose(centre, [0.02, 0.001, 0.0])
    # 20 cm apart: a squeeze of 0.05 would be noise.
    centre, _ = expected((1.8, 0.02, 0.001), (2.0, 0.03, 0.001))
    np.testing.assert_allclose(centre, [0.025, 0.001, 0.0])


# --- scores ---------------------------------------------------------------------------------------


def scored(**at: float) -> FloatArray:
    """Scores at bins of offsets, e.g. o36=0.4 at 3.6 m."""
    own = np.zeros(len(CENTRE))
    for name, value in at.items():
        own[np.argmin(np.abs(CENTRE - float(name[1:]) / 10))] = value
    return own


def test_a_neighbour_one_lane_away_lends_its_score_up_to_a_half() -> None:
    parameters = given_(lane_width_m=3.6, lane_width_sd=0.2)
    own = scored(o0=0.3)
    support = _fit._support(own, parameters)
    at = int(np.argmax(own))
    lane = round(3.6 / BIN)
    for side in (-1, 1):
        assert support[at + side * lane] == pytest.approx(0.3)
        # 0.3 m from the usual width: 1.5 standard deviations.
        for unusual in (lane - 6, lane + 6):
            assert support[at + side * unusual] == pytest.approx(0.3 * np.exp(-0.5 * 1.5**2))
        assert support[at + side * (lane + 20)] == 0
    assert support[at] == 0
    assert _fit._support(scored(o0=0.9), parameters).max() == pytest.approx(0.5)


def test_the_best_places_are_taken_first_and_keep_their_distance() -> None:
    score = scored(o0=0.9, o20=0.8, o36=0.4, o80=0.11)
    found = CENTRE[_fit._peaks(CENTRE, score, given_(apart_m=2.2, least_score=0.12))]
    assert found == pytest.approx([0.0, 3.6], abs=BIN)
    near = _fit._peaks(CENTRE, score, given_(apart_m=1.9, least_score=0.1))
    assert CENTRE[near] == pytest.approx([0.0, 2.0, 8.0], abs=BIN)
    one = _fit._peaks(CENTRE, score, given_(lines=1))
    assert CENTRE[one] == pytest.approx([0.0], abs=BIN)
    assert len(_fit._peaks(CENTRE, 0 * score, given_(least_score=0.0))) == 0


def scores_of(view: BirdsEye, strips: Strips, **more: object) -> tuple[FloatArray, FloatArray]:
    ahead, parameters = _fit._Common(0.0, 0.0, 0.0), given_(neighbour_bonus=0.0, **more)
    along = _fit._along(strips, ahead, parameters)
    return _fit._scores(view, strips, *along, ahead, parameters)


def test_the_score_is_the_share_of_the_visible_stripe_that_is_covered() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [1.01], [slice(100, 150)])
    centre, score = scores_of(VIEW, strips, stripe_m=0.1, reach_m=0.125)
    visible = _fit._visible(VIEW, ahead.shape(np.array([1.0])))[0]
    assert score.max() == pytest.approx(50 * 0.1 * 0.15 / (visible * 0.1))
    # What is within reach of the contour, to either side alike.
    assert centre[score > 0] == pytest.approx(1.025 + np.arange(-2, 3) * BIN)


def test_of_a_line_that_is_hardly_in_view_a_dot_is_not_enough() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    is_near = (VIEW.x_m < 5.5)[:, None] & VIEW.valid
    last = len(VIEW.x_m)
    strips = strips_along(ahead, [1.01], [slice(last - 10, last)])
    score = scores_of(replace(VIEW, valid=is_near), strips, stripe_m=0.15)[1]
    assert score.max() == pytest.approx(10 * 0.1 / 5.0)


# --- lines ----------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("squeeze", [-0.004, 0.0, 0.004])
def test_contours_on_lines_give_these_lines(squeeze: float) -> None:
    common = _fit._Common(0.02, 0.0008, squeeze)
    offsets = [-1.8, 1.86]
    found = _fit.fit_lines(VIEW, strips_along(common, offsets, [slice(100, 300)] * 2), DEFAULTS)
    np.testing.assert_allclose(found.shape[:, 0], offsets, atol=0.03)
    np.testing.assert_allclose(found.shape[:, 1], common.shape(np.array(offsets))[:, 1], atol=4e-3)
    np.testing.assert_allclose(found.shape[:, 2], 0.0008, atol=4e-4)


@needs_compiler
def test_straight_lines_have_no_curvature_whatever_is_expected() -> None:
    parameters = given_(curve="line", straight_to_m=35.0)
    bend = _fit._Common(0.0, 0.0015, 0.0)
    strips = strips_along(bend, [-1.8, 1.86], [slice(0, 300)] * 2)
    before = np.array([[-1.8, 0.0, 0.0015, 0.0], [1.86, 0.0, 0.0015, 0.0]])
    common = _fit._find_common(VIEW, strips, parameters, _fit._prior(parameters, before))
    assert common.curvature == 0
    found = _fit.fit_lines(VIEW, strips, parameters, before)
    assert len(found.score) > 0
    assert (found.shape[:, 2:] == 0).all()


def test_a_contour_agrees_as_far_as_it_goes_the_way_of_its_line() -> None:
    common = _fit._Common(0.02, 0.0015, 0.006)
    strips = strips_along(common, [-5.4, 5.4], [slice(100), slice(150, 250)])
    offset, agreement = _fit._along(strips, common, DEFAULTS)
    np.testing.assert_allclose(offset, np.repeat([-5.4, 5.4], 100))
    np.testing.assert_allclose(agreement, 1.0, atol=1e-9)
    tolerance = np.hypot(0.05, 0.02)
    for share, left in ((0.5, 0.75), (0.9, 0.19), (1.1, 0.0)):
        turned = replace(strips, slope=strips.slope + share * tolerance)
        agreement = _fit._along(turned, common, given_(slope_sd=0.05))[1]
        np.testing.assert_allclose(agreement, left, atol=1e-9)


def test_contours_weigh_as_much_as_they_agree() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [0.0, 0.1], [slice(100, 150), slice(200, 250)])
    strips = replace(strips, slope=np.array([0.0, 0.5 * np.hypot(0.05, 0.02)]))
    surely = np.zeros(3), np.full(3, 1e-7)
    parameters = given_(slope_sd=0.05, reach_m=0.125)
    common, found = _fit._refine(strips, ahead, np.array([0.0, 3.6]), parameters, surely)
    assert found == pytest.approx([0.1 * 0.75 / 1.75, 3.6], abs=1e-4)
    assert abs(common.heading) < 1e-6


def test_pieces_are_cut_along_the_road_from_one_contour_each() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [-1.8, 1.8], [slice(80, 104), slice(84, 100)])
    x, y, area, contour = _fit._pieces(VIEW, strips)
    # Of eight rows, 0.8 m.
    assert contour.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(area, np.array([8, 8, 8, 4, 8, 4]) * 0.1 * 0.15)
    np.testing.assert_allclose(y, [-1.8] * 3 + [1.8] * 3)
    assert x[1] == pytest.approx(VIEW.x_m[88:96].mean())
    assert x[3] == pytest.approx(VIEW.x_m[84:88].mean())


def test_contours_that_cross_a_line_do_not_cover_it() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [0.0, 0.05, 3.0], [slice(100, 150), slice(200, 230), slice(300)])
    offset = np.array([0.0, 1.5])
    covered = _fit._coverage(VIEW, strips, offset, ahead, DEFAULTS)
    assert covered == pytest.approx([80 * 0.1, 0.0])
    across = replace(strips, slope=np.array([0.0, 0.3, 0.0]))
    covered = _fit._coverage(VIEW, across, offset, ahead, DEFAULTS)
    assert covered == pytest.approx([50 * 0.1, 0.0])
    # Two contours in one row cover it once.
    twice = strips_along(ahead, [0.0, 0.05], [slice(100, 150), slice(120, 160)])
    assert _fit._coverage(VIEW, twice, offset[:1], ahead, DEFAULTS) == pytest.approx([60 * 0.1])


@needs_compiler
def test_no_line_is_covered_more_than_whole() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [-1.8, 1.86], [slice(100, 300)] * 2)
    # The rows that are looked at are the ones that show nothing.
    is_looked_at = (np.arange(len(VIEW.x_m)) % 4 == 0)[:, None]
    found = _fit.fit_lines(replace(VIEW, valid=VIEW.valid & ~is_looked_at), strips, DEFAULTS)
    assert found.coverage.tolist() == [1.0, 1.0]


def test_what_the_camera_is_to_ignore_is_not_visible() -> None:
    shape = np.array([[0.0, 0, 0, 0], [30.0, 0, 0, 0]])
    assert _fit._visible(VIEW, shape) == pytest.approx([30.0, 0.0], abs=1.0)
    half = VIEW.valid & (VIEW.x_m > 20)[:, None]
    assert _fit._visible(replace(VIEW, valid=half), shape) == pytest.approx([15.0, 0.0], abs=0.5)
