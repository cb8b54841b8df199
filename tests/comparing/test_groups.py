"""Experiments side by side: nothing of a block is known to what believes it, differences are
paired, recordings are grouped, and tables and figure show the document's numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm import paper as paper
from egolane_pgm.comparing.groups import (
    Group,
    Options,
    by_recording,
    compare_group,
    compare_groups,
    document,
    graphs_on_runs,
    on_runs,
    together,
)
from egolane_pgm.comparing.placing import load_for_scoring, on_recording, recording_key
from egolane_pgm.comparing.side import Search, Side, held_out_side
from egolane_pgm.drive import Drive
from egolane_pgm.experiment import Experiment, load_experiment, resolved
from egolane_pgm.plugins import plugin_names
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import bootstrap_interval, confusion_counts
from egolane_pgm.scoring.confusion import accuracy
from egolane_pgm.types import InputError
from egolane_pgm.views.comparison_figures import (
    comparison_figure,
    differences_figure,
    draw_comparison,
    draw_differences,
)
from egolane_pgm.views.comparison_tables import (
    accuracy_rows,
    full_rows,
    full_tables,
    health_rows,
    marks_text,
    search_rows,
    seeds_rows,
    together_tables,
)
from egolane_pgm.views.tables import page
from tests.conftest import needs_compiler
from tests.kits.drives import (
    command,
    done,
    geometry,
    refused,
    rewritten,
    short_drive,
    simulated,
    write_drive,
)

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]

N_FRAMES = 700
TRIALS = 12


def scrambled(drive: Drive, frames: np.ndarray) -> Drive:
    """The same drive with other lanes in some annotated frames."""
    lane = drive.truth.lane.copy()
    lane[frames] = np.random.default_rng(0).integers(1, drive.n_lanes + 1, size=len(lane[frames]))
    truth = replace(drive.truth, lane=lane)
    return replace(drive, recorded=replace(drive.recorded, truth=truth))


def run_of(drive: Drive) -> Side:
    return held_out_side(drive, search=Search(TRIALS))


@pytest.mark.parametrize(
    "experiment", [geometry(fit="learn"), simulated(fit="tune")], ids=["learn", "tune"]
)
def test_the_labels_of_a_block_do_not_reach_what_is_believed_in_it(experiment: Experiment) -> None:
    drive = load_for_scoring(experiment)
    block = np.array_split(np.arange(len(drive)), 5)[2]
    before, after = run_of(drive), run_of(scrambled(drive, block))
    assert before.tuned_on == after.tuned_on == "other_frames"
    np.testing.assert_array_equal(before.beliefs.lane[block], after.beliefs.lane[block])
    assert dict(before.held_out.parameters[2]) == dict(after.held_out.parameters[2])
    others = [
        k
        for k in range(5)
        if dict(before.held_out.parameters[k]) != dict(after.held_out.parameters[k])
    ]
    assert others
    assert 2 not in others


def test_untrusted_labels_are_never_fitted() -> None:
    experiment = geometry(fit="learn", tuning={"never_fit": {"from_frame": 1000}})
    drive = load_for_scoring(experiment)
    untrusted = np.flatnonzero(drive.truth.frame_id >= 1000)
    assert 0 < len(untrusted) < len(drive)
    before, after = run_of(drive), run_of(scrambled(drive, untrusted))
    np.testing.assert_array_equal(before.beliefs.lane, after.beliefs.lane)
    assert np.flatnonzero(~before.drive.may_fit).tolist() == untrusted.tolist()


def test_without_a_fit_the_belief_is_that_of_a_run() -> None:
    experiment = simulated(tuned_on="not_tuned")
    run = run_of(load_for_scoring(experiment))
    plain = run_experiment(experiment)
    np.testing.assert_array_equal(run.beliefs.lane, plain.beliefs.lane[plain.scored])
    assert run.tuned_on == "not_tuned"
    assert run.free_parameters == 0
    bad = plain.beliefs.marginals["SensorState"][:, 1]
    assert run.bad is not None
    np.testing.assert_array_equal(run.bad, bad[plain.scored])
    assert run.beliefs.log_evidence.mean() == pytest.approx(plain.beliefs.mean_log_evidence)
    assert 0 < run.seconds_per_frame < 0.01


def test_free_parameters_are_the_numbers_that_were_fitted() -> None:
    assert run_of(load_for_scoring(simulated(tuned_on="same_frames"))).free_parameters == 7
    kept = {"p1": 0.9, "p2": 0.9}
    tuned = simulated(fit="tune", parameters=kept, tuning={"parameters": kept})
    assert run_of(load_for_scoring(tuned)).free_parameters == 5
    learned = run_of(load_for_scoring(geometry(fit="learn")))
    found = {k: v for k, v in learned.held_out.parameters[0].items() if isinstance(v, tuple)}
    numbers = sum(len(v) for v in found.values())
    assert numbers <= learned.free_parameters <= numbers + 1


def test_a_difference_is_paired_and_to_the_first_experiment() -> None:
    first, second = simulated("first"), simulated("second", graph="lane_only")
    (group,) = by_recording([first, second])
    entries = compare_group(group, Options())["experiments"]
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
    same = compare_group(by_recording([first, simulated("twin")])[0], Options())
    assert same["experiments"][1]["difference"]["all_frames"]["f1"] == [0, 0, 0]


def test_experiments_are_grouped_by_recording() -> None:
    other = {"simulate": "quickstart", "seed": 7}
    groups = by_recording(
        [simulated("a"), simulated("b", recording=other), simulated("c", graph="no_wor")]
    )
    assert [[e.name for e in g.experiments] for g in groups] == [["a", "c"], ["b"]]
    assert groups[0].title != groups[1].title
    with pytest.raises(InputError, match="two experiments have the name a"):
        by_recording([simulated("a"), simulated("a", graph="no_wor")])


def test_without_the_frames_that_are_never_fitted_the_scores_are_shown_beside() -> None:
    tuning = {"never_fit": {"from_frame": 900}}
    experiments = [simulated("a"), simulated("b", graph="lane_only", tuning=tuning)]
    found = compare_group(by_recording(experiments)[0], Options(health=True))
    for entry in found["experiments"]:
        assert list(entry["scores"]) == ["all_frames", "without_never_fit"]
        every, trusted = entry["scores"].values()
        assert trusted["frames"] < every["frames"]
        assert list(entry["health"]) == list(entry["scores"])
    difference = found["experiments"][1]["difference"]
    assert difference["without_never_fit"]["accuracy"] != difference["all_frames"]["accuracy"]


def test_health_is_asked_of_frames_in_which_the_detector_commits() -> None:
    group = by_recording([simulated("counting"), geometry()])[0]
    found = compare_group(group, Options(health=True))
    detector = run_experiment(simulated("counting")).scores["detector"]
    health = found["health"]["all_frames"]
    matrix = np.array(detector["confusion"])
    assert health["frames"] == matrix.sum()
    assert health["committed"] == matrix[:-1].sum()
    assert health["wrong"] == matrix[:-1].sum() - np.trace(matrix[:-1])
    # Silence is never right: each silent frame beats all right ones, wrong lanes tie with these.
    silent = matrix[-1].sum()
    assert health["auc_unassigned"] == pytest.approx(
        (silent + 0.5 * health["wrong"]) / (silent + health["wrong"])
    )
    for entry in found["experiments"]:
        mine = entry["health"]["all_frames"]
        assert 0.5 < mine["auc_doubt"] <= 1
        assert 0 <= mine["auc_bad"] <= 1
    # Without any tentative vector among the experiments the default rule's is taken.
    alone = compare_group(by_recording([geometry()])[0], Options(health=True))
    assert alone["health"]["all_frames"]["frames"] == health["frames"]


def test_processes_find_the_same() -> None:
    other = {"simulate": "quickstart", "seed": 7}
    groups = by_recording([simulated("a"), simulated("b", recording=other)])
    one, two = (_compared(groups, Options(), jobs) for jobs in (1, 2))
    assert one == two


def _compared(groups: list[Group], options: Options, jobs: int = 1) -> dict[str, Any]:
    """The document, without the times that were measured."""
    found = document(list(compare_groups(groups, options, jobs=jobs)), options)
    assert not found["failed"]
    for recording in found["recordings"]:
        for entry in recording["experiments"]:
            assert entry.pop("microseconds_per_frame") > 0
    return found


def _searched(name: str, simulation: int, **keys: Any) -> Experiment:
    recording = {"simulate": "quickstart", "seed": simulation}
    return simulated(name, fit="tune", recording=recording, **keys)


def test_a_search_is_made_with_every_seed_and_scored_by_the_mean() -> None:
    groups = by_recording(
        [_searched(name, k, graph=name) for k in (0, 7) for name in ("lane_only", "no_wor")]
    )
    options = Options(blocks=2, trials_per_number=3, seeds=(0, 4))
    found = _compared(groups, options)
    assert found == _compared(groups, options, jobs=2)
    for entry, numbers in zip(found["recordings"][1]["experiments"], (3, 5), strict=True):
        assert (entry["free_parameters"], entry["trials"]) == (numbers, 3 * numbers)
        assert [one["seed"] for one in entry["seeds"]] == [0, 4]
        for one in entry["seeds"]:
            # With this seed alone: the same parameters, and the same scores.
            own = {"seed": one["seed"], "trials": 3 * numbers}
            alone = held_out_side(
                load_for_scoring(_searched("x", 7, graph=entry["name"], tuning=own)), n_blocks=2
            )
            assert [dict(p) for p in alone.held_out.parameters] == one["parameters"]
        each = [one["scores"]["all_frames"]["accuracy"] for one in entry["seeds"]]
        assert each[0] != each[1]
        assert entry["scores"]["all_frames"]["accuracy"] == pytest.approx(np.mean(each))
        assert entry["spread"]["all_frames"]["accuracy"] == pytest.approx(np.std(each, ddof=1))
    mean = [r["experiments"][1]["scores"]["all_frames"]["f1"] for r in found["recordings"]]
    first, second = found["together"]
    assert (first["difference"], second["recordings"], second["drives"]) == (None, 2, 2)
    assert second["scores"]["f1"][0] == pytest.approx(np.mean(mean))
    low, high = second["difference"]["f1"][1:]
    assert low < second["scores"]["f1"][0] - first["scores"]["f1"][0] < high
    assert search_rows(found)[1] == [
        ["lane_only", "3", "7", "9", "2"],
        ["no_wor", "5", "7", "15", "2"],
    ]
    (ax,) = comparison_figure(found).axes
    dots = [line for line in ax.lines if line.get_marker() == "."]
    assert [len(line.get_xdata()) for line in dots] == [2] * 4  # type: ignore[arg-type]
    for header, rows in (seeds_rows(found), *together_tables(found)):
        assert {len(row) for row in rows} == {len(header)}
        assert f"{np.mean(mean):.3f}" in str(rows) or header[-3] != "F1"


@pytest.mark.parametrize("accuracies", [(0.75, 0.82), (0.81, 0.83), (0.5, 0.999)])
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
    twice = _compared(by_recording(both), Options())["together"][1]["difference"]["accuracy"]
    (part,) = compare_groups(once, Options())
    alone = together([part, part])[1]["difference"]["accuracy"]
    assert twice == pytest.approx(alone)
    assert twice[2] > twice[1]
    assert together([part]) == []


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run 2 of a paper whose recording is a simulated one, three lanes."""
    folder = tmp_path / "experiments" / "paper"
    own = write_drive(
        folder, N_FRAMES, tuned_on="same_frames", tuning={"never_fit": {"from_frame": 650}}
    )
    own.rename(folder / "run02_x.yaml")
    (folder / "published.yaml").write_text(
        "runs: [{run: 2, recovered: {parameters: {p1: 0.9, p2: 0.8}}}]\n"
    )
    monkeypatch.setattr(paper, "experiments_folder", lambda: tmp_path / "experiments")
    return folder


