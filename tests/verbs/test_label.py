"""`egolane label`: what it writes and says, and what it refuses."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.recordings.ground_truth import read_ground_truth, write_ground_truth
from tests.kits.drives import contents, done, refused, write_drive

LABELS = {
    "beliefs.parquet",
    "events.csv",
    "experiment.yaml",
    "labels.txt",
    "lines.parquet",
    "run.json",
    "scores.json",
    "segments.csv",
}


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """lines.csv, ground_truth.txt beside it, and the labels of it in `labels`."""
    folder = tmp_path_factory.mktemp("label")
    write_drive(folder)
    done("label", folder / "lines.csv", "--n-lanes", 3, "--out", folder / "labels")
    return folder / "lines.csv"


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text())))


def test_it_writes_the_labels_and_the_segments(lines: Path) -> None:
    folder = lines.parent / "labels"
    assert set(contents(folder)) == LABELS
    found = ego.label(lines, n_lanes=3)
    truth = read_ground_truth(folder / "labels.txt")
    for name in ("frame_id", "lane", "is_crossing"):
        assert getattr(truth, name).tolist() == getattr(found.truth, name).tolist()
    rows = table(folder / "segments.csv")
    assert [int(row["frames"]) for row in rows] == found.segments()["frames"].to_list()


def test_its_labels_are_a_ground_truth_for_run(lines: Path, tmp_path: Path) -> None:
    truth = lines.parent / "labels" / "labels.txt"
    yaml = ego.experiments_folder() / "zero_label.yaml"
    words = ("--n-lanes", 3, "--out", tmp_path / "out")
    said = done("run", yaml, "--recording", lines, "--ground-truth", truth, *words).stdout
    is_crossing = read_ground_truth(truth).is_crossing
    assert f"{np.count_nonzero(~is_crossing)} frames scored" in said


def test_its_folder_is_a_run_s_result_too(lines: Path) -> None:
    again = ego.load_result(lines.parent / "labels")
    truth = read_ground_truth(lines.parent / "labels" / "labels.txt")
    assert again.assigned_lane.tolist() == truth.lane.tolist()


def test_with_ground_truth_it_says_how_good_the_labels_are(lines: Path, tmp_path: Path) -> None:
    mine = lines.parent / "labels" / "labels.txt"
    truth = read_ground_truth(mine)
    write_ground_truth(tmp_path / "other.txt", replace(truth, lane=truth.lane % 3 + 1))
    for file, accuracy in ((mine, 1), (tmp_path / "other.txt", 0)):
        words = ("--n-lanes", 3, "--ground-truth", file, "--json", tmp_path / "x.json")
        said = done("label", lines, *words, "--out", tmp_path / "x").stdout
        found = json.loads((tmp_path / "x.json").read_text())
        assert found["scores"]["model"]["accuracy"] == accuracy
        assert f"accuracy {accuracy:.4f}" in said


def test_a_lower_threshold_leaves_fewer_frames_unsure(lines: Path, tmp_path: Path) -> None:
    count = {}
    for below in (0, 0.5, 0.99999):
        done("label", lines, "--n-lanes", 3, "--below", below, "--out", tmp_path / "x")
        count[below] = sum(int(row["frames"]) for row in table(tmp_path / "x" / "segments.csv"))
    assert count[0] == 0
    assert count[0] <= count[0.5] < count[0.99999]


def test_the_recording_of_an_experiment_is_labelled_where_none_is_named(tmp_path: Path) -> None:
    place = ego.experiments_folder() / "zero_label.yaml"
    words = ("--set", "recording.frames=[0, 200]", "--out", tmp_path / "x")
    said = done("label", "--experiment", place, *words).stdout
    assert said.startswith("'zero_label': 200 frames, 3 lanes")


def test_what_cannot_be_labelled_is_refused_in_a_line(lines: Path, tmp_path: Path) -> None:
    here = ("--out", tmp_path / "x")
    assert "needs how many lanes its road has" in refused("label", lines, *here)
    assert "needs a recording" in refused("label", *here)
    assert "no such file" in refused("label", tmp_path / "no.csv", "--n-lanes", 3, *here)
    (tmp_path / "odd.csv").write_text("these are no lines\n")
    assert "odd.csv" in refused("label", tmp_path / "odd.csv", "--n-lanes", 3, *here)
    (tmp_path / "some.txt").write_text("1;5;0\n")
    words = ("--n-lanes", 3, "--ground-truth", tmp_path / "some.txt", *here)
    assert "lane 5 is outside 1..3" in refused("label", lines, *words)
    assert "recording: is empty" in refused("label", "", "--n-lanes", 3, *here)
    assert "--below" in refused("label", lines, "--n-lanes", 3, "--below", 2, *here)
    assert not (tmp_path / "x").exists()
