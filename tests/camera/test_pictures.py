"""Pictures of one or two cameras, and files that are no pictures, through the commands of a
user."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
import weakref
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.camera.model import write_camera
from egolane_pgm.camera.picture import Image
from egolane_pgm.camera.pictures import open_source, read_pictures
from egolane_pgm.recordings import read_lines
from egolane_pgm.types import InputError
from tests.kits.drives import command, done, refused
from tests.kits.synthetic_road import (
    CAMERA,
    PAIR,
    drive,
    images,
    write_pictures,
    write_place,
    write_video,
)

N_FRAMES = 16


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drive.avi, cam.yaml and run.yaml."""
    return write_place(tmp_path_factory.mktemp("camera"), N_FRAMES)


def detected(source: object, camera: Path, target: Path, *words: object) -> str:
    return done("detect", source, "--camera", camera, "-o", target, *words).stdout


def test_a_file_that_is_no_video_is_refused(place: Path, tmp_path: Path) -> None:
    for name, content in (("text.mp4", b"hello" * 100), ("zeros.avi", bytes(4096))):
        (tmp_path / name).write_bytes(content)
        words = (
            "detect",
            tmp_path / name,
            "--camera",
            place / "cam.yaml",
            "-o",
            tmp_path / "l.csv",
        )
        assert "is no video that can be read" in refused(*words)
    (tmp_path / "empty.mp4").touch()
    with pytest.raises(InputError, match=r"empty\.mp4: the file is empty"):
        open_source(tmp_path / "empty.mp4")
    with pytest.raises(InputError, match=r"nowhere\.mp4: no such video, folder or pictures"):
        open_source(tmp_path / "nowhere.mp4")
    with pytest.raises(InputError, match="has no pictures"):
        open_source(tmp_path / "*.png")
    with pytest.raises(InputError, match="has no pictures"):
        open_source(tmp_path)
    words = ("detect", "", "--camera", place / "cam.yaml", "-o", tmp_path / "l.csv")
    assert "the path is empty" in refused(*words)


