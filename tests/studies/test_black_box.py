"""An experiment's score for anybody's optimiser: what our own search scores."""

from __future__ import annotations

from typing import Any

import numpy as np
import optuna
import pytest
from optuna.distributions import IntDistribution

from egolane_pgm.loading import load_experiment
from egolane_pgm.studies.black_box import objective
from egolane_pgm.studies.fits import fit_tune, trials_of
from egolane_pgm.studies.sampler import Shade
from egolane_pgm.types import InputError
from tests.kits.studies import drive_of, fitting

QUICKSTART = "quickstart"


def test_optuna_finds_with_it_what_our_own_search_finds() -> None:
    score = objective(QUICKSTART)
    drive = drive_of(load_experiment(QUICKSTART))
    own = fitting(drive, trials=45, seed=1)
    ours = fit_tune([own], [np.arange(len(drive))], None).trials
    assert ours is not None
    study = optuna.create_study(direction=score.direction, sampler=Shade(1, score.distributions))
    for _ in range(45):
        trial = study.ask(score.distributions)
        study.tell(trial, score(trial.params))
    names = list(score.distributions)
    assert trials_of(study)[names].equals(ours[names])
    assert [trial.values[0] for trial in study.trials] == ours["accuracy"].tolist()


def test_values_that_are_left_out_are_the_experiments() -> None:
    score = objective(QUICKSTART)
    sigma1 = load_experiment(QUICKSTART).parameters["sigma1"]
    assert score({}) == score({"sigma1": np.float64(sigma1)}) != score({"sigma1": 2.5})
    assert score.distributions["bonus_value"] == IntDistribution(0, 9)
    switches = objective(QUICKSTART, overrides={"fit.objective": "false_switches_per_minute"})
    assert switches.direction == "minimize"


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"sigm1": 1}, "sigm1: is not searched (did you mean 'sigma1'?)"),
        ({"sigma1": 9}, "sigma1: 9 is not in FloatDistribution(high=3.0"),
        ({"sigma1": "a"}, "sigma1: 'a' is not in FloatDistribution(high=3.0"),
        ({"p1": float("nan")}, "p1: nan is not in FloatDistribution(high=0.999999"),
        ({"bonus_value": 2.5}, "bonus_value: 2.5 is not in IntDistribution(high=9"),
    ],
)
def test_what_is_out_of_the_space_is_refused(parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as info:
        objective(QUICKSTART)(parameters)
    assert str(info.value).startswith(said)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"overrides": {"fit.objective": "acuracy"}},
            "fit.objective: unknown score 'acuracy'",
        ),
        ({"overrides": {"filter": "smoothed"}}, "filter: a search takes assumed_density or exact"),
    ],
)
def test_what_cannot_be_scored_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as info:
        objective(QUICKSTART, **given)
    assert said in str(info.value)
