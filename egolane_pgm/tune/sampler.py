"""Differential evolution for scores that are piecewise constant: no gradient, no model of the
score, and a child as good as its parent takes its place, so that plateaus are walked across.

SHADE (Tanabe and Fukunaga 2013, doi:10.1109/CEC.2013.6557555): current-to-pbest/1 with an archive
and a memory of the scale factors and crossover rates that worked; begun anew, elsewhere, once no
member has improved for a while. Every draw depends only on seed and generation, so the state of a
search follows from its finished trials, and a study that was interrupted goes on as if it had not
been.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

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
    """N members in the unit cube.

    units (N, D), values (N,): more is better, -inf where not known. scale, crossover (MEMORY,):
    what worked. archive (A, D): members that were replaced. stagnant: generations without any
    improvement. generation: of the next children; 0 for the first draw.
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
    """A generation: units (N, D), and the scale factor and crossover rate of each, (N,)."""

    units: FloatArray
    scale: FloatArray
    crossover: FloatArray


def empty(n_dimensions: int) -> Population:
    """Before the first generation."""
    return Population(
        np.zeros((MEMBERS, n_dimensions)),
        np.full(MEMBERS, -np.inf),
        archive=np.zeros((0, n_dimensions)),
    )


def propose(population: Population, seed: int) -> Children:
    """The next generation; the same for the same population and seed."""
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
    """The population after a generation: values (N,), NaN where a child was not scored."""
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
