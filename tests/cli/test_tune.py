"""`egolane tune` as a user runs it."""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner, Result
from pyarrow import parquet

from egolane_pgm.cli.main import egolane
from egolane_pgm.experiment import load_experiment
from egolane_pgm.run import run_experiment
from tests.kits.tuning_kit import BLOCKS, EXPERIMENTS, QUICKSTART

NEEDS_DATA = pytest.mark.skipif(
    not os.environ.get("EGOLANE_DATA"), reason="the paper's recordings: needs EGOLANE_DATA"
)


def tune(*words: object) -> Result:
    return CliRunner().invoke(egolane, ["tune", *map(str, words)])


def refused(*words: object) -> str:
    result = tune(*words)
    assert result.exit_code == 2, result.output
    lines = [line for line in result.stderr.splitlines() if not line.startswith("warning:")]
    assert len(lines) == 1
    return lines[0]


def test_a_study_ends_with_tables_a_directory_and_an_experiment_to_run(tmp_path: Path) -> None:
    result = tune(QUICKSTART, "--trials", 40, "--blocks", BLOCKS, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 0, result.output
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
    content = yaml.safe_load(QUICKSTART.read_text())
    content["tuning"] = {"trials": 9, "seed": 3, "parameters": {"p1": [0.5, 0.9], "p2": 0.7}}
    path = tmp_path / "x.yaml"
    path.write_text(yaml.safe_dump(content))
    words = (path, "--in-sample-only", "--out", tmp_path, "-p", "p1=[0.6,0.7]", "--trials", 12)
    assert tune(*words).exit_code == 0
    document = json.loads((tmp_path / content["name"] / "study.json").read_text())
    assert document["best"]["trials"] == 12
    assert document["space"]["searched"]["p1"] == [0.6, 0.7]
    assert document["space"]["fixed"][content["name"]]["p2"] == 0.7
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
        return refused(QUICKSTART, "--blocks", BLOCKS, "--out", tmp_path / "o", *words)

    assert "did you mean 'accuracy'?" in says("--objective", "acuracy")
    assert "did you mean 'sigma1'?" in says("-p", "sigma_1=[0,1]")
    assert "is inverted" in says("-p", "sigma1=[1,0.5]")
    assert "is empty" in says("-p", "sigma1=[1,1]")
    assert "write it as" in says("-p", "sigma1")
    assert "did you mean 'tpe'?" in says("--sampler", "tpee")
    assert "take one of the two" in says("--workers", 2, "--jobs", 2)
    assert "lane change" in refused(QUICKSTART, "--blocks", 500, "--out", tmp_path / "o")
    assert "at least two" in refused(QUICKSTART, "--whole-recordings", "--out", tmp_path / "o")
    assert "name experiments" in refused("--out", tmp_path / "o")
    assert "another experiment has the name" in refused(QUICKSTART, QUICKSTART)
    assert not (tmp_path / "o").exists()


def test_another_search_space_of_the_same_name_is_refused(tmp_path: Path) -> None:
    words = (QUICKSTART, "--in-sample-only", "--no-figures", "--trials", 9, "--out", tmp_path)
    assert tune(*words).exit_code == 0
    folder = tmp_path / "quickstart"
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    line = refused(*words, "-p", "p1=0.9")
    assert "another study of this name" in line
    assert "p1" in line
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    words = (QUICKSTART, "--in-sample-only", "--trials", 9)
    assert "cannot be written" in refused(*words, "--out", tmp_path / "file")


def test_a_study_of_one_process_is_not_taken_over_by_workers(tmp_path: Path) -> None:
    words = (QUICKSTART, "--in-sample-only", "--trials", 9, "--out", tmp_path)
    assert tune(*words).exit_code == 0
    assert "begun in one process" in refused(*words, "--workers", 2)


def test_workers_share_a_study_and_one_process_may_go_on_with_it(tmp_path: Path) -> None:
    words = (QUICKSTART, "--in-sample-only", "--out", tmp_path, "--trials")
    assert tune(*words, 40, "--workers", 2).exit_code == 0
    assert tune(*words, 50).exit_code == 0
    table = parquet.read_table(tmp_path / "quickstart" / "trials.parquet").to_pylist()
    assert len(table) == 50


def test_a_group_has_one_parameter_set_and_an_experiment_per_recording(tmp_path: Path) -> None:
    first = yaml.safe_load(QUICKSTART.read_text())
    for k in (1, 2):
        content = {**first, "name": f"drive{k}"}
        content["recording"] = {**first["recording"], "seed": k}
        (tmp_path / f"{k}.yaml").write_text(yaml.safe_dump(content))
    group = {"name": "both", "experiments": ["1.yaml", "2.yaml"], "tuning": {"trials": 35}}
    (tmp_path / "group.yaml").write_text(yaml.safe_dump(group))
    words = (tmp_path / "group.yaml", "--whole-recordings", "--out", tmp_path / "o", "--jobs", 1)
    result = tune(*words)
    assert result.exit_code == 0, result.output
    folder = tmp_path / "o" / "both"
    sets = [load_experiment(folder / f"best_drive{k}.yaml").parameters for k in (1, 2)]
    assert sets[0] == sets[1]
    document = json.loads((folder / "study.json").read_text())
    each = [r["accuracy"] for r in document["held_out"]["all_frames"]["recordings"]]
    assert document["held_out"]["all_frames"]["accuracy"] == pytest.approx(sum(each) / 2)
    assert [s["left_out"] for s in document["held_out"]["studies"]] == ["drive1", "drive2"]


def test_a_typo_in_a_tuning_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text("name: g\nexperiments: [x.yaml]\ntuning: {trails: 3}\n")
    assert "unknown key 'trails' (did you mean 'trials'?)" in refused(path)
    path.write_text("name: g\nexperiments: [x.yaml]\ntunning: {}\n")
    assert "unknown key 'tunning' (did you mean 'tuning'?)" in refused(path)
    path.write_text("name: g\nexperiments: [x.yaml]\n")
    assert "x.yaml: cannot be read" in refused(path)


def is_alive(pid: str) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("moment", range(2))
def test_the_command_itself_is_killed_and_repeated(moment: int, tmp_path: Path) -> None:
    words = ["tune", str(QUICKSTART), "--in-sample-only", "--trials", "900", "--jobs", "2", "--out"]
    code = "from egolane_pgm.cli.main import main; main()"
    command = [sys.executable, "-c", code, *words, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as first:
        base = tmp_path / "quickstart" / "study.db"
        deadline = time.monotonic() + 60
        while not base.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(random.Random(moment).uniform(0.1, 0.8))
        own = Path(f"/proc/{first.pid}/task/{first.pid}/children").read_text().split()
        first.send_signal(signal.SIGKILL)
    time.sleep(0.2)
    assert own
    assert not [pid for pid in own if is_alive(pid)]
    assert tune(*words[1:], tmp_path).exit_code == 0
    with sqlite3.connect(base) as study:
        states = study.execute("SELECT state, count(*) FROM trials GROUP BY state").fetchall()
    assert states == [("COMPLETE", 900)]


@pytest.mark.parametrize(
    "path", sorted((EXPERIMENTS / "tuning").glob("*.yaml")), ids=lambda p: p.stem
)
def test_every_tuning_file_that_comes_along_is_sound(path: Path) -> None:
    from egolane_pgm.tune.plan import load_plan

    found = load_plan(path)
    assert found.name == path.stem
    assert found.settings.objectives == ("accuracy",)
    if "run" in path.stem:
        assert found.run == int(path.stem[3:5])


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
