"""One study: seeds, starting points, samplers, resuming."""

from __future__ import annotations

from typing import Any

import optuna
import pytest
from optuna.trial import TrialState

from egolane_pgm.experiment import FitSettings
from egolane_pgm.studies.search import (
    SAMPLERS,
    best_trial,
    make_sampler,
    new_study,
    search,
    settings_of,
)
from egolane_pgm.types import InputError
from tests.kits.studies import bowl, plain_space, search_in_memory, tried

SPACE = plain_space()


def complete(study: optuna.Study) -> list[Any]:
    """What was tried and what came out, in order, less the trials that were interrupted."""
    return tried(study.get_trials(states=(TrialState.COMPLETE,)))


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_the_same_seed_gives_the_same_study_and_another_one_another(sampler: str) -> None:
    settings = FitSettings(objective=("accuracy",), sampler=sampler, trials=12, seed=3)
    first = tried(search_in_memory(SPACE, bowl, settings).trials)
    assert tried(search_in_memory(SPACE, bowl, settings).trials) == first
    assert (
        tried(search_in_memory(SPACE, bowl, settings.model_copy(update={"seed": 4})).trials)
        != first
    )
    assert len(first) == 12


@pytest.mark.parametrize("stops", [(0,), (29,), (30,), (7, 77, 199)])
def test_an_interrupted_study_goes_on_to_its_total(stops: tuple[int, ...]) -> None:
    settings = FitSettings(objective=("accuracy",), sampler="evolution", trials=200, seed=0)
    whole = tried(search_in_memory(SPACE, bowl, settings).trials)
    study = new_study(settings)
    for stop in stops:

        def interrupted(point: Any, stop: int = stop) -> float:
            if len(complete(study)) == stop:
                raise KeyboardInterrupt
            return bowl(point)

        with pytest.raises(KeyboardInterrupt):
            search(study, SPACE, interrupted, settings)
    search(study, SPACE, bowl, settings)
    assert len(complete(study)) == 200
    assert complete(study)[: stops[0]] == whole[: stops[0]]
    assert len(study.get_trials(states=(TrialState.FAIL,))) == len(stops)


@pytest.mark.parametrize(
    "sampler",
    ["tpe", "cma-es", "nsga2", "random", "NSGAIIISampler", optuna.samplers.TPESampler(seed=1)],
    ids=str,
)
def test_a_sampler_of_optuna_repeats_no_trial_after_an_interruption(sampler: Any) -> None:
    settings = FitSettings(objective=("accuracy",), sampler=sampler, trials=15, seed=0)
    study = new_study(settings)
    search(study, SPACE, bowl, settings)
    search(study, SPACE, bowl, settings.model_copy(update={"trials": 30}))
    points = [tuple(t.params.values()) for t in study.trials]
    assert len(points) == len(set(points)) == 30


def test_workers_that_begin_at_the_same_moment_draw_other_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = FitSettings(objective=("accuracy",), sampler="random", trials=12, seed=0)
    study = new_study(settings)
    ask, own = study.ask, make_sampler(settings, SPACE, 0)

    def late(*given: Any) -> optuna.Trial:
        if not study.trials:
            # Another worker with the same seed is a little faster.
            mine, study.sampler = study.sampler, own
            trial = ask(*given)
            study.tell(trial, bowl(trial.params))
            study.sampler = mine
        return ask(*given)

    monkeypatch.setattr(study, "ask", late)
    search(study, SPACE, bowl, settings)
    points = [tuple(params.values()) for params, _ in complete(study)]
    assert len(points) == len(set(points)) == 12


def test_of_a_front_the_best_in_the_first_objective_is_taken() -> None:
    settings = FitSettings(objective=("accuracy", "log_loss"), sampler="nsga2", trials=60, seed=0)
    done = search_in_memory(SPACE, lambda p: [float(p["x0"]), float(p["x0"]) ** 2], settings)
    assert best_trial(done).values[0] == max(t.values[0] for t in done.trials)


def test_a_sampler_that_does_not_fit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "egolane_pgm.studies.search.find_spec", lambda name: name != "torch" or None
    )
    assert settings_of(FitSettings()).sampler == "evolution"
    assert settings_of(FitSettings(objective=("accuracy", "log_loss"))).sampler == "nsga2"
    with pytest.raises(InputError, match=r"unknown sampler 'tpee' \(did you mean 'tpe'\?\)"):
        settings_of(FitSettings(sampler="tpee"))
    with pytest.raises(InputError, match="evolution searches one objective; for accuracy, f1"):
        settings_of(FitSettings(objective=("accuracy", "f1"), sampler="evolution"))
    with pytest.raises(InputError, match="GPSampler needs torch: pip install torch"):
        settings_of(FitSettings(sampler="GPSampler"))
    with pytest.raises(InputError, match=r"sampler: BruteForceSampler: FloatDistribution\.step"):
        search_in_memory(SPACE, bowl, settings_of(FitSettings(sampler="BruteForceSampler")))
    with pytest.raises(ValueError, match="needs the name of a sampler"):
        FitSettings(sampler=3)


def test_each_study_has_its_own_copy_of_a_sampler_object() -> None:
    given = optuna.samplers.RandomSampler(seed=1)
    settings = settings_of(FitSettings(sampler=given, trials=5))
    first, second = (tried(search_in_memory(SPACE, bowl, settings).trials) for _ in range(2))
    assert first == second
    direct = optuna.create_study(direction="maximize", sampler=given)
    assert [direct.ask(SPACE.distributions).params for _ in range(5)] == [p for p, _ in first]
