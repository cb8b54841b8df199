"""The parameter search on run 1: time per trial, and our share of it.

`python -m tests.benchmarks.bench_tune` prints these rows alone.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from egolane_pgm.experiment import FitSettings
from egolane_pgm.loading import load_experiment
from egolane_pgm.studies.fits import objective, search_space
from egolane_pgm.studies.space import Point, SearchSpace
from tests.kits.studies import drive_of, points_at, search_in_memory

ROOT = Path(__file__).parents[2]
EXPERIMENT = ROOT / "experiments" / "paper" / "run01_italy_ml.yaml"
SIMULATED = ROOT / "experiments" / "quickstart.yaml"
HEADER = ("parameter search", "per trial", "trials per second")

Line = tuple[str, float]


class Problem(NamedTuple):
    score: Callable[[Point], list[float]]
    search_space: SearchSpace


def load() -> Problem:
    """Accuracy on run 1 of the paper if EGOLANE_DATA has it, otherwise on the simulated drive."""
    drive = drive_of(load_experiment(EXPERIMENT if os.environ.get("EGOLANE_DATA") else SIMULATED))
    fit, used = drive.experiment.fit, np.ones(len(drive), dtype=bool)
    space = search_space([drive.model], fit)
    return Problem(objective([drive], space, fit, [used], ["accuracy"]), space)


def tune_lines() -> Iterator[Line]:
    """(what, seconds per trial) of everything that is measured."""
    problem = load()
    score, space = problem.score, problem.search_space
    points = points_at(space, np.random.default_rng(0).random((256, len(space.distributions))))
    for point in points:
        score(point)

    def timed(run: Callable[[], object], trials: int) -> float:
        found = []
        for _ in range(3):
            begun = time.perf_counter()
            run()
            found.append((time.perf_counter() - begun) / trials)
        return median(found)

    seconds = timed(lambda: [score(point) for point in points], 256)
    yield "our share", seconds
    for sampler in ("random", "evolution"):
        settings = FitSettings(objective=("accuracy",), sampler=sampler, trials=2000, seed=0)
        seconds = timed(lambda s=settings: search_in_memory(space, score, s), 2000)
        yield f"{sampler}, in memory, whole trial", seconds
    for sampler in ("tpe", "cma-es"):
        yield from _at(problem, sampler)


def _at(problem: Problem, sampler: str) -> list[Line]:
    """A sampler that slows down: its 100th and its 1,000th trial (mean of 20 around it)."""
    clock: list[float] = []

    def timed(point: Any) -> Any:
        clock.append(time.perf_counter())
        return problem.score(point)

    settings = FitSettings(objective=("accuracy",), sampler=sampler, trials=1011, seed=0)
    search_in_memory(problem.search_space, timed, settings)
    return [
        (f"{sampler}, in memory, at the {n}th trial", (clock[n + 10] - clock[n - 10]) / 20)
        for n in (100, 1000)
    ]


def markdown(lines: Iterable[Line]) -> Iterator[str]:
    """The lines as a Markdown table, each when it is there."""
    yield f"| {' | '.join(HEADER)} |"
    yield "|---|---:|---:|"
    for what, s in lines:
        yield f"| {what} | {1e3 * s:.2f} ms | {1 / s:,.0f} |"


if __name__ == "__main__":
    for line in markdown(tune_lines()):
        print(line, flush=True)
