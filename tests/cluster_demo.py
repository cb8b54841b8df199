"""`make cluster-demo`: a fleet of simulated drives on a Dask cluster gives the same summary as one
process, though a worker is killed and another one comes later."""

from __future__ import annotations

import argparse
import contextlib
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


def write_fleet(path: Path, drives: int, frames: int) -> None:
    rows = [f'{seed},"[0, {frames}]",{"rain" if seed % 3 else "sun"}' for seed in range(drives)]
    path.write_text("\n".join(["recording.seed,recording.frames,tag.weather", *rows]) + "\n")


@contextlib.contextmanager
def cluster(n_workers: int, folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The address of a scheduler, and its workers, which may be killed and added to."""
    told = folder / "scheduler.json"
    words = ["scheduler", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
    scheduler = dask(*words, "--host", "127.0.0.1", "--scheduler-file", str(told), folder=folder)
    workers: list[subprocess.Popen[bytes]] = []
    try:
        while not told.exists() or not told.read_text().strip():
            time.sleep(0.1)
            if scheduler.poll() is not None:
                raise SystemExit("cluster demo: the scheduler ended, see scheduler.log")
        workers += [start_worker(told, folder) for _ in range(n_workers)]
        yield pd.read_json(told, typ="series")["address"], workers
    finally:
        for process in (*workers, scheduler):
            process.terminate()
        for process in (*workers, scheduler):
            process.wait()


def start_worker(told: Path, folder: Path) -> subprocess.Popen[bytes]:
    # Without a nanny, so that a worker that is killed stays away.
    words = ["--nthreads", "1", "--no-nanny", "--scheduler-file", str(told)]
    return dask("worker", *words, "--local-directory", str(folder), folder=folder)


def dask(what: str, *words: str, folder: Path) -> subprocess.Popen[bytes]:
    with (folder / f"{what}.log").open("ab") as log:
        command = [sys.executable, "-m", "dask", what, *words]
        return subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, **_ONE_THREAD})


_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def summary(folder: Path) -> pd.DataFrame:
    table = pq.read_table(folder / "summary.parquet")
    frame: pd.DataFrame = table.to_pandas()
    return frame.drop(columns=["seconds", "result"])


def main(drives: int, frames: int, n_workers: int) -> bool:
    """Whether both summaries are the same."""
    with tempfile.TemporaryDirectory(prefix="egolane-") as place:
        folder = Path(place)
        fleet = folder / "drives.csv"
        write_fleet(fleet, drives, frames)
        begun = time.perf_counter()
        ego.run_fleet(QUICKSTART, fleet, folder / "one")
        alone = time.perf_counter() - begun
        with cluster(n_workers, folder) as (address, workers):

            def kill_and_add() -> None:
                # Once the cluster is at work.
                while len(list((folder / "many").glob("*/run.json"))) < drives // 4:
                    time.sleep(0.1)
                workers[0].send_signal(signal.SIGKILL)
                workers.append(start_worker(folder / "scheduler.json", folder))
                print("one worker was killed, another one added", flush=True)

            threading.Thread(target=kill_and_add, daemon=True).start()
            begun = time.perf_counter()
            many = ego.run_fleet(QUICKSTART, fleet, folder / "many", jobs=address)
            shared = time.perf_counter() - begun
        is_same = summary(folder / "one").equals(summary(folder / "many"))
        print(many)
        print(f"one process: {alone:.1f} s; {n_workers} workers, one killed: {shared:.1f} s")
        print(f"the summaries are {'the same' if is_same else 'NOT the same'}, but for times")
        return is_same


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=400)
    parser.add_argument("--frames", type=int, default=1200)
    parser.add_argument("--workers", type=int, default=4)
    given = parser.parse_args()
    sys.exit(0 if main(given.drives, given.frames, given.workers) else 1)
