"""One study: Optuna proposes points and keeps trials, the objective scores them."""

from __future__ import annotations

import copy
import inspect
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import optuna
from optuna import samplers
from optuna.exceptions import ExperimentalWarning
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from egolane_pgm.experiment import FitSettings
from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.studies.objective import check_objective
from egolane_pgm.studies.sampler import Shade
from egolane_pgm.studies.space import Point, SearchSpace
from egolane_pgm.types import InputError, suggestion

#: Our names of samplers; the name of any other class of `optuna.samplers` is one, too.
SAMPLERS: dict[str, Callable[..., samplers.BaseSampler]] = {
    "evolution": Shade,
    "tpe": samplers.TPESampler,
    "cma-es": partial(samplers.CmaEsSampler, warn_independent_sampling=False),
    "random": samplers.RandomSampler,
    "nsga2": samplers.NSGAIISampler,
}

#: Packages that Optuna imports only when such a sampler draws.
_PACKAGES = {"cma-es": "cmaes", "CmaEsSampler": "cmaes", "GPSampler": "torch"}

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
    names = [check_objective(name, f"{where}.objective") for name in tuning.scores]
    if len(set(names)) < len(names):
        raise InputError(f"{where}.objective: a score is named twice")
    sampler = tuning.sampler or ("evolution" if len(names) == 1 else "nsga2")
    name = sampler_name(sampler)
    if len(names) > 1 and name in ("evolution", "cma-es"):
        raise InputError(
            f"{where}.sampler: {name} searches one objective; for {', '.join(names)} take nsga2,"
            " tpe or random"
        )
    known = {*SAMPLERS, *(each for each in samplers.__all__ if each.endswith("Sampler"))}
    if isinstance(sampler, str) and sampler not in known:
        hint = suggestion(sampler, known)
        raise InputError(f"{where}.sampler: unknown sampler '{sampler}'{hint}")
    package = _PACKAGES.get(name, "optuna")
    if find_spec(package) is None:
        raise InputError(f"{where}.sampler: {name} needs {package}: pip install {package}")
    seed = tuning.seed
    if fold is not None:
        seed = int(np.random.SeedSequence([tuning.seed, fold + 1]).generate_state(1)[0])
    trials = tuning.trials or TRIALS
    return tuning.model_copy(update={"sampler": sampler, "trials": trials, "seed": seed})


def sampler_name(sampler: Any) -> str:
    """The name of a sampler, or of the class of an object."""
    return sampler if isinstance(sampler, str) else type(sampler).__name__


def make_sampler(settings: FitSettings, space: SearchSpace, n_trials: int) -> samplers.BaseSampler:
    """Make the sampler of a study, or copy the one that is given.

    - n_trials: existing trials of the study. Shade continues from them. Optuna's samplers, which
      keep no state, get another seed, so that a resumed study repeats no trial.
    """
    given = settings.sampler
    if not isinstance(given, str):
        own: samplers.BaseSampler = copy.deepcopy(given)
        if n_trials:
            own.reseed_rng()
        return own
    if given == "evolution":
        return Shade(settings.seed, space.distributions)
    entropy = [settings.seed, n_trials, 0] if n_trials else [settings.seed]
    seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
    make = SAMPLERS.get(given) or getattr(samplers, given)
    has_seed = "seed" in inspect.signature(make).parameters
    with quiet():
        return make(**({"seed": seed} if has_seed else {}))


def new_study(settings: FitSettings, **given: Any) -> optuna.Study:
    """Create a study, in memory unless a storage and a name are given, or load that one."""
    up, down = StudyDirection.MAXIMIZE, StudyDirection.MINIMIZE
    directions = [up if SCORES[name].is_maximised else down for name in settings.scores]
    given["load_if_exists"] = "storage" in given
    with quiet():
        study = optuna.create_study(directions=directions, **given)
        if not study.metric_names:
            study.set_metric_names(list(settings.scores))
    return study


def search(study: optuna.Study, space: SearchSpace, score: Score, settings: FitSettings) -> None:
    """Run a study until its number of trials, by all workers, is there.

    A point that the model does not allow is a failed trial, which counts. Raises InputError if the
    sampler does not fit the space, and if all trials fail.
    """
    n_before = len(study.get_trials(deepcopy=False))
    with sampler_errors(settings.sampler):
        study.sampler = make_sampler(settings, space, n_before)
    has_drawn, total = False, settings.trials or TRIALS
    with quiet():
        while True:
            ended = _ended(study)
            # Trials that a study begins with have their values.
            is_given = bool(study.get_trials(deepcopy=False, states=(TrialState.WAITING,)))
            if len(ended) >= total and not is_given:
                break
            with sampler_errors(settings.sampler):
                trial = study.ask(space.distributions)
            if not (is_given or has_drawn):
                has_drawn = True
                if trial.number != n_before:
                    # Another worker began at the same moment and draws the same.
                    study.sampler = make_sampler(settings, space, trial.number)
                    study.tell(trial, state=TrialState.FAIL)
                    continue
            _run(study, trial, score, settings)
    failed = [trial for trial in ended if trial.state == TrialState.FAIL]
    if failed:
        first = failed[0]
        values = ", ".join(f"{name} {value:.6g}" for name, value in first.params.items())
        note = f"{len(failed)} of {len(ended)} trials failed; trial {first.number}, at {values}: "
        note += first.user_attrs[_REASON]
        if len(failed) == len(ended):
            raise InputError(note)
        warnings.warn(note, UserWarning, stacklevel=2)


#: The attribute of a failed trial with the reason.
_REASON = "reason"


def _ended(study: optuna.Study) -> list[FrozenTrial]:
    """The trials with a score or with a reason why they have none."""
    ends = (TrialState.COMPLETE, TrialState.FAIL)
    trials = study.get_trials(deepcopy=False, states=ends)
    return [t for t in trials if t.state == TrialState.COMPLETE or _REASON in t.user_attrs]


def _run(study: optuna.Study, trial: optuna.Trial, score: Score, settings: FitSettings) -> None:
    """Score a trial; it is complete or failed at the end, also if the command is interrupted."""
    try:
        found = score(trial.params)
    except InputError as error:
        trial.set_user_attr(_REASON, str(error))
        study.tell(trial, state=TrialState.FAIL)
    except BaseException:
        study.tell(trial, state=TrialState.FAIL)
        raise
    else:
        with sampler_errors(settings.sampler):
            study.tell(trial, found)


@contextmanager
def sampler_errors(sampler: Any) -> Iterator[None]:
    """Turn errors of a sampler that does not fit a study into InputError."""
    try:
        yield
    except (ImportError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"fit.sampler: {sampler_name(sampler)}: {error}") from error


def best_trial(study: optuna.Study) -> FrozenTrial:
    """The best trial, the first among equals; of a Pareto front the best in the first objective."""
    sign = 1 if study.directions[0] == StudyDirection.MAXIMIZE else -1
    is_front, states = len(study.directions) > 1, (TrialState.COMPLETE,)
    complete = study.best_trials if is_front else study.get_trials(deepcopy=False, states=states)
    return max(complete, key=lambda t: (sign * t.values[0], -t.number))
