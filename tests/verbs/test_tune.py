"""`egolane tune` and `egolane learn` as a user runs them."""

from __future__ import annotations

import json
import signal
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
import pytest
import yaml

from egolane_pgm.loading import experiments_folder, load_experiment
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.result import load_result
from egolane_pgm.studies.storage import open_storage
from egolane_pgm.types import lane_truth
from egolane_pgm.verbs.studied import open_studied
from tests.kits.drives import done, refused, rewritten, run, write_drive, write_experiment
from tests.kits.image_line_files import entry, saved_camera, tusimple
from tests.kits.processes import started

QUICKSTART = experiments_folder() / "quickstart.yaml"


def study_of(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "study.json").read_text())
    assert isinstance(found, dict)
    return found


def trials_of(folder: Path) -> pd.DataFrame:
    return pd.read_parquet(folder / "trials.parquet")


# --- tune ----------------------------------------------------------------------------------------


def test_a_study_ends_with_tables_a_directory_and_an_experiment_to_run(tmp_path: Path) -> None:
    drive, out = write_drive(tmp_path), tmp_path / "study"
    shown = done("tune", drive, "--trials", 8, "--folds", 2, "--out", out).stdout
    assert shown.startswith("'drive': tune, 8 trials, accuracy ")
    assert "held out: 2 folds, each scored with a fit to the others" in shown
    assert shown.endswith(f"study: {out}; run its best.yaml, or `include:` it\n")
    document = study_of(out)
    assert (document["method"], len(document["folds"]), len(trials_of(out))) == ("tune", 2, 8)
    figures = {path.name for path in (out / "figures").iterdir()}
    assert figures == {"history.png", "profile.png"}
    other = done("run", tmp_path / "lines.csv", "--experiment", out / "best.yaml", "--n-lanes", 3,
                 "--out", tmp_path / "same")  # fmt: skip
    assert "no ground truth" in other.stdout
    assert load_result(tmp_path / "same").run["tuned_on"] == "same_frames"


def test_options_go_before_the_yaml(tmp_path: Path) -> None:
    tuning = {"trials": 3, "seed": 3, "parameters": {"p1": [0.5, 0.9], "p2": 0.7}}
    path = rewritten(QUICKSTART, tmp_path / "x.yaml", fit=tuning)
    words = (path, "--folds", 0, "--out", tmp_path / "o", "-p", "p1=[0.6,0.7]", "--trials", 4)
    done("tune", *words)
    document = study_of(tmp_path / "o")
    assert len(trials_of(tmp_path / "o")) == 4
    assert document["settings"]["searched"]["p1"][:2] == [0.6, 0.7]
    assert document["settings"]["seed"] == 3
    assert load_experiment(tmp_path / "o" / "best.yaml").parameters["p2"] == 0.7


def test_a_database_keeps_the_study_and_those_without_a_block(tmp_path: Path) -> None:
    base = f"sqlite:///{tmp_path}/shared.db"
    words = ("tune", QUICKSTART, "--trials", 3, "--folds", 2, "--storage", base)
    for out in ("here", "there"):
        done(*words, "--out", tmp_path / out)
    names = optuna.get_all_study_names(base)
    assert len(names) == 3
    assert {len(optuna.load_study(study_name=n, storage=base).trials) for n in names} == {3}
    here, there = (study_of(tmp_path / out) for out in ("here", "there"))
    assert here["held_out"] == there["held_out"]


def test_a_list_of_experiments_has_one_parameter_set(tmp_path: Path) -> None:
    for k in (1, 2):
        rewritten(QUICKSTART, tmp_path / f"{k}.yaml", name=f"drive{k}", recording__seed=k)
    group = {"name": "both", "experiments": ["1.yaml", "2.yaml"], "fit": {"trials": 3}}
    (tmp_path / "group.yaml").write_text(yaml.safe_dump(group))
    out = tmp_path / "o" / "*"
    done("tune", tmp_path / "group.yaml", "--folds", 2, "--out", out)
    document = study_of(tmp_path / "o" / "both")
    assert document["experiments"] == ["drive1", "drive2"]
    content = yaml.safe_load((tmp_path / "o" / "both" / "best.yaml").read_text())
    assert [each["frames"] for each in content["tuned_on"]] == [[[0, 1200]]] * 2
    held_out = load_result(tmp_path / "o" / "both" / "held_out")
    assert held_out.frames["drive"].unique().tolist() == ["drive1", "drive2"]


