"""What is believed in a block, and all that is said of it, comes of what was fitted without it."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.comparing.placing import load_for_scoring
from egolane_pgm.comparing.side import Search, held_out_side
from egolane_pgm.drive import beliefs_of
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.learning import fit, fit_pooled, n_learned, with_found
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.tuning import held_out as module
from tests.conftest import needs_compiler
from tests.kits.drives import geometry, simulated, write_drive

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]

GRID = {"prior_frames": ["infinite", 50], "alpha": [0.05, 0.2]}
CHOOSING = geometry(fit="choose", choice={"grid": GRID, "objective": "log_loss"})


@pytest.mark.parametrize(
    "experiment",
    [geometry(fit="learn"), simulated(fit="tune"), CHOOSING],
    ids=["learn", "tune", "choose"],
)
def test_each_block_is_believed_with_its_own_parameters(experiment: Experiment) -> None:
    drive = load_for_scoring(experiment)
    run = held_out_side(drive, search=Search(4))
    assert len({repr(sorted(found.items())) for found in run.held_out.parameters}) > 1
    for found, block in zip(run.held_out.parameters, blocks(len(drive)), strict=True):
        model = with_found(drive.model, found, experiment)
        beliefs, _ = beliefs_of(drive, model)
        np.testing.assert_array_equal(run.beliefs.lane[block], beliefs.lane[block])
        np.testing.assert_array_equal(run.beliefs.log_evidence[block], beliefs.log_evidence[block])
        np.testing.assert_array_equal(
            run.beliefs.is_impossible[block], beliefs.is_impossible[block]
        )
        bad = beliefs.marginals["SensorState"][:, 1]
        assert run.bad is not None
        np.testing.assert_array_equal(run.bad[block], bad[block])


def test_a_choice_learns_with_the_setting_that_is_chosen_and_counts_both() -> None:
    drive = load_for_scoring(CHOOSING)
    run = held_out_side(drive)
    for found in run.held_out.parameters:
        assert set(GRID) | set(drive.model.rule.LEARNED) == set(found)
    assert run.free_parameters == 2 + n_learned(drive.model, CHOOSING)


def test_a_search_sees_the_other_blocks_only_and_draws_by_a_seed_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tuning = {"trials": 6, "never_fit": {"from_frame": 1000}}
    drive = load_for_scoring(simulated(fit="tune", tuning=tuning))
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
        held_out_side(drive, search=Search(4))
    assert [own.trials for own in settings] == [4] * 5
    assert len({own.seed for own in settings}) == 5
    for mask, block in zip(looked_at, blocks(len(drive)), strict=True):
        right = drive.truth.frame_id < 1000
        right[block] = False
        np.testing.assert_array_equal(mask, right)
    held_out_side(drive)
    assert [own.trials for own in settings[5:]] == [6] * 5


LINES: dict[str, Any] = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
    "parameters": {"cells": 4, "motion_bins": 9},
}


def test_of_another_drive_every_frame_that_is_trusted_is_learned_from(tmp_path: Path) -> None:
    """Its frame ids are those of another road, so no stretch of it is left out."""
    untrusted = {"never_fit": [[250, None]]}
    there = write_drive(tmp_path / "there", 400, **LINES, tuning=untrusted)
    here = write_drive(tmp_path / "here", 600, **LINES)
    keys = {"fit": "learn", "learned_on": (str(there),)}
    drive = load_for_scoring(load_experiment(here).model_copy(update=keys))
    run = held_out_side(drive)
    other = load_for_scoring(load_experiment(there))
    trusted = np.flatnonzero(other.truth.frame_id < 250)
    everything = fit(other, trusted)
    for found in run.held_out.parameters:
        assert found["rates"] == pytest.approx(everything["rates"])


def test_recordings_are_pooled_from_the_first_guess_whatever_was_learned_before(
    tmp_path: Path,
) -> None:
    """Else what is held out would be known by way of the parameters given."""
    first = load_for_scoring(load_experiment(write_drive(tmp_path, 300, **LINES)))
    train = [np.arange(len(first))] * 2
    found = fit_pooled([first, first], train)
    again = replace(first, model=with_found(first.model, found, first.experiment))
    assert dict(fit_pooled([again, again], train)) == dict(found)
