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
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate
from tests.kits.bags import line_bag
from tests.kits.drives import contents, done, refused, write_drive

LABELS = {
    "beliefs.parquet",
    "events.csv",
    "experiment.yaml",
    "labels.csv",
    "labels.txt",
    "lines.parquet",
    "review.csv",
    "run.json",
    "scores.json",
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


def test_it_writes_the_labels_the_review_list_and_pictures_of_it(lines: Path) -> None:
    folder = lines.parent / "labels"
    files = set(contents(folder))
    review = table(folder / "review.csv")
    assert {name for name in files if "figures" not in name} == LABELS
    assert len(files - LABELS) == min(len(review), 10)
    truth = read_ground_truth(folder / "labels.txt")
    rows = table(folder / "labels.csv")
    assert truth.frame_id.tolist() == [int(row["frame_id"]) for row in rows]
    assert truth.lane.tolist() == [int(row["lane"]) for row in rows]
    assert truth.is_crossing.tolist() == [row["crossing"] == "1" for row in rows]
    assert all(0 <= float(row["confidence"]) <= 1 for row in rows)
    inside = [
        any(int(r["first_frame"]) <= frame <= int(r["last_frame"]) for r in review)
        for frame in truth.frame_id
    ]
    assert inside == [row["review"] == "1" for row in rows]


def test_its_labels_are_a_ground_truth_for_run(lines: Path, tmp_path: Path) -> None:
    truth = lines.parent / "labels" / "labels.txt"
    yaml = ego.experiments_folder() / "zero_label.yaml"
    words = ("--n-lanes", 3, "--no-figures", "--out", tmp_path / "out")
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
    other = replace(truth, lane=truth.lane % 3 + 1)
    write_ground_truth(tmp_path / "other.txt", other)
    out, said = {}, {}
    for name, file in (("mine", mine), ("other", tmp_path / "other.txt")):
        words = ("--n-lanes", 3, "--below", 0.9, "--no-figures", "--out", tmp_path / name)
        words = (*words, "--ground-truth", file, "--json", tmp_path / f"{name}.json")
        # In 15 s no label gets sure with the smoother's own constants.
        for constant in ("alpha=0.035", "width_wanders=0"):
            words = (*words, "--set", f"parameters.{constant}")
        said[name] = done("label", lines, *words).stdout
        out[name] = json.loads((tmp_path / f"{name}.json").read_text())
    scores = {name: found["scores"] for name, found in out.items()}
    assert set(scores["mine"]["surest"].values()) == {1.0}
    assert set(scores["other"]["surest"].values()) == {0.0}
    assert "| 98%           | 1.0000 |" in said["mine"]
    assert f"{np.count_nonzero(~truth.is_crossing)} annotated frames" in said["mine"]
    assert "contradicts" not in said["mine"]
    assert "in which a sure label contradicts it: doubted.csv" in said["other"]
    assert len(table(tmp_path / "other" / "doubted.csv")) == len(out["other"]["doubted"]) > 0
    assert table(tmp_path / "mine" / "doubted.csv") == out["mine"]["doubted"] == []


def test_a_lower_threshold_leaves_less_to_review(lines: Path, tmp_path: Path) -> None:
    count = {}
    for below in (0, 0.5, 0.99999):
        words = ("--n-lanes", 3, "--below", below, "--no-figures", "--out", tmp_path / "x")
        done("label", lines, *words)
        count[below] = sum(row["review"] == "1" for row in table(tmp_path / "x" / "labels.csv"))
    assert count[0] == 0
    assert count[0] <= count[0.5] < count[0.99999]
    assert not (tmp_path / "x" / "figures").exists()


def test_the_recording_of_an_experiment_is_labelled_where_none_is_named(tmp_path: Path) -> None:
    place = ego.experiments_folder() / "zero_label.yaml"
    words = ("--set", "recording.frames=[0, 200]", "--out", tmp_path / "x", "--no-figures")
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


def test_the_number_of_lanes_is_doubted_where_the_lines_say_otherwise(tmp_path: Path) -> None:
    write_table(tmp_path / "lines.csv", simulate("quickstart", n_lanes=3).log)
    for said, is_doubted in ((3, False), (2, True)):
        words = ("--n-lanes", said, "--no-figures", "--out", tmp_path / "x")
        error = done("label", tmp_path / "lines.csv", *words).stderr
        assert ("the car moves across 3 lanes or more, n_lanes is 2" in error) == is_doubted


def test_a_bag_s_frames_may_be_numbered_by_seq(tmp_path: Path) -> None:
    bag = line_bag(tmp_path / "x.bag", list(range(100, 108)))
    for frame_id, first in (("way_id", 100), ("header.seq", 0)):
        words = ("--n-lanes", 2, "--columns", f"frame_id={frame_id}", "--no-figures")
        done("label", bag, *words, "--out", tmp_path / frame_id)
        assert read_ground_truth(tmp_path / frame_id / "labels.txt").frame_id[0] == first
