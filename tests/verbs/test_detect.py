"""From pictures to a recording of lines, as a user meets it: `egolane detect`, and `egolane run` on
a video."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from egolane_pgm.drives import check_sources, read_drives
from egolane_pgm.loading import load_experiment
from egolane_pgm.recordings import read_lines
from egolane_pgm.result import load_result
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import read_camera, write_camera
from tests.kits.drives import command, done, refused, rewritten, run
from tests.kits.synthetic_road import (
    CAMERA,
    N_FRAMES,
    PAIR,
    drive,
    images,
    write_pictures,
    write_video,
)

STEREO = """
import numpy as np
from egolane_pgm.vision.detectors import FrameLines
STEREO = True
def start(camera, parameters):
    def step(picture):
        where = float(picture.image.mean()), float(picture.right.mean())
        return FrameLines(np.array([[min(where), 0, 0, 0], [max(where), 0, 0, 0]]),
                          np.ones(2, bool), np.zeros(2, bool), np.ones(2))
    return step
"""


def detected(source: object, camera: Path, target: Path, *words: object) -> str:
    return done("detect", source, "--camera", camera, "-o", target, *words).output


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A folder with left/ and right/ pictures, pair.yaml and stereo.py."""
    pictures = drive(4, stereo=True)
    write_pictures(tmp_path / "left", [p.image for p in pictures], "l_{:d}.png")
    write_pictures(tmp_path / "right", [p.right for p in pictures if p.right is not None])
    write_camera(tmp_path / "pair.yaml", PAIR)
    (tmp_path / "stereo.py").write_text(STEREO)
    return tmp_path


def with_right(pair: Path) -> list[object]:
    return stereo_words(pair, "--set", f"recording.right={pair / 'right'}")


def stereo_words(pair: Path, *words: object) -> list[object]:
    given: list[object] = ["detect", pair / "left", "--camera", pair / "pair.yaml"]
    return [*given, "--detector", pair / "stereo.py", "-o", pair / "l.csv", *words]


@pytest.mark.parametrize("extension", ["parquet", "csv"])
def test_detect_writes_a_recording_that_run_takes(
    place: Path, tmp_path: Path, extension: str
) -> None:
    target = tmp_path / f"lines.{extension}"
    output = detected(place / "drive.avi", place / "cam.yaml", target)
    assert f"{N_FRAMES} frames, ids 0 to {N_FRAMES - 1}" in output
    assert "lines per frame" in output
    log = read_lines(target)
    assert log.time_s[-1] == pytest.approx((N_FRAMES - 1) / 12.5)
    near = np.abs(log.offset_m[-1][:, None] - [-5.2, -1.7, 1.8]).min(axis=0)
    assert (near < 0.15).all()
    assert log.is_valid[-1].sum() >= 3
    words = ("--experiment", place / "run.yaml", "--no-figures", "--out", tmp_path / "out")
    assert f"{N_FRAMES} frames" in done("run", target, *words).stdout


def test_parameters_and_a_range_of_frames_reach_the_detector(place: Path, tmp_path: Path) -> None:
    target = tmp_path / "l.csv"
    words = ("--set", "lri_frames=3", "--set", "side_m=8", "--set", "recording.frames=[4,9]")
    detected(place / "drive.avi", place / "cam.yaml", target, *words)
    log = read_lines(target)
    assert log.frame_id.tolist() == [4, 5, 6, 7, 8]
    assert np.nanmax(log.lri) == 3


@pytest.mark.parametrize(
    ("pictures", "words", "message"),
    [
        ("", "--detector mll", "unknown name 'mll' (did you mean"),
        ("", "--set lri_frame=3", "parameters.detector: unknown key 'lri_frame' (did you mean"),
        ("", "--set recording.frames=[500,900]", "no frame from 500 to before 900; it has 16"),
        ("", "--set recording.right=x.avi", "has one camera; leave the second out"),
        ("", "-o l.txt", "lines are written as .parquet, .csv"),
        ("", "--camera nix.yaml", "nix.yaml: no such file"),
        ("", "--camera {0}/sky.yaml", "only 0 % of the road from"),
        ("text.mp4", "", "is not a video that can be read"),
        ("empty.mp4", "", "is not a video that can be read"),
        ("nowhere.mp4", "", "nowhere.mp4: no such file"),
        ("*.png", "", "has no pictures"),
        (".", "", "has no pictures"),
    ],
)
def test_wrong_words_are_refused_in_one_line(
    place: Path, tmp_path: Path, pictures: str, words: str, message: str
) -> None:
    write_camera(tmp_path / "sky.yaml", replace(CAMERA, pitch_deg=40.0))
    (tmp_path / "text.mp4").write_bytes(b"hello" * 100)
    (tmp_path / "empty.mp4").touch()
    given = tmp_path / pictures if pictures else place / "drive.avi"
    out = ("--camera", place / "cam.yaml", "-o", tmp_path / "l.csv")
    assert message in refused("detect", given, *out, *words.format(tmp_path).split())
    assert not (tmp_path / "l.csv").exists()