def test_a_model_is_put_on_the_recording_of_a_run(runs: Path) -> None:
    model = simulated("model", n_lanes=4, tuned_on="same_frames", graph="lane_only")
    (group,) = on_runs([model], [2], with_paper=True, which="recovered")
    own, placed = group.experiments
    assert (own.name, own.parameters) == ("paper", {"p1": 0.9, "p2": 0.8})
    assert (placed.graph, placed.n_lanes) == ("lane_only", 3)
    assert placed.tuned_on == "other_frames"
    assert placed.tuning is not None
    assert placed.tuning.never_fit == ((650, None),)
    drive = load_for_scoring(placed)
    assert len(drive.recorded.log) == len(short_drive(N_FRAMES).log)
    assert on_recording(own, own).tuned_on == "same_frames"


def test_a_frame_rate_that_nobody_gave_is_left_to_the_recording() -> None:
    """A video tells its own."""
    place = {"simulate": "quickstart"}
    for given in ({}, {"frame_rate": 20.0}):
        placed = on_recording(simulated(), simulated("place", recording={**place, **given}))
        assert ("frame_rate" in placed.recording.model_fields_set) == bool(given)
    assert placed.recording.frame_rate == 20


def test_the_same_road_taken_for_another_number_of_lanes_is_another_recording(
    tmp_path: Path,
) -> None:
    three = load_experiment(write_drive(tmp_path, 60))
    assert recording_key(three) != recording_key(three.model_copy(update={"n_lanes": 4}))
    assert recording_key(three) == recording_key(three.model_copy(update={"name": "other"}))


