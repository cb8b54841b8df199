"""`make cluster-demo`: a fleet of simulated drives has the same summary from one process, from two,
and from a Dask cluster of which one worker is killed while another one comes."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq

import egolane_pgm as ego

QUICKSTART = ego.experiments_folder() / "quickstart.yaml"

#: The columns of summary.parquet that depend on when and where the drives were run: the seconds
#: that each took, and the directory of its result.
TIME_AND_PLACE = ["seconds", "result"]


def write_fleet(path: Path, drives: int, frames: int) -> None:
    rows = [f'{seed},"[0, {frames}]",{"rain" if seed % 3 else "sun"}' for seed in range(drives)]
    path.write_text("\n".join(["recording.seed,recording.frames,tag.weather", *rows]) + "\n")


@contextlib.contextmanager
def cluster(
    n_workers: int, folder: Path
) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """The address of a scheduler, its process and its workers, which may be killed and added to."""
    told = folder / "scheduler.json"
    words = ["scheduler", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
    scheduler = dask(*words, "--host", "127.0.0.1", "--scheduler-file", str(told), folder=folder)
    workers: list[subprocess.Popen[bytes]] = []
    try:
        while not told.exists() or not told.read_text().strip():
            time.sleep(0.1)
            if scheduler.poll() is not None:
                raise SystemExit("cluster demo: the scheduler ended, see scheduler.log")
        workers += [start_worker(folder) for _ in range(n_workers)]
        yield pd.read_json(told, typ="series")["address"], scheduler, workers
    finally:
        # Not told to end: a worker that loses its scheduler at that moment never would.
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def start_worker(folder: Path, threads: int = 1) -> subprocess.Popen[bytes]:
    # Without a nanny, so that a worker that is killed stays away.
    words = ["--nthreads", str(threads), "--no-nanny", "--local-directory", str(folder)]
    return dask("worker", *words, "--scheduler-file", str(folder / "scheduler.json"), folder=folder)


def dask(what: str, *words: str, folder: Path) -> subprocess.Popen[bytes]:
    with (folder / f"{what}.log").open("ab") as log:
        command = [sys.executable, "-m", "dask", what, *words]
        return subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, **_ONE_THREAD})


_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def read_summary(folder: Path) -> tuple[bytes, pd.DataFrame]:
    """summary.parquet without time and place, as the bytes of a file; and all of it."""
    table, file = pq.read_table(folder / "summary.parquet"), io.BytesIO()
    pq.write_table(table.drop_columns(TIME_AND_PLACE), file)
    return file.getvalue(), table.to_pandas()


def main(drives: int, frames: int, n_workers: int) -> bool:
    """Whether all summaries are the same."""
    with tempfile.TemporaryDirectory(prefix="egolane-") as place:
        folder = Path(place)
        fleet = folder / "drives.csv"
        write_fleet(fleet, drives, frames)

        def run(name: str, jobs: int | str) -> tuple[bytes, pd.DataFrame]:
            begun = time.perf_counter()
            done = ego.run(QUICKSTART, fleet=fleet, out=folder / name, jobs=jobs)
            seconds = time.perf_counter() - begun
            print(f"{name}: {seconds:.1f} s, {len(done.failed)} drives failed", flush=True)
            return read_summary(folder / name)

        one, two = run("one process", 1), run("two processes", 2)
        with cluster(n_workers, folder) as (address, _, workers):
            name = f"{n_workers} workers"

            def kill_and_add() -> None:
                # Once the cluster is at work.
                while len(list((folder / name).glob("*/run.json"))) < drives // 4:
                    time.sleep(0.1)
                workers[0].send_signal(signal.SIGKILL)
                workers.append(start_worker(folder))
                print("one worker was killed, another one added", flush=True)

            threading.Thread(target=kill_and_add, daemon=True).start()
            many = run(name, address)
        differ = {c for _, table in (two, many) for c in table if not table[c].equals(one[1][c])}
        is_same = one[0] == two[0] == many[0]
        print(f"{drives} drives, {len(one[1].columns)} columns; these differ: {sorted(differ)}")
        print(f"without {TIME_AND_PLACE}: {'the same' if is_same else 'NOT the same'} bytes")
        return is_same


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=400)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--workers", type=int, default=4)
    given = parser.parse_args()
    sys.exit(0 if main(given.drives, given.frames, given.workers) else 1)