def test_run_takes_a_video_and_keeps_what_it_needs_to_run_again(
    place: Path, tmp_path: Path
) -> None:
    assert "ok" in done("run", "--dry-run", place / "run.yaml").stdout
    done("run", place / "run.yaml", "--no-figures", "--out", tmp_path / "out")
    kept = yaml.safe_load((tmp_path / "out/experiment.yaml").read_text())
    assert kept["recording"]["path"] == str(place / "drive.avi")
    assert kept["recording"]["camera"] == str(place / "cam.yaml")
    # The video's own frame rate, if the YAML has none.
    assert kept["recording"]["frame_rate"] == 12.5
    data = json.loads((tmp_path / "out/run.json").read_text())["data"]
    assert [Path(entry["path"]).name for entry in data] == ["drive.avi", "cam.yaml"]
    assert all(len(entry["sha256"]) == 64 for entry in data)
    again, first = run(tmp_path / "out/experiment.yaml"), run(place / "run.yaml")
    np.testing.assert_array_equal(again.node("Lane"), first.node("Lane"))
    assert first.frames["time_s"].iloc[-1] == pytest.approx((N_FRAMES - 1) / 12.5)


def test_a_video_without_a_camera_calibrates_itself_once(place: Path, tmp_path: Path) -> None:
    video = Path(shutil.copy(place / "drive.avi", tmp_path))
    words = ("run", video, "--n-lanes", 2, "--no-figures", "--out", tmp_path / "out")
    beside = tmp_path / "drive.avi.camera.yaml"
    assert "ok" in done(*words, "--dry-run").stdout
    assert not beside.exists()
    assert f"{beside}: made from the pictures, for lanes of 3.5 m" in done(*words).stderr
    camera = read_camera(beside)
    assert camera.height_m == pytest.approx(CAMERA.height_m, rel=0.04)
    assert camera.pitch_deg == pytest.approx(CAMERA.pitch_deg, abs=0.5)
    kept = load_result(tmp_path / "out").experiment.recording
    assert (kept.detector, kept.camera, kept.frame_rate) == ("ml", str(beside), 12.5)
    again = done(*words, "--detector", "mc")
    assert "made from" not in again.stderr
    assert "16 frames, 2 lanes" in again.stdout
    # Where the road does not show, and for a file that is not writable, the key is named.
    black = write_video(tmp_path / "black.avi", [np.zeros((270, 480, 3), np.uint8)] * 3)
    message = refused("detect", black, "-o", tmp_path / "l.csv")
    assert "recording.camera: is missing, and cannot be made: " in message
    assert "no straight edges that meet" in message


