"""Lines found in stills: where they were painted, and what is not looked at."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.calibration import road_lines
from egolane_pgm.vision.calibration.chessboard import calibrate_lens
from egolane_pgm.vision.calibration.road_lines import (
    RoadView,
    assumed_camera,
    find_in_stills,
    grey_of,
    to_level,
    view_from,
)
from egolane_pgm.vision.camera.model import Camera, image_to_road, vanishing_point
from egolane_pgm.vision.camera.pictures import open_source, picture_files, spread
from tests.kits.calibration_kit import TRUE, draw_road, unturned
from tests.kits.synthetic_road import CAMERA, Paint, road

PLAIN = replace(unturned(TRUE), distortion=(0.0,) * 5)
WHOLE = road_lines.seen_mask(PLAIN)


def look(camera: Camera, path: object, lane_width_m: float = 3.7) -> tuple[RoadView, list]:
    """The camera of up to thirty pictures, and the lines of each."""
    found = find_in_stills(camera, spread(open_source(str(path)), 30))
    known = replace(camera, lane_width_m=lane_width_m)
    return view_from(known, found.ahead, found.each, found.fits), found.lines


def edges_to(point: tuple[float, float], seed: int, n: int = 40, stray: int = 20) -> FloatArray:
    """Edges that point at a point from below, and some in any direction."""
    rng = np.random.default_rng(seed)
    way = np.stack([rng.uniform(-1.5, 1.5, n), np.ones(n)], axis=-1)
    near, far = (np.array(point) + way * rng.uniform(*r, (n, 1)) for r in ((0.1, 0.2), (0.3, 0.4)))
    upper = rng.uniform((-0.5, -0.2), (0.5, 0.3), (stray, 2))
    lower = upper + rng.uniform((-0.2, 0.02), (0.2, 0.2), (stray, 2))
    return np.vstack([np.hstack([near, far]), np.hstack([upper, lower])])


def test_edges_in_any_direction_meet_nowhere() -> None:
    with pytest.raises(InputError, match="their straight edges do not meet in one point"):
        road_lines.meeting_of_stills(
            [edges_to((0.0, 0.0), seed, n=0, stray=300) for seed in (1, 2)]
        )
    with pytest.raises(InputError, match="no straight edges that meet"):
        road_lines.meeting_of_stills([edges_to((0.0, 0.0), 1, n=1, stray=0)])


def test_the_lines_of_a_still_are_where_they_were_painted() -> None:
    camera = replace(PLAIN, height_m=1.4)
    offsets = np.array([-5.5, -1.8, 1.9, 5.6])
    image = draw_road(camera, offsets)
    lines = road_lines.find_lines(camera, grey_of(image), WHOLE, np.array([0.0, 0.0]))
    # A level camera: the offset over the height is a over b.
    rays = [to_level(camera, *line.T) for line in lines]
    seen = sorted(float(np.median(r[:, 0] / r[:, 1])) * 1.4 for r in rays)
    for one, other in pairwise(seen):
        assert other - one > 3
    for offset in (-1.8, 1.9):
        assert np.abs(np.array(seen) - offset).min() < 0.05


def test_a_camera_is_recovered_from_lines_found_in_stills(stills):
    view, lines = look(unturned(TRUE), stills)
    assert view.vanishing_point == pytest.approx(vanishing_point(TRUE), abs=4)
    assert view.camera.height_m == pytest.approx(TRUE.height_m, rel=0.02)
    assert min(map(len, lines)) >= 3


def test_a_damaged_still_is_left_out_and_one_of_another_size_is_named(stills, tmp_path):
    for file in stills.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "text.png").write_text("no picture")
    assert len(look(unturned(TRUE), tmp_path)[1]) == 3
    cv2.imwrite(str(tmp_path / "low.png"), np.zeros((600, 1280, 3), np.uint8))
    with pytest.raises(InputError, match=r"low\.png: a picture of 1280x600"):
        look(unturned(TRUE), tmp_path)


def test_the_camera_of_the_real_chessboards_and_straight_stills(real_pictures, tmp_path):
    folder = real_pictures / "carnd"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/carnd")
    lens = calibrate_lens(picture_files(str(folder / "camera_cal" / "*.jpg")))
    assert (lens.camera.fx, lens.camera.fy) == pytest.approx((1156, 1151), abs=8)
    assert (lens.camera.cx, lens.camera.cy) == pytest.approx((672, 389), abs=8)
    assert len(lens.rms_px) >= 15
    assert len(lens.rms_px) + len(lens.skipped) == 20
    camera = replace(lens.camera, ignore=((0, 670, 1280, 720),))
    view, stills = look(camera, folder / "test_images" / "straight_lines*.jpg")
    assert view.vanishing_point == pytest.approx((639.5, 419.6), abs=3)
    assert view.camera.height_m == pytest.approx(1.25, abs=0.03)
    for lines in stills:
        y = np.array([np.median(image_to_road(view.camera, *points.T)[1]) for points in lines])
        width = y[y > 0].min() - y[y < 0].max()
        assert width == pytest.approx(3.7, abs=0.1)


def test_the_camera_of_the_real_lane_change_from_found_lines_only(real_pictures):
    folder = real_pictures / "lane_change_right"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/lane_change_right")
    masks = ((0, 0, 692, 130), (120, 300, 400, 480), (0, 360, 692, 480))
    camera = replace(assumed_camera(692, 480), ignore=masks)
    view, _ = look(camera, folder, 3.5)
    assert view.vanishing_point == pytest.approx((470, 214), abs=5)
    assert view.camera.height_m == pytest.approx(1.2, abs=0.08)


def test_the_road_between_two_tar_seams_is_no_line(tmp_path) -> None:
    """Taken for one, it halves the lanes, and the camera is twice as high."""
    seams = [Paint(offset, grey=40, width_m=0.12) for offset in (-0.3, 0.3)]
    for k in range(3):
        image = road((Paint(-1.8, 4, 12), Paint(1.8, 4, 12), *seams), 3.1 * k, seed=k)
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    view, _ = look(unturned(CAMERA), tmp_path, 3.6)
    assert view.camera.height_m == pytest.approx(CAMERA.height_m, rel=0.05)
