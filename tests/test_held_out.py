"""What is believed in a block, and all that is said of it, comes of what was fitted without it."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.drive import Drive, beliefs_of, load_drive
from egolane_pgm.experiment import Experiment
from egolane_pgm.held_out import held_out_result
from egolane_pgm.learning import with_found
from egolane_pgm.results import Result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.tuning import nested as module
from tests.conftest import needs_compiler
from tests.kits.drives import done, geometry, refused, simulated, write_drive

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]

FEW = {"trials": 12}
WAYS = pytest.mark.parametrize(
    "experiment", [geometry(fit="learn"), simulated(fit="tune", tuning=FEW)], ids=["learn", "tune"]
)


def loaded(experiment: Experiment) -> Drive:
    return load_drive(experiment, needs_truth=None)


def scrambled(drive: Drive, frames: np.ndarray) -> Drive:
    """The same drive with other lanes in some annotated frames."""
    lane = drive.truth.lane.copy()
    lane[frames] = np.random.default_rng(0).integers(1, drive.n_lanes + 1, size=len(lane[frames]))
    truth = replace(drive.truth, lane=lane)
    return replace(drive, recorded=replace(drive.recorded, truth=truth))


@WAYS
def test_each_block_is_believed_with_parameters_that_its_labels_did_not_reach(
    experiment: Experiment,
) -> None:
    drive = loaded(experiment)
    parts = blocks(len(drive), 5)
    before, after = (held_out_result(each) for each in (drive, scrambled(drive, parts[2])))
    assert before.run["tuned_on"] == after.run["tuned_on"] == "other_frames"
    np.testing.assert_array_equal(before.beliefs.lane[parts[2]], after.beliefs.lane[parts[2]])
    founds, others = (each.run["parameters_per_block"] for each in (before, after))
    assert founds[2] == others[2]
    assert founds != others
    for found, part in zip(founds, parts, strict=True):
        beliefs, _ = beliefs_of(drive, with_found(drive.model, found, experiment))
        for node, values in before.marginals.items():
            np.testing.assert_array_equal(values[part], beliefs.marginals[node][part])
        np.testing.assert_array_equal(before.log_evidence[part], beliefs.log_evidence[part])
    assert before.block is not None
    assert [np.flatnonzero(before.block == b).tolist() for b in range(5)] == [
        part.tolist() for part in parts
    ]


def test_untrusted_labels_are_never_fitted_and_scored_apart() -> None:
    tuning = {"never_fit": {"from_frame": 1000}}
    drive = loaded(geometry(fit="learn", tuning=tuning))
    untrusted = np.flatnonzero(drive.truth.frame_id >= 1000)
    assert 0 < len(untrusted) < len(drive)
    before, after = (held_out_result(each) for each in (drive, scrambled(drive, untrusted)))
    np.testing.assert_array_equal(before.beliefs.lane, after.beliefs.lane)
    crossing = drive.truth.is_crossing
    scores, everywhere = before.scores["model"], before.scores["model_all_frames"]
    assert scores["frames_scored"] == np.count_nonzero(~crossing[drive.may_fit])
    assert scores == after.scores["model"]
    assert everywhere["frames_scored"] == np.count_nonzero(~crossing)
    assert everywhere != after.scores["model_all_frames"]


def test_without_a_fit_the_belief_is_that_of_a_run() -> None:
    experiment = simulated(tuned_on="not_tuned")
    result, plain = held_out_result(loaded(experiment)), run_experiment(experiment)
    for name in ("assigned_lane", "true_lane", "tentative", "log_evidence"):
        np.testing.assert_array_equal(getattr(result, name), getattr(plain, name))
    for node, values in plain.marginals.items():
        np.testing.assert_array_equal(result.marginals[node], values)
    for key in ("model", "detector", "events", "lanes"):
        assert result.scores[key] == plain.scores[key]
    assert (result.run["tuned_on"], result.run["free_parameters"]) == ("not_tuned", 0)
    assert 0 < result.run["microseconds_per_frame"] < 1e4


def test_free_parameters_are_the_numbers_that_were_fitted() -> None:
    def free(experiment: Experiment) -> int:
        return int(held_out_result(loaded(experiment)).run["free_parameters"])

    assert free(simulated(tuned_on="same_frames")) == 7
    kept = {"p1": 0.9, "p2": 0.9}
    tuning = {"parameters": kept, "trials": 2}
    assert free(simulated(fit="tune", parameters=kept, tuning=tuning)) == 5


def test_a_search_sees_the_other_blocks_only_and_draws_by_a_seed_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tuning = {"trials": 6, "never_fit": {"from_frame": 1000}}
    drive = loaded(simulated(fit="tune", tuning=tuning))
    scorer, search_in_memory = module.scorer, module.search_in_memory
    looked_at: list[np.ndarray] = []
    settings: list[Any] = []

    def scores(problem: Any, used: Any) -> Any:
        looked_at.append(used[0].copy())
        return scorer(problem, used)

    def study(space: Any, score: Any, own: Any, *rest: Any) -> Any:
        settings.append(own)
        return search_in_memory(space, score, own, *rest)

    monkeypatch.setattr(module, "scorer", scores)
    monkeypatch.setattr(module, "search_in_memory", study)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        held_out_result(drive)
    assert [own.trials for own in settings] == [6] * 5
    assert len({own.seed for own in settings}) == 5
    for mask, block in zip(looked_at, blocks(len(drive)), strict=True):
        right = drive.truth.frame_id < 1000
        right[block] = False
        np.testing.assert_array_equal(mask, right)


def test_a_run_writes_what_it_held_out_as_any_result(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 600, fit="learn")
    out = tmp_path / "out"
    said = done("run", path, "--held-out", "--blocks", 3, "--no-figures", "--out", out).stdout
    assert "held out, 3 blocks: each is believed with what was learned without it" in said
    stored = ego.load_result(out)
    again = ego.run(path, held_out=True, blocks=3)
    assert isinstance(again, Result)
    for name in ("assigned_lane", "block", "true_lane"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(again, name))
    assert stored.scores == again.scores
    assert stored.run["parameters_per_block"] == again.run["parameters_per_block"]
    assert "held out" in repr(stored)
    # The experiment in it can be run, and learned from, again.
    repeated = ego.run(out / "experiment.yaml", held_out=True, blocks=3)
    assert repeated.scores["model"] == again.scores["model"]
    several = ego.run([path, simulated()], held_out=True, blocks=2)
    assert [each.run["blocks"] for each in several] == [2, 2]


def test_results_that_were_held_out_compare_as_their_experiments_do(tmp_path: Path) -> None:
    tuning = {"trials": 4, "never_fit": {"from_frame": 500}}
    paths = [
        write_drive(tmp_path, 600, name="a").rename(tmp_path / "a.yaml"),
        write_drive(tmp_path, 600, name="b", fit="learn").rename(tmp_path / "b.yaml"),
        write_drive(tmp_path, 600, name="c", fit="tune", tuning=tuning).rename(tmp_path / "c.yaml"),
    ]
    options = ("--blocks", 3, "--no-figures", "--held-out")
    done("run", *paths, *options, "--out", tmp_path / "runs")
    found = []
    for given, blocks_of in ((paths, ("--blocks", 3)), ((tmp_path / "runs").glob("?"), ())):
        target = tmp_path / "x.json"
        asked = ("--events", "--json", target)
        shown = done("compare", *sorted(given), *blocks_of, *asked).stdout
        document = json.loads(target.read_text())
        for entry in document["recordings"][0]["experiments"]:
            assert entry.pop("microseconds_per_frame") > 0
            del entry["source"]
        found.append((shown, document))
    assert found[0] == found[1]
    assert "held fixed" in found[0][0]


def test_what_cannot_be_held_out_is_one_line(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 60, ground_truth=None)
    for words, said in (
        (("--set", "fit=learn"), "ground_truth: is missing, learning needs it"),
        (("--set", "fit=tune"), "ground_truth: is missing, a search needs it"),
        (("--stream", "--out", tmp_path / "x"), "--stream: goes with one experiment"),
        (("--blocks", 61), "61 blocks are more than the 60 frames"),
    ):
        assert said in refused("run", path, "--held-out", "--no-figures", *words)
