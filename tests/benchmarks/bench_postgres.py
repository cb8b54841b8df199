"""Studies that several workers share: trials per second on PostgreSQL beside memory and journal,
and what limits it.

`python -m tests.benchmarks.bench_postgres` prints this alone. The server is one of its own, with
the distribution's settings (a commit waits for the disk), in a temporary directory.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from egolane_pgm.tune._claims import CLAIM
from egolane_pgm.tune._connection import Link
from egolane_pgm.tune.address import parse
from egolane_pgm.tune.objective import all_used
from egolane_pgm.tune.plan import Problem, evaluator
from egolane_pgm.tune.postgres import Part, begin_job
from egolane_pgm.tune.shared import SharedJob, Task, run_shared
from egolane_pgm.tune.storage import only_one
from egolane_pgm.tune.study import Evaluate, Settings, run_study
from egolane_pgm.tune.workers import Job, run_workers
from tests.kits.postgres_server import Server, find_binaries

TRIALS = 2000
WORKERS = (1, 2, 4)


@dataclass(frozen=True)
class Cost:
    """Of one trial. seconds: wall. transactions: of the server. server_s: processor time of all its
    processes. written: bytes of its log that were written ahead (WAL)."""

    seconds: float
    transactions: float
    server_s: float
    written: float


def shared_table(problem: Problem) -> str:
    """Everything that is measured, as Markdown; a line that says so without PostgreSQL."""
    if find_binaries() is None:
        return "PostgreSQL is not installed: shared studies were not measured.\n"
    evaluate = evaluator(problem, all_used(problem.drives))
    evaluate([{d.key: d.choices[0] if d.choices else d.low for d in problem.space.dimensions}] * 8)
    rows = [("random, in memory", 1, _memory(problem, evaluate), None)]
    for n in WORKERS:
        rows.append(("random, journal", n, _journal(problem, evaluate, n), None))
    with Server(options=()) as server:
        for n in WORKERS:
            cost = _postgres(server, problem, evaluate, "random", TRIALS, n)
            rows.append(("random, PostgreSQL", n, cost.seconds, cost))
        free: dict[tuple[str, int], Cost] = {}
        for n in WORKERS:
            # Trials that cost nothing: what is left is the storage.
            free["random", n] = _postgres(server, problem, _nothing, "random", TRIALS, n)
            rows.append(("random, PostgreSQL, empty trials", n, free["random", n].seconds, None))
        cost = _postgres(server, problem, _nothing, "tpe", 200, 1)
        rows.append(("tpe, PostgreSQL, empty trials", 1, cost.seconds, cost))
    lines = [
        "| shared studies | workers | trials per second | transactions per trial |",
        "|---|---:|---:|---:|",
    ]
    for what, n, seconds, kept in rows:
        shown = "" if kept is None else f"{kept.transactions:.3f}"
        lines.append(f"| {what} | {n} | {1 / seconds:,.0f} | {shown} |")
    one = _postgres_note(free["random", max(WORKERS)])
    return "\n".join([*lines, "", one]) + "\n"


def _postgres_note(cost: Cost) -> str:
    """What limits it, from the trials that cost nothing."""
    claims = 1 / (CLAIM * cost.seconds)
    processor = CLAIM * cost.server_s
    return (
        f"{os.cpu_count()} cores for workers and server together. With empty trials the storage is"
        f" the limit: {claims:,.0f} claims of {CLAIM} trials a second in one study, whose lock each"
        f" holds until its commit is on disk. A claim costs the server {1000 * processor:.1f} ms of"
        f" processor time ({1 / processor:,.0f} a second and core, over all studies) and"
        f" {CLAIM * cost.written / 1024:.0f} kB of WAL. A worker whose trials take t seconds makes"
        f" 1 / ({CLAIM} t) claims a second: at the rate measured here one study carries"
        f" {claims * CLAIM * 0.01:,.0f} workers with trials of 10 ms,"
        f" {claims * CLAIM * 0.1:,.0f} of 100 ms, and from there on the server's max_connections"
        " (100; one per worker, one per machine) is the limit."
    )


def _nothing(points: object) -> np.ndarray:
    return np.zeros((len(points), 1))  # type: ignore[arg-type]


def _timed(run: Callable[[], object], trials: int) -> float:
    begun = time.perf_counter()
    run()
    return (time.perf_counter() - begun) / trials


def _memory(problem: Problem, evaluate: Evaluate) -> float:
    settings = Settings(("accuracy",), "random", TRIALS, 0)
    return _timed(lambda: run_study(problem.space, evaluate, settings), TRIALS)


def _journal(problem: Problem, evaluate: Evaluate, workers: int) -> float:
    settings = Settings(("accuracy",), "random", TRIALS, 0)
    with tempfile.TemporaryDirectory() as folder:
        job = Job(Path(folder), "bench", problem.space, evaluate, settings, ())
        with only_one(Path(folder)):
            return _timed(lambda: run_workers(job, {}, workers), TRIALS)


def _postgres(
    server: Server, problem: Problem, evaluate: Evaluate, sampler: str, trials: int, workers: int
) -> Cost:
    name = f"bench{time.monotonic_ns()}"
    address = parse(server.new_database(name))
    settings = Settings(("accuracy",), sampler, trials, 0)
    link = Link(address)
    part = Part(name, "all", 0, 1, problem.space, settings, {"identity": {}})
    kept = begin_job(link, name, [part], 60.0)
    link.close()
    job = SharedJob(address, name, [Task(kept[0], problem.space, evaluate, settings)])
    before = _counters(server, name)
    seconds = _timed(lambda: run_shared(job, workers), trials)
    after = _counters(server, name)
    transactions, server_s, written = ((b - a) / trials for a, b in zip(before, after, strict=True))
    return Cost(seconds, transactions, server_s, written)


def _counters(server: Server, database: str) -> tuple[float, float, float]:
    """Transactions, processor seconds of the server, bytes of WAL, once nobody is connected."""
    query = f"SELECT 1 FROM pg_stat_activity WHERE datname = '{database}'"
    while server.execute(query):
        time.sleep(0.01)
    transactions, written = server.execute(
        "SELECT xact_commit + xact_rollback, pg_wal_lsn_diff(pg_current_wal_lsn(), '0/0')"
        f" FROM pg_stat_database WHERE datname = '{database}'"
    )[0]
    assert server.process is not None
    # User and system time of the server and its children, the finished ones too: proc(5).
    ticks = 0
    children = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children").read_text()
    for pid in (server.process.pid, *map(int, children.split())):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += sum(map(int, fields[11:15]))
    return float(transactions), ticks / os.sysconf("SC_CLK_TCK"), float(written)


if __name__ == "__main__":
    from tests.benchmarks.bench_tune import load

    print(shared_table(load()))
