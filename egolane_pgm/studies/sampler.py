"""Shade, a sampler for Optuna: differential evolution for scores that are piecewise constant.

It needs no gradient and no model of the score, and a child as good as its parent replaces it, so
that the search crosses plateaus. SHADE (Tanabe and Fukunaga 2013, doi:10.1109/CEC.2013.6557555):
current-to-pbest/1 with an archive and a memory of successful scale factors and crossover rates; the
population is redrawn after PATIENCE generations without improvement. Every draw depends on the
seed and the generation alone, so the state of a search follows from the seed and its finished
trials.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution
from optuna.samplers import RandomSampler
from optuna.study import Study, StudyDirection
from optuna.trial import FrozenTrial

from egolane_pgm.types import FloatArray

#: Members of the population: trials of one generation.
MEMBERS = 30

#: The best share of the population; a child moves towards one of these members.
BEST_SHARE = 0.15

#: Entries of the memory of scale factors and crossover rates.
MEMORY = 6

#: Generations without improvement after which a new population is drawn.
PATIENCE = 15


class Shade(RandomSampler):
    """A sampler for any `optuna.create_study` with one objective.

    - seed: of every draw.
    - search_space: D distributions by parameter name: choices, whole numbers, and numbers on a
      linear or logarithmic scale. Other parameters are drawn at random.

    Trial k is member `k % MEMBERS` of generation `k // MEMBERS`. A generation is selected from its
    complete trials when the next one begins; with several workers, running trials count as not
    scored.
    """

    def __init__(self, seed: int, search_space: Mapping[str, BaseDistribution]) -> None:
        super().__init__(seed)
        self._seed, self._space = seed, dict(search_space)
        self._number = 0
        self._draw_population()

    def infer_relative_search_space(
        self, study: Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        return self._space

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        while trial.number >= (begin := self._number * MEMBERS) + MEMBERS:
            self._select(*self._tried(study, begin))
        units = self._children[trial.number - begin].tolist()
        return {
            name: from_unit(d, u) for (name, d), u in zip(self._space.items(), units, strict=True)
        }

    def _tried(self, study: Study, begin: int) -> tuple[FloatArray, FloatArray]:
        """The children as tried (MEMBERS, D), and their scores, larger is better, or NaN."""
        sign = 1.0 if study.direction == StudyDirection.MAXIMIZE else -1.0
        tried, scores = self._children.copy(), np.full(MEMBERS, np.nan)
        trials = study.get_trials(deepcopy=False)[begin : begin + MEMBERS]
        for member, trial in enumerate(trials):
            if not set(self._space) <= set(trial.params):
                continue
            tried[member] = [to_unit(d, trial.params[n]) for n, d in self._space.items()]
            if trial.values is not None:
                scores[member] = sign * trial.values[0]
        return tried, scores

    def _draw_population(self) -> None:
        """Begin with members in the unit cube (MEMBERS, D), whose scores are unknown, -inf."""
        n_dimensions = len(self._space)
        self._units, self._values = np.zeros((MEMBERS, n_dimensions)), np.full(MEMBERS, -np.inf)
        # Means of the successful scale factors, and crossover rates; and the next entry to write.
        self._memory, self._slot = np.full((2, MEMORY), 0.5), 0
        # Members that were replaced by better ones; and generations since a member last improved.
        self._archive, self._stagnant = np.zeros((0, n_dimensions)), 0
        self._propose()

    def _propose(self) -> None:
        """Draw the children (MEMBERS, D), and scale factor and crossover rate of each."""
        rng = np.random.default_rng([self._seed, self._number])
        units, values = self._units, self._values
        n, d = units.shape
        entry = rng.integers(MEMORY, size=n)
        scale = self._memory[0, entry] + 0.1 * rng.standard_cauchy(n)
        crossover = np.clip(self._memory[1, entry] + 0.1 * rng.standard_normal(n), 0.0, 1.0)
        self._rates = np.stack([np.clip(scale, 0.05, 1.0), crossover])
        if not np.isfinite(values).any():
            self._children = rng.random((n, d))
            return
        order = np.argsort(-values, kind="stable")
        towards = units[order[rng.integers(max(2, int(BEST_SHARE * n)), size=n)]]
        others = np.concatenate([units, self._archive])
        step = towards - units + units[rng.integers(n, size=n)]
        step -= others[rng.integers(len(others), size=n)]
        children = units + self._rates[0][:, None] * step
        is_kept = rng.random((n, d)) > crossover[:, None]
        is_kept[np.arange(n), rng.integers(d, size=n)] = False
        children = np.where(is_kept, units, children)
        # Outside of the cube: anywhere between the parent and the side that was crossed.
        back = rng.random((n, d))
        children = np.where(children < 0, back * units, children)
        self._children = np.where(children > 1, 1 - back * (1 - units), children)

    def _select(self, tried: FloatArray, scores: FloatArray) -> None:
        """Begin the next generation, from the children as tried and their scores."""
        rng = np.random.default_rng([self._seed, self._number, 1])
        scored, before = np.where(np.isnan(scores), -np.inf, scores), self._values
        is_better = scored > before
        self._number += 1
        self._stagnant = 0 if is_better.any() else self._stagnant + 1
        if self._stagnant >= PATIENCE:
            self._draw_population()
            return
        replaces = (scored >= before) & np.isfinite(scored)
        learns = is_better & np.isfinite(before)
        if learns.any():
            gain = scored[learns] - before[learns]
            weight = gain / gain.sum()
            scale, crossover = self._rates[:, learns]
            self._memory[:, self._slot] = (
                (weight * scale**2).sum() / (weight * scale).sum(),
                (weight * crossover).sum(),
            )
            self._slot = (self._slot + 1) % MEMORY
            archive = np.concatenate([self._archive, self._units[learns]])
            self._archive = archive[rng.permutation(len(archive))[: len(scores)]]
        # A member without a score, whose trial is not finished yet, stays at its draw.
        moves = replaces | ~np.isfinite(before)
        self._units = np.where(moves[:, None], tried, self._units)
        self._values = np.where(replaces, scored, before)
        self._propose()


def from_unit(distribution: BaseDistribution, unit: float) -> Any:
    """A value of a distribution from a number in [0, 1]."""
    if not isinstance(distribution, FloatDistribution):
        values = _values(distribution)
        return values[min(int(unit * len(values)), len(values) - 1)]
    low, high = _ends(distribution)
    value = low + unit * (high - low)
    value = math.exp(value) if distribution.log else value
    return min(max(value, distribution.low), distribution.high)


def to_unit(distribution: BaseDistribution, value: Any) -> float:
    """The inverse of `from_unit`; whole numbers and choices lie at the middle of their cell."""
    if not isinstance(distribution, FloatDistribution):
        values = _values(distribution)
        return (values.index(value) + 0.5) / len(values)
    low, high = _ends(distribution)
    unit = ((math.log(value) if distribution.log else value) - low) / (high - low)
    return min(max(float(unit), 0.0), 1.0)


def _values(d: Any) -> Sequence[Any]:
    """The choices of a distribution, or its whole numbers."""
    is_choice = isinstance(d, CategoricalDistribution)
    return d.choices if is_choice else range(d.low, d.high + 1)


def _ends(d: FloatDistribution) -> tuple[float, float]:
    """The ends of a range, or their logarithms."""
    return (math.log(d.low), math.log(d.high)) if d.log else (d.low, d.high)
