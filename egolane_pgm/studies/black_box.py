"""The score of an experiment as a function of its parameters, for any optimiser."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from optuna.distributions import IntDistribution

from egolane_pgm.drives import read_drives
from egolane_pgm.loading import ExperimentLike, Overrides, load_experiment
from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.studies import fits
from egolane_pgm.studies.objective import check_objective
from egolane_pgm.studies.space import Point, coordinates, is_inside
from egolane_pgm.studies.study import check_labels
from egolane_pgm.types import InputError, suggestion


@dataclass(frozen=True, repr=False, eq=False)
class Objective:
    """An experiment's score as a function of its parameters; `objective` makes one.

    - direction: minimize or maximize, in Optuna's words.
    - distributions: the range of each parameter, for Optuna's `study.ask`.
    - start: the experiment's values; they may lie out of bounds.
    - score: the scores of a point of the search space: one.

    >>> import egolane_pgm as ego
    >>> accuracy = ego.objective("quickstart", overrides={"recording.frames": [0, 300]})
    >>> round(accuracy({"sigma1": 0.35}), 3)
    0.877
    """

    direction: Literal["minimize", "maximize"]
    distributions: dict[str, Any]
    start: Point
    score: Callable[[Point], Sequence[float]]

    def __call__(self, parameters: Mapping[str, Any]) -> float:
        """The score of some parameters; all others keep the experiment's values.

        Raises InputError for an unknown name, and for a value out of its range.
        """
        known, point = self.distributions, dict(self.start)
        for name, given in parameters.items():
            if name not in known:
                raise InputError(f"{name}: is not searched{suggestion(name, known)}")
            value = given.item() if isinstance(given, np.generic) else given
            if not is_inside(known[name], value):
                raise InputError(f"{name}: {value!r} is not in {known[name]}")
            point[name] = int(value) if isinstance(known[name], IntDistribution) else value
        return self.score(point)[0]


def objective(
    experiment: ExperimentLike,
    *,
    overrides: Overrides = (),
) -> Objective:
    """Prepare an experiment to score many sets of its parameters as `tune` does.

    - experiment, overrides: as `load_experiment` takes them. Its `fit.parameters` are searched; the
      score is the first of `fit.objective`, accuracy by default.

    Returns a function of a dict of parameters, with `distributions` and `direction`. The score is
    in-sample: the best of many trials does worse on other drives. To hold out, search with the
    `recording.frames` of one part and score the best parameters on another.

    Raises InputError for an experiment without ground truth.

    >>> import optuna
    >>> import egolane_pgm as ego
    >>> parts = ({"recording.frames": part} for part in ([0, 800], [800, 1600]))
    >>> fitted, held_out = (ego.objective("quickstart", overrides=part) for part in parts)
    >>> fitted.distributions["sigma1"]
    FloatDistribution(high=3.0, log=False, low=3e-06, step=None)
    >>> study = optuna.create_study(direction=fitted.direction)
    >>> for _ in range(5):
    ...     trial = study.ask(fitted.distributions)
    ...     _ = study.tell(trial, fitted(trial.params))
    >>> 0 <= held_out(study.best_params) <= 1
    True
    """
    chosen = load_experiment(experiment, overrides)
    tuning = chosen.fit
    name = check_objective(tuning.objective[0], f"{chosen.source}: fit.objective")
    drives = read_drives(chosen)
    check_labels(drives, "tune")
    used = [np.ones(len(drive), dtype=bool) for drive in drives]
    space = fits.search_space([drive.model for drive in drives], tuning)
    start = coordinates(space, fits.current_values(drives[0].model, tuning))
    scored = fits.objective(drives, space, tuning, used, [name])
    direction: Literal["minimize", "maximize"] = "maximize" if is_maximised(name) else "minimize"
    return Objective(direction, space.distributions, start, scored)
