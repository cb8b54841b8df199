"""From pictures to a recording of lines, as a user meets it: `egolane detect`, and `egolane run` on
a video."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from egolane_pgm.camera.pictures import open_source, read_pictures
from egolane_pgm.experiment import load_experiment
from egolane_pgm.loading import check_sources, load_recording, with_recording
from egolane_pgm.recordings import read_lines
from egolane_pgm.run import run_experiment, save_run
from egolane_pgm.types import InputError
from tests.kits.drives import done, refused
from tests.kits.full_disk import BLIND, drawing
from tests.kits.synthetic_road import CAMERA, images, write_pictures, write_place

N_FRAMES = 16


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drive.avi, cam.yaml and run.yaml."""
    return write_place(tmp_path_factory.mktemp("camera"), N_FRAMES)


def detected(source: object, camera: Path, target: Path, *words: object) -> str:
    return done("detect", source, "--camera", camera, "-o", target, *words).stdout


@pytest.mark.parametrize("extension", ["parquet", "csv"])
def test_detect_writes_a_recording_that_run_takes(
    place: Path, tmp_path: Path, extension: str
) -> None:
    target = tmp_path / f"lines.{extension}"
    said = detected(place / "drive.avi", place / "cam.yaml", target)
    assert f"{N_FRAMES} frames, ids 0 to {N_FRAMES - 1}" in said
    assert "lines per frame" in said
    assert "frames/s" in said
    assert "--set recording.frame_rate=12.5" in said
    log = read_lines(target)
    near = np.abs(log.offset_m[-1][:, None] - [-5.2, -1.7, 1.8]).min(axis=0)
    assert (near < 0.15).all()
    assert log.is_valid[-1].sum() >= 3
    out = done(
        "run", place / "run.yaml", "--recording", target, "--no-figures", "--out", tmp_path / "out"
    )
    assert f"{N_FRAMES} frames" in out.stdout


def test_a_folder_a_glob_and_a_video_give_the_same_lines(place: Path, tmp_path: Path) -> None:
    frames = [picture.image for picture in read_pictures(open_source(place / "drive.avi"), CAMERA)]
    folder = write_pictures(tmp_path / "pictures", frames, "drive_{:d}_left.png")
    logs = []
    for source in (place / "drive.avi", folder, f"{folder}/drive_*.png"):
        detected(source, place / "cam.yaml", tmp_path / "l.csv")
        logs.append((tmp_path / "l.csv").read_text())
    assert logs[0] == logs[1] == logs[2]


def test_parameters_and_a_range_of_frames_reach_the_detector(place: Path, tmp_path: Path) -> None:
    target = tmp_path / "l.csv"
    words = ("--set", "lri_frames=3", "--set", "detector_parameters.lines=2", "--frames", 4, 9)
    detected(place / "drive.avi", place / "cam.yaml", target, *words)
    log = read_lines(target)
    assert log.frame_id.tolist() == [4, 5, 6, 7, 8]
    assert np.nanmax(log.lri) == 3


def test_an_own_detector_is_one_file(place: Path, tmp_path: Path) -> None:
    own = Path(__file__).parents[2] / "examples" / "my_detector.py"
    detected(place / "drive.avi", place / "cam.yaml", tmp_path / "l.csv", "--detector", own)
    assert read_lines(tmp_path / "l.csv").is_valid[-1].sum() == 2


