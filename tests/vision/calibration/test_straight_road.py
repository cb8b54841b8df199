"""Each step of the calibration from parallel lines, on numbers made by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.calibration import straight_road
from egolane_pgm.vision.calibration.chessboard import _solve, calibrate_lens
from egolane_pgm.vision.calibration.straight_road import (
    FrameFit,
    RoadView,
    assumed_camera,
    check_lane_width,
    doubts_of,
    fit_frame,
    from_level,
    from_level_to_image,
    one_lane,
    to_level,
    view_from,
)
from egolane_pgm.vision.camera.model import Camera, vanishing_point
from tests.kits.calibration_kit import TRUE, lines_of, unturned, view_of_lines

PLAIN = replace(unturned(TRUE), distortion=(0.0,) * 5, lateral_m=0.25)


@pytest.mark.parametrize("degrees", [0.0, 9.9, 150.5, 180.0, -60.0])
def test_a_field_of_view_beyond_the_bounds_is_refused(degrees: float) -> None:
    with pytest.raises(InputError, match=f"field of view {degrees} is not between 10 and 150"):
        assumed_camera(1280, 720, degrees)


@pytest.mark.parametrize("degrees", [10.0, 90.0, 150.0])
def test_the_field_of_view_is_from_the_left_rim_to_the_right_one(degrees: float) -> None:
    camera = assumed_camera(1280, 720, degrees)
    assert camera.fx == camera.fy
    to_rim = [math.atan((u - camera.cx) / camera.fx) for u in (-0.5, 1279.5)]
    assert math.degrees(to_rim[1] - to_rim[0]) == pytest.approx(degrees)
    assert (camera.cx, camera.cy) == (639.5, 359.5)


@pytest.mark.parametrize("width", [0.36, 1.99, 6.01, 12.0, math.nan])
def test_widths_that_no_lane_has_are_refused(width: float) -> None:
    with pytest.raises(InputError, match="lanes are 2 to 6 m wide"):
        check_lane_width(width)
    check_lane_width(2.0)
    check_lane_width(6.0)


def test_rays_freed_of_lens_and_roll_come_back() -> None:
    camera = replace(TRUE, roll_deg=8.0)
    u, v = np.array([200.0, 640.0, 1000.0]), np.array([500.0, 300.0, 700.0])
    rays = to_level(camera, u, v)
    np.testing.assert_allclose(from_level_to_image(camera, rays), [u, v], atol=1e-3)
    # The horizon of a camera that is only rolled is level in them.
    only = replace(PLAIN, roll_deg=8.0)
    slope = math.tan(math.radians(-8.0)) * only.fy / only.fx
    across = np.array([100.0, 1200.0])
    level = to_level(only, across, only.cy + slope * (across - only.cx))
    np.testing.assert_allclose(level[:, 1], 0, atol=1e-12)


def rays_of(a0: float, b0: float, slopes: list[float], c: float = 0.0) -> list[FloatArray]:
    below = np.geomspace(0.05, 0.5, 40)
    return [np.stack([a0 + s * below + c / below, b0 + below], axis=-1) for s in slopes]


def test_bent_lines_with_an_outlier_have_the_common_point_and_bend() -> None:
    lines = rays_of(0.02, -0.03, [-1.3, 1.2, 4.0], 4e-4)
    lines[1][5:8, 0] += 0.2  # labelled on another line
    fit = fit_frame(lines, -0.02)
    assert fit is not None
    np.testing.assert_allclose(fit.vanishing_point, [0.02, -0.03], atol=2e-3)
    np.testing.assert_allclose(fit.slope, [-1.3, 1.2, 4.0], atol=0.02)
    assert fit.bend == pytest.approx(4e-4, abs=5e-5)


def test_what_is_near_the_horizon_is_not_looked_at() -> None:
    lines = rays_of(0.02, 0.0, [-1.3, 1.2])
    far = np.stack([np.linspace(-0.3, 0.3, 30), np.linspace(0.001, 0.039, 30)], axis=-1)
    fit = fit_frame([np.concatenate([line, far]) for line in lines], 0.0)
    assert fit is not None
    np.testing.assert_allclose(fit.vanishing_point, [0.02, 0.0], atol=1e-4)


def test_noise_of_short_lines_is_taken_for_no_sharp_bend() -> None:
    below = np.linspace(0.25, 0.5, 12)
    for seed in range(6):
        aside = np.random.default_rng(seed).normal(0, 0.002, (2, 12))
        sides = np.array([[-1.2], [1.3]]) * below + aside
        fit = fit_frame([np.stack([side, below], axis=-1) for side in sides], 0.0)
        assert fit is not None
        assert abs(fit.bend) < 0.002
        assert np.abs(fit.vanishing_point).max() < 0.01


def test_lines_that_do_not_spread_or_have_hardly_a_point_fit_nothing() -> None:
    assert fit_frame(rays_of(0.0, 0.0, [1.0, 1.2]), 0.0) is None
    assert fit_frame(rays_of(0.0, 0.0, [-1.0, 1.2]), 0.0) is not None
    one, other = rays_of(0.0, 0.0, [-1.0, 1.2])
    assert fit_frame([one, other[-4:]], 0.0) is None
    assert fit_frame([one, other[-5:]], 0.0) is not None


@given(
    st.lists(st.tuples(st.floats(0.5, 8), st.floats(0.05, 1)), min_size=1, max_size=30),
)
def test_gaps_are_compared_as_in_a_table_of_all_pairs(pairs: list[tuple[float, float]]) -> None:
    gaps, weights = np.array(sorted(pairs)).T
    table = np.maximum(0.0, 1 - np.abs(gaps[None, :] / gaps[:, None] - 1) / 0.15)
    np.testing.assert_allclose(straight_road._alike(gaps, weights), table @ weights, atol=1e-6)


def test_the_most_common_gap_is_the_lane() -> None:
    gaps = np.array([5.2, 2.6, 2.62, 2.58, 1.3, 3.4])
    assert one_lane(gaps, np.ones(6)).tolist() == [False, True, True, True, False, False]
    # Far to the side gaps count for little.
    weights = np.array([9.0, 1, 1, 1, 1, 1])
    assert one_lane(gaps, weights).tolist() == [True, False, False, False, False, False]
    # Those within 15 % of the middle one of what is near (1.05).
    spread = np.array([1.0, 1.0, 1.1, 1.12, 1.2, 1.26])
    assert one_lane(spread, np.array([9.0, 1, 1, 1, 1, 1])).tolist() == [True] * 5 + [False]
    assert one_lane(np.zeros(0), np.zeros(0)).shape == (0,)


def view_of(
    slopes: list[list[float]],
    each: Any = ((0.0, 0.0), (0.0, 0.0)),
    ahead: tuple[float, float] = (0.0, 0.0),
    camera: Camera = PLAIN,
) -> RoadView:
    fits = [FrameFit(np.array(ahead), np.array(s), 0.0) for s in slopes]
    return view_from(camera, np.array(ahead), np.array(each, dtype=float), fits, 3.6, "here")


def test_the_height_is_the_lane_width_over_the_gap_of_slopes() -> None:
    view = view_of([[-4.0, -1.5, 1.0], [-1.0, 1.5]])
    assert view.camera.height_m == pytest.approx(3.6 / 2.5)
    assert view.camera.lateral_m == 0.25
    np.testing.assert_allclose(view.gaps_m, 3.6)
    assert view.is_lane.all()
    assert view.spread_px.tolist() == [0.0, 0.0]
    # Gaps far to the side tell it less.
    near, far = 2.5, 2.7
    height = view_of([[-1.25, -1.25 + near], [7.0, 7.0 + far]]).camera.height_m
    weights = 1 / (1 + np.array([0.0, 7.0 + far / 2]) ** 2)
    assert height == pytest.approx(3.6 / np.average([near, far], weights=weights))
    # Neither two stripes of one marking nor what is lanes apart.
    odd = view_of([[-1.25, -1.05, 1.25], [-1.25, 1.25, 9.0]])
    np.testing.assert_allclose(sorted(odd.gaps_m), [2.3 / 2.5 * 3.6, 3.6], rtol=0.06)


@pytest.mark.parametrize("gap", [0.7, 7.5])
def test_gaps_that_would_need_a_camera_on_the_road_or_a_roof_are_no_lanes(gap: float) -> None:
    with pytest.raises(InputError, match=r"here: no two neighbouring lines .* 0.5 to 4 m above"):
        view_of([[-gap / 2, gap / 2]])


@pytest.mark.parametrize(
    ("spread", "is_refused"),
    [((0.16, 0.0), True), ((0.14, 0.0), False), ((0.0, 0.055), True), ((0.0, 0.045), False)],
)
def test_points_that_scatter_sideways_or_up_and_down_are_no_vanishing_point(
    spread: tuple[float, float], is_refused: bool
) -> None:
    each = np.array([[k * spread[0], k * spread[1]] for k in (-1, 1)] * 8)
    if is_refused:
        with pytest.raises(
            InputError, match=r"here: the lines of 16 frames meet at .* do not meet"
        ):
            view_of([[-1.0, 1.5]], each)
    else:
        found = view_of([[-1.0, 1.5]], each).spread_px
        np.testing.assert_allclose(found, np.array(spread) * (PLAIN.fx, PLAIN.fy))


@pytest.mark.parametrize("ahead", [(-0.7, 0.0), (0.7, 0.0), (0.0, -0.4), (0.0, 0.4)])
def test_a_vanishing_point_beyond_any_rim_is_refused(ahead: tuple[float, float]) -> None:
    with pytest.raises(
        InputError, match=r"here: the lines meet at .* outside the picture of 1280x"
    ):
        view_of([[-1.0, 1.5]], [ahead] * 2, ahead)


def test_the_camera_is_turned_to_where_the_lines_meet() -> None:
    camera = replace(PLAIN, roll_deg=3.0)
    view = view_of([[-1.0, 1.5]], [(0.05, -0.02)] * 2, (0.05, -0.02), camera)
    there = from_level(camera, np.array([0.05, -0.02]))
    assert vanishing_point(view.camera) == pytest.approx(tuple(float(x) for x in there))
    assert view.vanishing_point == pytest.approx(there)
    assert view.camera.roll_deg == 3.0


def seen_boards(
    distortion: tuple[float, ...], noise: float, n: int = 14
) -> list[tuple[Path, FloatArray]]:
    """The corners of boards of 9x6 in a picture of 1280x720, each turned in another way."""
    rng = np.random.default_rng(0)
    flat = np.zeros((54, 3))
    flat[:, :2] = np.mgrid[:9, :6].T.reshape(-1, 2)
    pinhole = np.array([[900.0, 0, 650], [0, 880.0, 350], [0, 0, 1]])
    boards = []
    for k in range(n):
        turn = rng.uniform(-0.6, 0.6, 3)
        place = np.array([rng.uniform(-8, 0), rng.uniform(-5, 0), rng.uniform(7, 10)])
        corners = cv2.projectPoints(flat, turn, place, pinhole, np.array(distortion))[0][:, 0]
        boards.append((Path(f"somewhere/{k}.png"), corners + rng.normal(0, noise, corners.shape)))
    return boards


def test_the_lens_of_exact_corners_is_found_coefficient_by_coefficient() -> None:
    true = (-0.25, 0.08, -0.004, 0.002, -0.03)
    lens = _solve(seen_boards(true, 0.0), (1280, 720), 9, 6, ["left out"])
    assert (lens.camera.fx, lens.camera.fy) == pytest.approx((900, 880), abs=1)
    assert (lens.camera.cx, lens.camera.cy) == pytest.approx((650, 350), abs=1)
    np.testing.assert_allclose(lens.camera.distortion[:2], true[:2], atol=0.01)
    np.testing.assert_allclose(lens.camera.distortion[2:4], true[2:4], atol=3e-4)
    assert lens.camera.distortion[4] == pytest.approx(true[4], abs=0.02)
    assert lens.boards == tuple(f"{k}.png" for k in range(14))
    assert lens.skipped == ("left out",)


def test_a_third_coefficient_that_noise_hides_is_none() -> None:
    lens = _solve(seen_boards((-0.25, 0.08, 0.0, 0.0, 0.0), 0.3), (1280, 720), 9, 6, [])
    assert lens.camera.distortion[4] == 0
    assert lens.camera.distortion[0] == pytest.approx(-0.25, abs=0.02)
    # Five standard errors of it are kept; it would be two of the first coefficient.
    little = _solve(seen_boards((-0.25, 0.08, 0.0, 0.0, 1e-3), 0.3), (1280, 720), 9, 6, [])
    assert little.camera.distortion[4] == pytest.approx(1e-3, abs=6e-4)
    assert little.camera.distortion[4] != 0
    # Root mean square of both axes' noise.
    assert lens.overall_rms_px == pytest.approx(0.3 * math.sqrt(2), rel=0.1)


def test_boards_that_give_no_lens_are_refused_with_what_to_do() -> None:
    boards = [(Path("a.png"), np.zeros((54, 2)))] * 5
    with pytest.raises(InputError, match=r"the 5 chessboards give no lens .*turned in different"):
        _solve(boards, (1280, 720), 9, 6, [])


@pytest.mark.parametrize("board", [(2, 6), (9, 2), (101, 6), (9, 101)])
def test_boards_that_there_are_not_are_refused(board: tuple[int, int]) -> None:
    with pytest.raises(InputError, match=f"board {board[0]}x{board[1]}: needs 3x3 to 100x100"):
        calibrate_lens([], *board)


@pytest.mark.parametrize(
    ("width", "said"),
    [
        (3.6, ""),
        (2.1, "two lanes were taken"),
        (5.9, "half a lane was taken"),
        # The height, 1.75 to 2.1 m, is possible: only the width is strange.
        (4.6, "2.5 to 4.5 m wide almost everywhere, not 4.6 m"),
        (5.4, "2.5 to 4.5 m wide almost everywhere, not 5.4 m"),
        (2.4, "2.5 to 4.5 m wide almost everywhere, not 2.4 m"),
    ],
)
def test_a_height_of_no_car_and_a_width_of_no_lane_are_doubted(width: float, said: str) -> None:
    """The lanes are 3.6 m wide, the camera is 1.4 m above the road."""
    true = replace(PLAIN, height_m=1.4, pitch_deg=-2.0)
    view = view_of_lines(true, PLAIN, [lines_of(true, (-5.4, -1.8, 1.8, 5.4))] * 3, width)
    assert view.camera.lane_width_m == width
    doubts = doubts_of(view)
    assert len(doubts) == bool(said)
    assert said in "".join(doubts)
