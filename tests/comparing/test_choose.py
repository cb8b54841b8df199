"""`fit: choose` and `learned_on`: nothing of the stretch of road that is scored is looked at, in no
recording of it; caution keeps what is not surely worse; learning on other recordings."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.comparing.choose import (
    LOSSES,
    Losses,
    candidates,
    choose,
    losses_of,
    plan,
    try_all,
)
from egolane_pgm.comparing.placing import load_for_scoring
from egolane_pgm.comparing.side import held_out_side
from egolane_pgm.drive import drive_key
from egolane_pgm.evidence import line_geometry
from egolane_pgm.experiment import Experiment, load_experiment, make_experiment
from egolane_pgm.learning import fit, fit_pooled
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.running import run_experiment
from egolane_pgm.types import InputError, LineLog
from tests.conftest import needs_compiler
from tests.kits.drives import (
    done,
    geometry,
    refused,
    rewritten,
    short_drive,
    simulated,
    write_drive,
    write_experiment,
)

pytestmark = needs_compiler
N_FRAMES = 700
SMALL = {"cells": 4, "motion_bins": 9}
GRID = {"prior_frames": ["infinite", 50], "alpha": [0.05, 0.2]}

CHOICE = {
    "grid": GRID,
    "objective": "log_loss",
    "recordings": ["experiment.yaml", "other.yaml"],
}

GEOMETRY: dict[str, Any] = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
    "parameters": SMALL,
}


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def scaled(log: LineLog, by: float) -> LineLog:
    return replace(log, offset_m=log.offset_m * by)


def two_recordings(folder: Path, **changes: Any) -> Experiment:
    """The same drive recorded twice: experiment.yaml, and other.yaml by a detector that reports
    longer metres and sees 7 frames less; and choosing.yaml, on the first."""
    path = write_drive(folder, N_FRAMES, **GEOMETRY)
    log = short_drive(N_FRAMES).log
    write_table(folder / "other.csv", scaled(log.take(slice(7, None)), 1.1))
    write_experiment(
        folder / "other.yaml", **{**GEOMETRY, "name": "other", "recording": {"path": "other.csv"}}
    )
    keys = {"fit": "choose", "choice": CHOICE, **changes}
    rewritten(path, folder / "choosing.yaml", name="choosing", **keys)
    return load_experiment(folder / "choosing.yaml")


def test_the_labels_of_a_stretch_reach_nothing_in_any_recording_of_it(tmp_path: Path) -> None:
    experiment = two_recordings(tmp_path)
    before = held_out_side(load_for_scoring(experiment))
    truth = short_drive(N_FRAMES).truth
    block = np.array_split(np.arange(len(truth)), 5)[2]
    lane = truth.lane.copy()
    lane[block] = np.random.default_rng(0).integers(1, 4, size=len(block))
    write_ground_truth(tmp_path / "ground_truth.txt", replace(truth, lane=lane))
    after = held_out_side(load_for_scoring(experiment))
    np.testing.assert_array_equal(before.beliefs.lane[block], after.beliefs.lane[block])
    assert dict(before.held_out.parameters[2]) == dict(after.held_out.parameters[2])
    assert any(
        dict(before.held_out.parameters[k]) != dict(after.held_out.parameters[k])
        for k in (0, 1, 3, 4)
    )
    assert before.tuned_on == "other_frames"


def test_untrusted_labels_choose_nothing(tmp_path: Path) -> None:
    """Neither by what is learned from them nor by the loss in their frames."""
    experiment = two_recordings(tmp_path, tuning={"never_fit": [[300, 380]]})
    truth = short_drive(N_FRAMES).truth
    found = []
    for other in (truth.lane, truth.lane % 3 + 1):
        is_untrusted = (truth.frame_id >= 300) & (truth.frame_id < 380)
        lane = np.where(is_untrusted, other, truth.lane)
        write_ground_truth(tmp_path / "ground_truth.txt", replace(truth, lane=lane))
        (task, _) = next(iter(plan([experiment], 5).values()))
        found.append(losses_of(task))
    for objective, sums in found[0].sums.items():
        np.testing.assert_array_equal(found[1].sums[objective], sums)
    np.testing.assert_array_equal(found[1].frames, found[0].frames)


def test_losses_are_those_of_what_is_learned_without_both_stretches(tmp_path: Path) -> None:
    experiment = two_recordings(tmp_path)
    (tasks,) = plan([experiment], 5).values()
    assert len(tasks) == 2
    assert tasks[0].stretches == tasks[1].stretches
    found = losses_of(tasks[1])
    drive = load_for_scoring(tasks[1].experiment)
    ids = drive.truth.frame_id
    inside = [(ids >= first) & (ids <= last) for first, last in tasks[1].stretches]
    # A block of one recording is a few frames longer than that of the other.
    assert (np.sum(inside, axis=0) > 1).any()
    setting = candidates(experiment)[3]
    model = replace(drive.model, parameters={**drive.model.parameters, **setting})
    train = np.flatnonzero(~inside[1] & ~inside[2])
    learned = fit(replace(drive, model=model), train)
    there = tasks[1].experiment.model_copy(
        update={"fit": "none", "parameters": {**SMALL, **setting, **learned}}
    )
    belief = held_out_side(load_for_scoring(there)).beliefs.lane
    loss = -np.log(np.maximum(belief[np.arange(len(ids)), drive.truth.lane - 1], 0.01))
    for without, on in ((1, 2), (2, 1)):
        kept = inside[on] & ~inside[without] & ~drive.truth.is_crossing
        assert found.sums["log_loss"][3, without, on] == pytest.approx(loss[kept].sum())
        wrong = belief.argmax(axis=1) + 1 != drive.truth.lane
        assert found.sums["accuracy"][3, without, on] == wrong[kept].sum()
        assert found.frames[without, on] == kept.sum()


def test_a_tie_is_wrong_and_a_sure_error_costs_no_more_than_the_floor_says() -> None:
    belief, lane = np.array([[0.5, 0.5], [0.2, 0.8], [1.0, 0.0]]), np.array([1, 2, 2])
    np.testing.assert_array_equal(LOSSES["accuracy"](belief, lane, 0.0), [1, 0, 1])
    np.testing.assert_array_equal(LOSSES["accuracy"](belief, lane, 0.9), [1, 1, 1])
    np.testing.assert_allclose(LOSSES["log_loss"](belief, lane, 0.0), -np.log([0.5, 0.8, 0.01]))


def losses(sums: list[list[float]], drive: str = "here", frames: int = 100) -> Losses:
    """sums[s][c], whatever else is left out."""
    table = np.array(sums, dtype=float)
    each = np.repeat(table[:, None, :], table.shape[1], axis=1)
    return Losses(drive, {"accuracy": each}, np.full(each.shape[1:], frames))


def choosing(cautious: str | None = "prior_frames", **keys: str) -> Experiment:
    grid = {"prior_frames": ["infinite", 100], "alpha": [0.05, 0.2]}
    return geometry(fit="choose", choice={"grid": grid, "cautious": cautious, **keys})


def test_the_setting_of_least_loss_is_chosen_where_nothing_is_cautious() -> None:
    one = losses([[9, 9, 9], [5, 5, 5], [5, 4, 5], [7, 7, 7]])
    assert choose([one], "here", 0, choosing(None)) == 2
    # Other drives count with all their stretches.
    other = losses([[9, 9], [0, 0], [5, 5], [9, 9]], "there")
    assert choose([one, other], "here", 0, choosing(None)) == 1


def test_what_is_scored_is_not_looked_at() -> None:
    one = losses([[0, 9, 9], [9, 5, 5], [9, 6, 6], [9, 7, 7]])
    assert choose([one], "here", 0, choosing(None)) == 1
    one.sums["accuracy"][:, :, 0] = np.nan
    assert choose([one], "here", 0, choosing(None)) == 1
    # What was learned with the block is of no use either.
    one = losses([[1, 1, 1], [2, 2, 2], [3, 3, 3], [4, 4, 4]])
    one.sums["accuracy"][:, 1:, :] = np.nan
    assert choose([one], "here", 0, choosing(None)) == 0


def test_without_a_frame_to_choose_on_nothing_is_chosen() -> None:
    one = losses([[0, 0, 0], [0, 0, 0]], frames=0)
    with pytest.raises(InputError, match="block 2: no frame is left to choose on"):
        choose([one], "here", 1, choosing(None))


def test_caution_keeps_what_is_not_worse_by_a_standard_error() -> None:
    paired = choosing(error_of="difference")
    # Worse by 1 in each stretch; or by 4, 0, -1, 1: a standard error of 1.1 about a mean of 1.
    surely = losses([[9] * 5, [0, 2, 9, 4, 6], [9] * 5, [0, 1, 8, 3, 5]])
    assert choose([surely], "here", 0, paired) == 3
    by_luck = losses([[9] * 5, [0, 9, 5, 4, 6], [9] * 5, [5] * 5])
    assert choose([by_luck], "here", 0, paired) == 1
    # By 4, 0, 3, 0: a standard error of 1 about a mean of 1.75.
    mostly = losses([[9] * 5, [0, 9, 5, 8, 5], [9] * 5, [5] * 5])
    assert choose([mostly], "here", 0, paired) == 3
    assert choose([by_luck], "here", 0, choosing(None)) == 3
    assert choose([by_luck], "here", 0, choosing("alpha", error_of="difference")) == 3
    # The least loss itself is not known as well as the difference: 1, 8, 3, 5.
    assert choose([surely], "here", 0, choosing()) == 1
    assert choose([by_luck], "here", 0, choosing()) == 3
    # Each value has its own chance: the first is surely worse by 1, the second by 8, 0, -2, 2.
    grid = {"prior_frames": ["infinite", 100, 50]}
    three = {"grid": grid, "cautious": "prior_frames", "error_of": "difference"}
    one_of_three = losses([[9, 6, 6, 6, 6], [9, 13, 5, 3, 7], [9, 5, 5, 5, 5]])
    assert choose([one_of_three], "here", 0, geometry(fit="choose", choice=three)) == 1


def test_with_a_rule_that_learns_nothing_only_the_grid_is_chosen_from() -> None:
    grid = {"sigma1": [0.2, 0.9], "p1": [0.5, 0.9]}
    experiment = simulated(fit="choose", choice={"grid": grid})
    run = held_out_side(load_for_scoring(experiment))
    assert run.free_parameters == 2
    for found in run.held_out.parameters:
        assert set(found) == set(grid)
        assert found["sigma1"] in grid["sigma1"]
    alone = simulated(parameters=dict(run.held_out.parameters[3]), tuned_on="not_tuned")
    block = np.array_split(np.arange(len(run.truth)), 5)[3]
    expected = held_out_side(load_for_scoring(alone)).beliefs.lane[block]
    np.testing.assert_array_equal(run.beliefs.lane[block], expected)


def test_processes_try_the_same(tmp_path: Path) -> None:
    (tasks,) = plan([two_recordings(tmp_path)], 5).values()
    for one, two in zip(try_all(tasks), try_all(tasks, jobs=2), strict=True):
        for objective in ("accuracy", "log_loss"):
            np.testing.assert_array_equal(one.sums[objective], two.sums[objective])


def test_the_command_says_what_was_chosen(tmp_path: Path) -> None:
    two_recordings(tmp_path)
    target = tmp_path / "found.json"
    shown = done("compare", tmp_path / "choosing.yaml", "--json", target).stdout
    (entry,) = json.loads(target.read_text())["recordings"][0]["experiments"]
    assert entry["fit"] == "choose"
    assert "| chosen" in shown
    chosen = [found["alpha"] for found in entry["parameters"]]
    assert set(chosen) <= set(GRID["alpha"])
    assert f"alpha {chosen[0]:g}" in shown


def test_what_is_learned_in_the_end_is_chosen_with_every_block(tmp_path: Path) -> None:
    # What the experiment says of a parameter is not what is chosen.
    experiment = two_recordings(tmp_path, parameters={**SMALL, "alpha": 0.1})
    target = tmp_path / "final.yaml"
    said = done("learn", tmp_path / "choosing.yaml", "--out", target).stdout
    assert "have seen that choice" in " ".join(said.split())
    final = load_experiment(target)
    (tasks,) = plan([experiment], 5, is_held_out=False).values()
    losses = list(try_all(tasks))
    total = sum(one.sums["log_loss"][:, range(5), range(5)].sum(axis=1) for one in losses)
    best = candidates(experiment)[int(np.argmin(total))]
    assert experiment.choice is not None
    assert experiment.choice.cautious is None
    assert {name: final.parameters[name] for name in best} == best
    assert final.fit == "none"
    assert f"alpha {best['alpha']}" in said


def test_a_choice_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    two_recordings(tmp_path)
    path = tmp_path / "choosing.yaml"
    assert "fit: choose needs choice.grid" in refused("compare", path, "--set", "choice=null")
    message = refused("compare", path, "--set", "choice.grid={alhpa: [0.1]}")
    assert "choice.grid: unknown key 'alhpa' (did you mean 'alpha'?)" in message
    message = refused("compare", path, "--set", "choice.grid={alpha: [-1]}")
    assert "choice.grid.alpha: -1 must not be negative" in message
    message = refused("compare", path, "--set", "choice.grid={alpha: []}")
    assert "choice: grid.alpha: needs values, each once" in message
    message = refused("compare", path, "--set", "choice.cautious=bta")
    assert "choice: cautious: 'bta' is not in the grid" in message
    message = refused("compare", path, "--set", "choice.recordings=[absent.yaml]")
    assert "choice.recordings: " in message
    assert "absent.yaml" in message
    message = refused("compare", path, "--set", "choice.recording=[absent.yaml]")
    assert "unknown key 'recording' (did you mean 'recordings'?)" in message
    message = refused("compare", path, "--blocks", "2", "--set", "choice.recordings=[]")
    assert "blocks 1 and 2: no frame is left to learn from; take more blocks" in message


def test_learned_on_another_recording_its_stretch_is_left_out(tmp_path: Path) -> None:
    two_recordings(tmp_path)
    target = tmp_path / "found.json"
    words = ("--learned-on", tmp_path / "other.yaml", "--json", target)
    done("compare", tmp_path / "experiment.yaml", *words)
    (entry,) = json.loads(target.read_text())["recordings"][0]["experiments"]
    assert entry["name"] == "on_other"
    assert entry["tuned_on"] == "other_frames"
    own = load_for_scoring(load_experiment(tmp_path / "experiment.yaml"))
    block = np.array_split(np.arange(len(own)), 5)[3]
    drive = load_for_scoring(load_experiment(tmp_path / "other.yaml"))
    assert drive_key(drive.experiment) == drive_key(own.experiment)
    train = np.flatnonzero(~np.isin(drive.truth.frame_id, own.truth.frame_id[block]))
    assert 0 < len(train) < len(drive)
    expected = fit(drive, train)
    assert entry["parameters"][3]["rates"] == pytest.approx(expected["rates"])


def test_pooled_parts_of_a_recording_come_to_the_whole(tmp_path: Path) -> None:
    write_drive(tmp_path, N_FRAMES, **GEOMETRY)
    drive = load_for_scoring(load_experiment(tmp_path / "experiment.yaml"))
    parts = np.array_split(np.arange(len(drive)), 2)
    whole = fit(drive, np.arange(len(drive)))
    pooled = fit_pooled([drive, drive], parts)
    for name, value in whole.items():
        np.testing.assert_allclose(np.asarray(pooled[name]), np.asarray(value), rtol=1e-6)


def test_detectors_with_other_metres_are_pooled_in_lane_widths(tmp_path: Path) -> None:
    two_recordings(tmp_path)
    first, second = (
        load_for_scoring(load_experiment(tmp_path / f"{name}.yaml"))
        for name in ("experiment", "other")
    )
    train = [np.arange(len(drive)) for drive in (first, second)]
    alone, pooled = fit_pooled([first], train[:1]), fit_pooled([first, second], train)
    assert pooled["fallback_width_m"] == alone["fallback_width_m"]
    np.testing.assert_allclose(np.asarray(pooled["sigmas_m"]), alone["sigmas_m"], atol=0.02)


def test_runs_of_the_paper_are_named_by_number(tmp_path: Path, monkeypatch: Any) -> None:
    from egolane_pgm.comparing import learned_on as elsewhere

    for number in (1, 2):
        (tmp_path / f"run{number}.yaml").touch()
    monkeypatch.setattr(elsewhere, "paper_experiment", lambda k: tmp_path / f"run{k}.yaml")
    first, second = simulated("a"), simulated("b", recording={"simulate": "quickstart", "seed": 1})
    found = elsewhere.learned_elsewhere([first, second], ["1", "1-2"], on_runs=False)
    assert [e.name for e in found] == ["on_run_1", "on_run_1-2"] * 2
    assert [len(e.learned_on) for e in found] == [1, 2] * 2
    found = elsewhere.learned_elsewhere([first, second], ["1"], on_runs=True)
    assert [e.name for e in found] == ["a_on_run_1", "b_on_run_1"]


def test_recordings_that_cannot_be_learned_from_are_refused(tmp_path: Path) -> None:
    two_recordings(tmp_path)
    path = tmp_path / "experiment.yaml"
    assert "absent.yaml: no such file" in refused("compare", path, "--learned-on", "absent.yaml")
    assert "names nothing" in refused("compare", path, "--learned-on", ",")
    assert "goes with experiments" in refused("compare", "--learned-on", "1")
    message = refused("compare", path, "--set", "learned_on=[other.yaml]")
    assert "learned_on: goes with fit: learn" in message
    wide = write_experiment(tmp_path / "wide.yaml", **GEOMETRY, n_lanes=4)
    message = refused("compare", path, "--learned-on", wide)
    assert "has 4 lanes, what is scored has 3" in message
    # The same stretch is all that there is.
    short = {"path": "other.csv", "frames": [10, 50]}
    write_experiment(tmp_path / "short.yaml", **{**GEOMETRY, "recording": short})
    message = refused("compare", path, "--learned-on", tmp_path / "short.yaml")
    assert "learned_on: no frame is left to learn from" in message


def test_a_rule_that_learns_from_one_recording_cannot_be_pooled(
    tmp_path: Path, monkeypatch: Any
) -> None:
    two_recordings(tmp_path)
    drive = load_for_scoring(load_experiment(tmp_path / "experiment.yaml"))
    monkeypatch.delattr(line_geometry, "fit_pooled")
    with pytest.raises(InputError, match="it has no fit_pooled"):
        fit_pooled([drive, drive], [np.arange(9)] * 2)


def test_nothing_is_learned_where_the_prior_is_infinite(tmp_path: Path) -> None:
    content = {
        "name": "x",
        "recording": {"simulate": "quickstart"},
        "n_lanes": 4,
        **GEOMETRY,
        "parameters": {**SMALL, "prior_frames": "infinite", "sigmas_m": [0.1] * 7},
    }
    drive = load_for_scoring(make_experiment(content, tmp_path, "x.yaml"))
    found = fit(drive, np.arange(len(drive)))
    # What the experiment has learned before may be from frames that are scored.
    assert set(found) == set(line_geometry.LEARNED)
    assert found["rates"] == found["sigmas_m"] == "generic"


def on_truth(folder: Path, name: str, truth: str, **changes: Any) -> Experiment:
    keys = {"name": name, "ground_truth__path": truth, **changes}
    return load_experiment(rewritten(folder / "experiment.yaml", folder / f"{name}.yaml", **keys))


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
