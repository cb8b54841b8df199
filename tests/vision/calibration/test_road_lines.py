"""Lines found in stills: the edges that vote for a point, and the paint in a fan of rays."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.calibration import road_lines
from egolane_pgm.vision.calibration.chessboard import calibrate_lens
from egolane_pgm.vision.calibration.road_lines import find_in_stills
from egolane_pgm.vision.calibration.straight_road import (
    assumed_camera,
    to_level,
    view_from,
)
from egolane_pgm.vision.camera.model import image_to_road, vanishing_point
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import files_matching
from tests.kits.calibration_kit import TRUE, draw_road, unturned
from tests.kits.synthetic_road import CAMERA, Paint, road

PLAIN = replace(unturned(TRUE), distortion=(0.0,) * 5)
WHOLE = road_lines.seen_mask(PLAIN)
SIDE = np.arange(-5, 5.0125, 0.025)
BELOW = np.geomspace(0.04, 0.4, 120)


def with_lines(*ends: tuple[tuple[int, int], tuple[int, int]]) -> Image:
    image = np.full((720, 1280, 3), 60, np.uint8)
    for one, other in ends:
        cv2.line(image, one, other, (220, 220, 220), 5)
    return image


def edges_to(point: tuple[float, float], seed: int, n: int = 40, stray: int = 20) -> FloatArray:
    """Edges that point at a point from below, and some in any direction."""
    rng = np.random.default_rng(seed)
    way = np.stack([rng.uniform(-1.5, 1.5, n), np.ones(n)], axis=-1)
    near, far = (np.array(point) + way * rng.uniform(*r, (n, 1)) for r in ((0.1, 0.2), (0.3, 0.4)))
    upper = rng.uniform((-0.5, -0.2), (0.5, 0.3), (stray, 2))
    lower = upper + rng.uniform((-0.2, 0.02), (0.2, 0.2), (stray, 2))
    return np.vstack([np.hstack([near, far]), np.hstack([upper, lower])])


def fan_of(streaks: dict[float, FloatArray], seen: slice = slice(None)) -> road_lines.Fan:
    """A fan with paint three samples wide: by its offset, where in each row it is (NaN: none)."""
    paint = np.zeros((120, len(SIDE)))
    for bright, places in streaks.items():
        for row, place in enumerate(places):
            if np.isfinite(place):
                k = int(np.argmin(np.abs(SIDE - place)))
                paint[row, k - 1 : k + 2] = bright
    is_seen = np.zeros(paint.shape, dtype=bool)
    is_seen[seen] = True
    return road_lines.Fan(paint, is_seen, BELOW, SIDE)


def straight(offset: float, rows: slice = slice(None)) -> FloatArray:
    places = np.full(120, np.nan)
    places[rows] = offset
    return places


def streaks(fan: road_lines.Fan) -> list[tuple[FloatArray, FloatArray]]:
    return list(road_lines._streaks(fan))


def test_rectangles_to_ignore_may_reach_beyond_the_picture() -> None:
    rectangles = ((-5, 0, 200, 30), (1200, 700, 9000, 9000), (-9, -9, -1, 2000))
    mask = road_lines.seen_mask(replace(PLAIN, ignore=rectangles))
    expected = np.ones((720, 1280), dtype=bool)
    expected[:30, :200] = expected[700:, 1200:] = False
    np.testing.assert_array_equal(mask, expected)


def test_edges_that_may_be_lines_of_the_road_are_kept_upper_end_first() -> None:
    image = with_lines(
        ((500, 700), (600, 400)),
        ((100, 300), (500, 310)),  # too flat
        ((900, 500), (910, 512)),  # too short
        ((1100, 700), (1000, 400)),
    )
    edges = road_lines.edges(PLAIN, image, WHOLE)
    ends = to_level(PLAIN, np.array([600.0, 500, 1000, 1100]), np.array([400.0, 700, 400, 700]))
    for upper, lower in (ends[:2], ends[2:]):
        # Both sides of the stripe.
        near = np.abs(edges - np.concatenate([upper, lower])).max(axis=1) < 0.02
        assert near.sum() == 2
    assert len(edges) == 4
    assert (edges[:, 1] < edges[:, 3]).all()
    half = WHOLE.copy()
    half[:, 800:] = False
    assert (road_lines.edges(PLAIN, image, half)[:, 0] < 0).all()
    assert road_lines.edges(PLAIN, with_lines(), WHOLE).shape == (0, 4)


def test_edges_vote_for_points_above_them_that_they_point_at() -> None:
    lines = np.array([[0.1, 0.1, 0.3, 0.3], [-0.3, 0.3, -0.6, 0.6]])
    lengths = np.array([0.2, 0.3]) * np.sqrt(2)
    points = np.array([[0.0, 0.0], [0.7, 0.7], [0.0, 0.1], [-0.1, 0.1]])
    votes = road_lines._votes(points, lines)
    # Of both; below the first one and on no line; on none; of the second alone.
    np.testing.assert_allclose(votes, [lengths.sum(), 0, 0, lengths[1]], atol=1e-9)


def test_the_point_where_most_edges_meet_is_found_and_is_the_same_every_time() -> None:
    points = [(0.03, -0.05), (0.05, -0.04), (0.01, -0.06)]
    stills = [edges_to(point, seed) for seed, point in enumerate(points)]
    every, each = road_lines.meeting_of_stills([*stills, np.zeros((0, 4))])
    assert every == pytest.approx((0.03, -0.05), abs=0.01)
    np.testing.assert_allclose(each[:3], points, atol=0.01)
    assert np.isnan(each[3]).all()
    again = road_lines.meeting_of_stills([*stills, np.zeros((0, 4))])
    np.testing.assert_array_equal(every, again[0])
    np.testing.assert_array_equal(each, again[1])


def test_a_still_full_of_other_edges_is_looked_at_near_the_common_point_only() -> None:
    road, house = (0.0, 0.0), (0.3, 0.0)
    mixed = np.vstack([edges_to(road, 7, 15, 0), edges_to(house, 8, 40, 0)])
    stills = [*(edges_to(road, seed) for seed in range(3)), mixed, edges_to(house, 9, 20, 0)]
    every, each = road_lines.meeting_of_stills(stills)
    assert every == pytest.approx(road, abs=0.01)
    assert each[3] == pytest.approx(road, abs=0.01)
    assert np.isnan(each[4]).all() or np.abs(each[4] - road).max() < 0.1


def test_edges_in_any_direction_meet_nowhere() -> None:
    with pytest.raises(InputError, match="stills: their straight edges do not meet in one point"):
        road_lines.meeting_of_stills(
            [edges_to((0.0, 0.0), seed, n=0, stray=300) for seed in (1, 2)]
        )
    with pytest.raises(InputError, match="stills: no straight edges that meet"):
        road_lines.meeting_of_stills([edges_to((0.0, 0.0), 1, n=1, stray=0)])


def test_white_and_yellow_paint_are_bright() -> None:
    colours = np.array([[[255, 255, 255], [60, 175, 250], [200, 90, 90]]], dtype=np.uint8)
    assert road_lines.grey_of(colours).tolist() == [[255, 212.5, 90]]


def test_paint_is_much_brighter_than_its_row_scatters() -> None:
    assert road_lines.is_paint(fan_of({100.0: straight(0.0)})).sum() == 3 * 120
    assert not road_lines.is_paint(fan_of({11.0: straight(0.0)})).any()
    assert not road_lines.is_paint(fan_of({100.0: straight(0.0)}, slice(0, 0))).any()
    rough = fan_of({30.0: straight(0.0)})
    rough.paint[60:] += 8.0  # 38 of 8 and more all over
    assert road_lines.is_paint(rough).sum(axis=1).tolist() == [3] * 120
    rough.paint[60:] += 8.0
    assert road_lines.is_paint(rough).sum(axis=1).tolist() == [3] * 60 + [0] * 60


def test_streaks_are_the_lines_most_covered_first() -> None:
    fan = fan_of(
        {150.0: straight(1.3), 100.0: straight(-1.2, slice(0, 40)), 90.0: straight(3.9, slice(80))}
    )
    lines = streaks(fan)
    assert [float(np.median(side)) for side, _ in lines] == pytest.approx(
        [1.3, 3.9, -1.2], abs=0.01
    )
    np.testing.assert_allclose(lines[0][1], BELOW)
    np.testing.assert_allclose(lines[2][1], BELOW[:40])


def test_a_dot_a_ragged_streak_and_what_is_hardly_in_view_are_no_lines() -> None:
    assert streaks(fan_of({100.0: straight(0.0, slice(0, 6))})) == []
    wild = np.random.default_rng(0).uniform(-0.18, 0.18, 120)
    assert streaks(fan_of({100.0: wild})) == []
    # A twelfth of what is seen, but of four rows only.
    assert streaks(fan_of({100.0: straight(0.0, slice(0, 4))}, slice(0, 35))) == []
    assert streaks(fan_of({100.0: straight(0.0)}, slice(0, 29))) == []
    assert len(streaks(fan_of({100.0: straight(0.0)}, slice(0, 31)))) == 1


def test_both_rims_of_a_wide_marking_are_one_line() -> None:
    fan = fan_of({100.0: straight(1.0), 101.0: straight(1.2, slice(100))})
    assert len(streaks(fan)) == 1


def test_what_is_beside_a_masked_part_is_not_seen_in_a_fan() -> None:
    grey = np.full((720, 1280), 100, np.float32)
    mask = WHOLE.copy()
    mask[:, 650:] = False
    half = road_lines.fan(PLAIN, grey, mask, np.array([0.0, 0.0]))
    assert half.seen[:, half.side < -0.5].any()
    # Half a marking (0.4) from the mask, which begins at offset 0.
    assert not half.seen[:, half.side > -0.35].any()


def test_a_lens_that_folds_back_shows_no_part_of_the_picture_twice() -> None:
    camera = replace(PLAIN, distortion=(-0.35, 0.0, 0.0, 0.0, 0.0))
    fan = road_lines.fan(camera, np.full((720, 1280), 100, np.float32), WHOLE, np.zeros(2))
    # The equation of the lens turns back where 1 - 3 * 0.35 r^2 = 0.
    reach = np.hypot(fan.side[None, :] * fan.below[:, None], fan.below[:, None])
    assert (reach > 1.5).any()
    assert not fan.seen[reach > np.sqrt(1 / (3 * 0.35))].any()


def test_rays_of_a_fan_are_the_bent_lines_of_the_road() -> None:
    point, side, below = np.array([0.02, -0.03]), np.array([-1.2, 1.3]), np.array([0.1, 0.4])
    rays = road_lines._rays(point, 5e-4, side, below)
    assert rays[:, 0] == pytest.approx([0.02 - 0.12 + 5e-3, 0.02 + 0.52 + 1.25e-3])
    assert rays[:, 1] == pytest.approx([0.07, 0.37])


def test_the_lines_of_a_still_are_where_they_were_painted() -> None:
    camera = replace(PLAIN, height_m=1.4)
    offsets = np.array([-5.5, -1.8, 1.9, 5.6])
    image = draw_road(camera, offsets)
    lines = road_lines.find_lines(camera, image, WHOLE, np.array([0.0, 0.0]))
    # A level camera: the offset over the height is a over b.
    rays = [to_level(camera, *line.T) for line in lines]
    seen = sorted(float(np.median(r[:, 0] / r[:, 1])) * 1.4 for r in rays)
    for one, other in pairwise(seen):
        assert other - one > 3
    for offset in (-1.8, 1.9):
        assert np.abs(np.array(seen) - offset).min() < 0.05


def test_a_camera_is_recovered_from_lines_found_in_stills(stills):
    found = find_in_stills(unturned(TRUE), sorted(stills.iterdir()))
    view = view_from(unturned(TRUE), found.ahead, found.each, found.fits, 3.7, "stills")
    assert view.vanishing_point == pytest.approx(vanishing_point(TRUE), abs=4)
    assert view.camera.height_m == pytest.approx(TRUE.height_m, rel=0.02)
    assert min(len(lines) for lines in found.lines) >= 3


def test_what_is_ignored_is_not_looked_at(stills):
    masked = replace(unturned(TRUE), ignore=((0, 0, 640, 720),))
    found = find_in_stills(masked, sorted(stills.iterdir()))
    assert all(points[:, 0].min() > 640 for lines in found.lines for points in lines)


def test_a_still_without_lines_says_nothing(stills, tmp_path):
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((720, 1280, 3), 90, np.uint8))
    found = find_in_stills(unturned(TRUE), [sorted(stills.iterdir())[0], blank])
    assert len(found.paths) == len(found.lines) == 2
    assert len(found.lines[0]) >= 3
    assert found.lines[1] == []
    assert found.each.shape == (1, 2)
    assert np.isfinite(found.each).all()
    assert len(found.fits) == 1


def test_stills_of_another_size_and_no_pictures_are_left_out_with_a_line_each(stills, tmp_path):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((100, 100, 3), np.uint8))
    low = tmp_path / "low.png"
    cv2.imwrite(str(low), np.zeros((600, 1280, 3), np.uint8))
    text = tmp_path / "text.png"
    text.write_text("no picture")
    found = find_in_stills(unturned(TRUE), [small, low, text, *sorted(stills.iterdir())])
    assert len(found.paths) == 3
    assert found.skipped == (
        f"{small}: 100x100, needs 1280x720",
        f"{low}: 1280x600, needs 1280x720",
        f"{text}: is no picture that can be read (another kind of file, or cut off)",
    )
    with pytest.raises(InputError, match=r"none of them can be used.*100x100"):
        find_in_stills(unturned(TRUE), [small])


def test_the_camera_of_the_real_chessboards_and_straight_stills(real_pictures, tmp_path):
    folder = real_pictures / "carnd"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/carnd")
    lens = calibrate_lens(files_matching(str(folder / "camera_cal" / "*.jpg")))
    assert (lens.camera.fx, lens.camera.fy) == pytest.approx((1156, 1151), abs=8)
    assert (lens.camera.cx, lens.camera.cy) == pytest.approx((672, 389), abs=8)
    assert len(lens.boards) >= 15
    assert len(lens.boards) + len(lens.skipped) == 20
    assert any("9x5 inner corners seen" in line for line in lens.skipped)
    camera = replace(lens.camera, ignore=((0, 670, 1280, 720),))
    stills = files_matching(str(folder / "test_images" / "straight_lines*.jpg"))
    found = find_in_stills(camera, stills)
    view = view_from(camera, found.ahead, found.each, found.fits, 3.7, "stills")
    assert view.vanishing_point == pytest.approx((639.5, 419.6), abs=3)
    assert view.camera.height_m == pytest.approx(1.25, abs=0.03)
    for lines in found.lines:
        y = np.array([np.median(image_to_road(view.camera, *points.T)[1]) for points in lines])
        width = y[y > 0].min() - y[y < 0].max()
        assert width == pytest.approx(3.7, abs=0.1)


def test_the_camera_of_the_real_lane_change_from_found_lines_only(real_pictures):
    folder = real_pictures / "lane_change_right"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/lane_change_right")
    masks = ((0, 0, 692, 130), (120, 300, 400, 480), (0, 360, 692, 480))
    camera = replace(assumed_camera(692, 480), ignore=masks)
    found = find_in_stills(camera, files_matching(str(folder))[::5])
    view = view_from(camera, found.ahead, found.each, found.fits, 3.5, "stills")
    assert view.vanishing_point == pytest.approx((470, 214), abs=5)
    assert view.camera.height_m == pytest.approx(1.2, abs=0.08)


def test_the_road_between_two_tar_seams_is_no_line(tmp_path) -> None:
    """Taken for one, it halves the lanes, and the camera is twice as high."""
    seams = [Paint(offset, grey=40, width_m=0.12) for offset in (-0.3, 0.3)]
    for k in range(3):
        image = road((Paint(-1.8, 4, 12), Paint(1.8, 4, 12), *seams), 3.1 * k, seed=k)
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    lens = unturned(CAMERA)
    found = find_in_stills(lens, files_matching(str(tmp_path)))
    view = road_lines.view_from_stills(lens, found, 3.6)
    assert view.camera.height_m == pytest.approx(CAMERA.height_m, rel=0.05)
