"""Smoothing and the readings of evidence as an experiment asks for them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.experiment import load_experiment
from egolane_pgm.inference.filtering import filter_beliefs, read_evidence
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, smooth_beliefs
from egolane_pgm.inference.viterbi import viterbi_path
from egolane_pgm.recordings.table import write_table
from egolane_pgm.results import read_result
from egolane_pgm.run import run_experiment, summary
from egolane_pgm.scoring.confusion import confusion
from tests.kits.drives import done, refused, short_drive, write_drive
from tests.reference import inference as reference


def test_a_smoothed_run_is_the_smoother_and_says_that_it_is_not_causal(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path)
    ran = done(
        *("run", experiment, "--set", "filter=smoothed", "--no-figures"),
        *("--out", tmp_path / "out", "--json", tmp_path / "out.json"),
    )
    assert "smoothed: not causal, a frame's belief uses all later frames too" in ran.stdout
    result = read_result(tmp_path / "out")
    assert result.run["is_causal"] is False
    assert result.scores["is_causal"] is False
    assert json.loads((tmp_path / "out.json").read_text())["is_causal"] is False
    run = run_experiment(load_experiment(experiment))
    right = smooth_beliefs(run.model.compiled, run.evidence)
    np.testing.assert_allclose(result.marginals["Lane"], right.lane, rtol=0, atol=1e-12)
    assert np.abs(result.marginals["Lane"] - run.beliefs.lane).max() > 0.01
    again = tmp_path / "out" / "experiment.yaml"
    assert load_experiment(again).filter == "smoothed"


def test_a_fixed_lag_run_waits_so_many_frames(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, filter="fixed_lag", lag=4)
    ran = done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert "fixed_lag: not causal, a frame's belief uses the next 4 frames too" in ran.stdout
    run = run_experiment(experiment)
    right = fixed_lag_beliefs(run.model.compiled, run.evidence, 4)
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)
    plain = reference.fixed_lag_beliefs(run.model.compiled, run.evidence, 4)
    np.testing.assert_allclose(plain.lane, right.lane, rtol=0, atol=1e-10)
    assert load_experiment(tmp_path / "out" / "experiment.yaml").lag == 4


@pytest.mark.parametrize("choice", ["assumed_density", "exact"])
def test_filters_are_causal_and_say_nothing_of_it(tmp_path: Path, choice: str) -> None:
    experiment = write_drive(tmp_path, 30, filter=choice)
    assert summary(run_experiment(experiment))["is_causal"] is True
    ran = done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert "not causal" not in ran.stdout


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ("filter=smothed", "filter: 'smothed' is not one of assumed_density, exact, smoothed"),
        (
            "filter=fixed_lag",
            "lag: filter fixed_lag needs a number of frames to wait, e.g. lag: 10",
        ),
        ("lag=3", "lag: only filter fixed_lag waits, filter assumed_density has no lag (got 3)"),
        ("filter=fixed_lag lag=-1", "lag: input should be greater than or equal to 0 (got -1)"),
        ("filter=smoothed evidence_reading=jeffrey", "jeffrey goes with filter assumed_density or"),
        ("evidence_reading=jefrey", "'jefrey' is not one of soft, hard, jeffrey (did you mean"),
    ],
)
def test_keys_that_do_not_fit_together_are_refused(tmp_path: Path, changes: str, said: str) -> None:
    experiment = write_drive(tmp_path, 20)
    options = [word for change in changes.split() for word in ("--set", change)]
    assert said in refused("validate", experiment, *options)


def test_evidence_read_by_jeffreys_rule_gives_other_beliefs_and_no_stop_at_gaps(
    tmp_path: Path,
) -> None:
    """A frame put in by `predict` says nothing: the belief spreads, it is not made uniform."""
    experiment = write_drive(
        tmp_path, evidence_reading="jeffrey", recording__missing_frames="predict"
    )
    log = short_drive().log
    write_table(tmp_path / "lines.csv", log.take(~np.isin(log.frame_id, (50, 51))))
    run = run_experiment(experiment)
    right = filter_beliefs(run.model.compiled, read_evidence(run.evidence, "jeffrey"))
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)
    soft = run_experiment(
        load_experiment(experiment).model_copy(update={"evidence_reading": "soft"})
    )
    assert np.abs(run.beliefs.lane - soft.beliefs.lane).max() > 0.1
    missing = np.flatnonzero(run.recorded.log.is_missing)
    assert len(missing) == 2
    before = run.beliefs.lane[missing[0] - 1]
    # One step of the lane dynamics by itself.
    from egolane_pgm.graphs.shared_parameters import f_table

    moved = before @ f_table("sigma1", 3, run.model.parameters)
    np.testing.assert_allclose(run.beliefs.lane[missing[0]], moved, rtol=0, atol=1e-12)


def test_a_decoded_run_answers_the_most_probable_path_beside_the_smoothed_belief(
    tmp_path: Path,
) -> None:
    experiment = write_drive(tmp_path, filter="smoothed", decode="viterbi")
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    run = run_experiment(experiment)
    path = viterbi_path(run.model.compiled, run.evidence)
    result = read_result(tmp_path / "out")
    np.testing.assert_array_equal(result.assigned_lane, path.lane)
    smoothed = smooth_beliefs(run.model.compiled, run.evidence)
    np.testing.assert_allclose(result.marginals["Lane"], smoothed.lane, rtol=0, atol=1e-12)
    truth, rows = run.recorded.truth, run.recorded.scored
    assert truth is not None
    counts = confusion(path.lane[rows], truth.lane, truth.is_crossing, run.model.n_lanes)
    assert result.scores["model"]["confusion"] == counts.tolist()
    assert load_experiment(tmp_path / "out" / "experiment.yaml").decode == "viterbi"


def test_a_path_that_the_smoothed_belief_doubts_for_long_is_noted(tmp_path: Path) -> None:
    """A detector that says nothing: the likeliest story holds one lane, all stories leave it."""
    experiment = write_drive(
        tmp_path,
        filter="smoothed",
        decode="viterbi",
        graph="lane_only",
        parameters={"sigma1": 0.8, "tentative_noise": 1e9},
    )
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    [note] = read_result(tmp_path / "out").run["warnings"]
    assert "the most probable path holds a Lane that the smoothed belief gives less" in note


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("decode=viterbi",), "decode: viterbi knows the whole drive"),
        (("filter=smoothed", "decode=viterbi", "unassigned_below=0.5"), "a path has a lane"),
    ],
)
def test_a_path_goes_with_the_smoother_and_without_a_reject_option(
    tmp_path: Path, changes: tuple[str, ...], said: str
) -> None:
    words = [word for change in changes for word in ("--set", change)]
    assert said in refused("run", write_drive(tmp_path), *words)


def test_what_scores_beliefs_refuses_an_experiment_that_decodes_a_path(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, filter="smoothed", decode="viterbi")
    assert "decode: viterbi is for `egolane run`" in refused("compare", experiment)
