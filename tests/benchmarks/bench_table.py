"""A table of simulated drives on one process, two, and four workers of a Dask cluster: what a drive
takes, and what sharing out a piece of work costs beside.

`python -m tests.benchmarks.bench_table` prints these rows alone. Wall time, which what else runs on
the machine lengthens, and processor time of all processes together, which it hardly does. Both are
of many pieces less those of few, so that the start of processes does not count.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import psutil
from distributed import LocalCluster

import egolane_pgm as ego
from egolane_pgm.tools.jobs import parallel
from tests.benchmarks.timing import machine

QUICKSTART = ego.experiments_folder() / "quickstart.yaml"

FRAMES = 300

#: How many drives, and how many pieces of work that do nothing: many, less few.
_DRIVES = (120, 20)
_PIECES = (1100, 100)

#: Seconds for one: on the wall, and of processors.
Seconds = tuple[float, float]

#: How the drives are shared out; what a drive takes; what a piece of work that does nothing takes.
Line = tuple[str, Seconds, Seconds]


def table_lines() -> list[Line]:
    """A line for each way to share out the drives."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for n in _DRIVES:
            rows = [f'{seed},"[0, {FRAMES}]"' for seed in range(n)]
            table = "\n".join(["recording.seed,recording.frames", *rows]) + "\n"
            (folder / f"{n}.csv").write_text(table)
        with LocalCluster(4, threads_per_worker=1, dashboard_address=None) as cluster:
            ways: dict[str, dict[str, Any]] = {
                "one process": {"jobs": 1},
                "two processes": {"jobs": 2},
                "four workers": {"cluster": cluster.scheduler_address},
            }
            return [
                (
                    name,
                    _for_one(partial(_run_table, folder, way), *_DRIVES),
                    _for_one(partial(_do_nothing, way), *_PIECES),
                )
                for name, way in ways.items()
            ]


def _run_table(folder: Path, way: dict[str, Any], n: int) -> None:
    with tempfile.TemporaryDirectory(dir=folder) as out:
        ego.run(QUICKSTART, table=folder / f"{n}.csv", out=out, **way)


def _do_nothing(way: dict[str, Any], n: int) -> None:
    for _ in parallel(abs, range(n), **way):
        pass


def _for_one(work: Callable[[int], None], many: int, few: int) -> Seconds:
    # Once before, as a process that is new to the work reads code and compiles.
    work(few)
    found = []
    for n in (few, many):
        wall, processor = time.perf_counter(), _processor_seconds()
        work(n)
        found.append((time.perf_counter() - wall, _processor_seconds() - processor))
    (wall_few, processor_few), (wall_many, processor_many) = found
    return (wall_many - wall_few) / (many - few), (processor_many - processor_few) / (many - few)


def _processor_seconds() -> float:
    """Of this process and all that it started, whether they run or have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    running = [child.cpu_times() for child in psutil.Process().children(recursive=True)]
    return sum(each.ru_utime + each.ru_stime for each in used) + sum(
        each.user + each.system for each in running
    )


def markdown(lines: list[Line]) -> str:
    """The lines as a Markdown table, with drives per second on the wall."""
    rows = [
        f"a drive of {FRAMES} frames | drives per second | processor time | sharing out one",
        "---|---:|---:|---:",
    ]
    for name, (wall, processor), (_, nothing) in lines:
        rows.append(f"{name} | {1 / wall:.1f} | {1e3 * processor:.0f} ms | {1e3 * nothing:.2f} ms")
    return "".join(f"| {row} |\n" for row in rows)


if __name__ == "__main__":
    print(f"{machine()}.\n\n{markdown(table_lines())}")
