"""Several experiments in one command: own result directories, failures listed and not fatal."""

import json
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from egolane_pgm import run as run_many
from egolane_pgm.cli.main import egolane
from egolane_pgm.experiment import load_experiment
from egolane_pgm.results import is_result
from egolane_pgm.types import InputError


@pytest.fixture
def experiments(tmp_path):
    """Three simulated drives and one whose recording is not there."""
    paths = []
    for seed in range(3):
        content = {
            "name": f"drive{seed}",
            "recording": {"simulate": "quickstart", "seed": seed},
            "n_lanes": 3,
            "tuned_on": "not_tuned",
        }
        paths.append(tmp_path / f"drive{seed}.yaml")
        paths[-1].write_text(yaml.safe_dump(content))
    content = {"name": "gone", "recording": {"path": "gone.bag"}, "n_lanes": 3}
    paths.insert(1, tmp_path / "gone.yaml")
    paths[1].write_text(yaml.safe_dump(content))
    return [str(path) for path in paths]


def invoke(*arguments):
    return CliRunner().invoke(egolane, [str(a) for a in arguments])


def tasks(experiments, folder):
    sources = [(path, lambda path=path: load_experiment(path)) for path in experiments]
    return run_many.plan_runs(sources, folder)


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_run_has_its_own_result_and_one_that_fails_stops_no_other(experiments, tmp_path, jobs):
    out = tmp_path / "out"
    found = invoke(
        "run", *experiments, "--jobs", jobs, "--no-figures", "--out", out, "--json", out / "a.json"
    )
    assert found.exit_code == 1
    assert "failed: gone: " in found.output
    assert "gone.bag: no such file" in found.output
    assert "results: 3 of 4" in found.output
    assert [is_result(out / f"drive{k}") for k in range(3)] == [True] * 3
    document = json.loads((out / "a.json").read_text())
    assert [run["name"] for run in document["runs"]] == ["drive0", "drive1", "drive2"]
    assert [entry["experiment"] for entry in document["failed"]] == ["gone"]


def test_several_processes_give_what_one_gives(experiments, tmp_path):
    one, two = (
        list(run_many.run_all(tasks(experiments, tmp_path / str(jobs)), jobs=jobs))
        for jobs in (1, 2)
    )
    assert [o.summary for o in one] == [o.summary for o in two]


def test_all_well_is_exit_code_0(experiments, tmp_path):
    good = [experiments[0], experiments[2]]
    found = invoke("run", *good, "--no-figures", "--out", tmp_path / "out")
    assert found.exit_code == 0
    assert "failed" not in found.output


def test_a_file_that_is_no_experiment_is_listed_and_the_others_run(experiments, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: x\nn_lane: 3\n")
    found = invoke("run", bad, experiments[0], "--no-figures", "--out", tmp_path / "out")
    assert found.exit_code == 1
    assert "unknown key 'n_lane' (did you mean 'n_lanes'?)" in found.output
    assert is_result(tmp_path / "out" / "drive0")


def test_two_runs_of_one_name_are_refused_before_anything_is_run(experiments, tmp_path):
    out = tmp_path / "out"
    other = tmp_path / "other.yaml"
    other.write_text(Path(experiments[0]).read_text())
    found = invoke("run", experiments[0], other, "--out", out)
    assert found.exit_code == 2
    assert "give one of them another `name`" in found.output
    assert not out.exists()


def test_one_experiment_on_several_recordings(experiments, tmp_path):
    for seed in range(2):
        invoke("simulate", "quickstart", "--seed", seed, "--out", tmp_path / f"road{seed}")
    lines = sorted(tmp_path.glob("road*/*lines*.csv")) or sorted(tmp_path.glob("road*/*.parquet"))
    renamed = [path.rename(tmp_path / f"drive_{k}{path.suffix}") for k, path in enumerate(lines)]
    assert len(renamed) == 2
    options = [o for path in renamed for o in ("--recording", path)]
    out = tmp_path / "out"
    found = invoke("run", experiments[0], *options, "--no-figures", "--out", out)
    assert found.exit_code == 0, found.output
    assert is_result(out / "drive_0")
    assert is_result(out / "drive_1")


def test_several_recordings_cannot_share_a_ground_truth(experiments, tmp_path):
    found = invoke(
        "run", experiments[0], "--recording", "a", "--recording", "b", "--ground-truth", "c"
    )
    assert found.exit_code == 2
    assert "several --recording go with one experiment" in found.output


KILLS = """
import os, signal
from egolane_pgm.evidence.counting import *
def evidence(*given, **named):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_process_that_dies_leaves_the_results_of_the_others(experiments, tmp_path):
    (tmp_path / "kills.py").write_text(KILLS)
    last = Path(experiments[3])
    last.write_text(last.read_text() + "evidence: ./kills.py\n")
    plan = tasks([experiments[k] for k in (0, 2, 3)], tmp_path / "out")
    done = list(run_many.run_all(plan, jobs=2))
    assert len(done) == 3
    assert done[2].error == "its process, or one beside it, died (killed, or out of memory?)"
    for outcome in done:
        assert (outcome.error is None) == (outcome.summary is not None)
        if outcome.error is None:
            assert is_result(outcome.directory)


def test_what_nobody_foresaw_in_one_run_is_listed_by_its_kind(experiments, tmp_path, monkeypatch):
    def breaks(experiment, **options):
        raise ZeroDivisionError("no lanes\nat all")

    monkeypatch.setattr(run_many, "run_experiment", breaks)
    (outcome,) = run_many.run_all(tasks(experiments[:1], tmp_path / "out"))
    assert outcome.error == "ZeroDivisionError: no lanes at all"


def test_a_folder_that_is_in_the_way_is_refused_before_anything_is_run(experiments, tmp_path):
    taken = tmp_path / "out" / "drive0"
    taken.mkdir(parents=True)
    (taken / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="exists and is not a result directory"):
        tasks(experiments, tmp_path / "out")
