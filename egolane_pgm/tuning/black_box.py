"""The score of an experiment as a function of its parameters, for any optimiser: Optuna, CMA-ES, a
grid, or a loop of your own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from optuna.distributions import BaseDistribution

from egolane_pgm.drive import load_drive
from egolane_pgm.experiment import Given, Overrides, Tuning, load_experiment
from egolane_pgm.recordings.source import Read
from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.tuning.objective import (
    DETECTOR,
    check_filter,
    check_objective,
    searched_of_detector,
)
from egolane_pgm.tuning.plan import Problem, plan_of, problem_of, scorer
from egolane_pgm.tuning.search import Score
from egolane_pgm.tuning.space import Dimension, Point, distributions
from egolane_pgm.types import InputError, not_one_of, suggestion


@dataclass(frozen=True, repr=False, eq=False)
class Objective:
    """An experiment's score as a function of its parameters; `objective` makes one.

    - problem: the recording, the model and the search space.
    - start: the experiment's own values of what is searched; they may lie out of bounds.

    >>> import egolane_pgm as ego
    >>> accuracy = ego.objective("quickstart", overrides={"recording.frames": [0, 300]})
    >>> round(accuracy({"sigma1": 0.35}), 3)
    0.877
    """

    problem: Problem
    start: Point
    score: Score

    def __repr__(self) -> str:
        name, score = self.problem.plan.name, self.problem.settings.objectives[0]
        return f"Objective({score} of {name!r}: {', '.join(self.space)})"

    @property
    def space(self) -> dict[str, list[Any]]:
        """What is searched: [low, high], both included and whole for whole numbers, or the names of
        a choice."""
        found: dict[str, list[Any]] = {}
        for d in self.problem.space.dimensions:
            number = int if d.is_integer else float
            found[d.key] = list(d.choices) or [number(d.low), number(d.high)]
        return found

    @property
    def distributions(self) -> dict[str, BaseDistribution]:
        """`space` as Optuna has it, for `study.ask`."""
        return distributions(self.problem.space)

    @property
    def direction(self) -> Literal["minimize", "maximize"]:
        """Whether less or more is better, as Optuna says it."""
        return "maximize" if is_maximised(self.problem.settings.objectives[0]) else "minimize"

    def __call__(self, parameters: Mapping[str, Any]) -> float:
        """The score of some parameters; those that are left out keep the experiment's values.

        Raises InputError for an unknown name, and for a value out of its range.
        """
        known = {d.key: d for d in self.problem.space.dimensions}
        point = dict(self.start)
        for name, value in parameters.items():
            if name not in known:
                raise InputError(f"{name}: is not searched{suggestion(name, known)}")
            point[name] = _checked(known[name], value)
        return float(self.score(point)[0])


def objective(
    experiment: Given,
    *,
    overrides: Overrides = (),
    score: str | None = None,
    frames: tuple[int | None, int | None] = (None, None),
    read: Read | None = None,
) -> Objective:
    """Prepare an experiment once, to score many sets of its parameters as `tune` does.

    - experiment, overrides: as `load_experiment` takes them. Its `tuning.parameters` say what is
      searched and within which bounds.
    - score: its name; by default the first of the experiment's `tuning.objective`, accuracy.
    - frames: first frame id that counts and the one after the last; None for no end. The filter
      sees every frame.
    - read: lines and lanes in memory, see `recordings.memory.in_memory`.

    Returns a function of a dict of parameters, with `space`, `distributions` and `direction`. The
    score is in-sample: the best of many trials is better than the parameters are on other drives.
    To hold out, search with the `frames` of one part and score what was found on those of another;
    `tune` does so for each block.

    Raises InputError for whatever does not fit, an experiment without ground truth included.

    >>> import optuna
    >>> import egolane_pgm as ego
    >>> halves = (0, 800), (800, None)
    >>> fitted, held_out = (ego.objective("quickstart", frames=half) for half in halves)
    >>> fitted.space["sigma1"]
    [3e-06, 3.0]
    >>> study = optuna.create_study(direction=fitted.direction)
    >>> for _ in range(5):
    ...     trial = study.ask(fitted.distributions)
    ...     _ = study.tell(trial, fitted(trial.params))
    >>> 0 <= held_out(study.best_params) <= 1
    True
    """
    chosen = load_experiment(experiment, overrides)
    tuning = chosen.tuning or Tuning()
    name = check_objective(score or tuning.objective[0], "score" if score else "tuning.objective")
    tuning = tuning.model_copy(update={"objective": (name,), "sampler": None})
    check_filter(chosen)
    drive = load_drive(chosen, needs_truth="a search needs it", read=read)
    problem = problem_of(replace(plan_of(drive.experiment), tuning=tuning), [drive])
    first, stop = frames
    ids = drive.truth.frame_id
    is_used = np.full(len(ids), True) if first is None else ids >= first
    if stop is not None:
        is_used &= ids < stop
    if not (is_used & ~drive.truth.is_crossing).any():
        raise InputError(f"{chosen.source}: frames {frames}: there is nothing to score in them")
    values = dict(drive.model.parameters)
    if any(d.parameter.startswith(DETECTOR) for d in problem.space.dimensions):
        values |= searched_of_detector(chosen)[1]
    start = {d.key: d.value_in(values) for d in problem.space.dimensions}
    return Objective(problem, start, scorer(problem, [is_used]))


def _checked(dimension: Dimension, value: Any) -> float | int | str:
    """The value of a dimension. Raises InputError for one that is not in its range."""
    d = dimension
    value = value.item() if isinstance(value, np.generic) else value
    if d.choices:
        if value not in d.choices:
            raise InputError(f"{d.key}: {not_one_of(value, d.choices)}")
        return str(value)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not d.low <= value <= d.high or (d.is_integer and value != int(value)):
        kind = "whole number" if d.is_integer else "number"
        raise InputError(f"{d.key}: {value!r} is no {kind} from {d.low:g} to {d.high:g}")
    return int(value) if d.is_integer else float(value)
