"""The command `egolane simulate`: lines and pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.result import load_result
from egolane_pgm.simulation import simulated_road
from egolane_pgm.vision.camera.model import read_camera
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from egolane_pgm.vision.simulated import draw_frame
from tests.kits.drives import contents, done, refused


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    words = ("a4", "--images", "--frames", 120, "--set", "seed=4", "--out", folder)
    output = done("simulate", *words, "--set", "min_stay_s=2").output
    assert "120 frames; try: egolane detect" in output
    return folder


def test_pictures_show_the_simulated_road(drive: Path) -> None:
    road = simulated_road("a4", 4, 120, min_stay_s=2)
    truth = read_ground_truth(drive / "ground_truth.txt")
    np.testing.assert_array_equal(truth["true_lane"], road.lane)
    camera = read_camera(drive / "camera.yaml")
    pictures = list(read_pictures(open_source(drive / "images"), camera))
    assert [picture.frame_id for picture in pictures] == list(range(120))
    # A JPEG is no exact copy.
    away = pictures[3].image.astype(float) - draw_frame(road, 3)
    assert np.abs(away).mean() < 3


def test_from_simulated_pictures_through_a_detector_to_a_belief(
    drive: Path, tmp_path: Path
) -> None:
    """What somebody without pictures does first."""
    seen = drive / "images", "--camera", drive / "camera.yaml"
    done("detect", *seen, "--detector", "ml", "-o", drive / "lines.parquet")
    done("run", drive / "experiment.yaml", "--no-figures", "--out", tmp_path / "result")
    result = load_result(tmp_path / "result")
    assert result.run["frames"] == 120
    assert result.truth is not None
    assert result.truth["true_lane"].nunique() > 1
    assert result.scores["model"]["accuracy"] > 0.85
    # The lines are where they are: each that is valid lies on one of the road.
    log, road = read_lines(drive / "lines.parquet"), simulated_road("a4", 4, 120, min_stay_s=2)
    frame, slot = np.nonzero(log.is_valid)
    away = np.abs(log.offset_m[frame, slot][:, None] - road.line_offset_m[frame]).min(axis=1)
    assert np.median(away) < 0.05
    assert np.quantile(away, 0.99) < 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("a5", "--images"), "unknown preset 'a5'"),
        (("a4", "--images", "--set", "chnge_s=1"), "did you mean 'change_s'"),
        (("a4", "--frames", "9" * 12), "simulation.n_frames: 999999999999: input"),
        (("a4", "--set", "seed=x"), "seed: 'x' is not a whole number"),
        (("a4", "--images", "--set", "n_lanes=101"), "simulation.n_lanes: 101: input should be"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    assert message in refused("simulate", *words, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_pictures_of_two_drives_are_not_mixed(drive: Path) -> None:
    before = sorted(path.stat().st_mtime_ns for path in drive.rglob("*"))
    output = refused("simulate", "a2", "--images", "--frames", 2, "--out", drive)
    assert output == f"{drive}/images: is not empty; name another folder"
    assert sorted(path.stat().st_mtime_ns for path in drive.rglob("*")) == before


def test_a_simulated_drive_is_written_and_runs(tmp_path: Path) -> None:
    words = ("simulate", "a2", "--frames", "120", "--set", "seed=4", "--set", "miss=0.5")
    shown = done(*words, "--out", tmp_path / "one").stdout
    experiment = tmp_path / "one" / "experiment.yaml"
    assert shown == f"120 frames; try: egolane run {experiment}\n"
    done("run", experiment, "--no-figures", "--out", tmp_path / "result")
    assert load_result(tmp_path / "result").run["frames"] == 120
    done(*words, "--out", tmp_path / "other")
    assert contents(tmp_path / "one") == contents(tmp_path / "other")  # seeded
    truth = read_ground_truth(tmp_path / "one" / "ground_truth.txt")
    assert truth["true_lane"].between(1, 3).all()
    done("simulate", "--frames", "20", "--set", "n_lanes=2", "--out", tmp_path / "two")
    assert yaml.safe_load((tmp_path / "two" / "experiment.yaml").read_text())["n_lanes"] == 2
