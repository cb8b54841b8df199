"""The sampler of our own, as it is and in any study of Optuna's."""

from __future__ import annotations

from typing import Any

import numpy as np
import optuna
import pytest
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.trial import TrialState

from egolane_pgm.studies.sampler import Shade, from_unit, to_unit

optuna.logging.set_verbosity(optuna.logging.ERROR)


SPACE: dict[str, BaseDistribution] = {
    "x": FloatDistribution(-2, 3),
    "rate": FloatDistribution(1e-5, 1, log=True),
    "n": IntDistribution(1, 9),
    "kind": CategoricalDistribution(["a", "b", None]),
}


def mixed(trial: optuna.Trial) -> float:
    """An objective with every kind of parameter; best, 0, at one point."""
    score = abs(trial.suggest_float("x", -2, 3) - 1)
    score += abs(np.log10(trial.suggest_float("rate", 1e-5, 1, log=True)) + 3)
    score += abs(trial.suggest_int("n", 1, 9) - 7)
    return float(score + 2 * (trial.suggest_categorical("kind", ["a", "b", None]) != "b"))


def best_of(sampler: Any, trials: int = 400) -> float:
    study = optuna.create_study(sampler=sampler)
    study.optimize(mixed, n_trials=trials)
    return study.best_value


def test_any_study_of_optuna_takes_it_with_its_search_space() -> None:
    ours = [best_of(Shade(s, SPACE)) for s in range(3)]
    theirs = [best_of(optuna.samplers.RandomSampler(seed=s)) for s in range(3)]
    assert max(ours) < min(theirs)


def test_a_trial_that_fails_is_not_proposed_for_ever() -> None:
    def fails(trial: optuna.Trial) -> float:
        return float("nan") if trial.suggest_float("x", 0, 1) > 0.5 else trial.params["x"]

    space: dict[str, BaseDistribution] = {"x": FloatDistribution(0, 1)}
    study = optuna.create_study(sampler=Shade(0, space))
    study.optimize(fails, n_trials=200)
    states = [t.state for t in study.trials]
    assert TrialState.FAIL in states
    assert study.best_value < 0.01
    assert len({t.params["x"] for t in study.trials}) > 190


@pytest.mark.parametrize("name", SPACE)
def test_values_and_the_unit_interval_agree(name: str) -> None:
    distribution = SPACE[name]
    found = [from_unit(distribution, u) for u in np.linspace(0, 1, 5001)]
    assert all(distribution._contains(distribution.to_internal_repr(v)) for v in found)
    again = [from_unit(distribution, to_unit(distribution, v)) for v in found]
    assert [v is None for v in again] == [v is None for v in found]
    if name == "kind":
        assert again == found
        assert {v: found.count(v) for v in ("a", "b", None)} == {"a": 1667, "b": 1667, None: 1667}
    else:
        np.testing.assert_allclose(again, found, rtol=1e-12)
        assert found == sorted(found)
        ends = [SPACE[name].low, SPACE[name].high]  # type: ignore[attr-defined]
        assert [found[0], found[-1]] == pytest.approx(ends)
