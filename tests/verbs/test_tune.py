"""`egolane tune` as a user runs it."""

from __future__ import annotations

import csv
import json
import os
import signal
import time
from collections import Counter
from pathlib import Path

import optuna
import pytest
import yaml
from click.testing import Result
from egolane_pgm.drive import load_recording
from egolane_pgm.tuning.plan import load_plan, make_problem, paper_plans
from egolane_pgm.tuning.recording_task import tuned_experiment
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from pyarrow import parquet

from egolane_pgm.experiment import Tuning, load_experiment
from egolane_pgm.model import prepare_model
from egolane_pgm.running import run_experiment
from egolane_pgm.tools.files import write_yaml
from tests.kits.drives import command, done, refused, rewritten, write_drive
from tests.kits.labelled_drive import N_LABELLED
from tests.kits.processes import started
from tests.kits.studies import BLOCKS, EXPERIMENTS, QUICKSTART

NEEDS_DATA = pytest.mark.skipif(
    not os.environ.get("EGOLANE_DATA"), reason="the paper's recordings: needs EGOLANE_DATA"
)


def tune(*words: object) -> Result:
    return command("tune", *words)


def tune_refuses(*words: object) -> str:
    result = tune(*words)
    assert result.exit_code == 2, result.output
    (line,) = (line for line in result.stderr.splitlines() if line.startswith("egolane: "))
    return line


def studies_of(base: str) -> list[optuna.Study]:
    names = optuna.get_all_study_names(base)
    return [optuna.load_study(study_name=name, storage=base) for name in names]


def states(journal: Path) -> Counter[str]:
    """How many trials of a study are in each state."""
    storage = JournalStorage(JournalFileBackend(str(journal)))
    study = optuna.load_study(study_name="quickstart", storage=storage)
    return Counter(t.state.name for t in study.trials)


def write_own_graph(experiment: Path) -> Path:
    """The experiment with a graph of its own, YAML, that has one parameter."""
    (experiment.parent / "g.py").write_text(
        "from egolane_pgm.graphs.lane_only import *\nfrom egolane_pgm.graphs.lane_only import"
        " build, HIDDEN, OBSERVED, PARAMETERS\n"
    )
    return rewritten(experiment, experiment, graph="g.py")


