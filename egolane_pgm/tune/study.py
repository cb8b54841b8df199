"""One study: points are proposed, scored and told to Optuna until there are as many as asked for.

A study in one process is the same for the same seed, whether it was interrupted or not (evolution
and random; the samplers of Optuna draw anew after an interruption, so that no trial is repeated).
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.tune import sampler as evolution
from egolane_pgm.tune.objective import is_maximised
from egolane_pgm.tune.space import Point, SearchSpace, distributions, from_unit, to_unit
from egolane_pgm.types import FloatArray, InputError, suggestion

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

    from egolane_pgm.tune.storage import Store

SAMPLERS = ("evolution", "tpe", "cma-es", "random", "nsga2")

#: Samplers of our own: many points at once, each drawn from seed and number alone.
BATCHED = ("evolution", "random")

#: Trials of a study where nothing else is said.
TRIALS = 3000

#: Points that the random sampler draws at once.
RANDOM_BATCH = 128

#: (P points) -> (P, O) scores.
Evaluate = Callable[[Sequence[Point]], FloatArray]

#: Called now and then: trials so far, best score so far.
Report = Callable[[int, float], None]


@dataclass(frozen=True)
class Settings:
    """How a study is run. objectives: names of scores."""

    objectives: tuple[str, ...] = ("accuracy",)
    sampler: str = "evolution"
    trials: int = TRIALS
    seed: int = 0

    @property
    def directions(self) -> list[Any]:
        """Optuna's directions."""
        return ["maximize" if is_maximised(name) else "minimize" for name in self.objectives]


def check_sampler(name: str | None, objectives: Sequence[str], where: str) -> str:
    """The sampler's name; by default evolution, for several objectives NSGA-II.

    Raises InputError for an unknown one, with a suggestion, and for one that has one objective.
    """
    if name is None:
        return "evolution" if len(objectives) == 1 else "nsga2"
    if name not in SAMPLERS:
        raise InputError(f"{where}: unknown sampler '{name}'{suggestion(name, SAMPLERS)}")
    if len(objectives) > 1 and name in ("evolution", "cma-es"):
        raise InputError(
            f"{where}: {name} searches one objective; for {', '.join(objectives)} take nsga2, tpe"
            " or random"
        )
    return name


def new_study(settings: Settings, finished: Sequence[FrozenTrial] = ()) -> optuna.Study:
    """A study in memory with some trials that are finished already."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(
        directions=settings.directions, sampler=make_sampler(settings, len(finished))
    )
    study.add_trials(finished)
    return study


def make_sampler(settings: Settings, n_finished: int = 0) -> optuna.samplers.BaseSampler:
    """Optuna's sampler, seeded by the seed and, after an interruption, by how far it came."""
    from optuna import samplers

    entropy = [settings.seed, n_finished] if n_finished else [settings.seed]
    seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if settings.sampler == "tpe":
            return samplers.TPESampler(seed=seed)
        if settings.sampler == "cma-es":
            return samplers.CmaEsSampler(seed=seed, warn_independent_sampling=False)
        if settings.sampler == "nsga2":
            return samplers.NSGAIISampler(seed=seed)
        return samplers.RandomSampler(seed=seed)


def run_study(
    space: SearchSpace,
    evaluate: Evaluate,
    settings: Settings,
    *,
    starts: Sequence[Point] = (),
    store: Store | None = None,
    report: Report | None = None,
) -> optuna.Study:
    """Run a study to its number of trials, or go on with the one in the store.

    starts: points that are tried first. Returns the study, in memory, with every trial. Raises
    InputError as the store does.
    """
    finished = store.finished() if store is not None else []
    study = new_study(settings, finished)
    if settings.sampler in BATCHED:
        run = _batches(study, space, evaluate, settings, starts)
    else:
        run = _one_by_one(study, space, evaluate, settings, starts)
    n_done, best = len(finished), _best_value(study)
    said = time.monotonic()
    for trials in run:
        if store is not None:
            store.write(trials)
        n_done += len(trials)
        for trial in trials:
            best = _better(best, trial.values[0], settings)
        if report is not None and (time.monotonic() - said > 0.1 or n_done >= settings.trials):
            said = time.monotonic()
            report(n_done, best)
    return study


def _better(best: float, value: float, settings: Settings) -> float:
    if np.isnan(best):
        return value
    return max(best, value) if is_maximised(settings.objectives[0]) else min(best, value)


def _best_value(study: optuna.Study) -> float:
    values = [t.values[0] for t in study.get_trials(deepcopy=False) if t.values is not None]
    if not values:
        return float("nan")
    return float(max(values) if study.directions[0].name == "MAXIMIZE" else min(values))