def test_whole_drives_of_a_table_are_held_out_by_a_tag(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(
        "name,recording.seed,tag.weather\na,1,sun\nb,2,rain\nc,3,sun\n"
    )
    words = ("--table", tmp_path / "runs.csv", "--by-tag", "weather", "--trials", 2)
    done("tune", QUICKSTART, *words, "--out", tmp_path / "o", "--set", "fit.objective=f1")
    # All frames count alike, as in the scores of the study.
    best = study_of(tmp_path / "o")["in_sample"]["model"]["f1"]
    assert trials_of(tmp_path / "o")["f1"].max() == pytest.approx(best, abs=1e-9)
    frames = load_result(tmp_path / "o" / "held_out").frames
    assert frames.groupby("drive")["block"].unique().map(list).to_dict() == {
        "a": [0], "b": [1], "c": [0],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("-p sigma1", "--parameter: sigma1: write it as key=value, e.g. n_lanes=3"),
        ("--folds 5000", "--folds: 5000 is not between 2 and the 1"),
        ("--folds 1", "--folds: 1 leaves nothing to fit to; 0 holds out nothing"),
        ("--trials 0", "'--trials'"),
        ("--set fit.sampler=CmaEsSampler --set fit.objective=[f1,brier]", "CmaEsSampler: If the"),
        (
            "--set fit.sampler=GridSampler",
            "fit.sampler: GridSampler: GridSampler.__init__()",
        ),
        ("--by-tag weather", "--by-tag: goes with a table of runs"),
        ("--storage nosuch://me:secret@host/base", "nosuch://me:***@host/base"),
        ("--set filter=fixed_lag --set lag=3", "filter: a search takes assumed_density or exact"),
        ("--ground-truth x.txt", "No such option"),
    ],
)
def test_a_search_that_cannot_start_is_one_line_and_leaves_nothing(
    tmp_path: Path, words: str, message: str
) -> None:
    line = refused("tune", QUICKSTART, "--out", tmp_path / "o", *words.split())
    assert message in line
    assert "secret" not in line
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("experiments: [x.yaml]\nfit: {trails: 3}\n", "unknown key 'trails' (did you mean"),
        ("experiments: [x.yaml]\nfitt: {}\n", "unknown key 'fitt' (did you mean 'fit'?)"),
        ("experiments: [x.yaml]\n", "x.yaml: cannot be read"),
    ],
)
def test_a_list_of_experiments_that_does_not_fit_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(f"name: g\n{text}")
    assert message in refused("tune", path)


def states(journal: Path) -> Counter[str]:
    """How many trials of a study are in each state."""
    storage = open_storage(str(journal))
    trials = [t for s in storage.get_all_studies() for t in storage.get_all_trials(s._study_id)]
    return Counter(t.state.name for t in trials)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_search_that_is_stopped_keeps_its_trials_and_goes_on(jobs: int, tmp_path: Path) -> None:
    words = ["tune", QUICKSTART, "--trials", 2500, "--folds", 2]
    journal = tmp_path / "study.journal"
    with started(*words, "--jobs", jobs, "--out", tmp_path) as first:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if journal.exists() and journal.stat().st_size > 100_000:
                break
            time.sleep(0.01)
        begun = time.monotonic()
        first.send_signal(signal.SIGINT)
        _, output = first.communicate()
    assert time.monotonic() - begun < 30
    assert first.returncode == 130
    assert [line[:20] for line in output.splitlines() if line.startswith("egolane: ")] == [
        "egolane: interrupted"
    ]
    assert "Traceback" not in output
    assert states(journal)["COMPLETE"] > 10


