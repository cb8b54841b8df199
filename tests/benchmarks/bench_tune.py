"""The parameter search on run 1: trials per second, and our share of one.

`python -m tests.benchmarks.bench_tune` prints these rows alone, `bench_postgres` those of studies
that several workers share.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

from egolane_pgm.tune.objective import all_used
from egolane_pgm.tune.plan import Problem, evaluator, load_plan, make_problem
from egolane_pgm.tune.space import from_unit
from egolane_pgm.tune.storage import SqliteStore, only_one
from egolane_pgm.tune.study import Settings, run_study
from egolane_pgm.tune.workers import Job, run_workers

ROOT = Path(__file__).parents[2]
EXPERIMENT = ROOT / "experiments" / "paper" / "run01_italy_ml.yaml"
SIMULATED = ROOT / "experiments" / "quickstart.yaml"
HEADER = ("parameter search", "per trial", "trials per second")

Line = tuple[str, float]


def load() -> Problem:
    """Run 1 of the paper where EGOLANE_DATA has it, else the simulated drive."""
    return make_problem(load_plan(EXPERIMENT if os.environ.get("EGOLANE_DATA") else SIMULATED))


def tune_lines(rounds: int = 3) -> list[Line]:
    """(what, seconds per trial) of everything that is measured."""
    problem = load()
    evaluate = evaluator(problem, all_used(problem.drives))
    units = np.random.default_rng(0).random((256, len(problem.space)))
    points = from_unit(problem.space, units)
    evaluate(points)
    n_frames = len(problem.drives[0].recorded.log)
    share = 10_000 / n_frames

    def timed(run: Callable[[], object], trials: int, times: int = rounds) -> float:
        found = []
        for _ in range(times):
            begun = time.perf_counter()
            run()
            found.append((time.perf_counter() - begun) / trials)
        return median(found)

    def one_by_one() -> None:
        for point in points[:100]:
            evaluate([point])

    lines = [
        ("our share, many at once, 10,000 frames", share * timed(lambda: evaluate(points), 256)),
        ("our share, one at a time, 10,000 frames", share * timed(one_by_one, 100)),
    ]
    for sampler in ("random", "evolution"):
        settings = Settings(("accuracy",), sampler, 2000, 0)
        seconds = timed(lambda s=settings: run_study(problem.space, evaluate, s), 2000)
        lines.append((f"{sampler}, in memory, whole trial", seconds))
        with tempfile.TemporaryDirectory() as folder:
            lines.append((f"{sampler}, SQLite", timed(_sqlite(problem, folder, settings), 2000, 1)))
    for sampler in ("tpe", "cma-es"):
        lines += _at(problem, sampler)
    slow: dict[int, float] = {}
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            slow[workers] = timed(_journal(problem, folder, workers), 800, 1)
        lines.append((f"random, journal, {workers} worker(s)", slow[workers]))
    return lines


def shared_studies() -> str:
    """Trials per second of studies that workers share, as Markdown."""
    from tests.benchmarks.bench_postgres import shared_table

    return shared_table(load())


def _sqlite(problem: Problem, folder: str, settings: Settings) -> Callable[[], object]:
    evaluate = evaluator(problem, all_used(problem.drives))

    def run() -> None:
        with SqliteStore(Path(folder), "bench", {}, ["maximize"]) as store:
            run_study(problem.space, evaluate, settings, store=store)

    return run


def _journal(problem: Problem, folder: str, workers: int) -> Callable[[], object]:
    evaluate = evaluator(problem, all_used(problem.drives))
    settings = Settings(("accuracy",), "random", 800, 0)
    job = Job(Path(folder), "bench", problem.space, evaluate, settings, ())

    def run() -> None:
        with only_one(Path(folder)):
            run_workers(job, {}, workers)

    return run


def _at(problem: Problem, sampler: str) -> list[Line]:
    """A sampler that slows down: its 100th and its 1,000th trial (mean of 20 around it)."""
    evaluate = evaluator(problem, all_used(problem.drives))
    clock: list[float] = []

    def timed(points: object) -> object:
        clock.append(time.perf_counter())
        return evaluate(points)  # type: ignore[arg-type]

    run_study(problem.space, timed, Settings(("accuracy",), sampler, 1011, 0))  # type: ignore[arg-type]
    return [
        (f"{sampler}, in memory, at the {n}th trial", (clock[n + 10] - clock[n - 10]) / 20)
        for n in (100, 1000)
    ]


def markdown(lines: list[Line]) -> str:
    """The lines as a Markdown table."""
    rows = [f"| {' | '.join(HEADER)} |", "|---|---:|---:|"]
    rows += [f"| {what} | {1e3 * s:.2f} ms | {1 / s:,.0f} |" for what, s in lines]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(markdown(tune_lines()))