def test_a_video_that_breaks_off_gives_what_was_there_and_one_warning(
    place: Path, tmp_path: Path
) -> None:
    whole = (place / "drive.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: int(len(whole) * 0.6)])
    ran = command(
        "detect", tmp_path / "cut.avi", "--camera", place / "cam.yaml", "-o", tmp_path / "l.csv"
    )
    assert ran.exit_code == 0, ran.stderr
    said = [line for line in ran.stderr.splitlines() if line.startswith("warning")]
    assert len(said) == 1
    assert "breaks off in frame" in said[0]
    log = read_lines(tmp_path / "l.csv")
    assert 5 < len(log) < N_FRAMES
    # The half picture at the end is not among those used: all are as in the whole video.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        used = list(read_pictures(open_source(tmp_path / "cut.avi"), CAMERA))
    for one, other in zip(
        used, read_pictures(open_source(place / "drive.avi"), CAMERA), strict=False
    ):
        np.testing.assert_array_equal(one.image, other.image)
    assert len(used) == len(log)


def test_pictures_of_another_size_are_refused_with_both_sizes(place: Path, tmp_path: Path) -> None:
    small = write_video(tmp_path / "small.avi", [image[:200] for image in images(3)])
    words = ("detect", small, "--camera", place / "cam.yaml", "-o", tmp_path / "l.csv")
    said = refused(*words)
    assert "frame 0: the picture has 480x200 pixels" in said
    assert "calibrated for 480x270" in said


def test_a_picture_that_cannot_be_used_keeps_the_lines_of_those_before(
    place: Path, tmp_path: Path
) -> None:
    folder = write_pictures(tmp_path / "pictures", images(8))
    (folder / "5.png").write_bytes(b"no picture")
    target = tmp_path / "l.csv"
    said = refused("detect", folder, "--camera", place / "cam.yaml", "-o", target)
    assert "5.png: is no picture that can be read" in said
    assert f"the lines of the frames before are in {target}" in said
    assert read_lines(target).frame_id.tolist() == [0, 1, 2, 3, 4]
    assert cv2.imwrite(str(folder / "5.png"), images(1)[0][:100])
    assert "frame 5: the picture has" in refused(
        "detect", folder, "--camera", place / "cam.yaml", "-o", target
    )


def test_the_order_of_pictures_is_natural_and_their_id_the_number_that_counts(
    tmp_path: Path,
) -> None:
    blank = np.zeros((4, 4, 3), dtype=np.uint8)
    cases = {
        "a": (["cam2_img_9.png", "cam2_img_10.png", "cam2_img_100.png"], [9, 10, 100]),
        "b": (["000180_20.png", "000200_20.png"], [180, 200]),
        "c": (["left.png", "right.png"], [0, 1]),
        "d": (["1_5.png", "2_5.png", "3.png"], [0, 1, 2]),
        "e": (["7.png"], [0]),
        "f": (["a1²2.png", "a2²2.png"], [1, 2]),
    }
    for folder, (names, ids) in cases.items():
        (tmp_path / folder).mkdir()
        for name in reversed(names):
            cv2.imwrite(str(tmp_path / folder / name), blank)
        (tmp_path / folder / "notes.txt").write_text("no picture")
        source = open_source(tmp_path / folder)
        assert [file.name for file in source.files] == names
        assert source.frame_id == tuple(ids)


@pytest.mark.parametrize("grey", [0, 255])
def test_black_and_white_pictures_have_no_lines(place: Path, tmp_path: Path, grey: int) -> None:
    rng = np.random.default_rng(0)
    noise = rng.integers(-3, 4, (12, CAMERA.height, CAMERA.width, 1))
    blank = np.clip(grey + noise, 0, 255).astype(np.uint8).repeat(3, axis=3)
    write_pictures(tmp_path / "blank", list(blank))
    detected(tmp_path / "blank", place / "cam.yaml", tmp_path / "l.csv")
    log = read_lines(tmp_path / "l.csv")
    assert len(log) == 12
    assert not log.is_valid.any()


def test_a_frozen_camera_is_said_once_and_its_lines_become_invalid(
    place: Path, tmp_path: Path
) -> None:
    moving = images(12)
    folder = write_pictures(tmp_path / "frozen", [*moving, *[moving[-1]] * 14])
    target = tmp_path / "l.csv"
    ran = command("detect", folder, "--camera", place / "cam.yaml", "-o", target)
    assert ran.exit_code == 0
    said = [line for line in ran.stderr.splitlines() if line.startswith("warning")]
    assert len(said) == 1
    assert "frame 14: the picture has not changed for 3 frames" in said[0]
    log = read_lines(target)
    assert log.is_valid[11].any()
    # A picture or two shown twice change nothing (a video converted to another frame rate).
    np.testing.assert_array_equal(log.lri[13], log.lri[11])
    assert not log.is_valid[-1].any()


def test_a_camera_that_looks_at_the_sky_is_refused_before_any_picture(
    place: Path, tmp_path: Path
) -> None:
    write_camera(tmp_path / "sky.yaml", replace(CAMERA, pitch_deg=40.0))
    words = ["detect", place / "drive.avi", "--camera", tmp_path / "sky.yaml"]
    said = refused(*words, "-o", tmp_path / "l.csv")
    assert "pitch_deg" in said
    assert "sky" in said
    said = refused("validate", place / "run.yaml", "--set", f"recording.camera={tmp_path}/sky.yaml")
    assert "sky" in said


def test_ctrl_c_keeps_what_was_detected(place: Path, tmp_path: Path) -> None:
    slow = tmp_path / "slow.py"
    slow.write_text(
        "import time\nfrom egolane_pgm.detectors import ml\nSTEREO = False\n"
        "PARAMETERS = ml.PARAMETERS\n"
        "def start(camera, parameters):\n"
        "    step = ml.start(camera, parameters)\n"
        "    def slow(picture):\n"
        "        lines = step(picture)\n"
        "        print('frame', picture.frame_id, flush=True)\n"
        "        time.sleep(0 if picture.frame_id < 5 else 30)\n"
        "        return lines\n"
        "    return slow\n"
    )
    target = tmp_path / "lines.parquet"
    words = ["detect", place / "drive.avi", "--camera", place / "cam.yaml", "-o", target]
    running = subprocess.Popen(
        [sys.executable, "-c", "from egolane_pgm.cli.main import main; main()"]
        + [str(word) for word in (*words, "--detector", slow)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ},
    )
    assert running.stdout is not None
    assert any(line.startswith("frame 5") for line in running.stdout)
    time.sleep(0.2)
    running.send_signal(signal.SIGINT)
    out, error = running.communicate(timeout=60)
    assert running.returncode == 130, error
    assert f"interrupted; what was detected so far is in {target}" in error
    assert "5 frames, ids 0 to 4" in out
    assert read_lines(target).frame_id.tolist() == [0, 1, 2, 3, 4]


def test_memory_holds_a_picture_or_two_however_long_the_video(place: Path, tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "pictures", images(6))
    for source in (open_source(place / "drive.avi"), open_source(folder)):
        alive: list[weakref.ref[Image]] = []
        for picture in read_pictures(source, CAMERA):
            alive.append(weakref.ref(picture.image))
            del picture
            assert sum(image() is not None for image in alive) <= 1


# --- two cameras ---------------------------------------------------------------------------------

STEREO = """
import numpy as np
from egolane_pgm.detectors import FrameLines
STEREO = True
def start(camera, parameters):
    def step(picture):
        where = float(picture.image.mean()), float(picture.right.mean())
        return FrameLines(np.array([[min(where), 0, 0, 0], [max(where), 0, 0, 0]]),
                          np.ones(2, bool), np.zeros(2, bool), np.ones(2))
    return step
"""


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A folder with left/ and right/ pictures, pair.yaml and stereo.py."""
    pictures = drive(4, stereo=True)
    write_pictures(tmp_path / "left", [p.image for p in pictures], "l_{:d}.png")
    write_pictures(tmp_path / "right", [p.right for p in pictures if p.right is not None])
    write_camera(tmp_path / "pair.yaml", PAIR)
    (tmp_path / "stereo.py").write_text(STEREO)
    return tmp_path


def stereo_words(pair: Path, *words: object) -> list[object]:
    given: list[object] = ["detect", pair / "left", "--camera", pair / "pair.yaml"]
    return [*given, "--detector", pair / "stereo.py", "-o", pair / "l.csv", *words]


def test_a_stereo_detector_gets_the_pictures_of_both_cameras(pair: Path) -> None:
    done(*stereo_words(pair, "--right", pair / "right"))
    left, right = cv2.imread(str(pair / "left/l_2.png")), cv2.imread(str(pair / "right/2.png"))
    expected = sorted([left.mean(), right.mean()])
    log = read_lines(pair / "l.csv")
    np.testing.assert_allclose(log.offset_m[2], expected)
    # Pairs go by position, whatever the names say.
    (pair / "right/0.png").rename(pair / "right/17.png")
    for k in (1, 2, 3):
        (pair / f"right/{k}.png").rename(pair / f"right/{17 + k}.png")
    done(*stereo_words(pair, "--right", pair / "right", "--frames", 2, 3))
    np.testing.assert_allclose(read_lines(pair / "l.csv").offset_m[0], expected)


def test_pairs_that_do_not_match_are_refused(pair: Path) -> None:
    assert "needs the pictures of a second camera" in refused(*stereo_words(pair))
    (pair / "right/3.png").unlink()
    said = refused(*stereo_words(pair, "--right", pair / "right"))
    assert "has 3 pictures" in said
    assert "has 4; the pictures of the two cameras must be equally many" in said
    cv2.imwrite(str(pair / "right/3.png"), np.zeros((100, 100, 3), dtype=np.uint8))
    assert "frame 3: the picture has 100x100" in refused(
        *stereo_words(pair, "--right", pair / "right")
    )
    write_camera(pair / "pair.yaml", CAMERA)
    assert "baseline_m of the camera" in refused(*stereo_words(pair, "--right", pair / "right"))


@pytest.mark.parametrize("shorter", ["left", "right"])
def test_videos_of_two_cameras_of_unequal_length_are_refused(
    pair: Path, monkeypatch: pytest.MonkeyPatch, shorter: str
) -> None:
    """Also where the videos do not say how long they are."""
    frames = images(5)
    sources = {}
    for side in ("left", "right"):
        video = write_video(pair / f"{side}.avi", frames[: 3 if side == shorter else 5])
        sources[side] = replace(open_source(video), n_frames=None)
    with pytest.raises(InputError, match=rf"{shorter}\.avi: ends before"):
        list(read_pictures(sources["left"], PAIR, sources["right"]))
