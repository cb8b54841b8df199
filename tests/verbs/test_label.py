"""`egolane label`: its files, its output, and its refusals."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pandas as pd
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
    pd.testing.assert_frame_equal(read_ground_truth(folder / "labels.txt"), found.truth)
    rows = table(folder / "segments.csv")
    assert [int(row["frames"]) for row in rows] == found.segments()["frames"].to_list()
    # The folder is a run's result too.
    again = ego.load_result(folder).frames["assigned_lane"]
    assert again.to_list() == found.truth["true_lane"].to_list()


def test_with_ground_truth_the_labels_are_scored(lines: Path, tmp_path: Path) -> None:
    mine = lines.parent / "labels" / "labels.txt"
    truth = read_ground_truth(mine)
    write_ground_truth(tmp_path / "other.txt", truth.assign(true_lane=truth["true_lane"] % 3 + 1))
    for file, accuracy in ((mine, 1), (tmp_path / "other.txt", 0)):
        words = ("--n-lanes", 3, "--ground-truth", file, "--out", tmp_path / "x")
        output = done("label", lines, *words).stdout
        found = json.loads((tmp_path / "x" / "scores.json").read_text())
        assert found["model"]["accuracy"] == accuracy
        assert f"accuracy {accuracy:.4f}" in output


@pytest.mark.parametrize(
    ("given", "words", "message"),
    [
        ("lines.csv", "", "--n-lanes: is missing: give the number of lanes"),
        ("lines.csv", "--n-lanes 3 --ground-truth {0}/some.txt", "lane 5 is outside 1..3"),
        ("lines.csv", "--n-lanes 3 --below 2", "'--below': 2.0 is not in the range"),
        ("lines.csv", "--n-lanes 3 --set recording.camera={0}/cam.yaml", "cam.yaml"),
    ],
)
def test_a_recording_that_cannot_be_labelled_is_refused_in_a_line(
    lines: Path, tmp_path: Path, given: str, words: str, message: str
) -> None:
    folder = lines.parent
    (folder / "some.txt").write_text("1;5;0\n")
    out = ("--out", tmp_path / "x")
    assert message in refused("label", folder / given, *words.format(folder).split(), *out)
    assert not (tmp_path / "x").exists()
