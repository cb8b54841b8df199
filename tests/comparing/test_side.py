"""What is believed in a block, and all that is said of it, comes of what was fitted without it."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from egolane_pgm.comparing.placing import load_for_scoring
from egolane_pgm.comparing.side import Search, held_out_side
from egolane_pgm.drive import beliefs_of
from egolane_pgm.experiment import Experiment
from egolane_pgm.learning import with_found
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.tuning import nested as module
from tests.conftest import needs_compiler
from tests.kits.drives import geometry, simulated

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]


@pytest.mark.parametrize(
    "experiment",
    [geometry(fit="learn"), simulated(fit="tune")],
    ids=["learn", "tune"],
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