def test_a_study_ends_with_tables_a_directory_and_an_experiment_to_run(tmp_path: Path) -> None:
    result = tune(QUICKSTART, "--trials", 40, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 0, result.output
    assert "7 numbers are searched: bonus_value 0 to 9, sigma1 0 to 3," in result.stderr
    assert "7 are held fixed: lane_width_m 3.5," in result.stderr
    assert "accuracy, held out" in result.output
    assert "in-sample: on the frames that the parameters were tuned on" in result.output
    folder = tmp_path / "quickstart"
    document = json.loads((folder / "study.json").read_text())
    assert document["schema_version"] == 1
    assert document["versions"]["optuna"] != "not installed"
    assert document["tuning"]["trials"] == 40
    experiment = load_experiment(folder / "best.yaml")
    assert experiment.tuned_on == "same_frames"
    run = run_experiment(experiment)
    assert run.scores["model"]["accuracy"] == pytest.approx(
        document["in_sample"]["all_frames"]["accuracy"]
    )
    table = parquet.read_table(folder / "trials.parquet").to_pylist()
    assert len(table) == 40
    assert max(row["accuracy_in_sample"] for row in table) == run.scores["model"]["accuracy"]
    with (folder / "trials.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 40


def test_the_same_command_gives_the_same_study_and_a_repeated_one_does_nothing_more(
    tmp_path: Path,
) -> None:
    words = (QUICKSTART, "--trials", 35, "--in-sample-only", "--seed", 5)
    for out in ("a", "b", "b"):
        assert tune(*words, "--out", tmp_path / out).exit_code == 0
    rows = [(tmp_path / out / "quickstart" / "trials.csv").read_text() for out in ("a", "b")]
    assert rows[0] == rows[1]
    assert rows[0].count("\n") == 36


def test_options_go_before_the_yaml(tmp_path: Path) -> None:
    tuning = {"trials": 9, "seed": 3, "parameters": {"p1": [0.5, 0.9], "p2": 0.7}}
    path = rewritten(QUICKSTART, tmp_path / "x.yaml", tuning=tuning)
    words = (path, "--in-sample-only", "--out", tmp_path, "-p", "p1=[0.6,0.7]", "--trials", 12)
    assert tune(*words).exit_code == 0
    document = json.loads((tmp_path / "quickstart" / "study.json").read_text())
    assert document["best"]["trials"] == 12
    assert document["space"]["searched"]["p1"] == [0.6, 0.7]
    assert document["space"]["fixed"]["quickstart"]["p2"] == 0.7
    assert document["tuning"]["seed"] == 3


def test_several_objectives_give_a_front(tmp_path: Path) -> None:
    words = ("--objective", "accuracy", "--objective", "log_loss", "--in-sample-only")
    assert tune(QUICKSTART, *words, "--trials", 60, "--out", tmp_path).exit_code == 0
    document = json.loads((tmp_path / "quickstart" / "study.json").read_text())
    assert document["tuning"]["sampler"] == "nsga2"
    assert len(document["best"]["pareto"]) >= 1
    assert set(document["best"]["values"]) == {"accuracy", "log_loss"}


def test_bad_input_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    def says(*words: object) -> str:
        return tune_refuses(QUICKSTART, "--blocks", BLOCKS, "--out", tmp_path / "o", *words)

    assert "did you mean 'accuracy'?" in says("--objective", "acuracy")
    assert "write it as" in says("-p", "sigma1")
    assert "did you mean 'tpe'?" in says("--sampler", "tpee")
    assert "take one of the two" in says("--workers", 2, "--jobs", 2)
    assert "blocks are more than the" in tune_refuses(
        QUICKSTART, "--blocks", 5000, "--out", tmp_path / "o"
    )
    assert "name experiments" in tune_refuses("--out", tmp_path / "o")
    assert "another experiment has the name" in tune_refuses(QUICKSTART, QUICKSTART)
    assert not (tmp_path / "o").exists()


def test_a_database_keeps_the_study_and_those_without_a_block(tmp_path: Path) -> None:
    base = f"sqlite:///{tmp_path}/shared.db"
    words = (QUICKSTART, "--trials", 6, "--blocks", BLOCKS, "--storage", base, "--no-figures")
    for out in ("here", "there"):
        assert tune(*words, "--out", tmp_path / out, "--jobs", 1).exit_code == 0
    parts = [f"quickstart without block {k}" for k in range(1, BLOCKS + 1)]
    assert optuna.get_all_study_names(base) == ["quickstart", *parts]
    assert {len(s.trials) for s in studies_of(base)} == {6}
    documents = [
        json.loads((tmp_path / out / "quickstart" / "study.json").read_text())
        for out in ("here", "there")
    ]
    for key in ("in_sample", "held_out"):
        assert documents[0][key] == documents[1][key]
    line = tune_refuses(*words, "--out", tmp_path / "there", "-p", "p1=0.9")
    assert "holds another study" in line
    assert tune(*words, "--out", tmp_path / "here", "--jobs", 1, "--trials", 8).exit_code == 0
    assert {len(s.trials) for s in studies_of(base)} == {8}


def test_the_password_of_a_storage_is_not_shown(tmp_path: Path) -> None:
    address = "nosuch://me:secret@host/base"
    line = tune_refuses(QUICKSTART, "--in-sample-only", "--out", tmp_path, "--storage", address)
    assert "nosuch://me:***@host/base" in line
    assert "secret" not in line


def test_a_group_has_one_parameter_set_and_an_experiment_per_recording(tmp_path: Path) -> None:
    for k in (1, 2):
        rewritten(QUICKSTART, tmp_path / f"{k}.yaml", name=f"drive{k}", recording__seed=k)
    group = {"name": "both", "experiments": ["1.yaml", "2.yaml"], "tuning": {"trials": 35}}
    (tmp_path / "group.yaml").write_text(yaml.safe_dump(group))
    words = (tmp_path / "group.yaml", "--blocks", BLOCKS, "--out", tmp_path / "o", "--jobs", 1)
    result = tune(*words)
    assert result.exit_code == 0, result.output
    folder = tmp_path / "o" / "both"
    sets = [load_experiment(folder / f"best_drive{k}.yaml").parameters for k in (1, 2)]
    assert sets[0] == sets[1]
    document = json.loads((folder / "study.json").read_text())
    each = [r["accuracy"] for r in document["held_out"]["all_frames"]["recordings"]]
    assert document["held_out"]["all_frames"]["accuracy"] == pytest.approx(sum(each) / 2)
    assert [s["left_out"] for s in document["held_out"]["studies"]] == [None] * BLOCKS


def test_a_typo_in_a_tuning_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text("name: g\nexperiments: [x.yaml]\ntuning: {trails: 3}\n")
    assert "unknown key 'trails' (did you mean 'trials'?)" in tune_refuses(path)
    path.write_text("name: g\nexperiments: [x.yaml]\ntunning: {}\n")
    assert "unknown key 'tunning' (did you mean 'tuning'?)" in tune_refuses(path)
    path.write_text("name: g\nexperiments: [x.yaml]\n")
    assert "x.yaml: cannot be read" in tune_refuses(path)


@pytest.mark.parametrize(("jobs", "stop"), [(1, signal.SIGKILL), (2, signal.SIGINT)])
def test_the_command_itself_is_stopped_and_repeated(
    jobs: int, stop: signal.Signals, tmp_path: Path
) -> None:
    words = ["tune", QUICKSTART, "--trials", 2500, "--blocks", BLOCKS, "--no-figures"]
    words += ["--jobs", jobs, "--out", tmp_path]
    with started(*words) as first:
        journal = tmp_path / "quickstart" / "study.journal"
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if journal.exists() and journal.stat().st_size > 100_000:
                break
            time.sleep(0.01)
        begun = time.monotonic()
        first.send_signal(stop)
        _, said = first.communicate()
        assert time.monotonic() - begun < 30
    if stop == signal.SIGINT:
        assert first.returncode == 130
        lines = [x for x in said.splitlines() if x.startswith("egolane: ")]
        assert lines == [
            f"egolane: interrupted; complete trials are kept in {tmp_path / 'quickstart'};"
            " repeat the command to go on"
        ]
    before = states(journal)
    assert before["COMPLETE"] > 10
    total = before["COMPLETE"] + 10
    words = [QUICKSTART, "--in-sample-only", "--no-figures", "--jobs", 1]
    assert tune(*words, "--trials", total, "--out", tmp_path).exit_code == 0
    assert states(journal)["COMPLETE"] == total


@pytest.mark.parametrize(
    "path", sorted((EXPERIMENTS / "tuning").glob("*.yaml")), ids=lambda p: p.stem
)
def test_every_tuning_file_that_comes_along_is_sound(path: Path) -> None:
    found = load_plan(path)
    assert found.name == path.stem
    assert found.settings.objectives == ("accuracy",)


def test_the_runs_of_the_paper_can_be_searched_by_number() -> None:
    found = paper_plans(range(1, 11))
    assert [plan.run for plan in found] == list(range(1, 11))
    assert {plan.settings.objectives for plan in found} == {("accuracy",)}
    assert all(plan.tuning == Tuning() for plan in found)


@NEEDS_DATA
def test_the_published_parameters_are_tried_first_and_frames_never_fitted(tmp_path: Path) -> None:
    result = tune("--runs", "6", "--trials", 30, "--blocks", 2, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 0, result.output
    folder = tmp_path / "run06_spain_ml"
    first, second = parquet.read_table(folder / "trials.parquet").to_pylist()[:2]
    assert second["sigma1"] == 0.407
    assert first["sigma1"] == pytest.approx(0.407, abs=1e-3)
    assert first["accuracy_in_sample"] == pytest.approx(0.8963, abs=1e-4)
    document = json.loads((folder / "study.json").read_text())
    sizes = [document["held_out"][k]["frames_scored"] for k in ("all_frames", "without_never_fit")]
    assert sizes[0] - sizes[1] == 200
    assert "| run06_spain_ml | paper |  0.407" in result.output


def test_a_tuned_experiment_runs_from_its_own_folder(labelled: Path, tmp_path: Path) -> None:
    problem = make_problem(load_plan(write_own_graph(labelled)))
    target = tmp_path / "study" / "best.yaml"
    target.parent.mkdir()
    (drive,) = problem.drives
    write_yaml(target, tuned_experiment(drive.experiment, drive.model.parameters, problem))
    tuned = load_experiment(target)
    assert tuned.recording.path == str(labelled.parent / "labels.json")
    assert tuned.recording.camera == str(labelled.parent / "cam.yaml")
    assert len(load_recording(tuned).log) == N_LABELLED
    assert prepare_model(tuned).compiled.n_states == 3


def test_a_study_scores_the_reject_option_as_a_run_does(tmp_path: Path) -> None:
    path = write_drive(tmp_path, unassigned_below=0.9)
    out = ("--trials", 12, "--in-sample-only", "--jobs", 1, "--no-figures")
    for name in ("accuracy", "false_switches_per_minute"):
        done("tune", path, "--objective", name, *out, "--out", tmp_path / name)
        study = json.loads((tmp_path / name / "drive" / "study.json").read_text())
        run = run_experiment(tmp_path / name / "drive" / "best.yaml")
        scores = run.scores["model"]
        assert scores["coverage"] < 1
        assert study["best"]["values"][name] == pytest.approx(scores[name])
        assert study["in_sample"]["all_frames"]["accuracy"] == pytest.approx(scores["accuracy"])
    said = refused("tune", path, "--set", "unassigned_below=0.5", *out, "--out", tmp_path / name)
    assert "unassigned_below" in said


def test_a_search_refuses_a_filter_that_looks_ahead(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 60, filter="fixed_lag", lag=3)
    said = refused("tune", path, "--out", tmp_path / "out")
    assert said.startswith(
        f"{path}: filter: a search takes assumed_density or exact, not fixed_lag"
    )
