"""The camera found from lines that are found in stills, and the command `egolane calibrate`."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from egolane_pgm.calibration import road_lines as found_lines
from egolane_pgm.calibration.drawing import draw_view
from egolane_pgm.calibration.road_lines import find_in_stills
from egolane_pgm.calibration.straight_road import FrameFit, to_level, view_from
from egolane_pgm.camera.model import (
    distorted,
    image_to_road,
    read_camera,
    vanishing_point,
)
from egolane_pgm.types import InputError
from tests.kits.calibration_kit import TRUE, calibrate, unturned, write_labels

pytest_plugins = ["tests.kits.calibration_fixtures"]


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


def test_lines_that_meet_far_from_where_the_edges_do_are_not_used(stills, monkeypatch):
    ahead = to_level(TRUE, *np.reshape(distorted(TRUE, *vanishing_point(TRUE)), (2, 1)))[0]
    for away, n_fits in (([0.09, 0.0], 1), ([0.11, 0.0], 0), ([0.0, 0.024], 1), ([0.0, -0.036], 0)):

        def fit(lines, about_b0, away=away):
            # The horizon is looked for about that of all edges.
            assert about_b0 == pytest.approx(ahead[1], abs=0.005)
            return FrameFit(ahead + away, np.array([-1.0, 1.0]), 0.0)

        monkeypatch.setattr(found_lines, "find_lines", lambda *_: [])
        monkeypatch.setattr(found_lines, "fit_frame", fit)
        found = find_in_stills(unturned(TRUE), sorted(stills.iterdir())[:1])
        assert len(found.fits) == n_fits, away


def test_a_still_whose_edges_do_not_meet_is_looked_at_where_those_of_all_do(stills, monkeypatch):
    ahead = to_level(TRUE, *np.reshape(distorted(TRUE, *vanishing_point(TRUE)), (2, 1)))[0]
    meeting = (ahead, np.full((1, 2), np.nan))
    monkeypatch.setattr(found_lines, "meeting_of_stills", lambda *_: meeting)
    found = find_in_stills(unturned(TRUE), sorted(stills.iterdir())[:1])
    assert len(found.lines[0]) >= 3
    assert found.each.shape == (0, 2)


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