def test_ls_lists_the_detectors() -> None:
    line = next(line for line in done("ls").stdout.splitlines() if line.startswith("detectors"))
    assert {"ml", "mc"} <= set(line.replace(",", " ").split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--detector", "mll"], "unknown name 'mll' (did you mean"),
        (["--set", "lri_frame=3"], "unknown key 'lri_frame' (did you mean 'lri_frames'?)"),
        (["--set", "lri_frames=0"], "lri_frames: 0 must be at least 1"),
        (["--set", "lri_frames"], "write it as key=value"),
        (["--frames", "5", "5"], "is an empty range"),
        (["--frames", "500", "900"], "no frame from 500 to before 900; it has 16 frames"),
        (["--right", "x.avi"], "looks at one camera only"),
        (["-o", "l.txt"], "lines are written as .parquet, .csv, .bag"),
        (["-o", "/proc/no/l.csv"], "cannot be written"),
        (["--camera", "nix.yaml"], "nix.yaml: cannot be read"),
    ],
)
def test_wrong_words_are_refused_in_one_line(
    place: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    given = ["detect", place / "drive.avi", "--camera", place / "cam.yaml"]
    given += ["-o", tmp_path / "l.csv", *words]
    assert message in refused(*given)
    assert not (tmp_path / "l.csv").exists()


def test_run_takes_a_video_and_keeps_what_it_needs_to_run_again(
    place: Path, tmp_path: Path
) -> None:
    assert "ok" in done("validate", place / "run.yaml").stdout
    done("run", place / "run.yaml", "--no-figures", "--out", tmp_path / "out")
    kept = yaml.safe_load((tmp_path / "out/experiment.yaml").read_text())
    assert kept["recording"]["path"] == str(place / "drive.avi")
    assert kept["recording"]["camera"] == str(place / "cam.yaml")
    # The video's own frame rate, where the YAML says none.
    assert kept["recording"]["frame_rate"] == 12.5
    data = json.loads((tmp_path / "out/run.json").read_text())["data"]
    assert [Path(entry["path"]).name for entry in data] == ["drive.avi", "cam.yaml"]
    assert all(len(entry["sha256"]) == 64 for entry in data)
    again = run_experiment(tmp_path / "out/experiment.yaml")
    first = run_experiment(place / "run.yaml")
    np.testing.assert_array_equal(again.beliefs.lane, first.beliefs.lane)
    assert first.recorded.log.time_s[-1] == pytest.approx((N_FRAMES - 1) / 12.5)


def test_run_on_another_video_by_options(place: Path, tmp_path: Path) -> None:
    (tmp_path / "x.yaml").write_text(
        yaml.safe_dump({"name": "x", "recording": {"simulate": "quickstart"}, "n_lanes": 3})
    )
    out = tmp_path / "out"
    words = ["--recording", place / "drive.avi", "--camera", place / "cam.yaml"]
    words += ["--detector", "mc", "--n-lanes", 2, "--no-figures", "--out", out]
    assert "drive: 16 frames, 2 lanes" in done("run", tmp_path / "x.yaml", *words).stdout
    kept = yaml.safe_load((out / "experiment.yaml").read_text())["recording"]
    assert (kept["detector"], kept["frame_rate"]) == ("mc", 12.5)


def test_another_video_of_the_same_kind_keeps_camera_and_detector(place: Path) -> None:
    experiment = load_experiment(place / "run.yaml")
    other = with_recording(experiment, str(place / "other.avi"), None, None).recording
    assert (other.camera, other.detector) == ("cam.yaml", "ml")
    assert "frame_rate" not in other.model_fields_set
    table = with_recording(experiment, str(place / "lines.csv"), None, None).recording
    assert (table.camera, table.detector) == (None, None)


def test_a_folder_of_pictures_has_one_checksum(place: Path, tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "pictures", images(3))
    content = yaml.safe_load((place / "run.yaml").read_text())
    content["recording"] = {
        "path": "pictures",
        "camera": str(place / "cam.yaml"),
        "detector": str(Path(__file__).parents[2] / "examples/my_detector.py"),
        "frames": [1, 3],
    }
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(content))
    first = run_experiment(tmp_path / "run.yaml")
    assert first.recorded.log.frame_id.tolist() == [1, 2]
    save_run(first, tmp_path / "out")
    data = json.loads((tmp_path / "out/run.json").read_text())["data"]
    assert [Path(e["path"]).name for e in data] == ["pictures", "cam.yaml", "my_detector.py"]
    assert data[0]["files"] == 3
    cv2.imwrite(str(folder / "0.png"), images(2)[1])
    save_run(run_experiment(tmp_path / "run.yaml"), tmp_path / "out")
    changed = json.loads((tmp_path / "out/run.json").read_text())["data"]
    assert changed[0]["sha256"] != data[0]["sha256"]
    run_experiment(tmp_path / "out/experiment.yaml")


def test_a_frame_rate_that_is_not_the_video_s_is_said(place: Path) -> None:
    experiment = load_experiment(place / "run.yaml", ["recording.frame_rate=25"])
    run = run_experiment(experiment)
    assert run.experiment.recording.frame_rate == 25
    assert any("the video has 12.5 frames per second" in note for note in run.notes)


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        ({"detector": "mll"}, "recording.detector: unknown name 'mll'"),
        (
            {"detector_parameters": {"lri_frame": 3}},
            "recording.detector_parameters: unknown key 'lri_frame' (did you mean 'lri_frames'?)",
        ),
        ({"camera": None}, "recording.camera: is missing"),
        ({"camera": "nix.yaml"}, "recording.camera: nix.yaml: no such file"),
        ({"path": "nix.mp4"}, "recording.path: nix.mp4: no such file"),
        ({"path": "*.jpg"}, "recording.path: "),
        ({"path": "cam.yaml"}, "is no video that can be read"),
        ({"right": "drive.avi"}, "recording.right: detector ml looks at one camera only"),
        ({"format": "table"}, "recording.format: does not go with a detector"),
        ({"detector": None}, "is a video: say which detector looks at it"),
    ],
)
def test_what_does_not_fit_is_said_with_its_key_by_validate_and_run(
    place: Path, tmp_path: Path, recording: dict[str, object], message: str
) -> None:
    content = yaml.safe_load((place / "run.yaml").read_text())
    content["recording"] = {**content["recording"], **recording}
    bad = place / f"bad_{tmp_path.name}.yaml"
    bad.write_text(yaml.safe_dump(content))
    experiment = load_experiment(bad)
    for check in (check_sources, load_recording):
        with pytest.raises(InputError) as caught:
            check(experiment)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


def test_lines_of_a_folder_that_went_away_are_put_elsewhere(place: Path, tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    own = tmp_path / "own.py"
    own.write_text(BLIND.format(f"shutil.rmtree({str(tmp_path / 'gone')!r})"))
    target = tmp_path / "gone" / "lines.csv"
    said = refused(*drawing(place, "detect", target, "--detector", own))
    assert said.startswith(f"{target}: cannot be written: No such file or directory; the lines are")
    other = Path(said.split(" are in ")[1].removesuffix(" instead"))
    try:
        assert len(read_lines(other)) == N_FRAMES
    finally:
        shutil.rmtree(other.parent)
