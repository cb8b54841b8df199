"""The camera found from pictures: chessboards, labelled lines, lines found in stills."""

import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.calibration.chessboard import calibrate_lens, find_board
from egolane_pgm.calibration.drawing import draw_view
from egolane_pgm.calibration.found_lines import find_in_stills
from egolane_pgm.calibration.labels import line_points, read_labels
from egolane_pgm.calibration.parallel_lines import assumed_camera, view_from, view_of_road
from egolane_pgm.calibration.pictures import matching
from egolane_pgm.camera import (
    Camera,
    distorted,
    image_to_road,
    read_camera,
    road_to_image,
    undistorted,
    vanishing_point,
)
from egolane_pgm.cli import egolane
from egolane_pgm.types import InputError

LENS = (-0.25, 0.02, -0.0006, 0.0002, 0.0)
TRUE = Camera(
    1280, 720, 1100.0, 1095.0, 650.0, 370.0, height_m=1.4, pitch_deg=-2.0, yaw_deg=1.0,
    distortion=LENS,
)  # fmt: skip

cameras = st.builds(
    Camera,
    st.just(1280),
    st.just(720),
    st.floats(900, 1300),
    st.floats(900, 1300),
    st.floats(600, 700),
    st.floats(330, 400),
    height_m=st.floats(1.0, 2.8),
    pitch_deg=st.floats(-4, 3),
    yaw_deg=st.floats(-4, 4),
    roll_deg=st.floats(-3, 3),
    distortion=st.sampled_from([(0.0,) * 5, LENS]),
)


@pytest.fixture(scope="session")
def pictures() -> Path:
    """The folder of real pictures."""
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "camera"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("real pictures: needs EGOLANE_DATA with a folder camera")
    return folder


def unturned(camera: Camera) -> Camera:
    """What is known before the road is looked at: lens and roll."""
    return replace(camera, height_m=1.0, pitch_deg=0.0, yaw_deg=0.0)


def lines_of(camera: Camera, offsets, heading=0.0, curvature=0.0, noise=0.0, seed=0):
    """The points of parallel lines, pixels, as somebody would label them."""
    x = np.geomspace(5, 60, 60)
    rng = np.random.default_rng(seed)
    lines = []
    for offset in offsets:
        y = offset + heading * x + curvature * x**2 / 2
        points = np.stack(road_to_image(camera, x, y), axis=-1)
        points += rng.normal(0, noise, points.shape)
        inside = (points >= 0).all(axis=1) & (points < (camera.width, camera.height)).all(axis=1)
        lines.append(points[inside])
    return lines


@cache
def _rays(camera: Camera):
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    u, v = undistorted(camera, u, v)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0 * u + 1], -1)


def draw_board(camera: Camera, turn, place):
    """A chessboard of 9x6 inner corners, 30 mm squares, seen through a lens."""
    rays = _rays(camera)
    rotation = cv2.Rodrigues(np.array(turn, dtype=np.float64))[0]
    normal = rotation[:, 2]
    where = rays * ((normal @ place) / (rays @ normal))[..., None] - place
    column, row = (where @ rotation[:, i] / 0.03 + n / 2 for i, n in ((0, 10), (1, 7)))
    dark = (np.floor(column) + np.floor(row)) % 2 == 0
    board = (column >= 0) & (column < 10) & (row >= 0) & (row < 7)
    grey = np.where(board & dark, 40, 220).astype(np.uint8)
    return cv2.cvtColor(cv2.GaussianBlur(grey, (0, 0), 0.8), cv2.COLOR_GRAY2BGR)


