"""Scores of parameter sets: the same as a run's, evidence once per value of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from egolane_pgm.drives import Drive
from egolane_pgm.experiment import FitSettings
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import make_evidence
from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.studies import objective
from egolane_pgm.studies.fits import search_space
from egolane_pgm.studies.search import settings_of
from egolane_pgm.studies.space import to_parameters
from egolane_pgm.studies.study import run_study
from egolane_pgm.types import Beliefs, InputError
from tests.kits.drives import run
from tests.kits.studies import drive_of, fitting, points_at, scrambled


@cache
def quickstart() -> Drive:
    return drive_of(load_experiment("quickstart"))


def everything() -> Any:
    return np.ones(len(quickstart()), dtype=bool)


@cache
def posteriors(n: int) -> list[tuple[dict[str, Any], Beliefs]]:
    """Some parameter sets, and the beliefs at each."""
    space = search_space([quickstart().model], FitSettings())
    units = np.random.default_rng(0).random((n, len(space.distributions)))
    sets = [to_parameters(space, point) for point in points_at(space, units)]
    beliefs_at = objective.beliefs_at(quickstart())
    return [(each, beliefs_at(each)) for each in sets]


def scores(drives: Sequence[Drive], used: Sequence[Any], names: Sequence[str], n: int) -> Any:
    """(P, O): the scores of n parameter sets, the same posterior for each drive."""
    return np.array(
        [
            [objective.score_of(drives, [posterior] * len(drives), used, n) for n in names]
            for _, posterior in posteriors(n)
        ]
    )


def test_scores_are_those_of_a_run_with_the_same_parameters() -> None:
    names = [name for name in SCORES if name != "log_evidence"]
    found = scores([quickstart()], [everything()], names, 12)
    for row, (parameters, _) in zip(found, posteriors(12), strict=True):
        model = run("quickstart", {"parameters": parameters}).scores["model"]
        assert row == pytest.approx([model[name] for name in names], rel=1e-9)


def test_only_frames_that_are_used_count_and_labels_of_others_do_not_matter() -> None:
    drive, used = quickstart(), np.zeros(len(quickstart()), dtype=bool)
    used[200:700] = True
    before = scores([drive], [used], list(SCORES), 12)
    changed = scrambled(drive, np.flatnonzero(~used))
    np.testing.assert_array_equal(scores([changed], [used], list(SCORES), 12), before)
    assert len(np.unique(before[:, 0])) > 3


def test_evidence_is_made_again_only_when_its_own_parameters_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []
    name = "egolane_pgm.studies.objective.make_evidence"
    monkeypatch.setattr(name, lambda *given: made.append(1) or make_evidence(*given))
    beliefs_at = objective.beliefs_at(quickstart())
    parameters = quickstart().model.parameters
    for k in range(40):
        beliefs_at({**parameters, "bonus_value": k % 3, "p1": k / 40})
    assert len(made) == 3


def test_drives_weigh_the_same_whatever_their_length_unless_they_are_pooled() -> None:
    drive = quickstart()
    few = np.arange(len(drive)) < 150
    both = scores([drive, drive], [few, ~few], ("accuracy",), 5)
    one, other = (scores([drive], [used], ("accuracy",), 5) for used in (few, ~few))
    np.testing.assert_allclose(both, (one + other) / 2)
    for _, posterior in posteriors(5):
        # A false switch is lost between the parts.
        for name in SCORES.keys() - {"false_switches_per_minute"}:
            pooled, whole = (
                objective.score_of(drives, [posterior] * len(drives), used, name, pooled=True)
                for drives, used in (([drive, drive], [few, ~few]), ([drive], [everything()]))
            )
            assert pooled == pytest.approx(whole)


def test_log_evidence_is_that_of_a_run_and_an_impossible_frame_counts() -> None:
    [(parameters, beliefs)] = posteriors(1)
    drive, found = quickstart(), run("quickstart", {"parameters": parameters})
    score = objective.score_of([drive], [beliefs], [everything()], "log_evidence")
    assert score == pytest.approx(found.scores["mean_log_evidence"])
    impossible = replace(beliefs, is_impossible=np.arange(len(beliefs)) == 7)
    worse = objective.score_of([drive], [impossible], [everything()], "log_evidence")
    assert worse < score - 100


def test_a_search_for_log_evidence_ends_below_the_maximum_of_em_and_needs_no_labels() -> None:
    """On a short stretch. Parameters of the evidence rule keep their values."""
    fit = {"labels": False, "learns": "parameters", "objective": "log_evidence"}
    changes = {"recording.frames": [0, 400], "filter": "exact", "fit": fit, "name": "x"}
    drive = drive_of(load_experiment("quickstart", changes))
    unlabelled = replace(drive, true_lane=0 * drive.true_lane)
    learned = run_study([unlabelled], "learn", [])
    tuned = run_study([fitting(unlabelled, trials=600)], "tune", [])
    found, most = (each.in_sample.scores["mean_log_evidence"] for each in (tuned, learned))
    assert most - 0.005 < found < most + 1e-5
    assert "bonus_value" not in tuned.fitted
    with pytest.raises(InputError, match=r"parameters.bonus_value: changes the evidence"):
        run_study([fitting(drive, parameters={"bonus_value": [0, 5]})], "tune", [])


def test_evidence_of_a_search_is_read_as_in_a_run() -> None:
    given = load_experiment("quickstart", {"evidence_mode": "hard", "filter": "exact"})
    drive = drive_of(given)
    beliefs = objective.beliefs_at(drive)(drive.model.parameters)
    np.testing.assert_allclose(beliefs.lane, run(given).node("Lane"), rtol=0, atol=1e-12)


def test_settings_that_do_not_fit_are_refused() -> None:
    assert settings_of(FitSettings(objective="f1")).objective == ("f1",)
    for given, message in (
        (["acuracy"], r"fit.objective: unknown score 'acuracy' \(did you mean 'accuracy'\?\)"),
        (["f1", "f1"], "fit.objective: a score is named twice"),
    ):
        with pytest.raises(InputError, match=message):
            settings_of(FitSettings(objective=given))