def _batches(
    study: optuna.Study,
    space: SearchSpace,
    evaluate: Evaluate,
    settings: Settings,
    starts: Sequence[Point],
) -> Iterator[list[FrozenTrial]]:
    """Generations of our own samplers: proposed, scored and kept together."""
    from optuna.trial import create_trial

    ranges = distributions(space)
    trials = study.get_trials(deepcopy=False)
    n = len(trials)
    draw = Proposals(space, settings, starts)
    if trials:
        draw.learn(trials)
    while n < settings.trials:
        points = draw.points(n, settings.trials - n)
        scores = evaluate(points)
        made = [
            create_trial(params=dict(p), distributions=ranges, values=[float(v) for v in row])
            for p, row in zip(points, scores, strict=True)
        ]
        study.add_trials(made)
        for k, trial in enumerate(made):
            trial.number = n + k
        draw.learn(made)
        n += len(made)
        yield made


class Proposals:
    """What the batched samplers propose for trial number 0, 1, ...; a function of the space, the
    seed and the trials that were learned from."""

    def __init__(self, space: SearchSpace, settings: Settings, starts: Sequence[Point]) -> None:
        self.space = space
        self.seed = settings.seed
        self.is_random = settings.sampler == "random"
        self.sign = 1.0 if is_maximised(settings.objectives[0]) else -1.0
        self.starts = starts
        self.population = evolution.empty(len(space))
        self._begin()

    def _begin(self) -> None:
        self.children = evolution.propose(self.population, self.seed)
        self.tried = self.children.units.copy()
        self.scored = np.full(evolution.MEMBERS, np.nan)

    def points(self, number: int, at_most: int) -> list[dict[str, Any]]:
        """The points of the trials from `number` on: as many as are known without more scores."""
        if self.is_random:
            count = min(at_most, RANDOM_BATCH)
            numbers = range(number, number + count)
            units = np.stack(
                [np.random.default_rng([self.seed, k]).random(len(self.space)) for k in numbers]
            )
        else:
            member = number - self.population.generation * evolution.MEMBERS
            count = min(at_most, evolution.MEMBERS - member)
            units = self.children.units[member : member + count]
        points = from_unit(self.space, units)
        for k in range(number, min(number + count, len(self.starts))):
            points[k - number] = dict(self.starts[k])
        return points

    def learn(self, trials: Sequence[FrozenTrial]) -> None:
        """Take finished trials into account, in the order of their numbers."""
        if self.is_random:
            return
        units = to_unit(self.space, [t.params for t in trials])
        for unit, trial in zip(units, trials, strict=True):
            self.advance_to(trial.number)
            member = trial.number - self.population.generation * evolution.MEMBERS
            if member < 0:
                continue  # Of a generation that went on without it: several workers.
            self.tried[member] = unit
            if trial.values is not None:
                self.scored[member] = self.sign * trial.values[0]
            self.advance_to(trial.number + 1)

    def advance_to(self, number: int) -> None:
        """Select up to the generation of this trial."""
        while number >= (self.population.generation + 1) * evolution.MEMBERS:
            self._select()

    def _select(self) -> None:
        children = evolution.Children(self.tried, self.children.scale, self.children.crossover)
        self.population = evolution.select(self.population, children, self.scored, self.seed)
        self._begin()


def _one_by_one(
    study: optuna.Study,
    space: SearchSpace,
    evaluate: Evaluate,
    settings: Settings,
    starts: Sequence[Point],
) -> Iterator[list[FrozenTrial]]:
    """Optuna's samplers: ask, score, tell."""
    ranges = distributions(space)
    n = len(study.get_trials(deepcopy=False))
    for start in starts[n:]:
        study.enqueue_trial(dict(start))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while n < settings.trials:
            trial = study.ask(ranges)
            scores = evaluate([trial.params])
            yield [study.tell(trial, [float(v) for v in scores[0]])]
            n += 1


def best_trial(study: optuna.Study) -> FrozenTrial:
    """The best trial, the first among equals; of a Pareto front the best in the first objective."""
    sign = 1 if study.directions[0].name == "MAXIMIZE" else -1
    trials = study.best_trials if len(study.directions) > 1 else study.get_trials(deepcopy=False)
    done = [t for t in trials if t.values is not None]
    return max(done, key=lambda t: (sign * t.values[0], -t.number))


def pareto(study: optuna.Study) -> list[Mapping[str, Any]]:
    """The Pareto front: number, values and point of each trial on it."""
    return [
        {"number": t.number, "values": list(t.values), "point": dict(t.params)}
        for t in study.best_trials
    ]