def test_a_folder_of_pictures_has_one_checksum(place: Path, tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "pictures", images(3))
    recording = {
        "path": "pictures",
        "camera": str(place / "cam.yaml"),
        "detector": str(Path(__file__).parents[2] / "examples/my_detector.py"),
        "frames": [1, 3],
    }
    rewritten(place / "run.yaml", tmp_path / "run.yaml", recording=recording)
    first = run(tmp_path / "run.yaml")
    assert first.frames.index.tolist() == [1, 2]
    data = first.run["data"]
    assert [Path(e["path"]).name for e in data] == ["pictures", "cam.yaml", "my_detector.py"]
    cv2.imwrite(str(folder / "0.png"), images(2)[1])
    assert run(tmp_path / "run.yaml").run["data"][0]["sha256"] != data[0]["sha256"]


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        ({"camera": None}, "recording.camera: is missing"),
        ({"path": "*.jpg"}, "recording.path: "),
        ({"right": "drive.avi"}, "recording.right: detector ml has one camera"),
        ({"format": "table"}, "recording.format: does not go with a detector"),
        ({"detector": None}, "of a video a detector"),
    ],
)
def test_a_key_that_does_not_fit_is_named_by_validate_and_run(
    place: Path, tmp_path: Path, recording: dict[str, object], message: str
) -> None:
    content = yaml.safe_load((place / "run.yaml").read_text())
    content["recording"] = {**content["recording"], **recording}
    bad = place / f"bad_{tmp_path.name}.yaml"
    bad.write_text(yaml.safe_dump(content))
    experiment = load_experiment(bad)
    for check in (check_sources, read_drives):
        with pytest.raises(InputError) as caught:
            check(experiment)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_video_that_breaks_off_gives_what_was_there_and_one_warning(
    place: Path, tmp_path: Path
) -> None:
    whole = (place / "drive.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: int(len(whole) * 0.6)])
    ran = command(
        "detect", tmp_path / "cut.avi", "--camera", place / "cam.yaml", "-o", tmp_path / "l.csv"
    )
    assert ran.exit_code == 0, ran.stderr
    output = [line for line in ran.stderr.splitlines() if line.startswith("warning")]
    assert len(output) == 1
    assert f"of the {N_FRAMES} frames that it should have (cut off, " in output[0]
    assert 5 < len(read_lines(tmp_path / "l.csv")) < N_FRAMES


def test_pictures_of_the_same_aspect_ratio_scale_the_camera_with_one_warning(
    place: Path, tmp_path: Path
) -> None:
    larger = [cv2.resize(image, (960, 540)) for image in images(12)]
    video = write_video(tmp_path / "large.avi", larger)
    target = tmp_path / "l.csv"
    words = ("--camera", place / "cam.yaml", "-o", target)
    ran = done("detect", video, *words)
    [warning] = [line for line in ran.stderr.splitlines() if "960x540" in line]
    assert "cam.yaml was calibrated for 480x270: it is scaled to them" in warning
    seen = read_lines(target).offset_m[-1]
    done("detect", write_video(tmp_path / "as_is.avi", images(12)), *words)
    calibrated = read_lines(target).offset_m[-1]
    assert seen[:3] == pytest.approx(calibrated[:3], abs=0.08)


def test_a_camera_too_high_for_a_lorry_is_doubted_and_used(place: Path, tmp_path: Path) -> None:
    target = tmp_path / "l.csv"
    for height_m, is_doubted in ((2.6, False), (3.6, True)):
        write_camera(tmp_path / "cam.yaml", replace(CAMERA, height_m=height_m))
        output = done(
            *("detect", place / "drive.avi", "--camera", tmp_path / "cam.yaml", "-o", target)
        ).stderr
        assert is_doubted == ("cam.yaml: doubtful: the camera is 3.60 m above the road" in output)
        assert len(read_lines(target)) == N_FRAMES


def test_pictures_without_a_rate_get_the_given_one(place: Path, tmp_path: Path) -> None:
    folder, target = write_pictures(tmp_path / "pictures", images(4)), tmp_path / "l.csv"
    words = ("detect", folder, "--camera", place / "cam.yaml", "-o", target)
    note = "10 pictures per second are assumed (set recording.frame_rate)"
    assert note in done(*words).stderr
    assert read_lines(target).time_s == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert "are assumed" not in done(*words, "--set", "recording.frame_rate=25").stderr
    assert read_lines(target).time_s == pytest.approx([0.0, 0.04, 0.08, 0.12])


def test_a_picture_that_cannot_be_used_keeps_the_lines_of_those_before(
    place: Path, tmp_path: Path
) -> None:
    folder = write_pictures(tmp_path / "pictures", images(8))
    (folder / "3.png").write_bytes(b"no picture")
    target = tmp_path / "l.csv"
    words = ("detect", folder, "--camera", place / "cam.yaml", "-o", target)
    assert "left out 1 of 8 frames whose picture cannot be read, first " in done(*words).stderr
    assert read_lines(target).frame_id.tolist() == [0, 1, 2, 4, 5, 6, 7]
    assert cv2.imwrite(str(folder / "5.png"), images(1)[0][:100])
    message = refused(*words)
    assert "frame 5: a picture of 480x100" in message
    assert f"the lines of the frames before are in {target}" in message
    assert read_lines(target).frame_id.tolist() == [0, 1, 2, 4]


def test_a_stereo_detector_gets_the_pictures_of_both_cameras(pair: Path) -> None:
    done(*with_right(pair))
    left, right = cv2.imread(str(pair / "left/l_2.png")), cv2.imread(str(pair / "right/2.png"))
    expected = sorted([left.mean(), right.mean()])
    log = read_lines(pair / "l.csv")
    np.testing.assert_allclose(log.offset_m[2], expected)


def test_pairs_that_do_not_match_are_refused(pair: Path) -> None:
    assert "needs the pictures of a second camera" in refused(*stereo_words(pair))
    (pair / "right/3.png").unlink()
    output = refused(*with_right(pair))
    assert "have not equally many pictures" in output
    cv2.imwrite(str(pair / "right/3.png"), np.zeros((100, 100, 3), dtype=np.uint8))
    assert "frame 3: a picture of 100x100" in refused(*with_right(pair))
    write_camera(pair / "pair.yaml", CAMERA)
    assert "baseline_m of the camera" in refused(*with_right(pair))