@pytest.mark.parametrize(
    "path", sorted((experiments_folder() / "tuning").glob("*.yaml")), ids=lambda p: p.stem
)
def test_every_shipped_list_of_experiments_is_sound(path: Path, recordings: Path) -> None:
    name, inputs = open_studied(path, {"recording.frames": [3000, 3200]}, None)
    assert name == path.stem
    assert all(each.experiment.fit.objective for each in inputs)


def test_the_published_parameters_are_tried_first(recordings: Path, tmp_path: Path) -> None:
    words = ("run06_spain_ml", "--trials", 2, "--folds", 2, "--out", tmp_path)
    done("tune", *words)
    first, second = trials_of(tmp_path).iloc[:2].to_dict("records")
    assert second["sigma1"] == 0.407
    assert first["sigma1"] == pytest.approx(0.407, abs=1e-3)
    assert first["accuracy"] == pytest.approx(0.8963, abs=1e-4)
    held_out = study_of(tmp_path)["held_out"]
    scored = [held_out[key]["frames_scored"] for key in ("model_all_frames", "model")]
    assert scored[0] - scored[1] == 200


def test_a_study_scores_the_reject_option_as_a_run_does(tmp_path: Path) -> None:
    path = write_drive(tmp_path, min_confidence=0.9)
    out = tmp_path / "o"
    name = "false_switches_per_minute"
    words = ("--set", f"fit.objective={name}", "--trials", 5, "--folds", 0, "--out", out)
    done("tune", path, *words)
    scores = run(out / "best.yaml").scores["model"]
    assert scores["coverage"] < 1
    assert trials_of(out)[name].min() == pytest.approx(scores[name])


# --- learn ---------------------------------------------------------------------------------------


def test_a_model_learned_elsewhere_reads_the_same_labels_and_camera(tmp_path: Path) -> None:
    frame = np.arange(12)
    tusimple(tmp_path / "labels.json", [entry(k, raw_file=f"{k:05d}.jpg") for k in frame])
    write_ground_truth(tmp_path / "t.txt", lane_truth(frame, np.full(12, 2), frame < 0))
    labelled = write_experiment(
        tmp_path / "x.yaml",
        recording={"path": "labels.json", "camera": saved_camera(tmp_path).name},
        ground_truth={"path": "t.txt"},
        graph="lane_only",
    )
    out = tmp_path / "new" / "folder"
    shown = done("learn", labelled, "--folds", 2, "--out", out).stdout
    assert shown.startswith("'drive': learn, accuracy ")
    assert shown.endswith(f"study: {out}; run its best.yaml, or `include:` it\n")
    found, before = load_experiment(out / "best.yaml"), load_experiment(labelled)
    for key in ("path", "camera"):
        assert getattr(found.recording, key) == getattr(before.recording, key)
    assert found.ground_truth == before.ground_truth
    assert (found.graph, study_of(out)["method"]) == (str(out / "best.graph.yaml"), "learn")
    assert run(found).run["tuned_on"] == "same_frames"
    # The learned graph by itself, on the frames that it was learned from, is in-sample too.
    assert run(before, graph=out / "best.graph.yaml").run["tuned_on"] == "same_frames"


@pytest.mark.parametrize(
    ("keys", "words", "message"),
    [
        (
            {"graph": "lane_only", "evidence": "never.py"},
            "",
            "allows no frame of the 150 to",
        ),
        ({"ground_truth": None}, "", "ground_truth: is missing"),
        ({}, "--set fit.strength=0", "fit.strength: needs a number greater than 0"),
    ],
)
def test_a_model_that_cannot_be_learned_is_one_line(
    tmp_path: Path, keys: dict[str, Any], words: str, message: str
) -> None:
    path = write_drive(tmp_path, **keys)
    (tmp_path / "never.py").write_text(
        "import numpy as np\nfrom egolane_pgm.types import Evidence\n"
        "def evidence(log, n_lanes, parameters):\n"
        "    return Evidence({'DetectorOutput': np.zeros((len(log), n_lanes))})\n"
    )
    assert message in refused("learn", path, "--out", tmp_path / "o", *words.split())
    assert not (tmp_path / "o").exists()
