"""Lines found in single pictures of known roads."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import ml
from egolane_pgm.vision.detectors.simple import fit as _fit
from egolane_pgm.vision.detectors.simple import kernels as _kernels
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye
from egolane_pgm.vision.detectors.simple.contours import Strips
from egolane_pgm.vision.detectors.simple.fit import Found, find_lines, view_for
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA as ROAD_CAMERA
from tests.kits.synthetic_road import Paint, road
from tests.reference import line_finder

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)
DEFAULTS = resolve_parameters(FINDING, {}, 1)
VIEW = view_for(CAMERA, DEFAULTS)
STRAIGHT = {**DEFAULTS, "curve": "line"}
STRAIGHT_VIEW = view_for(CAMERA, STRAIGHT)
WIDTH = 3.66


def parallel(offset, heading=0.0, curvature=0.0, lines=(-1, 0, 1, 2), **more):
    return [Paint(offset + k * WIDTH, heading=heading, curvature=curvature, **more) for k in lines]


def at(found: Found, x: float):
    return found.shape @ np.array([1, x, x**2 / 2, x**3 / 6])


def found_in(image, view=VIEW, parameters=DEFAULTS, **more) -> Found:
    return find_lines(view, image, parameters, **more)


@needs_compiler
@settings(max_examples=12, deadline=None)
@given(
    st.floats(-3.2, -0.5),
    st.floats(-0.05, 0.05),
    st.floats(-0.0012, 0.0012),
    st.integers(0, 2**31),
)
def test_random_clothoids_are_found_to_within_centimetres(offset, heading, curvature, seed):
    lines = parallel(offset, heading, curvature)
    found = found_in(road(lines, camera=CAMERA, seed=seed))
    for x, tolerance in ((0, 0.15), (10, 0.05), (25, 0.08)):
        true = [p.offset_m + x * (heading + x * curvature / 2) for p in lines]
        places = at(found, x)
        for place, line in zip(true, lines, strict=True):
            if abs(line.offset_m) < 6 and abs(place) < 6:
                assert np.abs(places - place).min() < tolerance
        if x == 10:
            assert all(np.abs(np.array(true) - place).min() < 0.1 for place in places)
    assert (np.diff(found.shape[:, 0]) > 0).all()


@needs_compiler
@settings(max_examples=6, deadline=None)
@given(st.floats(-3.2, -0.5), st.floats(-0.05, 0.05), st.integers(0, 2**31))
def test_straight_lines_stay_straight_and_are_found_to_within_centimetres(offset, heading, seed):
    lines = parallel(offset, heading)
    image = road(lines, camera=CAMERA, seed=seed)
    found = found_in(image, STRAIGHT_VIEW, STRAIGHT)
    assert (found.shape[:, 2:] == 0).all()
    for line in lines:
        if abs(line.offset_m) < 5:
            k = np.argmin(np.abs(found.shape[:, 0] - line.offset_m))
            assert found.shape[k, 0] == pytest.approx(line.offset_m, abs=0.05)
            assert found.shape[k, 1] == pytest.approx(heading, abs=0.005)


@pytest.mark.parametrize("curvature", [-0.0008, 0.0008])
def test_straight_lines_on_a_bend_are_within_a_tenth_of_a_metre_at_the_car(curvature):
    lines = parallel(-1.8, curvature=curvature)
    found = found_in(road(lines, camera=CAMERA), STRAIGHT_VIEW, STRAIGHT)
    for line in lines[:3]:
        assert np.abs(found.shape[:, 0] - line.offset_m).min() < 0.1


def test_a_car_that_pitches_still_finds_parallel_lines():
    # 0.4 degrees: the lane is 14 % wider 30 m ahead than the calibration says.
    lines = parallel(-1.8)
    pitched = replace(CAMERA, pitch_deg=CAMERA.pitch_deg + 0.4)
    found = found_in(road(lines, camera=pitched))
    for line in lines[:3]:
        assert np.abs(found.shape[:, 0] - line.offset_m).min() < 0.06


def mirrored(camera: Camera) -> Camera:
    return replace(camera, cx=camera.width - 1 - camera.cx, yaw_deg=-camera.yaw_deg)


@pytest.mark.parametrize("seed", range(3))
def test_a_mirrored_picture_has_mirrored_lines(seed):
    camera = replace(CAMERA, yaw_deg=1.5, cx=500.0)
    lines = [Paint(-1.5, 4.0, 12.0, 0.02, 0.0006), Paint(2.1, heading=0.02, curvature=0.0006)]
    image = road(lines, camera=camera, seed=seed)
    found = found_in(image, view_for(camera, DEFAULTS))
    other = found_in(np.ascontiguousarray(image[:, ::-1]), view_for(mirrored(camera), DEFAULTS))
    assert len(found.score) == len(other.score) == 2
    np.testing.assert_allclose(at(other, 10), -at(found, 10)[::-1], atol=0.02)
    np.testing.assert_allclose(other.shape[:, 0], -found.shape[::-1, 0], atol=0.05)


@pytest.mark.parametrize("grey", [0, 40, 128, 255])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_picture_without_a_road_has_no_lines(grey, noise):
    shape = (CAMERA.height, CAMERA.width, 3)
    values = grey + noise * np.random.default_rng(0).standard_normal(shape)
    found = found_in(np.clip(values, 0, 255).astype(np.uint8))
    assert found.shape.shape == (0, 4)
    assert len(found.score) == 0


def test_with_the_left_half_blank_there_is_no_left_line():
    image = road(parallel(-1.8), camera=CAMERA)
    image[:, : CAMERA.width // 2] = 0
    found = found_in(image)
    assert len(found.score) >= 1
    assert (found.shape[:, 0] > 0).all()


def test_the_rim_of_a_blanked_part_is_no_line():
    # The road is a little brighter right beside it.
    image = road(parallel(-1.8), camera=CAMERA)
    half = CAMERA.width // 2
    image[:, :half] = 0
    ramp = np.interp(np.arange(half), [0, 60], [1.0, 0.75])[:, None]
    image[:, half:] = (image[:, half:] * ramp).astype(np.uint8)
    found = found_in(image)
    assert found.shape[:, 0] == pytest.approx([1.86, 5.52], abs=0.1)


def test_flanks_of_vehicles_are_no_lines():
    # Bright edges that stand up from the road: upright in the picture, streaks from above.
    image = road(parallel(-1.8), camera=CAMERA)
    clean = found_in(image)
    for column in (180, 215, 250, 700, 740):
        cv2.line(image, (column, 150), (column, 430), (230, 230, 230), 3)
    found = found_in(image)
    own = np.abs(clean.shape[:, 0]) < 4
    for offset in clean.shape[own, 0]:
        assert np.abs(found.shape[:, 0] - offset).min() < 0.1


def test_marking_off_the_plane_of_the_road_is_dropped():
    image = road(parallel(-1.8), camera=CAMERA)
    on_road = np.ones(VIEW.valid.shape, dtype=bool)
    on_road[:, VIEW.y_m > 0] = False
    found = found_in(image, on_road=on_road)
    assert len(found.score) >= 1
    assert (found.shape[:, 0] < 0.2).all()


def test_lines_expected_from_before_decide_where_the_picture_does_not():
    # Two dots: on their own they have hardly a heading.
    lines = [Paint(-1.8, 1.0, 100.0, heading=0.05), Paint(1.86, 1.0, 100.0, heading=0.05)]
    image = road(lines, -10.0, camera=CAMERA)
    before = np.array([[-1.8, 0.05, 0, 0], [1.86, 0.05, 0, 0]])
    faint = {**DEFAULTS, "least_score": 0.1}
    alone = found_in(image, parameters=faint)
    helped = found_in(image, parameters=faint, prior_shape=before)
    assert len(alone.score) == len(helped.score) == 2
    assert np.abs(helped.shape[:, 1] - 0.05).max() < 0.01
    assert np.abs(helped.shape[:, 1] - 0.05).max() < np.abs(alone.shape[:, 1] - 0.05).max()
    nothing = found_in(image, parameters=faint, prior_shape=np.zeros((0, 4)))
    assert nothing.shape == pytest.approx(alone.shape)


def random_mask(seed):
    rng = np.random.default_rng(seed)
    mask = cv2.blur(rng.random((40, 50)), (3, 3)) > 0.55
    return np.where(mask, rng.integers(1, 256, mask.shape), 0).astype(np.uint8)


def borders(mask):
    found, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    around = tree[0, :, 3]
    owner = np.where(around < 0, np.arange(len(found)), around)
    return np.concatenate(found)[:, 0], np.cumsum([0, *map(len, found)]), owner


@pytest.mark.parametrize("seed", range(5))
def test_runs_of_contours_are_the_same_as_in_numpy_and_cover_the_mask(seed):
    mask = random_mask(seed)
    arguments = (mask, *borders(mask))
    runs = _kernels.contour_runs(*arguments)
    for ours, twin in zip(runs, line_finder.contour_runs(*arguments), strict=True):
        np.testing.assert_array_equal(ours, twin)
    row, left, right, contour, _ = runs
    # Which runs belong together, told by OpenCV's connected components.
    _, label = cv2.connectedComponents(mask, connectivity=8)
    again = np.zeros_like(mask)
    component = {}
    for r, a, b, k in zip(row, left, right, contour, strict=True):
        again[r, a : b + 1] = 1
        assert component.setdefault(k, label[r, a]) == label[r, a]
    np.testing.assert_array_equal(again, mask > 0)
    assert len(set(component.values())) == len(component) == label.max()


@pytest.mark.parametrize(("seed", "n_headings"), [(0, 5), (1, 41), (2, 41), (3, 2), (4, 1)])
def test_scores_of_what_lines_share_are_the_same_as_in_numpy(seed, n_headings):
    rng = np.random.default_rng(seed)
    n = 60
    pieces = (
        rng.uniform(4, 35, n),
        rng.uniform(-10, 10, n),
        rng.uniform(0.01, 0.2, n),
        rng.uniform(4, 35, n),
        rng.normal(0, 0.05, n),
        rng.uniform(0.04, 0.3, n),
    )
    headings = np.linspace(-0.1, 0.12, n_headings)
    grid = (headings, np.linspace(-0.002, 0.002, 3), np.linspace(-0.01, 0.01, 3))
    ours = _kernels.common_scores(*pieces, *grid, 9.0, 0.1)
    twin = line_finder.common_scores(*pieces, *grid, 9.0, 0.1)
    np.testing.assert_allclose(ours, twin, rtol=1e-9)
    assert ours.max() > 0


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**31),
    st.integers(1, 6),
    st.sampled_from(["line", "parabola", "clothoid"]),
)
def test_equations_of_lines_near_runs_are_the_same_as_in_numpy(seed, n_lines, curve):
    rng = np.random.default_rng(seed)
    n = 80
    x, y, offset = rng.uniform(4, 35, n), rng.uniform(-9, 9, n), rng.uniform(-9, 9, n)
    agreement = np.maximum(rng.uniform(-0.3, 1, n), 0)
    found = np.sort(rng.uniform(-9, 9, n_lines))
    near = rng.uniform(0.1, 0.3, n), offset, agreement, found, -0.004, _fit.shared_by(curve), 1.5
    for ours, twin in zip(
        _kernels.line_equations(x, y, *near), line_finder.line_equations(x, y, *near), strict=True
    ):
        np.testing.assert_allclose(ours, twin, rtol=1e-9, atol=1e-9)


def test_every_constant_is_documented_and_its_name_is_used_once():
    names = [parameter.name for parameter in ml.PARAMETERS]
    assert {parameter.name for parameter in FINDING} <= {*names, "curve"}
    assert len(set(names)) == len(names)
    assert all(len(parameter.doc) > 10 for parameter in (*FINDING, *ml.PARAMETERS))


ROAD = _fit.view_for(ROAD_CAMERA, DEFAULTS)
SIDE, BIN = 9.0, 0.05
CENTRE = -SIDE + (np.arange(360) + 0.5) * BIN


def given_(**more: object) -> Parameters:
    return resolve_parameters(FINDING, more, 1)


def strips_along(
    common: _fit._Common, offsets: list[float], rows: list[slice], view: BirdsEye = ROAD
) -> Strips:
    """Contours 0.15 m wide that lie on the lines at these offsets, in some rows each."""
    row = np.concatenate([np.arange(len(view.x_m))[r] for r in rows])
    contour = np.repeat(np.arange(len(rows)), [len(view.x_m[r]) for r in rows])
    x = view.x_m[row]
    shape = common.shape(np.array(offsets))[contour]
    y = shape[:, 0] + x * (shape[:, 1] + x * (shape[:, 2] / 2 + x * shape[:, 3] / 6))
    middle = np.array([view.x_m[r].mean() for r in rows])
    slope = common.shape(np.array(offsets))[:, 1]
    slope = slope + middle * (common.curvature + middle * common.rate / 2)
    return Strips(
        row, x, y, np.full(len(x), 0.15), contour, middle, slope, np.full(len(rows), 0.02)
    )


def test_the_red_of_a_picture_is_looked_at_and_a_grey_one_as_it_is() -> None:
    image = np.zeros((ROAD_CAMERA.height, ROAD_CAMERA.width, 3), np.uint8)
    image[:] = 10, 90, 200
    assert (_fit.from_above(ROAD, image)[ROAD.valid] == 200).all()
    assert (_fit.from_above(ROAD, image[..., 1])[ROAD.valid] == 90).all()


def expected(*lines: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    return _fit._prior(np.array([[*line, 2e-5] for line in lines]).reshape(-1, 4))


def test_without_lines_from_before_a_road_is_straight_ahead_give_or_take_the_usual() -> None:
    for centre, sd in (_fit._prior(None), expected()):
        assert centre.tolist() == [0, 0, 0, 0]
        assert sd.tolist() == [0.03, 0.001, 0.004, 4e-5]


def test_lines_from_before_say_heading_curvature_and_squeeze_more_surely() -> None:
    lines = [(o, 0.02 + 0.003 * o, 0.0007) for o in (-5.4, -1.8, 1.9)]
    centre, sd = expected(*lines)
    np.testing.assert_allclose(centre, [0.02, 0.0007, 0.003, 2e-5])
    # A clothoid may begin or end between two frames, so the rate is as open as before.
    np.testing.assert_allclose(sd, [0.3, 0.3, 0.3, 1] * expected()[1])


def test_lines_near_to_each_other_say_nothing_of_the_squeeze() -> None:
    centre, _ = expected((1.8, 0.02, 0.001))
    np.testing.assert_allclose(centre, [0.02, 0.001, 0.0, 2e-5])
    # 20 cm apart: a squeeze of 0.05 would be noise.
    centre, _ = expected((1.8, 0.02, 0.001), (2.0, 0.03, 0.001))
    np.testing.assert_allclose(centre, [0.025, 0.001, 0.0, 2e-5])


def scored(**at: float) -> FloatArray:
    """Scores at bins of offsets, e.g. o36=0.4 at 3.6 m."""
    own = np.zeros(len(CENTRE))
    for name, value in at.items():
        own[np.argmin(np.abs(CENTRE - float(name[1:]) / 10))] = value
    return own


def test_a_neighbour_one_lane_away_lends_its_score_up_to_a_half() -> None:
    parameters = given_(lane_width_m=3.6, lane_width_sd=0.2)
    own = scored(o0=0.3)
    support = _fit._support(own, 3.6, parameters)
    at = int(np.argmax(own))
    lane = round(3.6 / BIN)
    for side in (-1, 1):
        assert support[at + side * lane] == pytest.approx(0.3)
        # 0.3 m from the usual width: 1.5 standard deviations.
        for unusual in (lane - 6, lane + 6):
            assert support[at + side * unusual] == pytest.approx(0.3 * np.exp(-0.5 * 1.5**2))
        assert support[at + side * (lane + 20)] == 0
    assert support[at] == 0
    assert _fit._support(scored(o0=0.9), 3.6, parameters).max() == pytest.approx(0.5)


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
    along = _fit._along(strips, ahead)
    return _fit._scores(view, strips, *along, ahead, parameters)


def test_the_score_is_the_share_of_the_visible_stripe_that_is_covered() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [1.01], [slice(100, 150)])
    centre, score = scores_of(ROAD, strips, stripe_m=0.1, reach_m=0.125)
    visible = _fit._visible(ROAD, ahead.shape(np.array([1.0])))[0]
    assert score.max() == pytest.approx(50 * 0.1 * 0.15 / (visible * 0.1))
    # What is within reach of the contour, to either side alike.
    assert centre[score > 0] == pytest.approx(1.025 + np.arange(-2, 3) * BIN)


def test_of_a_line_that_is_hardly_in_view_a_dot_is_not_enough() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    is_near = (ROAD.x_m < 5.5)[:, None] & ROAD.valid
    last = len(ROAD.x_m)
    strips = strips_along(ahead, [1.01], [slice(last - 10, last)])
    score = scores_of(replace(ROAD, valid=is_near), strips, stripe_m=0.15)[1]
    assert score.max() == pytest.approx(10 * 0.1 / 5.0)


@needs_compiler
@pytest.mark.parametrize("squeeze", [-0.004, 0.0, 0.004])
def test_contours_on_lines_give_these_lines(squeeze: float) -> None:
    common = _fit._Common(0.02, 0.0008, squeeze)
    offsets = [-1.8, 1.86]
    found = _fit.fit_lines(ROAD, strips_along(common, offsets, [slice(100, 300)] * 2), DEFAULTS)
    np.testing.assert_allclose(found.shape[:, 0], offsets, atol=0.03)
    np.testing.assert_allclose(found.shape[:, 1], common.shape(np.array(offsets))[:, 1], atol=4e-3)
    np.testing.assert_allclose(found.shape[:, 2], 0.0008, atol=4e-4)


@needs_compiler
def test_straight_lines_have_no_curvature_whatever_is_expected() -> None:
    parameters = given_(curve="line", straight_to_m=35.0)
    bend = _fit._Common(0.0, 0.0015, 0.0)
    strips = strips_along(bend, [-1.8, 1.86], [slice(0, 300)] * 2)
    before = np.array([[-1.8, 0.0, 0.0015, 0.0], [1.86, 0.0, 0.0015, 0.0]])
    common = _fit._find_common(ROAD, strips, parameters, _fit._prior(before))
    assert common.curvature == 0
    found = _fit.fit_lines(ROAD, strips, parameters, before)
    assert len(found.score) > 0
    assert (found.shape[:, 2:] == 0).all()


def test_a_contour_agrees_as_far_as_it_goes_the_way_of_its_line() -> None:
    common = _fit._Common(0.02, 0.0015, 0.006)
    strips = strips_along(common, [-5.4, 5.4], [slice(100), slice(150, 250)])
    offset, agreement = _fit._along(strips, common)
    np.testing.assert_allclose(offset, np.repeat([-5.4, 5.4], 100))
    np.testing.assert_allclose(agreement, 1.0, atol=1e-9)
    tolerance = np.hypot(0.05, 0.02)
    for share, left in ((0.5, 0.75), (0.9, 0.19), (1.1, 0.0)):
        turned = replace(strips, slope=strips.slope + share * tolerance)
        agreement = _fit._along(turned, common)[1]
        np.testing.assert_allclose(agreement, left, atol=1e-9)


def test_contours_weigh_as_much_as_they_agree() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [0.0, 0.1], [slice(100, 150), slice(200, 250)])
    strips = replace(strips, slope=np.array([0.0, 0.5 * np.hypot(0.05, 0.02)]))
    surely = np.zeros(4), np.array([1e-7, 1e-7, 1e-7, 1e-11])
    parameters = given_(reach_m=0.125)
    common, found = _fit._refine(strips, ahead, np.array([0.0, 3.6]), parameters, surely)
    assert found == pytest.approx([0.1 * 0.75 / 1.75, 3.6], abs=1e-4)
    assert abs(common.heading) < 1e-6


def test_pieces_are_cut_along_the_road_from_one_contour_each() -> None:
    ahead = _fit._Common(0.0, 0.0, 0.0)
    strips = strips_along(ahead, [-1.8, 1.8], [slice(80, 104), slice(84, 100)])
    x, y, area, contour = _fit._pieces(ROAD, strips)
    # Of eight rows, 0.8 m.
    assert contour.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(area, np.array([8, 8, 8, 4, 8, 4]) * 0.1 * 0.15)
    np.testing.assert_allclose(y, [-1.8] * 3 + [1.8] * 3)
    assert x[1] == pytest.approx(ROAD.x_m[88:96].mean())
    assert x[3] == pytest.approx(ROAD.x_m[84:88].mean())


def test_what_the_camera_is_to_ignore_is_not_visible() -> None:
    shape = np.array([[0.0, 0, 0, 0], [30.0, 0, 0, 0]])
    assert _fit._visible(ROAD, shape) == pytest.approx([30.0, 0.0], abs=1.0)
    half = ROAD.valid & (ROAD.x_m > 20)[:, None]
    assert _fit._visible(replace(ROAD, valid=half), shape) == pytest.approx([15.0, 0.0], abs=0.5)
