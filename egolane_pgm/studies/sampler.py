"""Shade, a sampler for Optuna: differential evolution for scores that are piecewise constant.

It needs no gradient and no model of the score, and a child as good as its parent takes its place,
so that plateaus are walked across. SHADE (Tanabe and Fukunaga 2013,
doi:10.1109/CEC.2013.6557555): current-to-pbest/1 with an archive and a memory of the scale factors
and crossover rates that worked; the population is drawn anew once no member has improved for a
while. Every draw depends on the seed and the generation alone, so the state of a search follows
from the seed and its finished trials.

    import optuna
    from egolane_pgm.studies.sampler import Shade

    study = optuna.create_study(direction="maximize", sampler=Shade(seed=0))
    study.optimize(objective, n_trials=600)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
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

#: Share of the population that a child is drawn towards.
BEST_SHARE = 0.15

#: Entries of the memory of scale factors and crossover rates.
MEMORY = 6

#: Generations in which no member has improved, after which a new population is drawn.
PATIENCE = 15


@dataclass
class Population:
    """N members in the unit cube, and what the search has learned.

    - units (N, D): the members.
    - values (N,): their scores, more is better; -inf where a score is not known.
    - scale, crossover (MEMORY,): means of the scale factors and crossover rates that worked.
    - archive (A, D): members that were replaced by better ones.
    - slot: entry of the memory that is written next.
    - stagnant: number of generations since a member last improved.
    - generation: number of the next generation of children; 0 for the first draw.
    """

    units: FloatArray
    values: FloatArray
    scale: FloatArray = field(default_factory=lambda: np.full(MEMORY, 0.5))
    crossover: FloatArray = field(default_factory=lambda: np.full(MEMORY, 0.5))
    archive: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    slot: int = 0
    stagnant: int = 0
    generation: int = 0


@dataclass(frozen=True)
class Children:
    """One generation: units (N, D), and the scale factor and crossover rate of each child, (N,)."""

    units: FloatArray
    scale: FloatArray
    crossover: FloatArray


def empty(n_dimensions: int) -> Population:
    """The population before the first generation."""
    return Population(
        np.zeros((MEMBERS, n_dimensions)),
        np.full(MEMBERS, -np.inf),
        archive=np.zeros((0, n_dimensions)),
    )


def propose(population: Population, seed: int) -> Children:
    """Draw the next generation; the same population and seed give the same one."""
    rng = np.random.default_rng([seed, population.generation])
    n, d = population.units.shape
    memory = rng.integers(MEMORY, size=n)
    scale = population.scale[memory] + 0.1 * rng.standard_cauchy(n)
    scale = np.clip(scale, 0.05, 1.0)
    crossover = np.clip(population.crossover[memory] + 0.1 * rng.standard_normal(n), 0.0, 1.0)
    is_first = not np.isfinite(population.values).any()
    if is_first:
        return Children(rng.random((n, d)), scale, crossover)
    parents = population.units
    order = np.argsort(-population.values, kind="stable")
    towards = parents[order[rng.integers(max(2, int(BEST_SHARE * n)), size=n)]]
    others = np.concatenate([parents, population.archive])
    step = towards - parents + parents[rng.integers(n, size=n)]
    step -= others[rng.integers(len(others), size=n)]
    children = parents + scale[:, None] * step
    is_kept = rng.random((n, d)) > crossover[:, None]
    is_kept[np.arange(n), rng.integers(d, size=n)] = False
    children = np.where(is_kept, parents, children)
    # Outside of the cube: anywhere between the parent and the side that was crossed.
    back = rng.random((n, d))
    children = np.where(children < 0, back * parents, children)
    children = np.where(children > 1, 1 - back * (1 - parents), children)
    return Children(children, scale, crossover)


def select(population: Population, children: Children, values: FloatArray, seed: int) -> Population:
    """Return the population after a generation; values (N,) are NaN where a child has no score."""
    rng = np.random.default_rng([seed, population.generation, 1])
    scored = np.where(np.isnan(values), -np.inf, values)
    before = population.values
    is_better = scored > before
    replaces = (scored >= before) & np.isfinite(scored)
    memory = (population.scale.copy(), population.crossover.copy())
    slot, archive = population.slot, population.archive
    learns = is_better & np.isfinite(before)
    if learns.any():
        gain = scored[learns] - before[learns]
        weight = gain / gain.sum()
        f, c = children.scale[learns], children.crossover[learns]
        memory[0][slot] = (weight * f**2).sum() / (weight * f).sum()
        memory[1][slot] = (weight * c).sum()
        slot = (slot + 1) % MEMORY
        archive = np.concatenate([archive, population.units[learns]])
        archive = archive[rng.permutation(len(archive))[: len(values)]]
    stagnant = 0 if is_better.any() else population.stagnant + 1
    # A member without a score, whose trial is not finished yet, is wherever it was drawn.
    moves = replaces | ~np.isfinite(before)
    after = Population(
        np.where(moves[:, None], children.units, population.units),
        np.where(replaces, scored, before),
        *memory,
        archive,
        slot,
        stagnant,
        population.generation + 1,
    )
    if stagnant < PATIENCE:
        return after
    fresh = empty(population.units.shape[1])
    fresh.generation = after.generation
    return fresh


@dataclass(frozen=True)
class _State:
    """How far a study has come, as the sampler sees it.

    - space: name and distribution of each of the D dimensions, in the order of the unit cube.
    - places: per trial its place in the order of proposals; a trial that was tried again shares
      its place with the one that it repeats.
    - n_places: number of places.
    - population, children: the current generation.
    """

    space: Mapping[str, BaseDistribution]
    places: list[int]
    n_places: int
    population: Population
    children: Children


class Shade(optuna.samplers.BaseSampler):
    """A sampler for any `optuna.create_study` with one objective.

    - seed: of every draw.
    - search_space: distributions by parameter name. Without it the space is what the finished
      trials have in common (Optuna's `IntersectionSearchSpace`), and parameters outside of that
      space, those of the first trial included, are drawn at random.

    Trial k is member `k % MEMBERS` of generation `k // MEMBERS`. A generation is selected from the
    trials of it that are complete when the next one is begun; with several workers those that are
    still running count as not scored. A failed trial that Optuna's retry callback repeats keeps
    its place. Raises ValueError for a study with several objectives.
    """

    def __init__(
        self, seed: int = 0, search_space: Mapping[str, BaseDistribution] | None = None
    ) -> None:
        self._seed = seed
        self._given = search_space
        self._shared_space = IntersectionSearchSpace()
        self._state: _State | None = None

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
        # The state is replaced as a whole, so that threads of one study do not disturb each other.
        state = self._state
        if state is None or dict(state.space) != search_space:
            population = empty(len(search_space))
            state = _State(search_space, [], 0, population, propose(population, self._seed))
        state = self._caught_up(state, study, trial.number)
        self._state = state
        member = state.places[trial.number] - state.population.generation * MEMBERS
        if member < 0:  # A trial of an earlier generation that is repeated: its values are fixed.
            return {}
        units = state.children.units[member].tolist()
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

    def _caught_up(self, state: _State, study: Study, number: int) -> _State:
        """The state at the generation of a trial."""
        trials = study.get_trials(deepcopy=False)
        places, n_places = list(state.places), state.n_places
        for trial in trials[len(places) :]:
            # The number of the first trial with these values, set by Optuna's retry callback.
            first = trial.system_attrs.get("failed_trial")
            places.append(n_places if first is None else places[first])
            n_places += first is None
        population, children = state.population, state.children
        sign = 1.0 if study.direction == StudyDirection.MAXIMIZE else -1.0
        while places[number] >= (population.generation + 1) * MEMBERS:
            tried, scores = children.units.copy(), np.full(MEMBERS, np.nan)
            begin = population.generation * MEMBERS
            for place, trial in zip(places, trials, strict=True):
                member = place - begin
                if not 0 <= member < MEMBERS or not set(state.space) <= set(trial.params):
                    continue
                tried[member] = [to_unit(d, trial.params[n]) for n, d in state.space.items()]
                if trial.values is not None:
                    scores[member] = sign * trial.values[0]
            tried_children = Children(tried, children.scale, children.crossover)
            population = select(population, tried_children, scores, self._seed)
            children = propose(population, self._seed)
        return _State(state.space, places, n_places, population, children)


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
    """The ends of a range in the scale that it is searched in; whole numbers on a logarithmic scale
    have half a number more on either side."""
    if not d.log:
        return d.low, d.high
    half = 0.5 if isinstance(d, IntDistribution) else 0.0
    return math.log(d.low - half), math.log(d.high + half)
