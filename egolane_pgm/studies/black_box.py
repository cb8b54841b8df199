"""The score of an experiment as a function of its parameters, for any optimiser."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from optuna.distributions import BaseDistribution

from egolane_pgm.drives import Drive, read_drives
from egolane_pgm.loading import ExperimentLike, Overrides, load_experiment
from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.studies import fits
from egolane_pgm.studies.objective import check_objective
from egolane_pgm.studies.space import Point, SearchSpace, distributions
from egolane_pgm.studies.study import check_labels
from egolane_pgm.types import InputError, suggestion


@dataclass(frozen=True, repr=False, eq=False)
class Objective:
    """An experiment's score as a function of its parameters; `objective` makes one.

    - name: of the score.
    - drives: the recording and the model.
    - search_space: its dimensions and fixed parameters.
    - start: the experiment's values; they may lie out of bounds.
    - score: the scores of a point of the search space.

    >>> import egolane_pgm as ego
    >>> accuracy = ego.objective("quickstart", overrides={"recording.frames": [0, 300]})
    >>> round(accuracy({"sigma1": 0.35}), 3)
    0.877
    """

    name: str
    drives: Sequence[Drive]
    search_space: SearchSpace
    start: Point
    score: Callable[[Point], Sequence[float]]

    def __repr__(self) -> str:
        return f"Objective({self.name} of {self.drives[0].name!r}: {', '.join(self.distributions)})"

    @property
    def distributions(self) -> dict[str, BaseDistribution]:
        """The range of each parameter, for Optuna's `study.ask`."""
        return distributions(self.search_space)

    @property
    def direction(self) -> Literal["minimize", "maximize"]:
        """Whether to minimise or to maximise, in Optuna's words."""
        return "maximize" if is_maximised(self.name) else "minimize"

    def __call__(self, parameters: Mapping[str, Any]) -> float:
        """The score of some parameters; all others keep the experiment's values.

        Raises InputError for an unknown name, and for a value out of its range.
        """
        known = {d.key: d for d in self.search_space.dimensions}
        point = dict(self.start)
        for name, given in parameters.items():
            if name not in known:
                raise InputError(f"{name}: is not searched{suggestion(name, known)}")
            value = given.item() if isinstance(given, np.generic) else given
            if value not in known[name]:
                raise InputError(f"{name}: {value!r} is not in {known[name].distribution}")
            point[name] = type(known[name].ends[0])(value)
        return float(self.score(point)[0])


def objective(
    experiment: ExperimentLike,
    *,
    overrides: Overrides = (),
    frames: tuple[int | None, int | None] = (None, None),
    lines: Any = None,
    ground_truth: Any = None,
) -> Objective:
    """Prepare an experiment to score many sets of its parameters as `tune` does.

    - experiment, overrides: as `load_experiment` takes them. Its `fit.parameters` are searched; the
      score is the first of `fit.objective`, accuracy by default.
    - frames: first frame id that counts and the one after the last; None for no end. The filter
      sees every frame.
    - lines, ground_truth: data in memory, for `recording.path: in memory`.

    Returns a function of a dict of parameters, with `distributions` and `direction`. The score is
    in-sample: the best of many trials does worse on other drives. To hold out, search with the
    `frames` of one part and score the best parameters on another; `tune` does so for each block.

    Raises InputError for an experiment without ground truth, and without a frame to score.

    >>> import optuna
    >>> import egolane_pgm as ego
    >>> halves = (0, 800), (800, None)
    >>> fitted, held_out = (ego.objective("quickstart", frames=half) for half in halves)
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
    drives = read_drives(chosen, lines, ground_truth)
    check_labels(drives, "tune")
    first, stop = frames
    used = []
    for drive in drives:
        ids = drive.log.frame_id[drive.rows]
        low, high = -np.inf if first is None else first, np.inf if stop is None else stop
        used.append((ids >= low) & (ids < high))
        if not (used[-1] & ~drive.is_crossing[drive.rows]).any():
            raise InputError(f"{chosen.source}: frames {frames}: contain no frame to score")
    space = fits.search_space([drive.model for drive in drives], tuning)
    values = fits.current_values(drives[0].model, tuning)
    start = {d.key: d.value_in(values) for d in space.dimensions}
    scored = fits.objective(drives, space, tuning, used, [name])
    return Objective(name, drives, space, start, scored)
