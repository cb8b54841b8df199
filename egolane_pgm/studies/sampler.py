"""Shade, a sampler for Optuna: differential evolution for scores that are piecewise constant.

It needs no gradient and no model of the score, and a child as good as its parent replaces it, so
that the search crosses plateaus. SHADE (Tanabe and Fukunaga 2013, doi:10.1109/CEC.2013.6557555):
current-to-pbest/1 with an archive and a memory of successful scale factors and crossover rates; the
population is redrawn after PATIENCE generations without improvement. Every draw depends on the
seed and the generation alone, so the state of a search follows from the seed and its finished
trials.

    import optuna
    from egolane_pgm.studies.sampler import Shade

    study = optuna.create_study(direction="maximize", sampler=Shade(seed=0))
    study.optimize(objective, n_trials=600)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, IntDistribution
from optuna.search_space import IntersectionSearchSpace
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


@dataclass(frozen=True)
class Generation:
    """N members in the unit cube, their children, and the memory of the search.

    - number: from 0.
    - units (N, D): the members.
    - values (N,): their scores, larger is better; -inf if unknown.
    - memory (2, MEMORY): means of the successful scale factors, and crossover rates.
    - archive (A, D): members that were replaced by better ones.
    - slot: the next entry of the memory to write.
    - stagnant: number of generations since a member last improved.
    - children (N, D), rates (2, N): the proposals, and scale factor and crossover rate of each.
    """

    number: int
    units: FloatArray
    values: FloatArray
    memory: FloatArray
    archive: FloatArray
    slot: int
    stagnant: int
    children: FloatArray
    rates: FloatArray


def first_generation(n_dimensions: int, seed: int, number: int = 0) -> Generation:
    """A new population, whose children are drawn uniformly."""
    units, memory = np.zeros((MEMBERS, n_dimensions)), np.full((2, MEMORY), 0.5)
    return propose(
        seed, number, units, np.full(MEMBERS, -np.inf), memory, np.zeros((0, n_dimensions)), 0, 0
    )


def propose(
    seed: int,
    number: int,
    units: FloatArray,
    values: FloatArray,
    memory: FloatArray,
    archive: FloatArray,
    slot: int,
    stagnant: int,
) -> Generation:
    """Draw the children of a generation; the same arguments give the same ones."""
    rng = np.random.default_rng([seed, number])
    n, d = units.shape
    entry = rng.integers(MEMORY, size=n)
    scale = memory[0, entry] + 0.1 * rng.standard_cauchy(n)
    crossover = np.clip(memory[1, entry] + 0.1 * rng.standard_normal(n), 0.0, 1.0)
    rates = np.stack([np.clip(scale, 0.05, 1.0), crossover])
    state = (number, units, values, memory, archive, slot, stagnant)
    if not np.isfinite(values).any():
        return Generation(*state, rng.random((n, d)), rates)
    order = np.argsort(-values, kind="stable")
    towards = units[order[rng.integers(max(2, int(BEST_SHARE * n)), size=n)]]
    others = np.concatenate([units, archive])
    step = towards - units + units[rng.integers(n, size=n)]
    step -= others[rng.integers(len(others), size=n)]
    children = units + rates[0][:, None] * step
    is_kept = rng.random((n, d)) > crossover[:, None]
    is_kept[np.arange(n), rng.integers(d, size=n)] = False
    children = np.where(is_kept, units, children)
    # Outside of the cube: anywhere between the parent and the side that was crossed.
    back = rng.random((n, d))
    children = np.where(children < 0, back * units, children)
    children = np.where(children > 1, 1 - back * (1 - units), children)
    return Generation(*state, children, rates)


def select(now: Generation, tried: FloatArray, scores: FloatArray, seed: int) -> Generation:
    """The next generation, from the children as tried (N, D) and their scores (N,), or NaN."""
    rng = np.random.default_rng([seed, now.number, 1])
    scored = np.where(np.isnan(scores), -np.inf, scores)
    before, number = now.values, now.number + 1
    is_better = scored > before
    stagnant = 0 if is_better.any() else now.stagnant + 1
    if stagnant >= PATIENCE:
        return first_generation(now.units.shape[1], seed, number)
    replaces = (scored >= before) & np.isfinite(scored)
    memory, slot, archive = now.memory.copy(), now.slot, now.archive
    learns = is_better & np.isfinite(before)
    if learns.any():
        gain = scored[learns] - before[learns]
        weight = gain / gain.sum()
        scale, crossover = now.rates[:, learns]
        memory[:, slot] = (
            (weight * scale**2).sum() / (weight * scale).sum(),
            (weight * crossover).sum(),
        )
        slot = (slot + 1) % MEMORY
        archive = np.concatenate([archive, now.units[learns]])
        archive = archive[rng.permutation(len(archive))[: len(scores)]]
    # A member without a score, whose trial is not finished yet, stays at its draw.
    moves = replaces | ~np.isfinite(before)
    units = np.where(moves[:, None], tried, now.units)
    values = np.where(replaces, scored, before)
    return propose(seed, number, units, values, memory, archive, slot, stagnant)


class Shade(optuna.samplers.BaseSampler):
    """A sampler for any `optuna.create_study` with one objective.

    - seed: of every draw.
    - search_space: distributions by parameter name; by default the parameters that all finished
      trials have (Optuna's `IntersectionSearchSpace`). Other parameters are drawn at random.

    Trial k is member `k % MEMBERS` of generation `k // MEMBERS`. A generation is selected from its
    complete trials when the next one begins; with several workers, running trials count as not
    scored. Raises ValueError for a study with several objectives.
    """

    def __init__(
        self, seed: int = 0, search_space: Mapping[str, BaseDistribution] | None = None
    ) -> None:
        self._seed = seed
        self._given = search_space
        self._shared_space = IntersectionSearchSpace()
        self._state: tuple[Mapping[str, BaseDistribution], Generation] | None = None

    def infer_relative_search_space(
        self, study: Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        space = self._shared_space.calculate(study) if self._given is None else self._given
        return {name: d for name, d in space.items() if not d.single()}

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        if len(study.directions) > 1:
            raise ValueError("Shade searches one objective; take NSGAIISampler for several")
        if not search_space:
            return {}
        # The state is replaced as a whole: several threads may run one study.
        state = self._state
        if state is None or state[0] != search_space:
            state = search_space, first_generation(len(search_space), self._seed)
        generation = self._generation(*state, study, trial.number)
        self._state = search_space, generation
        member = trial.number - generation.number * MEMBERS
        if member < 0:  # Another thread has begun the next generation.
            return {}
        units = generation.children[member].tolist()
        return {
            name: from_unit(d, u) for (name, d), u in zip(search_space.items(), units, strict=True)
        }

    def sample_independent(
        self,
        study: Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        rng = np.random.default_rng([self._seed, trial.number, *param_name.encode()])
        return from_unit(param_distribution, rng.random())

    def _generation(
        self,
        space: Mapping[str, BaseDistribution],
        generation: Generation,
        study: Study,
        number: int,
    ) -> Generation:
        """The generation of a trial."""
        sign = 1.0 if study.direction == StudyDirection.MAXIMIZE else -1.0
        while number >= (begin := generation.number * MEMBERS) + MEMBERS:
            tried, scores = generation.children.copy(), np.full(MEMBERS, np.nan)
            trials = study.get_trials(deepcopy=False)[begin : begin + MEMBERS]
            for member, trial in enumerate(trials):
                if not set(space) <= set(trial.params):
                    continue
                tried[member] = [to_unit(d, trial.params[n]) for n, d in space.items()]
                if trial.values is not None:
                    scores[member] = sign * trial.values[0]
            generation = select(generation, tried, scores, self._seed)
        return generation


def from_unit(distribution: BaseDistribution, unit: float) -> Any:
    """A value of a distribution from a number in [0, 1]."""
    if isinstance(distribution, CategoricalDistribution):
        n = len(distribution.choices)
        return distribution.choices[min(int(unit * n), n - 1)]
    d: Any = distribution
    low, high = _ends(d)
    if d.step is not None and not d.log:
        n = round((d.high - d.low) / d.step) + 1
        value = d.low + d.step * min(int(unit * n), n - 1)
    else:
        value = low + unit * (high - low)
        value = math.exp(value) if d.log else value
        value = round(value) if isinstance(d, IntDistribution) else value
    return min(max(value, d.low), d.high)


def to_unit(distribution: BaseDistribution, value: Any) -> float:
    """The inverse of `from_unit`; whole numbers and choices lie at the middle of their cell."""
    if isinstance(distribution, CategoricalDistribution):
        return float((distribution.to_internal_repr(value) + 0.5) / len(distribution.choices))
    d: Any = distribution
    low, high = _ends(d)
    if d.step is not None and not d.log:
        return float(
            (round((value - d.low) / d.step) + 0.5) / (round((d.high - d.low) / d.step) + 1)
        )
    unit = ((math.log(value) if d.log else value) - low) / (high - low)
    return min(max(float(unit), 0.0), 1.0)


def _ends(d: Any) -> tuple[float, float]:
    """The ends of a range, or their logarithms; whole numbers on a logarithmic scale have half a
    number more on either side."""
    if not d.log:
        return d.low, d.high
    half = 0.5 if isinstance(d, IntDistribution) else 0.0
    return math.log(d.low - half), math.log(d.high + half)
