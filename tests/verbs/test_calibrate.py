"""The command `egolane calibrate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.vision.camera.model import read_camera
from egolane_pgm.vision.camera.pictures import read_image
from tests.kits.calibration_kit import TRUE, calibrate, write_labels
from tests.kits.drives import contents, done, refused
from tests.kits.synthetic_road import CAMERA as SMALL_CAMERA
from tests.kits.synthetic_road import road, write_video


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
        assert f"{k}.jpg: the image of a label is missing; give its size" in missing.output
        cv2.imwrite(str(tmp_path / f"{k}.jpg"), np.zeros((720, 1280, 3), np.uint8))
    done = calibrate(*arguments)
    assert done.exit_code == 0, done.output
    assert read_camera(tmp_path / "c").width == 1280


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--lane-width", "3.7"], "either stills of a road or lines"),
        (["--lane-width", "3.7", "--stills", "nowhere/*.jpg"], "nowhere/*.jpg: no file matches"),
        (["--lane-width", "3700", "--stills", "x"], "lane width 3700: lanes are 2 to 6 m"),
        (["--lane-width", "3.7", "--lines", "none.jsonl"], "none.jsonl: cannot be read"),
        (["--lane-width", "3.7", "--lines", "x", "--size", "big"], "--size: 'big' is not two"),
        (["--lane-width", "3.7", "--stills", "x", "--size", "9x9"], "--size: goes with lines"),
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


def test_the_command_calibrates_from_a_video(tmp_path: Path) -> None:
    frames = [road(travelled_m=2.3 * k, seed=k) for k in range(12)]
    video = write_video(tmp_path / "drive.avi", [frames[0]] * 3 + frames)
    out, picture = tmp_path / "cam.yaml", tmp_path / "look.png"
    options = ("--lane-width", 3.5, "--field-of-view", 63.2, "-o", out)
    told = done("calibrate", "--stills", video, *options, "--picture", picture).output
    assert "12 of 12 frames taken from" in told
    assert "12 of 12 frames taken from" in out.read_text()
    camera = read_camera(out)
    assert camera.height_m == pytest.approx(SMALL_CAMERA.height_m, rel=0.04)
    assert camera.pitch_deg == pytest.approx(SMALL_CAMERA.pitch_deg, abs=0.25)
    assert picture.exists()
    told = refused("calibrate", "--stills", video, *options, "--first", 3)
    assert "--first: goes without a video" in told


def on_labels(labels: Path, *words: object) -> tuple[object, ...]:
    return ("calibrate", "--lane-width", 3.5, "--lines", labels, *words)


def test_what_calibrate_reads_is_not_written_over(labels: Path) -> None:
    before = contents(labels.parent)
    assert refused(*on_labels(labels, "-o", labels)) == f"{labels}: is read here; name another file"
    still = labels.parent / "pics" / "frame_000001.png"
    said = refused(
        "calibrate", "--lane-width", 3.5, "--stills", still.parent, "--picture", still,
        "-o", labels.with_name("new.yaml"),
    )  # fmt: skip
    assert said == f"{still}: is read here; name another file"
    assert contents(labels.parent) == before


def test_a_size_that_the_pictures_do_not_have_is_refused(labels: Path) -> None:
    target = labels.with_name("new.yaml")
    picture = labels.parent / "pics" / "frame_000000.png"
    said = refused(*on_labels(labels, "-o", target, "--size", "960x540"))
    assert said == f"--size: {picture} is 480x270, not 960x540"
    for file in picture.parent.iterdir():
        file.unlink()
    said = refused(*on_labels(labels, "-o", target, "--size", "480x200"))
    assert (
        said == f"--size: the lines of {labels} reach down to row 265, below a picture of 480x200"
    )
    assert not target.exists()
    done(*on_labels(labels, "-o", target, "--size", "480x270"))
    assert read_camera(target).height_m == pytest.approx(SMALL_CAMERA.height_m, rel=0.05)


def test_calibrate_makes_the_folders_that_its_files_need(labels: Path) -> None:
    camera, picture = labels.parent / "a" / "b" / "cam.yaml", labels.parent / "c" / "grid.png"
    done(*on_labels(labels, "-o", camera, "--picture", picture))
    assert read_camera(camera).width == SMALL_CAMERA.width
    assert read_image(picture).shape == (SMALL_CAMERA.height, SMALL_CAMERA.width, 3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--picture", "grid.txt"), "grid.txt: a picture's name ends in .png or .jpg or .jpeg"),
        (("--ignore", "0,300,480,400"), "--ignore: 0,300,480,400 is not in a picture of 480x270"),
        (("--ignore", "480,0,500,90"), "--ignore: 480,0,500,90 is not in a picture of 480x270"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(
    labels: Path, words: tuple[str, ...], said: str
) -> None:
    target = labels.with_name("new.yaml")
    assert refused(*on_labels(labels, "-o", target, *words)) == said
    assert not target.exists()
