"""The parameter search on run 1: time per trial, and our share of it.

`python -m tests.benchmarks.bench_tune` prints these rows alone.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from egolane_pgm.tuning.objective import all_used
from egolane_pgm.tuning.plan import Problem, load_plan, make_problem, scorer
from egolane_pgm.tuning.search import Settings, search, search_in_memory
from egolane_pgm.tuning.storage import open_storage, open_study
from tests.kits.tuning_kit import points_at

ROOT = Path(__file__).parents[2]
EXPERIMENT = ROOT / "experiments" / "paper" / "run01_italy_ml.yaml"
SIMULATED = ROOT / "experiments" / "quickstart.yaml"
HEADER = ("parameter search", "per trial", "trials per second")

Line = tuple[str, float]


def load() -> Problem:
    """Run 1 of the paper where EGOLANE_DATA has it, else the simulated drive."""
    return make_problem(load_plan(EXPERIMENT if os.environ.get("EGOLANE_DATA") else SIMULATED))


def tune_lines(rounds: int = 3) -> Iterator[Line]:
    """(what, seconds per trial) of everything that is measured."""
    problem = load()
    score = scorer(problem, all_used(problem.drives))
    points = points_at(problem.space, np.random.default_rng(0).random((256, len(problem.space))))
    for point in points:
        score(point)
    share = 10_000 / len(problem.drives[0].recorded.log)

    def timed(run: Callable[[], object], trials: int, times: int = rounds) -> float:
        found = []
        for _ in range(times):
            begun = time.perf_counter()
            run()
            found.append((time.perf_counter() - begun) / trials)
        return median(found)

    seconds = timed(lambda: [score(point) for point in points], 256)
    yield "our share, 10,000 frames", share * seconds
    for sampler in ("random", "evolution"):
        settings = Settings(("accuracy",), sampler, 2000, 0)
        seconds = timed(lambda s=settings: search_in_memory(problem.space, score, s), 2000)
        yield f"{sampler}, in memory, whole trial", seconds
        for kept in ("journal", "SQLite"):
            with tempfile.TemporaryDirectory() as folder:
                url = f"sqlite:///{folder}/study.db" if kept == "SQLite" else None
                trials = 100 if url else 1000
                run = _kept(problem, Path(folder), url, Settings(("accuracy",), sampler, trials, 0))
                yield f"{sampler}, {kept}", timed(run, trials, 1)
    for sampler in ("tpe", "cma-es"):
        yield from _at(problem, sampler)


def _kept(
    problem: Problem, folder: Path, url: str | None, settings: Settings
) -> Callable[[], object]:
    score = scorer(problem, all_used(problem.drives))

    def run() -> None:
        study = open_study(open_storage(url, folder), "bench", settings, {})
        search(study, problem.space, score, settings)

    return run


def _at(problem: Problem, sampler: str) -> list[Line]:
    """A sampler that slows down: its 100th and its 1,000th trial (mean of 20 around it)."""
    score = scorer(problem, all_used(problem.drives))
    clock: list[float] = []

    def timed(point: Any) -> Any:
        clock.append(time.perf_counter())
        return score(point)

    search_in_memory(problem.space, timed, Settings(("accuracy",), sampler, 1011, 0))
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