@pytest.fixture(scope="module")
def boards(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("boards")
    rng = np.random.default_rng(3)
    for k in range(10):
        turn = rng.uniform(-0.5, 0.5, 3)
        place = np.array([rng.uniform(-0.09, 0.09), rng.uniform(-0.04, 0.04), 0.42])
        cv2.imwrite(str(folder / f"{k}.png"), draw_board(TRUE, turn, place))
    return folder


def draw_road(camera: Camera, offsets, heading=0.0, seed=0):
    """A grey road with bright markings, dashed but for the outer ones, under a dark sky."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    x, y = image_to_road(camera, u, v)
    paint = np.zeros(x.shape, dtype=bool)
    with np.errstate(invalid="ignore"):
        for k, offset in enumerate(offsets):
            solid = k in (0, len(offsets) - 1)
            on = np.abs(y - offset - heading * x) < 0.08
            paint |= on & (x < 80) & (solid | ((x + 3 * seed) % 12 < 5))
    grey = np.where(np.isfinite(x), 90.0, 40.0) + np.random.default_rng(seed).normal(0, 3, x.shape)
    grey = np.clip(np.where(paint, 210.0, grey), 0, 255).astype(np.uint8)
    return cv2.cvtColor(cv2.GaussianBlur(grey, (0, 0), 0.7), cv2.COLOR_GRAY2BGR)


@pytest.fixture(scope="module")
def stills(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("stills")
    for k, shift in enumerate((0.0, 0.3, -0.4)):
        offsets = np.array([-5.55, -1.85, 1.85, 5.55]) + shift
        cv2.imwrite(str(folder / f"{k}.png"), draw_road(TRUE, offsets, 0.004 * (k - 1), k))
    return folder


def calibrate(*arguments):
    return CliRunner().invoke(egolane, ["calibrate", *map(str, arguments)])


def write_labels(path: Path, camera: Camera, n_frames=4, offsets=(-5.4, -1.8, 1.8, 5.4)):
    rows = list(range(240, 720, 10))
    with path.open("w") as file:
        for k in range(n_frames):
            lanes = []
            for line in lines_of(camera, np.array(offsets) + 0.2 * k, 0.003 * (k - 1.5)):
                line = line[np.argsort(line[:, 1])]
                at = np.interp(rows, line[:, 1], line[:, 0], left=-2, right=-2)
                lanes.append([float(value) for value in at])
            frame = {"lanes": lanes, "h_samples": rows, "raw_file": f"{k}.jpg"}
            file.write(json.dumps(frame) + "\n")


# --- the lens ---


def test_a_lens_is_recovered_from_drawn_chessboards(boards):
    lens = calibrate_lens(sorted(boards.iterdir()))
    assert (lens.width, lens.height) == (1280, 720)
    assert (lens.fx, lens.fy) == pytest.approx((TRUE.fx, TRUE.fy), rel=0.01)
    assert (lens.cx, lens.cy) == pytest.approx((TRUE.cx, TRUE.cy), abs=12)
    assert len(lens.rms_px) == len(lens.boards) >= 8
    assert max(lens.rms_px) < 0.3
    # The bend at the picture's border matters, its coefficients trade with each other.
    found = Camera(1280, 720, lens.fx, lens.fy, lens.cx, lens.cy, 1.0, distortion=lens.distortion)
    edge = np.array([100.0, 1180.0]), np.array([360.0, 360.0])
    rays = [(undistorted(c, *edge)[0] - c.cx) / c.fx for c in (found, TRUE)]
    assert np.diff(rays[0]) == pytest.approx(np.diff(rays[1]), rel=0.01)


def test_pictures_that_cannot_be_used_are_left_out_with_one_line_each(boards, tmp_path):
    for path in sorted(boards.iterdir())[:6]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "x_text.jpg").write_text("no picture")
    cv2.imwrite(str(tmp_path / "x_empty.png"), np.full((720, 1280, 3), 128, np.uint8))
    cv2.imwrite(str(tmp_path / "x_small.png"), np.full((480, 640, 3), 128, np.uint8))
    part = cv2.imread(str(tmp_path / "0.png"))
    corners = find_board(part, 9, 6)
    part[int(np.median(corners[:, 1])) :] = 220
    cv2.imwrite(str(tmp_path / "x_part.png"), part)
    lens = calibrate_lens(sorted(tmp_path.iterdir()))
    said = {line.split(": ")[0].rsplit("/", 1)[1]: line for line in lens.skipped}
    assert "no picture" in said["x_text.jpg"]
    assert "no chessboard" in said["x_empty.png"]
    assert "640x480, most are 1280x720" in said["x_small.png"]
    assert "inner corners seen, not 9x6" in said["x_part.png"]
    assert "x_part.png" not in lens.boards


def test_too_few_chessboards_are_refused(boards):
    with pytest.raises(InputError, match=r"3 of 3 pictures show the whole chessboard.*needs 5"):
        calibrate_lens(sorted(boards.iterdir())[:3])


def test_a_board_with_other_corners_than_said_is_named(boards):
    with pytest.raises(InputError, match=r"[01] of 6 .*8x6.*--board"):
        calibrate_lens(sorted(boards.iterdir())[:6], columns=8)


def test_without_any_chessboard_the_first_reason_is_said(stills):
    with pytest.raises(InputError, match=r"0 of 3 pictures.*no chessboard found"):
        calibrate_lens(sorted(stills.iterdir()))


# --- labelled lines ---


@settings(deadline=None, max_examples=25)
@given(cameras, st.floats(-0.02, 0.02), st.floats(-0.001, 0.001), st.integers(0, 99))
def test_any_camera_is_recovered_from_labelled_lines(camera, heading, curvature, seed):
    offsets = np.array([-5.4, -1.8, 1.8, 5.4])
    frames = [
        lines_of(camera, offsets + shift, heading * sign, curvature * sign, 0.3, seed + k)
        for k, (shift, sign) in enumerate(((0.0, 1), (0.3, -1), (-0.3, 1), (0.1, -1)))
    ]
    view = view_of_road(unturned(camera), frames, 3.6)
    assert view.camera.height_m == pytest.approx(camera.height_m, rel=0.02)
    assert view.camera.pitch_deg == pytest.approx(camera.pitch_deg, abs=0.15)
    assert view.camera.yaw_deg == pytest.approx(camera.yaw_deg, abs=0.3)
    assert view.camera.roll_deg == camera.roll_deg


def test_offsets_hardly_depend_on_the_focal_length_assumed():
    camera = replace(TRUE, distortion=(0.0,) * 5)
    frames = [lines_of(camera, np.array([-5.4, -1.8, 1.8, 5.4]) + d) for d in (0.0, 0.4)]
    points = np.concatenate(lines_of(camera, [-2.0, 1.5]))
    offsets = []
    for degrees in (45.0, 60.0, 80.0):
        view = view_of_road(assumed_camera(1280, 720, degrees), frames, 3.6)
        offsets.append(image_to_road(view.camera, *points.T)[1])
    assert np.abs(offsets[0] - offsets[2]).max() < 0.05


def test_a_bend_moves_the_vanishing_point_but_not_the_horizon():
    frames = [lines_of(TRUE, [-5.4, -1.8, 1.8], curvature=1 / 600)] * 2
    view = view_of_road(unturned(TRUE), frames, 3.6)
    assert view.vanishing_point[1] == pytest.approx(vanishing_point(TRUE)[1], abs=1.0)
    assert view.vanishing_point[0] == pytest.approx(vanishing_point(TRUE)[0], abs=8.0)


def test_a_line_left_unlabelled_does_not_double_the_height():
    frames = [lines_of(TRUE, offsets) for offsets in ([-5.4, -1.8, 1.8], [-1.8, 1.8], [-5.4, 1.8])]
    view = view_of_road(unturned(TRUE), frames, 3.6)
    assert view.camera.height_m == pytest.approx(TRUE.height_m, rel=0.01)
    assert (~view.is_lane).sum() == 1


def test_the_spread_of_the_vanishing_point_is_reported():
    def spread(size):
        frames = [lines_of(TRUE, [-1.8, 1.8], size * k) for k in (-2, -1, 0, 1, 2)]
        return view_of_road(unturned(TRUE), frames, 3.6).spread_px[0]

    assert spread(0.0) < 0.1
    assert spread(0.01) == pytest.approx(0.01 * TRUE.fx * 1.36, rel=0.05)


def test_too_few_lines_are_refused():
    with pytest.raises(InputError, match="none of 2 frames has two lines"):
        view_of_road(unturned(TRUE), [lines_of(TRUE, [1.8])] * 2, 3.6)


def test_a_lane_width_of_kilometres_is_refused():
    with pytest.raises(InputError, match="lane width 3700: lanes are 2 to 6 m wide"):
        view_of_road(unturned(TRUE), [lines_of(TRUE, [-1.8, 1.8])], 3700.0)


def test_lines_that_do_not_meet_are_refused():
    v = np.linspace(300, 700, 40)
    upright = [np.stack([np.full_like(v, u), v], axis=-1) for u in (300.0, 600.0, 900.0)]
    camera = assumed_camera(1280, 720)
    with pytest.raises(InputError, match=r"do not meet|no frame has two lines that meet"):
        view_of_road(camera, [upright], 3.6)
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(8):
        ends = rng.uniform(200, 1000, (3, 2))
        frames.append([np.stack([np.linspace(a, b, 40), v], axis=-1) for a, b in ends])
    with pytest.raises(InputError, match=r"meet"):
        view_of_road(camera, frames, 3.6)


def test_a_horizon_outside_the_picture_is_refused():
    camera = replace(TRUE, pitch_deg=-25.0, distortion=(0.0,) * 5)
    with pytest.raises(InputError, match=r"outside the picture.*horizon must be in it"):
        view_of_road(unturned(camera), [lines_of(camera, [-1.8, 1.8])] * 2, 3.6)


def test_lines_too_near_to_each_other_for_lanes_are_refused():
    frames = [lines_of(TRUE, [-0.1, 0.35])] * 2
    with pytest.raises(InputError, match="check the lane width"):
        view_of_road(unturned(TRUE), frames, 3.6)


def test_a_field_of_view_no_lens_has_is_refused():
    with pytest.raises(InputError, match=r"field of view 0\.9 is not between 10 and 150"):
        assumed_camera(1280, 720, 0.9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no labelled frame"),
        ("{", "line 1: is not JSON"),
        ("3", "line 1: has no raw_file"),
        ('{"raw_file": "a", "lanes": [[1]]}', "line 1: has no h_samples"),
        ('{"raw_file": "a", "lanes": [[1, 2]], "h_samples": [1]}', "has 2 values for 1 h_samples"),
        ('{"raw_file": "a", "lanes": [["a"]], "h_samples": [1]}', "lane 1"),
    ],
)
def test_labels_that_are_none_are_named_with_their_line(tmp_path, text, said):
    (tmp_path / "labels.jsonl").write_text(text)
    with pytest.raises(InputError, match=f"labels.jsonl: .*{said}|labels.jsonl: {said}"):
        read_labels(tmp_path / "labels.jsonl")


# --- lines found in stills ---


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


def test_stills_of_another_size_and_no_pictures_are_left_out_with_a_line_each(stills, tmp_path):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((100, 100, 3), np.uint8))
    text = tmp_path / "text.png"
    text.write_text("no picture")
    found = find_in_stills(unturned(TRUE), [small, text, *sorted(stills.iterdir())])
    assert len(found.paths) == 3
    assert found.skipped == (
        f"{small}: 100x100, needs 1280x720",
        f"{text}: is no picture that can be read",
    )
    with pytest.raises(InputError, match=r"none of them can be used.*100x100"):
        find_in_stills(unturned(TRUE), [small])


def test_edges_in_all_directions_and_blank_stills_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    paths = []
    for k in range(2):
        image = np.zeros((720, 1280, 3), np.uint8)
        for ends in rng.integers(0, (1280, 720), (150, 2, 2)).tolist():
            cv2.line(image, ends[0], ends[1], (200, 200, 200), 3)
        paths.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(paths[-1]), image)
    with pytest.raises(InputError, match="edges do not meet in one point"):
        find_in_stills(unturned(TRUE), paths)
    cv2.imwrite(str(tmp_path / "blank.png"), np.full((720, 1280, 3), 255, np.uint8))
    with pytest.raises(InputError, match="no straight edges"):
        find_in_stills(unturned(TRUE), [tmp_path / "blank.png"])


def test_the_drawing_lays_its_lanes_over_the_lines(stills):
    path = sorted(stills.iterdir())[1]
    found = find_in_stills(unturned(TRUE), [path])
    view = view_from(unturned(TRUE), found.ahead, found.each, found.fits, 3.7, "stills")
    before = cv2.imread(str(path))
    drawn = draw_view(before, view, [])
    assert (before == cv2.imread(str(path))).all()
    orange = (drawn == (0, 159, 230)).all(axis=-1)
    near = np.argwhere(orange)[:, ::-1]
    y = image_to_road(TRUE, *near.T.astype(float))[1]
    # Without lines the lanes start half a lane to the left.
    off = np.abs((y[np.isfinite(y)] + 1.85 + 1.85) % 3.7 - 1.85)
    assert np.median(off) < 0.15


# --- the command ---


def test_the_command_calibrates_from_chessboards_and_stills(boards, stills, tmp_path):
    out, picture = tmp_path / "cam.yaml", tmp_path / "look.png"
    done = calibrate(
        "--chessboards", boards / "*.png", "--stills", stills, "--lane-width", 3.7,
        "--ignore-below", 700, "--baseline", 0.5, "--picture", picture, "-o", out,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    camera = read_camera(out)
    assert camera.height_m == pytest.approx(TRUE.height_m, rel=0.03)
    assert camera.baseline_m == 0.5
    assert camera.ignore == ((0, 700, 1280, 720),)
    comment = [line for line in out.read_text().splitlines() if line.startswith("#")]
    text = "\n".join(comment)
    for word in ("chessboards (9x6 inner corners) of 10", "px RMS", "meet at", "3.7 m"):
        assert word in text
    assert done.output.count("px RMS\n") >= 8
    assert cv2.imread(str(picture)).shape == (720, 1280, 3)


def test_the_command_calibrates_from_labels_without_their_pictures(tmp_path):
    true = replace(TRUE, distortion=(0.0,) * 5)
    write_labels(tmp_path / "labels.jsonl", true)
    done = calibrate(
        "--lines", tmp_path / "labels.jsonl", "--lane-width", 3.6, "--size", "1280x720",
        "--first", 3, "-o", tmp_path / "cam.yaml",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert read_camera(tmp_path / "cam.yaml").height_m == pytest.approx(1.4, rel=0.02)
    text = (tmp_path / "cam.yaml").read_text()
    assert "field of view of 62 degrees assumed" in text
    assert "first 3 labelled frames" in text


def test_the_size_comes_from_the_labelled_pictures(tmp_path):
    write_labels(tmp_path / "labels.jsonl", TRUE, n_frames=2)
    arguments = ("--lines", tmp_path / "labels.jsonl", "--lane-width", 3.6, "-o", tmp_path / "c")
    for k in range(2):
        missing = calibrate(*arguments)
        assert missing.exit_code == 2
        assert f"{k}.jpg: the image of a label is missing; give --size" in missing.output
        cv2.imwrite(str(tmp_path / f"{k}.jpg"), np.zeros((720, 1280, 3), np.uint8))
    done = calibrate(*arguments)
    assert done.exit_code == 0, done.output
    assert read_camera(tmp_path / "c").width == 1280


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--lane-width", "3.7"], "either --stills of a road or --lines"),
        (["--lane-width", "3.7", "--stills", "nowhere/*.jpg"], "nowhere/*.jpg: no file matches"),
        (["--lane-width", "3700", "--stills", "x"], "lane width 3700: lanes are 2 to 6 m"),
        (["--lane-width", "3.7", "--lines", "none.jsonl"], "none.jsonl: cannot be read"),
        (["--lane-width", "3.7", "--lines", "x", "--size", "big"], "--size: 'big' is not two"),
        (["--lane-width", "3.7", "--stills", "x", "--size", "9x9"], "--size: goes with --lines"),
        (["--lane-width", "3.7", "--stills", "x", "--ignore", "1,2"], "--ignore: '1,2' is not"),
    ],
)
def test_bad_options_are_one_line(tmp_path, arguments, said):
    done = calibrate(*arguments, "-o", tmp_path / "cam.yaml")
    assert done.exit_code == 2
    assert said in done.output
    assert len(done.output.strip().splitlines()) == 1
    assert not (tmp_path / "cam.yaml").exists()


def test_boards_and_road_of_different_sizes_are_refused(boards, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640, 3), np.uint8))
    done = calibrate(
        "--chessboards", boards, "--stills", tmp_path / "a.png", "--lane-width", 3.7,
        "-o", tmp_path / "c.yaml",
    )  # fmt: skip
    assert done.exit_code == 2
    assert "the chessboards are 1280x720, the road's pictures 640x480" in done.output


# --- the camera ---


@given(cameras, st.floats(100, 1180), st.floats(100, 620))
def test_taking_the_lens_away_and_back_changes_nothing(camera, u, v):
    back = distorted(camera, *undistorted(camera, u, v))
    assert np.array(back) == pytest.approx((u, v), abs=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3", "ignore: needs a list of rectangles"),
        ("[[1, 2, 3]]", "is not a list of left, top, right, bottom"),
        ("[[0, 0, 10, 1.5]]", "1.5 is not a whole number"),
        ("[[10, 0, 10, 5]]", "is empty"),
        ("[[a, 0, 10, 5]]", "'a' is not a finite number"),
    ],
)
def test_a_rectangle_to_ignore_that_is_none_is_named(tmp_path, text, said):
    path = tmp_path / "cam.yaml"
    path.write_text(
        f"width: 100\nheight: 100\nfx: 90\nfy: 90\ncx: 50\ncy: 50\nheight_m: 1\nignore: {text}\n"
    )
    with pytest.raises(InputError, match=f"cam.yaml: .*{said}|cam.yaml: {said}"):
        read_camera(path)


# --- real pictures ---


def test_the_camera_of_the_real_chessboards_and_straight_stills(pictures, tmp_path):
    folder = pictures / "carnd"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/carnd")
    lens = calibrate_lens(matching(str(folder / "camera_cal" / "*.jpg")))
    assert (lens.fx, lens.fy) == pytest.approx((1156, 1151), abs=8)
    assert (lens.cx, lens.cy) == pytest.approx((672, 389), abs=8)
    assert len(lens.boards) >= 15
    assert len(lens.boards) + len(lens.skipped) == 20
    assert any("9x5 inner corners seen" in line for line in lens.skipped)
    camera = Camera(
        1280, 720, lens.fx, lens.fy, lens.cx, lens.cy, 1.0,
        distortion=lens.distortion, ignore=((0, 670, 1280, 720),),
    )  # fmt: skip
    stills = matching(str(folder / "test_images" / "straight_lines*.jpg"))
    found = find_in_stills(camera, stills)
    view = view_from(camera, found.ahead, found.each, found.fits, 3.7, "stills")
    assert view.vanishing_point == pytest.approx((639.5, 419.6), abs=3)
    assert view.camera.height_m == pytest.approx(1.25, abs=0.03)
    for lines in found.lines:
        y = np.array([np.median(image_to_road(view.camera, *points.T)[1]) for points in lines])
        width = y[y > 0].min() - y[y < 0].max()
        assert width == pytest.approx(3.7, abs=0.1)


def test_the_camera_of_the_real_labels(pictures):
    if not (pictures / "tusimple_frames").is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/tusimple_frames")
    # The last 55 stay unseen, for detectors.
    frames = read_labels(pictures / "tusimple_frames" / "labels.jsonl")[:55]
    lines = [line_points(frame) for frame in frames]
    view = view_of_road(assumed_camera(1280, 720), lines, 3.66)
    assert view.vanishing_point == pytest.approx((658, 236), abs=6)
    assert view.camera.height_m == pytest.approx(1.68, abs=0.04)


def test_the_camera_of_the_real_lane_change_from_found_lines_only(pictures):
    folder = pictures / "lane_change_right"
    if not folder.is_dir():
        pytest.skip("real pictures: EGOLANE_DATA has no folder camera/lane_change_right")
    masks = ((0, 0, 692, 130), (120, 300, 400, 480), (0, 360, 692, 480))
    camera = replace(assumed_camera(692, 480), ignore=masks)
    found = find_in_stills(camera, matching(str(folder))[::5])
    view = view_from(camera, found.ahead, found.each, found.fits, 3.5, "stills")
    assert view.vanishing_point == pytest.approx((470, 214), abs=5)
    assert view.camera.height_m == pytest.approx(1.2, abs=0.08)
