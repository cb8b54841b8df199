"""Studies from end to end: held-out labels change nothing, and an interrupted search goes on."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
import pytest
import yaml
from pandas.testing import assert_frame_equal

from egolane_pgm.drives import Drive
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import with_parameters
from egolane_pgm.result import Result, is_result, load_result
from egolane_pgm.runs import open_input, run_input
from egolane_pgm.studies.study import (
    Study,
    Work,
    block_folds,
    group_folds,
    is_study,
    run_held_out,
    run_study,
)
from egolane_pgm.types import InputError
from tests.conftest import needs_compiler
from tests.kits.drives import contents, geometry, run, simulated, write_drive, write_experiment
from tests.kits.studies import drive_of, fitting, scrambled, two_drives, with_labels

pytestmark = needs_compiler

FEW = {"trials": 12}
FITS = pytest.mark.parametrize(
    "keys",
    [{"fit": {"method": "learn"}}, {"fit": {"method": "tune", **FEW}}],
    ids=["tables", "tune"],
)


def tuned(drives: list[Drive], folds: Any = (), trials: int = 6, **options: Any) -> Study:
    keys = {"trials": trials, **options.pop("fit", {})}
    given = [fitting(each, **keys) for each in drives]
    return run_study(given, "tune", list(folds), Work(**options))


# --- held out ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "experiment",
    [
        simulated(fit={"method": "learn"}),
        simulated(fit={"method": "learn", "labels": False}),
        geometry(fit={"method": "learn"}),
        simulated(fit={"method": "tune", **FEW}),
        simulated(fit={"method": "tune", **FEW, "objective": ["log_loss", "brier"]}),
    ],
    ids=["tables", "evidence", "rule", "tune", "front"],
)
def test_poisoned_labels_of_a_block_change_nothing_of_what_is_inferred_in_it(
    experiment: Any,
) -> None:
    drive = drive_of(experiment)
    folds = block_folds([drive])
    block = folds[2].test[0]
    before = run_held_out([drive])
    for seed in (1, 2):
        after = run_held_out([scrambled(drive, block, seed)])
        ours, theirs = (each.frames[each.frames["block"] == 2] for each in (before, after))
        truth = ["true_lane", "is_crossing"]
        assert_frame_equal(ours.drop(columns=truth), theirs.drop(columns=truth))
        assert before.run["fitted"][2] == after.run["fitted"][2]
    if experiment.fit.method == "none":
        # The other folds see them.
        assert before.run["fitted"] != after.run["fitted"]
    assert (before.run["tuned_on"], before.run["blocks"]) == ("other_frames", 5)
    for b, fold in enumerate(folds):
        assert np.flatnonzero(before.frames["block"] == b).tolist() == fold.test[0].tolist()


@FITS
def test_untrusted_labels_are_never_fitted_and_scored_apart(keys: dict[str, Any]) -> None:
    fit = {**keys["fit"], "untrusted_frames": [[1000, None]]}
    drive = drive_of(simulated(**{**keys, "fit": fit}))
    untrusted = np.flatnonzero(~drive.is_trusted)
    before, after = (run_held_out([each]) for each in (drive, scrambled(drive, untrusted)))
    np.testing.assert_array_equal(before.node("Lane"), after.node("Lane"))
    crossing = drive.is_crossing[drive.rows]
    scores, everywhere = before.scores["model"], before.scores["model_all_frames"]
    assert scores["frames_scored"] == np.count_nonzero(~crossing[drive.is_trusted])
    assert scores == after.scores["model"]
    assert everywhere["frames_scored"] == np.count_nonzero(~crossing)
    assert everywhere != after.scores["model_all_frames"]


@pytest.mark.parametrize("method", ["learn", "tune"])
def test_a_whole_drive_is_held_out_without_being_seen(method: str) -> None:
    drives = two_drives()
    folds = group_folds(drives, ["a", "b"])
    poisoned = [drives[0], scrambled(drives[1], np.arange(len(drives[1])))]
    found = []
    for given in (drives, poisoned):
        study = run_study([fitting(each, trials=8) for each in given], method, folds)
        assert study.held_out is not None
        found.append(study)
    one, other = (study.held_out for study in found)
    assert one is not None
    assert other is not None
    assert one.run["fitted"][1] == other.run["fitted"][1]
    ours, theirs = (each.frames[each.frames["block"] == 1] for each in (one, other))
    assert ours["drive"].unique().tolist() == ["d1"]
    np.testing.assert_array_equal(ours["assigned_lane"], theirs["assigned_lane"])
    assert one.run["fitted"][0] != other.run["fitted"][0]


def test_values_of_the_experiment_are_not_told_to_a_study_of_a_fold() -> None:
    drive = drive_of(simulated())
    other = {**drive.model.parameters, "sigma1": 0.123, "p1": 0.321}
    changed = replace(drive, model=with_parameters(drive.model, other))
    first, second = (tuned([each], block_folds([drive], 3)) for each in (drive, changed))
    assert first.held_out is not None
    assert second.held_out is not None
    assert first.held_out.run["fitted"] == second.held_out.run["fitted"]
    # The study on everything tries them first.
    assert second.trials["sigma1"][0] == 0.123
    assert first.trials["sigma1"][0] == drive.model.parameters["sigma1"]


def test_one_of_several_drives_may_have_untrusted_labels() -> None:
    odd = drive_of(simulated(fit={"untrusted_frames": [[1000, None]]}))
    drives = [drive_of(simulated()), odd]
    study = tuned(drives, block_folds(drives, 2))
    assert study.held_out is not None
    for frames in (study.in_sample.frames, study.held_out.frames):
        assert frames["is_trusted"].dtype == bool
        assert int((~frames["is_trusted"]).sum()) == int((~odd.is_trusted).sum())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"fit": {"method": "learn"}}, "ground_truth: is missing, learning needs it"),
        ({"fit": {"method": "tune"}}, "ground_truth: is missing, a search needs it"),
        ({"filter": "viterbi"}, "filter: viterbi is for `egolane run`; fits"),
    ],
)
def test_what_cannot_be_held_out_is_refused(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    path = write_drive(tmp_path, 60, ground_truth=None)
    with pytest.raises(InputError, match=said):
        run_input(open_input(path, overrides=changes), n_blocks=3)


# --- searches ------------------------------------------------------------------------------------


def test_a_study_has_in_sample_and_held_out_scores_and_is_saved(tmp_path: Path) -> None:
    drive = drive_of(simulated(fit={"untrusted_frames": [[1100, None]]}))
    out = tmp_path / "out"
    study = tuned([drive], block_folds([drive], 3), trials=20, directory=out)
    assert study.held_out is not None
    assert study.in_sample.run["tuned_on"] == "same_frames"
    assert study.held_out.run["tuned_on"] == "other_frames"
    assert len(study.trials) == 20
    best = study.trials["accuracy"].max()
    assert study.in_sample.scores["model"]["accuracy"] >= 0.9 * best
    # The best trial, run alone over all frames, has its score.
    frames = study.in_sample.frames
    counted = ~frames["is_crossing"].to_numpy(dtype=bool)
    right = (frames["assigned_lane"] == frames["true_lane"]).to_numpy(dtype=bool)
    assert right[counted].mean() == pytest.approx(best)
    # What is kept.
    assert is_study(out)
    assert not is_result(out)
    document = json.loads((out / "study.json").read_text())
    assert document["fitted"] == dict(study.fitted)
    assert document["held_out"] == study.held_out.scores
    assert document["folds"] == study.held_out.run["fitted"]
    assert_frame_equal(pd.read_parquet(out / "trials.parquet"), study.trials)
    assert_frame_equal(load_result(out / "held_out").frames, study.held_out.frames)
    content = yaml.safe_load((out / "best.yaml").read_text())
    assert content["name"] == "a_tuned"
    again = run(out / "best.yaml")
    np.testing.assert_array_equal(again.node("Lane"), study.in_sample.node("Lane"))
    optuna.load_study(study_name="a", storage=_journal(out))
    assert study.experiments == [fitting(drive, trials=20).experiment]


def _journal(out: Path) -> Any:
    from egolane_pgm.studies.storage import open_storage

    return open_storage(str(out / "study.journal"))


def test_another_study_in_the_same_storage_is_refused(tmp_path: Path) -> None:
    drive, out = drive_of(simulated()), tmp_path / "out"
    tuned([drive], directory=out)
    before = contents(out)
    all_other = with_labels(drive, np.arange(5), 1)
    for given, fit, said in (
        (drive, {"seed": 5}, "with another seed"),
        (drive, {"objective": "f1"}, "objective"),
        (drive, {"parameters": {"sigma1": [0.1, 0.2]}}, "space"),
        (scrambled(all_other, np.arange(500)), {}, "data"),
    ):
        with pytest.raises(InputError, match="the storage holds another study of this") as caught:
            tuned([given], fit=fit, directory=out)
        assert said in str(caught.value)
    # Optuna's journal has a line for each time that it is opened.
    assert tuned([drive], directory=out).trials["accuracy"].size == 6
    assert contents(out).keys() == before.keys()
    result = run(simulated()).save(tmp_path / "result")
    with pytest.raises(InputError, match="is a result directory; name another one"):
        tuned([drive], directory=result)


@pytest.mark.parametrize(
    ("pattern", "damage", "message"),
    [
        (rb'"sampler":', b'"method":', "was written by another version, or is damaged; name"),
        (rb'"values": \[[^]]+\]', b'"values": []', "trial 0 has other values: the storage is dam"),
        (rb'"param_name": "sigma1"', b'"param_name": "s"', "trial 0 has no sigma1: the storage is"),
        (rb"\Z", b"{\n", "line . column .*: the storage is damaged"),
    ],
)
def test_a_damaged_study_or_one_of_another_version_is_refused(
    tmp_path: Path, pattern: bytes, damage: bytes, message: str
) -> None:
    drive, journal = drive_of(simulated()), tmp_path / "study.journal"
    tuned([drive], directory=tmp_path)
    journal.write_bytes(re.sub(pattern, damage, journal.read_bytes(), count=1))
    with pytest.raises(InputError, match=message):
        tuned([drive], directory=tmp_path)


def test_processes_find_the_same_as_one() -> None:
    drive = drive_of(simulated())
    one, two = (tuned([drive], block_folds([drive], 2), jobs=jobs) for jobs in (1, 2))
    assert one.fitted == two.fitted
    assert one.held_out is not None
    assert two.held_out is not None
    assert one.held_out.run["fitted"] == two.held_out.run["fitted"]
    assert_frame_equal(one.trials, two.trials)


# --- detectors -----------------------------------------------------------------------------------


def test_each_trial_detects_with_its_own_parameters(tmp_path: Path) -> None:
    from tests.kits.drives import done

    bounds = {"detector.least_rise": [2, 60], "detector.least_score": [0.1, 0.99]}
    done("simulate", "a4", "--images", "--frames", "12", "--out", tmp_path / "drive")
    path = write_experiment(
        tmp_path / "drive" / "pictures.yaml",
        name="seen",
        recording={"path": "images", "camera": "camera.yaml", "detector": "ml"},
        n_lanes=4,
        fit={"objective": "log_loss", "parameters": bounds},
    )
    drive = drive_of(load_experiment(path))
    study = tuned([drive], trials=3)
    names = ["least_rise", "least_score"]
    assert study.trials["log_loss"].nunique() > 1
    for _, row in study.trials.iterrows():
        values = {f"parameters.detector.{n}": row[f"detector.{n}"] for n in names}
        found: Result = run(path, values)
        assert found.scores["model"]["log_loss"] == pytest.approx(row["log_loss"])
    best = study.trials.loc[study.trials["log_loss"].idxmin()]
    kept = study.experiment.parameters["detector"]
    assert [kept[n] for n in names] == [best[f"detector.{n}"] for n in names]
    assert set(study.fitted) == set(bounds)
    lines = drive_of(simulated())
    with pytest.raises(InputError, match=r"fit\.parameters: detector: the recording has none"):
        tuned([lines], fit={"parameters": bounds})
