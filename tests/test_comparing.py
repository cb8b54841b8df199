"""Results side by side: differences are paired, recordings are grouped, and tables and figures show
the document's numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.comparing.compared import compare_results, document, together
from egolane_pgm.comparing.planning import Group, by_recording, compare_groups
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.results import Result, read_result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import bootstrap_interval, confusion_counts
from egolane_pgm.scoring.confusion import accuracy
from egolane_pgm.types import InputError
from egolane_pgm.views.comparison_figures import comparison_figure, differences_figure, draw_all
from egolane_pgm.views.comparison_tables import (
    accuracy_rows,
    full_rows,
    full_tables,
    marks_text,
    search_rows,
    together_tables,
)
from egolane_pgm.views.events import event_comparison_rows
from egolane_pgm.views.tables import page
from tests.conftest import needs_compiler
from tests.kits.drives import command, done, geometry, refused, simulated, write_drive

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]

N_FRAMES = 700


def compared(*experiments: Experiment, events: bool = False) -> list[dict[str, Any]]:
    """What is said of each experiment on the one recording that they share."""
    (part,) = compare_groups(by_recording(experiments), events=events)
    entries: list[dict[str, Any]] = part["experiments"]
    return entries


def test_a_difference_is_paired_and_to_the_first_experiment() -> None:
    first, second = simulated("first"), simulated("second", graph="lane_only")
    entries = compared(first, second)
    assert entries[0]["difference"] is None
    assert entries[1]["difference_to"] == "first"
    counts = []
    for experiment in (second, first):
        run = run_experiment(experiment)
        truth, belief = run.truth, run.beliefs.lane[run.scored]
        assert truth is not None
        counts.append(confusion_counts(assigned_lane(belief), truth.lane, truth.is_crossing, 4))
    expected = bootstrap_interval(counts[:1], accuracy, minus=counts[1:])
    found = entries[1]["difference"]["all_frames"]["accuracy"]
    assert found == [expected.estimate, expected.low, expected.high]
    scores = [e["scores"]["all_frames"]["accuracy"] for e in entries]
    assert found[0] == pytest.approx(scores[1] - scores[0])
    _, twin = compared(first, simulated("twin"))
    assert twin["difference"]["all_frames"]["f1"] == [0, 0, 0]


def test_without_the_frames_that_are_never_fitted_the_scores_are_shown_beside() -> None:
    tuning = {"never_fit": {"from_frame": 900}}
    experiments = [simulated("a"), simulated("b", graph="lane_only", tuning=tuning)]
    entries = compared(*experiments)
    for entry in entries:
        assert list(entry["scores"]) == ["all_frames", "without_never_fit"]
        every, trusted = entry["scores"].values()
        assert trusted["frames"] < every["frames"]
    difference = entries[1]["difference"]
    assert difference["without_never_fit"]["accuracy"] != difference["all_frames"]["accuracy"]


def whole(groups: list[Group], **options: Any) -> dict[str, Any]:
    """The document, without the times that were measured."""
    found = document(compare_groups(groups, **options))
    assert not found["failed"]
    for recording in found["recordings"]:
        for entry in recording["experiments"]:
            assert entry.pop("microseconds_per_frame") > 0
    return found


def _searched(name: str, simulation: int, **keys: Any) -> Experiment:
    recording = {"simulate": "quickstart", "seed": simulation}
    return simulated(name, fit="tune", recording=recording, **keys)


def test_a_search_is_scored_as_a_run_and_recordings_are_taken_together() -> None:
    groups = by_recording(
        [
            _searched(name, k, graph=name, tuning={"trials": 9})
            for k in (0, 7)
            for name in ("lane_only", "no_wor")
        ]
    )
    found = whole(groups, n_blocks=2)
    assert found == whole(groups, n_blocks=2, jobs=2)
    for entry, numbers in zip(found["recordings"][1]["experiments"], (3, 5), strict=True):
        assert (entry["free_parameters"], entry["trials"]) == (numbers, 9)
        searched = _searched("x", 7, graph=entry["name"], tuning={"trials": 9})
        alone = ego.run(searched, held_out=True, blocks=2)
        assert alone.run["parameters_per_block"] == entry["parameters"]
        mine = entry["scores"]["all_frames"]["accuracy"]
        assert mine == pytest.approx(alone.scores["model"]["accuracy"])
    mean = [r["experiments"][1]["scores"]["all_frames"]["f1"] for r in found["recordings"]]
    first, second = found["together"]
    assert (first["difference"], second["recordings"], second["drives"]) == (None, 2, 2)
    assert second["scores"]["f1"][0] == pytest.approx(np.mean(mean))
    low, high = second["difference"]["f1"][1:]
    assert low < second["scores"]["f1"][0] - first["scores"]["f1"][0] < high
    assert search_rows(found)[1] == [["lane_only", "3", "7", "9"], ["no_wor", "5", "7", "9"]]
    for header, rows in together_tables(found):
        assert {len(row) for row in rows} == {len(header)}
        assert f"{np.mean(mean):.3f}" in str(rows) or header[-2] != "F1"


@pytest.mark.parametrize("accuracies", [(0.81, 0.83), (0.5, 0.999)])
def test_the_axis_of_accuracies_names_three_at_least(accuracies: tuple[float, float]) -> None:
    entries = [
        {
            "name": str(accuracy),
            "tuned_on": "other_frames",
            "scores": {"all_frames": {"accuracy": accuracy, "intervals": {"accuracy": None}}},
        }
        for accuracy in accuracies
    ]
    (ax,) = comparison_figure({"recordings": [{"title": "x", "experiments": entries}]}).axes
    assert 3 <= len(ax.get_yticks()) <= 12


def test_recordings_of_one_drive_do_not_count_as_two(tmp_path: Path) -> None:
    """A copy of a recording adds nothing, so the interval stays; another drive does."""
    paths = [write_drive(tmp_path / name, N_FRAMES) for name in ("a", "b")]
    alike = [load_experiment(path) for path in paths]
    both = [
        e.model_copy(update={"name": n, "graph": g})
        for e in alike
        for n, g in (("x", "sensor_failure"), ("y", "lane_only"))
    ]
    once = by_recording(both[:2])
    twice = whole(by_recording(both))["together"][1]["difference"]["accuracy"]
    (part,) = compare_groups(once)
    alone = together([part, part])[1]["difference"]["accuracy"]
    assert twice == pytest.approx(alone)
    assert twice[2] > twice[1]
    assert together([part]) == []


def test_the_command_shows_writes_and_draws(tmp_path: Path) -> None:
    keys = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}
    never = {"never_fit": {"from_frame": 650}}
    paper = {"tuned_on": "same_frames", "name": "paper", "tuning": never}
    paths = [
        write_drive(tmp_path, N_FRAMES, **paper).rename(tmp_path / "paper.yaml"),
        write_drive(tmp_path, N_FRAMES, **keys, name="learned", fit="learn"),
    ]
    target, out = tmp_path / "all.json", tmp_path / "out"
    shown = done("compare", *paths, "--json", target, "--out", out).stdout
    found = json.loads(target.read_text())
    assert found == json.loads((out / "comparison.json").read_text())
    assert (found["held_out"], found["blocks"]) == (True, 5)
    (recording,) = found["recordings"]
    entries = {e["name"]: e for e in recording["experiments"]}
    assert list(entries) == ["paper", "learned"]
    assert [e["tuned_on"] for e in entries.values()] == ["same_frames", "other_frames"]
    for name, entry in entries.items():
        for scores in entry["scores"].values():
            assert f"{scores['accuracy']:.3f}" in shown
        result = read_result(out / "lines" / name)
        right = (result.assigned_lane == result.true_lane)[~result.is_crossing]
        assert right.mean() == pytest.approx(entry["scores"]["all_frames"]["accuracy"], abs=1e-12)
    drawn = sorted(file.name for file in (out / "figures").iterdir())
    assert drawn == ["accuracy.png", "differences.png"]
    latex = done("compare", paths[0], "--format", "latex").stdout
    assert latex.startswith(r"\begin{tabular}")
    csv = done("compare", paths[0], "--format", "csv").stdout.splitlines()
    assert [len(line.split(",")) > 15 for line in csv] == [True, True, True]


def test_the_scores_of_one_recording_stand_upright_and_fit_the_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tuning = {"never_fit": {"from_frame": 900}}
    ahead = {"filter": "smoothed", "tuned_on": "not_tuned"}
    whole = {"cells": 4, "motion_bins": 9, "lane_width_m": "auto"}
    experiments = [
        simulated("a", tuning=tuning), geometry("b"), simulated("c", graph="no_wor", **ahead),
        simulated("d", graph="lane_only"),
        geometry("e_whose_name_is_longer_than_its_scores", parameters=whole),
    ]  # fmt: skip
    found = document(compare_groups(by_recording(experiments)))
    upright = full_tables(found)
    monkeypatch.setenv("COLUMNS", "100")
    assert max(map(len, page(upright).splitlines())) <= 100
    header, rows = full_rows(found)
    for subset in ("trusted", "all"):
        mine = [t[:2] for t in upright if t[0][0] == f"quickstart, seed 0, {subset} frames"]
        assert len(mine) == 1
        cells = {
            (name, line[0]): value
            for head, lines in mine
            for line in lines
            for name, value in zip(head[1:], line[1:], strict=True)
        }
        expected = {
            (row[1], label): value
            for row in rows
            for label, value in zip(header[3:], row[3:], strict=True)
            if row[2] == subset
        }
        assert {k: v for k, v in cells.items() if v != "-"} == {
            k: v for k, v in expected.items() if v != "-"
        }
    assert upright[0][0][0].endswith("trusted frames")
    assert marks_text(found).splitlines() == [
        "* in-sample, or not known to be held out",
        "causal: a, b, d",
        "not causal (evidence): e_whose_name_is_longer_than_its_scores",
        "not causal (filter): c",
    ]


def test_differences_need_the_same_annotated_frames(tmp_path: Path) -> None:
    write_drive(tmp_path, ground_truth__extra_rows=None)
    text = (tmp_path / "ground_truth.txt").read_text().splitlines(keepends=True)
    (tmp_path / "other.txt").write_text("".join(text[:100]))
    second = write_drive(tmp_path, name="second", ground_truth__path="other.txt")
    second.rename(tmp_path / "second.yaml")
    first = write_drive(tmp_path, name="first")
    assert "a difference needs the same frames" in refused(
        "compare", first, tmp_path / "second.yaml"
    )


def small_document() -> dict[str, Any]:
    """Two recordings, the second without the second experiment and with untrusted labels."""
    groups = by_recording(
        [
            simulated("a", tuned_on="same_frames"),
            simulated("b", graph="lane_only", tuned_on="not_tuned"),
            simulated("c", recording={"simulate": "quickstart", "seed": 7}),
        ]
    )
    return document(compare_groups(groups))


def test_the_figure_of_differences_has_a_panel_for_each_experiment_but_the_first() -> None:
    def entry(name: str, found: list[float] | None) -> dict[str, Any]:
        return {"name": name, "difference": found and {"all_frames": {"accuracy": found}}}

    recordings = [
        {
            "title": f"run {k}",
            "experiments": [
                entry("a", None),
                entry("b", [0.02 * k, 0.01, 0.05]),
                entry("c", [-0.01, -0.03, 0.02]),
            ],
        }
        for k in (1, 2)
    ]
    means = [
        {"name": name, "recordings": 2, "difference": found and {"accuracy": found}}
        for name, found in (("a", None), ("b", [0.03, 0.02, 0.04]), ("c", [0.0, -0.01, 0.01]))
    ]
    found = {"recordings": recordings, "together": means}
    axes = differences_figure(found).axes
    assert [ax.get_title("left") for ax in axes] == ["b", "c"]
    assert [label.get_text() for label in axes[0].get_yticklabels()] == ["run 1", "run 2", "all 2"]
    for ax, values, is_clear in zip(
        axes, ([0.02, 0.04, 0.03], [-0.01, -0.01, 0.0]), (True, False), strict=True
    ):
        points = [line for line in ax.lines if line.get_marker() in ("o", "D")]
        assert [np.asarray(p.get_xdata()).item() for p in points] == pytest.approx(values)
        assert [p.get_markerfacecolor() != "white" for p in points] == [is_clear] * 3
    with pytest.raises(InputError, match="needs two experiments"):
        differences_figure({"recordings": []})


def test_tables_and_figure_show_the_numbers_of_the_document(tmp_path: Path) -> None:
    found = small_document()
    header, rows = accuracy_rows(found)
    assert header == ["accuracy", "a", "b", "c"]
    assert rows[0][3] == rows[1][1] == ""
    assert rows[0][1].endswith("*")
    assert not rows[0][2].endswith("*")
    header, rows = full_rows(found)
    assert {len(row) for row in rows} == {len(header)}
    at = header.index("parameters from")
    assert [row[at] for row in rows] == ["in-sample", "not tuned", "unknown"]
    assert [row[at + 1] for row in rows] == ["causal"] * 3
    ((shorter, cells, *_),) = full_tables(found)
    unsaid = {"fixed", "trials"}
    assert shorter == [name for name in header if name not in unsaid]
    assert cells == [
        [cell for name, cell in zip(header, row, strict=True) if name not in unsaid] for row in rows
    ]
    (ax,) = comparison_figure(found).axes
    points = [line for line in ax.lines if np.size(line.get_xdata()) == 1]
    heights = [np.asarray(line.get_ydata()).item() for line in points]
    entries = [e for r in found["recordings"] for e in r["experiments"]]
    expected = [-np.log10(1 - e["scores"]["all_frames"]["accuracy"]) for e in entries]
    assert heights == pytest.approx(expected)
    hollow = [line.get_markerfacecolor() == "white" for line in points]
    assert hollow == [True, False, True]
    draw_all(found, tmp_path)


# --- lane changes ------------------------------------------------------------------------------


def test_the_events_of_a_comparison_are_those_of_the_runs() -> None:
    experiments = [simulated("counting"), geometry(), simulated("late", filter="fixed_lag", lag=9)]
    entries = compared(*experiments, events=True)
    for experiment, entry in zip(experiments, entries, strict=True):
        assert entry["events"]["all_frames"] == run_experiment(experiment).scores["events"]
    first, second, _ = (entry["events"]["all_frames"] for entry in entries)
    assert first["crossing"] is None
    assert second["crossing"]["warned"] > 0
    assert first["changes"] == second["changes"] > 0
    assert compared(simulated())[0]["events"] is None


def test_changes_in_frames_of_untrusted_labels_are_not_counted() -> None:
    (entry,) = compared(geometry(tuning={"never_fit": {"from_frame": 600}}), events=True)
    every, trusted = entry["events"].values()
    assert 0 < trusted["changes"] < every["changes"]
    assert trusted["hours"] == pytest.approx(600 / 36000)


def test_lane_changes_have_a_row_per_recording_and_one_for_all(tmp_path: Path) -> None:
    paths = [write_drive(tmp_path / name, name="one", n_frames=400) for name in ("a", "b")]
    target = tmp_path / "all.json"
    shown = done("compare", *paths, "--events", "--wide", "--json", target).stdout
    found = json.loads(target.read_text())
    header, rows = event_comparison_rows(found)
    assert {len(row) for row in rows} == {len(header)}
    assert [row[0] for row in rows][-1] == "all 2"
    scores = [r["experiments"][0]["events"]["all_frames"] for r in found["recordings"]]
    right = sum(each["within"]["2"]["right"] for each in scores)
    total = dict(zip(header, rows[-1], strict=True))
    assert total["right"] == f"{right}"
    assert total["recall"] == f"{right / sum(each['changes'] for each in scores):.3f}"
    for row in rows:
        assert all(cell in shown for cell in row)


def test_the_causal_model_tells_the_lane_changes_of_the_paper_s_runs(recordings: Path) -> None:
    """Two detectors on either road; Spain counts before frame 9577."""
    place = ego.experiments_folder() / "zero_label.yaml"
    found = ego.compare(place, runs="1,3,6,9", events=True, progress=False).document
    scores = [[*r["experiments"][0]["events"].values()][-1] for r in found["recordings"]]
    right, false, missed = (
        sum(each["within"]["2"][key] for each in scores) for key in ("right", "false", "missed")
    )
    assert right + missed == 2 * 109 + 2 * 34
    assert right / (right + false) >= 0.98
    assert right / (right + missed) >= 0.98
    for recording, each in zip(found["recordings"], scores, strict=True):
        warning = each["crossing"]
        assert warning["warned"] == warning["changes"]
        assert warning["auc"] > (0.9 if recording["run"] < 6 else 0.8)
        assert warning["lead_s"]["median"] > 1.3


# --- stored results ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("stored")
    one = simulated()
    other = load_experiment(one, {"parameters.sigma1": 0.2})
    return [
        run_experiment(each).save(folder / name, figures=False)
        for each, name in ((one, "one"), (other, "other"))
    ]


def test_stored_results_are_scored_as_they_were_and_named_by_their_directories(
    stored: list[Path], tmp_path: Path
) -> None:
    ran = done("compare", *stored, "--wide", "--json", tmp_path / "x.json")
    found = json.loads((tmp_path / "x.json").read_text())
    assert not found["held_out"]
    (recording,) = found["recordings"]
    assert recording["title"] == "quickstart, seed 0"
    entries = recording["experiments"]
    for place, entry in zip(stored, entries, strict=True):
        scores = dict(entry["scores"]["all_frames"])
        del scores["mean_log_evidence"]
        assert scores == read_result(place).scores["model"]
        assert entry["name"] == str(place)
        assert str(place) in ran.stdout
    difference = entries[1]["difference"]["all_frames"]["accuracy"][0]
    of = [entry["scores"]["all_frames"]["accuracy"] for entry in entries]
    assert difference == pytest.approx(of[1] - of[0])
    again = ego.compare(stored)
    assert again[recording["title"], str(stored[1])].directory == stored[1]
    for words, said in (
        (stored[:1], "needs two result directories"),
        ((*stored, "--runs", "1"), "--runs: goes with experiments"),
        ((stored[0], tmp_path), "is not a result directory"),
    ):
        assert said in refused("compare", *words)


def test_results_of_other_frames_are_refused_with_both_ranges(stored: list[Path]) -> None:
    one: Result = read_result(stored[0])
    late = replace(one, frame_id=one.frame_id + 5)
    first, last = one.frame_id[one.true_lane > 0][[0, -1]]
    with pytest.raises(InputError) as caught:
        compare_results("x", [one, late])
    assert f"from {first} to {last}" in str(caught.value)
    assert f"from {first + 5} to {last + 5}" in str(caught.value)
    without = replace(one, true_lane=np.zeros_like(one.true_lane))
    with pytest.raises(InputError, match="has no ground truth"):
        compare_results("x", [one, without])


# --- several recordings, and what fails --------------------------------------------------------


def test_a_recording_that_fails_is_listed_and_the_others_are_compared(tmp_path: Path) -> None:
    paths = [write_drive(tmp_path / name, name=name) for name in ("a", "gone", "b")]
    (paths[1].parent / "lines.csv").unlink()
    file, out = tmp_path / "all.json", tmp_path / "out"
    found = command("compare", *paths, "--json", file, "--out", out)
    assert found.exit_code == 1
    assert "failed: gone lines: " in found.output
    assert "lines.csv: no such file" in found.output
    found_in = json.loads(file.read_text())
    assert [part["title"] for part in found_in["recordings"]] == ["a lines", "b lines"]
    assert [part["title"] for part in found_in["failed"]] == ["gone lines"]
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == [
        *("a_lines", "b_lines", "figures"),
    ]
    alone = command("compare", paths[1])
    assert alone.exit_code == 2
    assert alone.output.count("\n") == 1


def test_ctrl_c_shows_the_recordings_that_were_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write_drive(tmp_path / name, name=name) for name in ("a", "b")]
    real = compare_groups

    def interrupted(groups: Any, *given: Any, **named: Any) -> Any:
        yield next(iter(real(groups[:1], *given, **named)))
        raise KeyboardInterrupt

    monkeypatch.setattr("egolane_pgm.verbs.compare.compare_groups", interrupted)
    result = command("compare", *paths, "--json", tmp_path / "x.json")
    assert result.exit_code == 130
    assert (
        result.stderr
        == "egolane: interrupted; this is 1 of 2 recordings; the same command begins anew\n"
    )
    assert "| a lines  |" in result.stdout
    assert len(json.loads((tmp_path / "x.json").read_text())["recordings"]) == 1