def test_every_graph_gets_an_evidence_rule_that_fits_it(runs: Path) -> None:
    graphs = plugin_names("graphs")
    (group,) = graphs_on_runs(graphs, [2], "tune")
    assert [e.name for e in group.experiments] == graphs
    for experiment in group.experiments:
        assert experiment.fit == "tune"
        plain = experiment.model_copy(update={"fit": "none"})
        assert held_out_side(load_for_scoring(plain)).beliefs.lane.shape[1] == 3
    found = {e.graph: e.evidence for e in group.experiments}
    assert found["sensor_failure"] == "counting"
    assert found["wor_levels"] == "counting_levels"
    assert found["position_in_lane"] == "line_geometry"


def write(path: Path, experiment: Experiment) -> Path:
    content = experiment.model_dump(mode="json", exclude_defaults=True)
    path.write_text(yaml.safe_dump(content))
    return path


def test_the_command_shows_writes_and_draws(runs: Path, tmp_path: Path) -> None:
    first = write(tmp_path / "zero.yaml", geometry("zero", tuned_on="not_tuned"))
    second = write(tmp_path / "learned.yaml", geometry("learned", fit="learn"))
    target, figure = tmp_path / "all.json", tmp_path / "all.png"
    differences = tmp_path / "differences.png"
    words = ("compare", first, second, "--runs", "2", "--with-paper", "--health")
    shown = done(*words, "--json", target, "--figure", figure, "--differences", differences).stdout
    found = json.loads(target.read_text())
    assert found["held_out"] is True
    (recording,) = found["recordings"]
    assert (recording["title"], recording["run"]) == ("run 2", 2)
    entries = {e["name"]: e for e in recording["experiments"]}
    assert list(entries) == ["paper", "zero", "learned"]
    assert [e["tuned_on"] for e in entries.values()] == ["same_frames", "not_tuned", "other_frames"]
    for entry in entries.values():
        for scores in entry["scores"].values():
            assert f"{scores['accuracy']:.3f}" in shown
        assert f"{entry['health']['without_never_fit']['auc_doubt']:.4f}" in shown
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert differences.read_bytes().startswith(b"\x89PNG")
    latex = done("compare", first, "--runs", "2", "--format", "latex").stdout
    assert latex.startswith(r"\begin{tabular}")
    csv = done("compare", first, "--runs", "2", "--format", "csv").stdout.splitlines()
    assert [len(line.split(",")) > 15 for line in csv] == [True, True, True]


