"""The command `egolane simulate`: lines and rendered pictures."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import Result

from egolane_pgm.experiment import load_experiment
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.results import read_result
from egolane_pgm.vision.camera.model import read_camera
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from egolane_pgm.vision.rendering import files, render
from egolane_pgm.vision.rendering.render import render_frame
from egolane_pgm.vision.rendering.scene import make_scene
from tests.kits.drives import command, contents, done


def simulate(*words: object) -> Result:
    return command("simulate", *words)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rendered")
    result = simulate(
        "a2", "--images", "--stereo", "--png", "--frames", 5, "--seed", 4, "--out", folder
    )
    assert result.exit_code == 0, result.output
    assert "5 frames" in result.output
    return folder


def test_pictures_of_both_cameras_are_read_back_as_rendered(drive: Path) -> None:
    camera = read_camera(drive / "camera.yaml")
    left, right = open_source(drive / "left"), open_source(drive / "right")
    pictures = list(read_pictures(left, camera, right))
    assert [p.frame_id for p in pictures] == list(range(5))
    frame = render_frame(make_scene("a2", 4, 5, stereo=True), 3)
    np.testing.assert_array_equal(pictures[3].image, frame.image)
    assert pictures[3].right is not None
    assert frame.right is not None
    np.testing.assert_array_equal(pictures[3].right, frame.right)


def test_the_truth_on_disk_is_that_of_the_frames(drive: Path) -> None:
    scene = make_scene("a2", 4, 5, stereo=True)
    truth = read_ground_truth(drive / "ground_truth.txt")
    np.testing.assert_array_equal(truth.lane, scene.road.lane)
    log = read_lines(drive / "lines_truth.parquet")
    np.testing.assert_allclose(log.offset_m, scene.road.line_offset_m)
    with (drive / "visibility.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 4
    last = render.frame_truth(scene, 4)
    assert [float(row["visible"]) for row in rows[-4:]] == pytest.approx(last.visible, abs=1e-3)
    assert float(rows[-1]["heading"]) == pytest.approx(last.shape[3, 1], rel=1e-4)
    assert [row["is_continuous"] for row in rows[:4]] == ["1", "0", "0", "1"]


def test_the_drive_says_how_to_run_on_it(drive: Path) -> None:
    said = (drive / "README.md").read_text()
    assert "egolane detect left --right right --camera camera.yaml --detector sl" in said
    assert load_experiment(drive / "experiment.yaml").n_lanes == 3


def test_a_video_has_every_frame(tmp_path: Path) -> None:
    result = simulate("quickstart", "--images", "--video", "--frames", 4, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    video = open_source(tmp_path / "images.mp4")
    pictures = list(read_pictures(video, read_camera(tmp_path / "camera.yaml")))
    assert len(pictures) == 4
    assert video.frame_rate == pytest.approx(10)
    frame = render_frame(make_scene("quickstart", 0, 4), 2)
    assert np.abs(pictures[2].image.astype(float) - frame.image).mean() < 8


def test_what_was_rendered_before_an_interruption_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = render.render_frame

    def interrupted(scene: Any, k: int) -> Any:
        if k == 2:
            raise KeyboardInterrupt
        return real(scene, k)

    monkeypatch.setattr(files, "render_frame", interrupted)
    result = simulate("a4", "--images", "--video", "--frames", 9, "--out", tmp_path)
    assert result.exit_code == 130
    assert f"egolane: interrupted; 2 of 9 frames are in {tmp_path}" in result.output
    assert "half-written" not in result.output
    camera = read_camera(tmp_path / "camera.yaml")
    assert len(list(read_pictures(open_source(tmp_path / "images.mp4"), camera))) == 2
    assert len((tmp_path / "visibility.csv").read_text().splitlines()) == 1 + 2 * 5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("a4", "--video"), "--video: needs images"),
        (("a4", "--images", "--png", "--video"), "--video: goes without png"),
        (("a5", "--images"), "unknown preset 'a5'"),
        (("a4", "--images", "--set", "waer=1"), "did you mean 'wear'"),
        (("a4", "--images", "--set", "seed=1"), "unknown key 'seed'"),
        (("a4", "--images", "--set", "wear=2"), "simulation.wear: 2 is not a probability"),
        (("a4", "--frames", "9" * 12), "simulation.n_frames: 999999999999 must be at most"),
        (("quikstart",), "did you mean 'quickstart'"),
        (("a4", "--set", "cluter=1"), "did you mean 'clutter'"),
        (("a4", "--set", "noise_m"), "write it as key=value"),
        (("a4", "--set", "noise_m=[1"), "not YAML"),
        (("a4", "--set", "seed=3"), "--set: seed is a parameter beside it"),
        (("a4", "--set", "frames=3"), "--set: frames is a parameter beside it"),
        (("a4", "--images", "--n-lanes", "101"), "simulation.n_lanes: 101 must be at most 100"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    result = simulate(*words, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert said in result.output
    assert len(result.output.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_pictures_of_two_drives_are_not_mixed(drive: Path) -> None:
    before = sorted(path.stat().st_mtime_ns for path in drive.rglob("*"))
    result = simulate("a2", "--images", "--stereo", "--frames", 2, "--out", drive)
    assert result.exit_code == 2
    assert result.output == f"egolane: {drive}/left: is not empty; name another folder\n"
    assert sorted(path.stat().st_mtime_ns for path in drive.rglob("*")) == before


def test_a_simulated_drive_is_written_and_runs(tmp_path: Path) -> None:
    words = ("simulate", "a2", "--frames", "120", "--seed", "4", "--set", "miss=0.5")
    shown = done(*words, "--out", tmp_path / "one").stdout
    experiment = tmp_path / "one" / "experiment.yaml"
    assert shown == f"120 frames; try: egolane run {experiment}\n"
    done("run", experiment, "--no-figures", "--out", tmp_path / "result")
    assert read_result(tmp_path / "result").run["frames"] == 120
    done(*words, "--out", tmp_path / "other")
    assert contents(tmp_path / "one") == contents(tmp_path / "other")  # seeded
    truth = read_ground_truth(tmp_path / "one" / "ground_truth.txt")
    assert (truth.lane >= 1).all()
    assert (truth.lane <= 3).all()
    done("simulate", "--frames", "20", "--n-lanes", "2", "--out", tmp_path / "two")
    assert yaml.safe_load((tmp_path / "two" / "experiment.yaml").read_text())["n_lanes"] == 2
