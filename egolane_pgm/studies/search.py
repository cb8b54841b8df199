"""One study: Optuna proposes points and keeps trials, the objective scores them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import optuna
from optuna import samplers
from optuna.exceptions import ExperimentalWarning
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from egolane_pgm.experiment import FitSettings
from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.studies.objective import check_objective
from egolane_pgm.studies.sampler import Shade
from egolane_pgm.studies.space import Point, SearchSpace
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError, suggestion

#: The samplers, each made with its `seed`; `evolution` takes the search space as well.
SAMPLERS: dict[str, Callable[..., samplers.BaseSampler]] = {
    "evolution": Shade,
    "tpe": samplers.TPESampler,
    "cma-es": partial(samplers.CmaEsSampler, warn_independent_sampling=False),
    "random": samplers.RandomSampler,
    "nsga2": samplers.NSGAIISampler,
}

#: The default number of trials of a study.
TRIALS = 3000

#: Scores a point: one number, or one per objective.
Score = Callable[[Point], float | Sequence[float]]


@contextmanager
def quiet() -> Iterator[None]:
    """Silence Optuna: its log of every trial, and its warnings of experimental features."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(before)


def settings_of(tuning: FitSettings, fold: int | None = None, source: str = "fit") -> FitSettings:
    """The settings of a study, complete and checked. Each fold has its own seed.

    Raises InputError for an unknown score or sampler, a score given twice, a sampler of a single
    objective for several, and a sampler whose package is not installed.
    """
    where = f"{source}: fit"
    names = [check_objective(name, f"{where}.objective") for name in tuning.objective]
    if len(set(names)) < len(names):
        raise InputError(f"{where}.objective: a score is named twice")
    sampler = tuning.sampler or ("evolution" if len(names) == 1 else "nsga2")
    if sampler not in SAMPLERS:
        hint = suggestion(sampler, SAMPLERS)
        raise InputError(f"{where}.sampler: unknown sampler '{sampler}'{hint}")
    if len(names) > 1 and sampler in ("evolution", "cma-es"):
        raise InputError(
            f"{where}.sampler: {sampler} searches one objective; for {', '.join(names)} take nsga2,"
            " tpe or random"
        )
    if sampler == "cma-es":
        with needed(f"{where}.sampler: cma-es", "cmaes"):
            import cmaes  # noqa: F401
    seed = tuning.seed
    if fold is not None:
        seed = int(np.random.SeedSequence([tuning.seed, fold + 1]).generate_state(1)[0])
    trials = tuning.trials or TRIALS
    return tuning.model_copy(update={"sampler": sampler, "trials": trials, "seed": seed})


def make_sampler(settings: FitSettings, space: SearchSpace, n_trials: int) -> samplers.BaseSampler:
    """Make the sampler of a study.

    - n_trials: existing trials of the study. Shade continues from them. Optuna's samplers, which
      keep no state, get another seed, so that a resumed study repeats no trial.
    """
    if settings.sampler == "evolution":
        return Shade(settings.seed, space.distributions)
    entropy = [settings.seed, n_trials, 0] if n_trials else [settings.seed]
    seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
    with quiet():
        return SAMPLERS[str(settings.sampler)](seed=seed)


def new_study(settings: FitSettings, **given: Any) -> optuna.Study:
    """Create a study, in memory unless a storage and a name are given, or load that one."""
    up, down = StudyDirection.MAXIMIZE, StudyDirection.MINIMIZE
    directions = [up if is_maximised(name) else down for name in settings.objective]
    given["load_if_exists"] = "storage" in given
    with quiet():
        study = optuna.create_study(directions=directions, **given)
        if not study.metric_names:
            study.set_metric_names(list(settings.objective))
    return study


def search(study: optuna.Study, space: SearchSpace, score: Score, settings: FitSettings) -> None:
    """Run a study until its number of trials, by all workers, is complete."""
    total, complete = settings.trials or TRIALS, (TrialState.COMPLETE,)
    n_before, is_first = len(study.get_trials(deepcopy=False)), True
    study.sampler = make_sampler(settings, space, n_before)
    with quiet():
        while len(study.get_trials(deepcopy=False, states=complete)) < total:
            # Trials that a study begins with have their values.
            waiting = is_first and study.get_trials(deepcopy=False, states=(TrialState.WAITING,))
            trial = study.ask(space.distributions)
            if is_first and not waiting:
                is_first = False
                if trial.number != n_before:
                    # Another worker began at the same moment and draws the same.
                    study.sampler = make_sampler(settings, space, trial.number)
                    study.tell(trial, state=TrialState.FAIL)
                    continue
            study.tell(trial, score(trial.params))


def best_trial(study: optuna.Study) -> FrozenTrial:
    """The best trial, the first among equals; of a Pareto front the best in the first objective."""
    sign = 1 if study.directions[0] == StudyDirection.MAXIMIZE else -1
    is_front, states = len(study.directions) > 1, (TrialState.COMPLETE,)
    complete = study.best_trials if is_front else study.get_trials(deepcopy=False, states=states)
    return max(complete, key=lambda t: (sign * t.values[0], -t.number))
