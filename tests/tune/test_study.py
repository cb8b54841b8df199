"""One study: seeds, starting points, samplers, resuming."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm.tune import sampler as evolution
from egolane_pgm.tune.plan import starting_points
from egolane_pgm.tune.study import SAMPLERS, Settings, best_trial, pareto, run_study
from tests.kits.tuning_kit import bowl, plain_space, problem, told

SPACE = plain_space()


class Memory:
    """A store that keeps trials in a list, and stops the study after some."""

    def __init__(self, stop_after: int = 10**9) -> None:
        self.trials: list[Any] = []
        self.stop_after = stop_after

    def finished(self) -> list[Any]:
        return list(self.trials)

    def write(self, trials: Any) -> None:
        self.trials += trials
        if len(self.trials) >= self.stop_after:
            raise KeyboardInterrupt


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_the_same_seed_gives_the_same_study_and_another_one_another(sampler: str) -> None:
    settings = Settings(("accuracy",), sampler, 40, 3)
    first = told(run_study(SPACE, bowl, settings).trials)
    assert told(run_study(SPACE, bowl, settings).trials) == first
    assert told(run_study(SPACE, bowl, replace(settings, seed=4)).trials) != first
    assert len(first) == 40


@pytest.mark.parametrize("sampler", ["evolution", "random"])
@pytest.mark.parametrize("stop_after", [1, 29, 31, 77])
def test_an_interrupted_study_goes_on_as_if_it_had_not_been(sampler: str, stop_after: int) -> None:
    settings = Settings(("accuracy",), sampler, 130, 0)
    whole = told(run_study(SPACE, bowl, settings).trials)
    store = Memory(stop_after)
    with pytest.raises(KeyboardInterrupt):
        run_study(SPACE, bowl, settings, store=store)
    store.trials, store.stop_after = store.trials[:stop_after], 10**9
    assert told(run_study(SPACE, bowl, settings, store=store).trials) == whole


@pytest.mark.parametrize("sampler", ["tpe", "cma-es", "nsga2"])
def test_a_sampler_of_optuna_repeats_no_trial_after_an_interruption(sampler: str) -> None:
    settings = Settings(("accuracy",), sampler, 15, 0)
    store = Memory()
    run_study(SPACE, bowl, settings, store=store)
    done = run_study(SPACE, bowl, replace(settings, trials=30), store=store)
    points = [tuple(t.params.values()) for t in done.trials]
    assert len(points) == len(set(points)) == 30


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_known_points_are_tried_first_and_in_order(sampler: str) -> None:
    starts = [{"x0": 0.1, "x1": 0.2, "x2": 0.3}, {"x0": 0.3, "x1": 0.3, "x2": 0.3}]
    done = run_study(SPACE, bowl, Settings(("accuracy",), sampler, 12, 0), starts=starts)
    assert [t.params for t in done.trials[:2]] == starts
    assert best_trial(done).number == 1


def test_a_finished_study_is_not_run_again() -> None:
    store = Memory()
    settings = Settings(("accuracy",), "evolution", 50, 0)
    run_study(SPACE, bowl, settings, store=store)

    def never(points: Any) -> Any:
        raise AssertionError("no trial was asked for")

    again = run_study(SPACE, never, settings, store=store)
    assert len(again.trials) == 50


def test_evolution_beats_random_on_steps() -> None:
    space = plain_space(7)
    best = {
        sampler: [
            best_trial(run_study(space, bowl, Settings(("accuracy",), sampler, 600, s))).values[0]
            for s in range(3)
        ]
        for sampler in ("evolution", "random")
    }
    assert min(best["evolution"]) > max(best["random"])


def test_evolution_minimises_what_is_better_small() -> None:
    settings = Settings(("log_loss",), "evolution", 400, 0)
    done = run_study(SPACE, lambda points: 1 - bowl(points), settings)
    assert best_trial(done).values[0] == min(t.values[0] for t in done.trials) < 0.02


def test_a_population_that_stands_still_is_drawn_anew() -> None:
    population = evolution.empty(2)
    for _ in range(evolution.PATIENCE + 1):
        children = evolution.propose(population, 0)
        population = evolution.select(population, children, np.zeros(len(children.units)), 0)
    assert not np.isfinite(population.values).any()
    assert population.generation == evolution.PATIENCE + 1


def test_children_stay_in_the_cube_and_a_child_as_good_takes_its_parents_place() -> None:
    population = evolution.empty(3)
    for _ in range(10):
        children = evolution.propose(population, 1)
        assert children.units.min() >= 0
        assert children.units.max() <= 1
        before = population
        population = evolution.select(population, children, np.full(len(children.units), 0.5), 1)
    np.testing.assert_array_equal(population.units, children.units)
    assert not np.array_equal(before.units, population.units)


def test_several_objectives_give_a_front_that_nothing_in_it_dominates() -> None:
    def two(points: Any) -> Any:
        x = np.array([p["x0"] for p in points])
        return np.stack([x, x**2], axis=1)

    settings = Settings(("accuracy", "log_loss"), "nsga2", 60, 0)
    front = pareto(run_study(SPACE, two, settings))
    assert len(front) > 5
    for a in front:
        assert not any(
            b["values"][0] > a["values"][0] and b["values"][1] < a["values"][1] for b in front
        )


def test_the_current_values_are_tried_first_unless_from_scratch() -> None:
    points, notes = starting_points(problem())
    current = problem().drives[0].model.parameters
    assert points == [{key: current[key] for key in problem().space.keys}]
    assert not notes
    assert starting_points(problem(from_scratch=True)) == ([], [])
