"""Constants are chosen as the scores judge, and no label of what is scored comes in by a copy of
the ground truth under another name."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm.compare.choose import candidates, losses_of, plan
from egolane_pgm.compare.placing import drive_key
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.run import run_experiment
from tests.compare.test_comparing import simulated
from tests.conftest import needs_compiler
from tests.kits.drives import refused, write_drive

pytestmark = needs_compiler


def on_truth(folder: Path, name: str, truth: str, **changes: Any) -> Experiment:
    content = yaml.safe_load((folder / "experiment.yaml").read_text())
    content |= {"name": name, "ground_truth": {"path": truth}, **changes}
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(content))
    return load_experiment(folder / f"{name}.yaml")


@pytest.mark.parametrize("below", [0.0, 0.9])
def test_a_setting_is_judged_by_accuracy_as_the_scores_judge_it(below: float) -> None:
    grid = {"sigma1": [0.2, 0.9], "p1": [0.5, 0.9]}
    experiment = simulated(fit="choose", choice={"grid": grid}, unassigned_below=below)
    ((task,),) = plan([experiment], 5, is_held_out=False).values()
    found = losses_of(task)
    assert found.frames.sum() > 0
    for setting, sums in zip(candidates(experiment), found.sums["accuracy"], strict=True):
        one = simulated(parameters=setting, unassigned_below=below, tuned_on="not_tuned")
        scores = run_experiment(one).scores["model"]
        wrong = round((1 - scores["accuracy"]) * scores["frames_scored"])
        assert sums.trace() == wrong
        assert found.frames.trace() == scores["frames_scored"]


def test_a_copy_of_the_ground_truth_is_of_the_same_drive(tmp_path: Path) -> None:
    own = load_experiment(write_drive(tmp_path))
    text = (tmp_path / "ground_truth.txt").read_text()
    shutil.copy(tmp_path / "ground_truth.txt", tmp_path / "copy.txt")
    (tmp_path / "windows.csv").write_text(
        "frame,lane,crossing\n" + text.replace(";", ",").replace("\n", "\r\n"), newline=""
    )
    os.link(tmp_path / "ground_truth.txt", tmp_path / "link.txt")
    frame, lane, crossing = text.splitlines()[0].split(";")
    changed = f"{frame};{int(lane) % 3 + 1};{crossing}\n" + text.split("\n", 1)[1]
    (tmp_path / "changed.txt").write_text(changed)
    for name in ("copy.txt", "windows.csv", "link.txt"):
        assert drive_key(on_truth(tmp_path, "other", name)) == drive_key(own)
    assert drive_key(on_truth(tmp_path, "other", "changed.txt")) != drive_key(own)
    # Written anew under its name, it is another one.
    (tmp_path / "copy.txt").write_text(changed + "999999;1;0\n")
    assert drive_key(on_truth(tmp_path, "other", "copy.txt")) != drive_key(own)


def test_the_held_out_stretch_is_left_out_of_a_copy_too(tmp_path: Path) -> None:
    write_drive(tmp_path)
    shutil.copy(tmp_path / "ground_truth.txt", tmp_path / "copy.txt")
    choice = {"grid": {"sigma1": [0.2, 0.9]}, "recordings": ["other.yaml"]}
    on_truth(tmp_path, "other", "copy.txt", recording={"path": "lines2.csv"})
    shutil.copy(tmp_path / "lines.csv", tmp_path / "lines2.csv")
    own = on_truth(tmp_path, "own", "ground_truth.txt", fit="choose", choice=choice)
    (tasks,) = plan([own], 5).values()
    assert [task.is_target for task in tasks] == [True, True]
    first, second = (losses_of(task) for task in tasks)
    assert first.drive == second.drive
    np.testing.assert_array_equal(first.frames, second.frames)
    assert (second.frames[0, 1:] > 0).all(), "tried without the block that is scored"


def test_a_ground_truth_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = write_drive(tmp_path, fit="choose", choice={"grid": {"sigma1": [0.2, 0.9]}})
    (tmp_path / "ground_truth.txt").unlink()
    said = refused("compare", path)
    assert f"{path}: ground_truth.path: ground_truth.txt: no such file" in said