def test_graphs_held_out_are_tuned_without_each_block(runs: Path, tmp_path: Path) -> None:
    target = tmp_path / "graphs.json"
    words = ("--graphs", "lane_only,no_wor", "--runs", "2", "--held-out", "--trials", "5")
    done("compare", *words, "--blocks", "3", "--json", target)
    (recording,) = json.loads(target.read_text())["recordings"]
    assert recording["blocks"] == 3
    for entry in recording["experiments"]:
        assert entry["tuned_on"] == "other_frames"
        assert len(entry["parameters"]) == 3


GRAPH = """
from egolane_pgm.graphs.lane_only import HIDDEN, OBSERVED, UNUSED, build
from egolane_pgm.parameters import Parameter

PARAMETERS = (
    Parameter("sigma1", "sigma", 0.4, "standard deviation of the lane dynamics, lanes"),
    Parameter("sigma2", "sigma", 0.5, "standard deviation of the detector output, lanes"),
    Parameter("normal", "choice", "density", "how F is made", choices=("density",)),
    Parameter("lane_widths", "positive", 1.0, "widths", search=None),
)
"""


def _entries(target: Path) -> list[list[tuple[str, str, int, str]]]:
    """Per recording name, graph, numbers fitted and fit of each experiment."""
    keys = ("name", "graph", "free_parameters", "fit")
    recordings = json.loads(target.read_text())["recordings"]
    return [[tuple(e[k] for k in keys) for e in r["experiments"]] for r in recordings]


