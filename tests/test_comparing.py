"""Comparisons: differences are paired, recordings of one drive are resampled together."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.comparing import compare
from egolane_pgm.drives import drive_key
from egolane_pgm.identity import data_files, digest
from egolane_pgm.loading import load_experiment
from egolane_pgm.paper import paper_experiment
from egolane_pgm.result import Result, load_result
from egolane_pgm.runs import open_input, run_input
from egolane_pgm.scoring.bootstrap import bootstrap_interval
from egolane_pgm.scoring.scores import SCORES, Answers
from egolane_pgm.studies.study import run_held_out, run_study
from egolane_pgm.types import InputError
from egolane_pgm.views.comparisons import comparison_text
from tests.conftest import needs_compiler
from tests.kits.drives import geometry, run, simulated, write_drive
from tests.kits.studies import drive_of

accuracy = SCORES["accuracy"].statistic

SIDES = ("sensor_failure", "lane_only")


def sides(seed: int = 0, **keys: Any) -> list[Result]:
    recording = {"simulate": "quickstart", "seed": seed}
    return [run(simulated(g, graph=g, recording=recording, **keys)) for g in SIDES]


@pytest.fixture(scope="module")
def results() -> list[Result]:
    """Two graphs on two recordings."""
    return [*sides(0), *sides(7)]


def interval(row: Any, name: str) -> list[float]:
    return [row[f"{name}{end}"] for end in ("", "_low", "_high")]


def counts_of(result: Result, column: str = "assigned_lane") -> Any:
    assert result.truth is not None
    truth = [result.truth[name].to_numpy() for name in ("true_lane", "is_crossing")]
    answers = Answers(result.node("Lane"), *truth, result.frames[column].to_numpy())
    return SCORES["accuracy"].summands(answers)


def test_a_difference_is_paired_and_to_the_first_side(results: list[Result]) -> None:
    first, second = results[:2]
    found = compare([first, second])
    assert (found.index.name, found.index.to_list()) == ("name", list(SIDES))
    expected = bootstrap_interval([counts_of(second)], accuracy, minus=[counts_of(first)])
    ours = interval(found.loc["lane_only"], "accuracy_difference")
    assert ours == [expected.estimate, expected.low, expected.high]
    alone = bootstrap_interval([counts_of(second)], accuracy)
    ours = interval(found.loc["lane_only"], "accuracy")
    assert ours == [alone.estimate, alone.low, alone.high]
    assert found["accuracy_difference"].isna().to_list() == [True, False]
    assert found["accuracy"].to_list() == [
        pytest.approx(each.scores["model"]["accuracy"]) for each in (first, second)
    ]
    twin = run(simulated("twin", graph="lane_only"))
    same = compare([second, twin]).loc["twin"]
    assert interval(same, "f1_difference") == [0, 0, 0]


def test_a_side_has_the_mean_over_its_recordings(results: list[Result]) -> None:
    found = compare(results, of="graph")
    assert found["recordings"].to_list() == [2, 2]
    for side, graph in enumerate(SIDES):
        for name in ("accuracy", "f1", "log_loss"):
            each = [result.scores["model"][name] for result in results[side::2]]
            assert found.loc[graph, name] == pytest.approx(np.mean(each))
    difference = found.loc["lane_only", "accuracy_difference"]
    assert difference == pytest.approx(found["accuracy"].diff().iloc[1])
    by = compare(results, of="graph", by="recording.seed")
    assert by.index.names == ["recording.seed", "graph"]
    alone = compare(results[2:], of="graph").loc["lane_only"]
    assert by.loc[(7, "lane_only")].to_dict() == alone.to_dict()


def test_recordings_of_one_drive_do_not_count_as_two(tmp_path: Path) -> None:
    """A copy of a recording adds nothing, so the interval stays."""
    paths = [write_drive(tmp_path / name, 700) for name in ("a", "b")]
    found = [run(path, {"name": graph, "graph": graph}) for path in paths for graph in SIDES]
    once, twice = (compare(some, of="graph").loc["lane_only"] for some in (found[:2], found))
    assert twice["recordings"] == 2
    for name in ("accuracy", "accuracy_difference"):
        assert interval(twice, name) == pytest.approx(interval(once, name))
    assert once["accuracy_high"] > once["accuracy_low"]


def test_a_copy_of_the_ground_truth_is_of_the_same_drive(tmp_path: Path) -> None:
    own = load_experiment(write_drive(tmp_path))
    truth = tmp_path / "ground_truth.txt"
    shutil.copy(truth, tmp_path / "copy.txt")
    (tmp_path / "changed.txt").write_text(truth.read_text() + "999999;1;0\n")

    def key(name: str) -> str:
        other = load_experiment(own, {"ground_truth.path": tmp_path / name})
        return drive_key(other, list(map(digest, data_files(other))))

    assert key("copy.txt") == key("ground_truth.txt") != key("changed.txt")


def test_the_detector_is_a_side_of_its_own(results: list[Result]) -> None:
    found = compare(results, of="graph", detector=True)
    assert found.index.to_list() == [*SIDES, "detector alone"]
    detector = found.loc["detector alone"]
    each = [result.scores["detector"]["accuracy"] for result in results[::2]]
    assert detector["accuracy"] == pytest.approx(np.mean(each))
    minus = [counts_of(result) for result in results[::2]]
    mine = [counts_of(result, "detector_lane") for result in results[::2]]
    expected = bootstrap_interval(mine, accuracy, minus=minus, seeds=[0, 1])
    ours = interval(detector, "accuracy_difference")
    assert ours == pytest.approx([expected.estimate, expected.low, expected.high])


def test_untrusted_labels_are_not_compared(results: list[Result]) -> None:
    first, second = sides(0, fit={"method": "learn", "untrusted_frames": [[900, None]]})
    opened = [open_input(each.experiment) for each in (first, second)]
    held_out = [run_input(each, n_blocks=3) for each in opened]
    found = compare(held_out, of="graph")
    for result in held_out:
        assert result.scores["model"]["frames_scored"] < len(result)
        right = result.scores["model"]["accuracy"]
        assert found.loc[result.experiment.graph, "accuracy"] == pytest.approx(right)
    assert found["tuned_on"].to_list() == ["other_frames"] * 2


# --- log evidence --------------------------------------------------------------------------------


def test_log_evidence_is_compared_over_the_frames_that_all_have(results: list[Result]) -> None:
    """The interval is that of the block bootstrap, BIC is computed by hand."""
    changes = {"name": "other", "graph": "wor_on_lane", "recording.frames": [100, 1100]}
    changes["parameters.p3"] = [0.5, 0.6, 0.7, 0.8]
    first, second = results[0], run(results[0].experiment, changes)
    second.frames.loc[[150, 160], "is_impossible"] = True
    blind = [replace(each, frames=without_truth(each.frames)) for each in (first, second)]
    found = compare(blind)
    assert "accuracy" not in found
    kept = second.frames.index.drop([150, 160])
    each = [result.frames["log_evidence"].loc[kept].to_numpy() for result in (first, second)]
    # Impossible frames keep their place in the blocks.
    is_kept = second.frames.index.isin(kept)
    counts = [np.zeros((1000, 2)), np.zeros((1000, 2))]
    for count, values in zip(counts, each, strict=True):
        count[is_kept] = np.stack([values, np.ones(998)], axis=1)
    ratio = SCORES["log_loss"].statistic
    row = found.loc["other"]
    expected = bootstrap_interval(counts[1:], ratio, minus=counts[:1])
    ours = interval(row, "log_evidence_difference")
    assert ours == pytest.approx([expected.estimate, expected.low, expected.high], abs=1e-12)
    alone = bootstrap_interval(counts[1:], ratio)
    ours = interval(row, "log_evidence")
    assert ours == pytest.approx([alone.estimate, alone.low, alone.high], abs=1e-12)
    # WOR depends on the lane, too.
    sizes = [TABLES, TABLES + 2 * 3]
    assert found["free_parameters"].to_list() == sizes
    right = [e.sum() - k * math.log(998) / 2 for e, k in zip(each, sizes, strict=True)]
    assert found["bic"].to_list() == pytest.approx(right)


#: Of later frames Lane 4 x 3 and SensorState 2; of each state the output 4 x 3, WOR 1.
#: DetectorOutput of a bad sensor is uniform, so its entries are free too.
TABLES = 12 + 2 + 8 * 3 + 2


def without_truth(frames: pd.DataFrame) -> pd.DataFrame:
    return frames.assign(true_lane=pd.NA, is_crossing=pd.NA)


def test_the_free_parameters_of_tables_count_and_held_out_frames_have_no_bic() -> None:
    study = run_study([drive_of(simulated())], "learn", [])
    learned = compare(study.in_sample).iloc[0]
    assert learned["free_parameters"] == TABLES
    network = ego.run(study.in_sample, graph=study.model.network)
    assert network.run["free_parameters"] == TABLES
    held_out = run_held_out([drive_of(simulated(fit={"method": "learn"}))], 2)
    row = compare(held_out).iloc[0]
    assert row["free_parameters"] == learned["free_parameters"]
    assert "bic" not in row
    assert "bic" in learned


def test_log_evidence_of_other_evidence_is_left_empty_with_a_reason(results: list[Result]) -> None:
    first = results[0]
    others: dict[str, dict[str, Any]] = {
        "rule": {"evidence": "line_geometry", "graph": "position_in_lane"},
        "parameter": {"parameters.bonus_value": 5},
        "mode": {"evidence_mode": "hard"},
        "nodes": {"graph": "no_wor"},
    }
    for name, changes in others.items():
        other = run(first.experiment, {"name": name, **changes})
        found = compare([first, other])
        assert "log_evidence" not in found
        text = " ".join(comparison_text(found, "markdown").split())
        assert "log evidence is not compared: the rows differ in evidence rule" in text
    old = {key: value for key, value in first.run.items() if key != "of_rule"}
    reason = compare(replace(first, run=old)).attrs["log_evidence"]
    assert "a result was written by an older version; run it again" in reason


def test_scores_of_lane_changes_are_added(results: list[Result]) -> None:
    both = [run(geometry("one")), run(simulated("two", filter="fixed_lag", lag=9))]
    found = compare(both)
    for result in both:
        within = result.scores["events"]["within"]["1"]
        row = found.loc[result.name]
        assert row["event_precision"] == within["precision"]
        assert row["event_recall"] == within["recall"]
        assert row["event_delay_s"] == result.scores["events"]["delay_s"]["median"]


def test_results_are_found_below_folders_and_named_by_them(
    results: list[Result], tmp_path: Path
) -> None:
    for side, result in zip(("new", "old", "new", "old"), results, strict=True):
        seed = result.experiment.recording.seed
        renamed = load_experiment(result.experiment, {"name": f"d{seed}"})
        run(renamed).save(tmp_path / side / f"d{seed}")
    found = compare([tmp_path / "new", tmp_path / "old"])
    assert (found.index.name, found.index.to_list()) == ("folder", ["new", "old"])
    right = compare(results, of="graph")
    np.testing.assert_array_equal(found["accuracy"], right["accuracy"])
    one = load_result(tmp_path / "new" / "d0")
    assert len(compare(one)) == len(compare(tmp_path / "new" / "d0")) == 1


def test_what_cannot_be_compared_is_refused(results: list[Result], tmp_path: Path) -> None:
    shorter = run(simulated("short"), {"recording.frames": [0, 300]})
    without = run(simulated("none"), ground_truth="none")
    for given, of, said in (
        (results[:3], "graph", "graph lane_only: has other recordings, frames or labels"),
        ([results[0], shorter], "name", "name short: has other recordings, frames or labels"),
        (results[:2], "filter", "assumed_density has two results of one recording, sensor_failure"),
        ([results[0], without], "name", "none: has no ground truth to compare with"),
    ):
        with pytest.raises(InputError, match=said):
            compare(given, of=of)
    with pytest.raises(InputError, match="is not a result directory"):
        compare(tmp_path)


@needs_compiler
def test_the_causal_model_finds_the_lane_changes_of_the_papers_runs(recordings: Path) -> None:
    """A detector on either road; Spain counts before frame 9577."""
    scores = []
    for number in (1, 9):
        paper = load_experiment(paper_experiment(number))
        model = load_experiment("zero_label").model_dump(exclude_unset=True)
        keys = {"recording", "ground_truth", "n_lanes", "name"}
        content = {**model, **paper.model_dump(include=keys, exclude_unset=True)}
        if number >= 6:
            content["recording"] = {**content["recording"], "frames": [0, 9577]}
        scores.append(run(content).scores["events"])
    right, false, missed = (
        sum(each["within"]["2"][key] for each in scores) for key in ("right", "false", "missed")
    )
    assert right + missed == 109 + 34
    assert right / (right + false) >= 0.98
    assert right / (right + missed) >= 0.98
