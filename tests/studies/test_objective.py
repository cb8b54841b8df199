"""Scores of parameter sets: the same as a run's, evidence once per value of its parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm import model
from egolane_pgm.drive import belief_of, load_drive
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.stability import lane_changes
from egolane_pgm.scoring.summary import score_all
from egolane_pgm.tuning import objective
from egolane_pgm.tuning.objective import OF_CHANGES
from egolane_pgm.tuning.space import to_parameters
from egolane_pgm.types import InputError
from tests.kits.tuning_kit import plan, points_at, problem

NAMES = ("accuracy", "f1", "precision", "recall", "coverage")


def some_sets(n: int = 12) -> list[dict[str, Any]]:
    space = problem().space
    units = np.random.default_rng(0).random((n, len(space)))
    return [to_parameters(space, p) for p in points_at(space, units)]


def scores(
    drives: list[Any], sets: list[list[Any]], used: list[Any], names: tuple[str, ...]
) -> np.ndarray:
    """(P, O): the scores of P parameter sets, given per drive."""
    each = zip(*sets, strict=True)
    return np.array([objective.scores_of(drives, mine, used, names) for mine in each])


def test_scores_are_those_of_a_run_with_the_same_parameters() -> None:
    drive, sets = problem().drives[0], some_sets()
    everything = objective.all_used([drive])
    names = (*NAMES, "log_loss", "brier", "expected_calibration_error", "false_switches_per_minute")
    found = scores([drive], [sets], everything, names)
    for row, parameters in zip(found, sets, strict=True):
        content = drive.experiment.model_copy(update={"parameters": parameters})
        run = run_experiment(content, recorded=drive.recorded)
        assert row == pytest.approx([run.scores["model"][name] for name in names], rel=1e-9)


def test_delay_is_that_of_a_run_over_all_frames() -> None:
    drive, sets = problem().drives[0], some_sets(4)
    everything = objective.all_used([drive])
    found = scores([drive], [sets], everything, ("delay", "share_missed"))
    for row, parameters in zip(found, sets, strict=True):
        belief = belief_of(drive, parameters)
        truth = drive.truth
        delay = score_all(belief, truth.lane, truth.is_crossing, truth.frame_id, 10.0)["delay"]
        assert row[0] == (
            objective.UNDEFINED if delay["median_frames"] is None else delay["median_frames"]
        )
        assert row[1] == pytest.approx(delay["share_missed"])


def test_only_frames_that_are_used_count_and_labels_of_others_do_not_matter() -> None:
    drive, sets = problem().drives[0], some_sets()
    used = np.zeros(len(drive), dtype=bool)
    used[200:700] = True
    names = (*NAMES, *objective.BELIEF_SCORES)
    before = scores([drive], [sets], [used], names)
    rng = np.random.default_rng(1)
    lane = drive.truth.lane.copy()
    lane[~used] = rng.integers(1, drive.n_lanes + 1, size=(~used).sum())
    truth = replace(drive.truth, lane=lane)
    scrambled = replace(drive, recorded=replace(drive.recorded, truth=truth))
    cut = tuple(n for n in names if n not in OF_CHANGES)
    columns = [names.index(n) for n in cut]
    after = scores([scrambled], [sets], [used], cut)
    np.testing.assert_array_equal(before[:, columns], after)
    assert len(np.unique(before[:, 0])) > 3


def test_evidence_is_made_again_only_when_its_own_parameters_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fresh = load_drive(problem().drives[0].experiment, needs_truth="a search needs it")
    made = []
    original = model.make_evidence
    monkeypatch.setattr(
        "egolane_pgm.drive.make_evidence", lambda *a, **k: made.append(1) or original(*a, **k)
    )
    sets = [{**fresh.model.parameters, "bonus_value": k % 3, "p1": k / 40} for k in range(40)]
    everything = objective.all_used([fresh])
    scores([fresh], [sets], everything, ("accuracy",))
    scores([fresh], [sets], everything, ("accuracy", "log_loss"))
    assert len(made) == 3


def test_several_recordings_weigh_the_same_whatever_their_length() -> None:
    drive, sets = problem().drives[0], some_sets(5)
    few = np.zeros(len(drive), dtype=bool)
    few[:150] = True
    both = scores([drive, drive], [sets, sets], [few, ~few], ("accuracy",))
    one = scores([drive], [sets], [few], ("accuracy",))
    other = scores([drive], [sets], [~few], ("accuracy",))
    np.testing.assert_allclose(both, (one + other) / 2)


@pytest.mark.parametrize("together", [False, True])
def test_a_drive_without_a_lane_change_says_nothing_of_their_delay(together: bool) -> None:
    drive, sets = problem().drives[0], some_sets(5)
    changes = lane_changes(drive.truth.lane, drive.truth.is_crossing)
    straight = np.arange(len(drive)) < changes.start[0]
    (everything,) = objective.all_used([drive])

    def found(drives: int, used: list[Any]) -> list[list[float]]:
        many = [drive] * drives
        return [
            objective.scores_of(many, [one] * drives, used, OF_CHANGES, together=together)
            for one in sets
        ]

    alone = found(1, [everything])
    assert all(0 <= missed <= 1 for _, missed in alone)
    np.testing.assert_allclose(found(2, [everything, straight]), alone)
    assert found(1, [straight]) == [[objective.UNDEFINED] * 2] * 5


def test_a_drive_whose_lane_changes_are_not_followed_is_no_better_than_none() -> None:
    drive = problem().drives[0]
    changes = lane_changes(drive.truth.lane, drive.truth.is_crossing)
    belief = np.tile(np.eye(drive.n_lanes)[changes.from_lane[0] - 1], (len(drive), 1))
    used = np.arange(len(drive)) < changes.until[0]
    assert objective.belief_score(drive, belief, used, "share_missed") == 1
    assert objective.belief_score(drive, belief, used, "delay") == objective.UNDEFINED


def test_an_unknown_objective_is_refused_with_a_suggestion() -> None:
    with pytest.raises(InputError, match=r"unknown score 'acuracy' \(did you mean 'accuracy'\?\)"):
        plan(objective=("acuracy",)).settings  # noqa: B018
    assert plan(objective=("f1",)).settings.objectives == ("f1",)


def test_an_unknown_sampler_and_one_for_one_objective_are_refused() -> None:
    with pytest.raises(InputError, match=r"unknown sampler 'tpee' \(did you mean 'tpe'\?\)"):
        plan(sampler="tpee").settings  # noqa: B018
    with pytest.raises(InputError, match="evolution searches one objective"):
        plan(sampler="evolution", objective=("accuracy", "log_loss")).settings  # noqa: B018
    assert plan(objective=("accuracy", "log_loss")).settings.sampler == "nsga2"


def test_never_fit_takes_frame_ids() -> None:
    drive = problem().drives[0]
    first = int(drive.truth.frame_id[100])
    kept = replace(drive, never_fit=((first, first + 10), (first + 500, None))).may_fit
    np.testing.assert_array_equal(np.flatnonzero(~kept)[:10], np.arange(100, 110))
    assert not kept[600:].any()
    assert kept[110:600].all()