def test_a_graph_is_found_from_where_one_stands(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And is searched as the package's are, without saying so."""
    for folder in ("mine", "theirs"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "worn.py").write_text(GRAPH)
    experiment = write_drive(tmp_path / "elsewhere", tuned_on="not_tuned")
    monkeypatch.chdir(tmp_path / "mine")
    target = tmp_path / "found.json"
    few = ("--held-out", "--trials", 2, "--blocks", 2, "--json", target)
    done("compare", "--graphs", "lane_only,./worn.py,../theirs/worn.py", "--runs", 2, *few)
    expected = [("lane_only", "lane_only", 3, "tune")]
    assert _entries(target) == [
        [*expected, ("mine_worn", "worn.py", 3, "tune"), ("theirs_worn", "worn.py", 3, "tune")]
    ]
    other = write_drive(tmp_path / "other", name="other")
    done("compare", experiment, other, "--graphs", "lane_only,worn.py", *few)
    assert _entries(target) == [[*expected, ("worn", "worn.py", 3, "tune")]] * 2
    again = rewritten(experiment, tmp_path / "elsewhere" / "again.yaml", name="again")
    words = (experiment, again, "--graphs", "worn.py,lane_only")
    done("compare", *words, "--set", "unassigned_below=0.3", "--json", target)
    (found,) = _entries(target)
    names = ["drive_worn", "drive_lane_only", "again_worn", "again_lane_only"]
    assert [name for name, *_ in found] == names
    assert {fit for *_, fit in found} == {"none"}
    done("compare", experiment, "--graphs", "worn.py", "--runs", 2, "--json", target)
    assert [r["title"] for r in json.loads(target.read_text())["recordings"]] == ["run 2"]


def test_graphs_that_cannot_be_used_are_all_named_before_a_recording_is_read(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (runs / "lines.csv").unlink()
    (tmp_path / "bad.py").write_text(GRAPH.replace("OBSERVED,", "") + "OBSERVED = ('Lanes',)\n")
    on_run = ("--runs", 2)
    for words in ((*on_run, "--held-out"), on_run):
        result = command("compare", "--graphs", "lane_olny,./absent.py", *words)
        assert result.exit_code == 2
        if "--held-out" in words:
            assert "--graphs: unknown name 'lane_olny' (did you mean 'lane_only'?)" in result.stderr
            assert f"--graphs: no file {tmp_path / 'absent.py'}" in result.stderr
        message = refused("compare", "--graphs", "lane_only,bad.py", *words)
        assert "Lanes" in message
        assert "lines.csv" not in message
    assert "lines.csv: no such file" in refused("compare", "--graphs", "lane_only", "--runs", 2)
    message = refused("compare", "--graphs", "lane_only,lane_only", "--held-out", *on_run)
    assert message == "--graphs: lane_only is named twice"


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
    found = document(list(compare_groups(by_recording(experiments))), Options())
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


def test_what_cannot_be_compared_is_refused_in_one_line(runs: Path, tmp_path: Path) -> None:
    one = write(tmp_path / "one.yaml", simulated("one"))
    assert "--with-paper" in refused("compare", one, "--with-paper")
    assert "or with held_out" in refused("compare", "--health", "--runs", "2")
    message = refused("compare", write(tmp_path / "f.yaml", simulated()), "--set", "fit=lern")
    assert "fit: 'lern' is not one of none, learn, tune (did you mean 'learn'?)" in message
    (tmp_path / "bare").mkdir()
    bare = write_drive(tmp_path / "bare", ground_truth=None)
    assert "ground_truth: is missing" in refused("compare", bare)
    crossing = write_drive(tmp_path / "crossing", 60)
    truth = short_drive(60).truth
    flags = np.ones(len(truth), dtype=bool)
    write_ground_truth(crossing.parent / "ground_truth.txt", replace(truth, is_crossing=flags))
    message = refused("compare", crossing)
    assert message.endswith("ground_truth.txt: every frame is a crossing, nothing to score")
    assert "a figure ends in .png" in refused("compare", one, "--figure", tmp_path / "a.gif")
    assert "need two experiments" in refused("compare", one, "--differences", tmp_path / "a.png")
    assert "a search takes assumed_density or exact" in refused(
        "compare", one, "--set", "fit=tune", "--set", "filter=smoothed"
    )
    wide = geometry("wide", parameters={"sigmas_m": [0.2] * 7})
    message = refused("compare", write(tmp_path / "wide.yaml", wide), "--runs", "2")
    assert message.startswith("run 2, 3 lanes: ")
    assert "parameters.sigmas_m: has 7 numbers, needs a list of 6" in message
    for text in ("0", "x", "-1", ",", "1.5"):
        message = refused("compare", one, f"--seeds={text}")
        assert message == f"--seeds: {text} is neither how many, 5, nor which, 3,7"
    assert "--seeds: nothing is searched" in refused("compare", one, "--seeds", 2)
    assert "instead of trials" in refused("compare", one, "--trials", 4, "--trials-per-number", 4)
    everything = ("--set", "tuning.never_fit=[[0, null]]", "--set", "fit=tune")
    assert "no frame is left to fit on" in refused("compare", one, *everything)


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


def test_how_it_is_fitted_is_no_part_of_what_is_run() -> None:
    plain, learned = (resolved(simulated(fit=fit), {}) for fit in ("none", "learn"))
    assert plain == learned


def small_document() -> dict[str, Any]:
    """Two recordings, the second without the second experiment and with untrusted labels."""
    groups = by_recording(
        [
            simulated("a", tuned_on="same_frames"),
            simulated("b", graph="lane_only", tuned_on="not_tuned"),
            simulated("c", recording={"simulate": "quickstart", "seed": 7}),
        ]
    )
    return document(list(compare_groups(groups, Options(health=True))), Options(health=True))


def test_the_figure_of_differences_has_a_panel_for_each_experiment_but_the_first(
    tmp_path: Path,
) -> None:
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
    draw_differences(found, tmp_path / "x.png")
    with pytest.raises(InputError, match="needs two experiments"):
        draw_differences({"recordings": []}, tmp_path / "y.png")


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
    unsaid = {"fixed", "trials", "seeds", "accuracy +-"}
    assert shorter == [name for name in header if name not in unsaid]
    assert cells == [
        [cell for name, cell in zip(header, row, strict=True) if name not in unsaid] for row in rows
    ]
    header, rows = health_rows(found)
    assert {len(row) for row in rows} == {len(header)}
    (ax,) = comparison_figure(found).axes
    points = [line for line in ax.lines if np.size(line.get_xdata()) == 1]
    heights = [np.asarray(line.get_ydata()).item() for line in points]
    entries = [e for r in found["recordings"] for e in r["experiments"]]
    expected = [-np.log10(1 - e["scores"]["all_frames"]["accuracy"]) for e in entries]
    assert heights == pytest.approx(expected)
    hollow = [line.get_markerfacecolor() == "white" for line in points]
    assert hollow == [True, False, True]
    draw_comparison(found, tmp_path / "x.svg")
    with pytest.raises(InputError, match="no experiment"):
        comparison_figure({"recordings": []})
