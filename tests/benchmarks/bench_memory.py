"""Memory against the length of a drive: `egolane run` with and without `--chunk-frames`.

`python -m tests.benchmarks.bench_memory [FRAMES ...]` prints a table for drives of
so many frames (10,000 and 100,000 by default; a day at 30 frames a second has 2,592,000). A drive
is a simulated one over and over, with its ground truth, in a Parquet file that is itself written
part after part. Each run is a process of its own, without figures; its peak is `VmHWM`, which
Linux tells, less that of Python alone.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet

from egolane_pgm.simulation import SimulatedDrive, simulate

ROOT = Path(__file__).parents[2]
N_LANES = 4
LENGTHS = (10_000, 100_000)
CHUNK = 10_000
FRAME_RATE = 30
#: A process says itself what its largest memory was, kB: to its parent it counts the parent's too.
TOLD = """
import atexit, re, sys
from pathlib import Path
def tell():
    print(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1], file=sys.stderr)
atexit.register(tell)
"""
EGOLANE = (sys.executable, "-c", f"{TOLD}\nfrom egolane_pgm.command import main\nmain()")
RUNS = (("the paper's graph", "quickstart.yaml"), ("zero label", "zero_label.yaml"))
HEADER = ("frames", "`egolane run`", "whole: memory", "time", "chunks: memory", "time")


def memory_lines(lengths: Sequence[int] = LENGTHS) -> Iterator[str]:
    """The lines of a Markdown table."""
    yield f"| {' | '.join(HEADER)} |"
    yield "|---:|---|---:|---:|---:|---:|"
    bare, _ = peak([sys.executable, "-c", TOLD])
    for n_frames in lengths:
        with tempfile.TemporaryDirectory() as folder:
            recording, truth = write_long_drive(Path(folder), n_frames)
            for what, experiment in RUNS:
                cells = []
                for option in ((), ("--chunk-frames", CHUNK)):
                    words = (recording, "--experiment", ROOT / "experiments" / experiment)
                    words += ("--ground-truth", truth, "--n-lanes", N_LANES, *option)
                    words += ("--no-figures",)
                    words += (f"--set=recording.frame_rate={FRAME_RATE}", "--out", f"{folder}/out")
                    most, seconds = peak([*EGOLANE, "run", *map(str, words)])
                    cells += [f"{most - bare:,.0f} MB", f"{seconds:,.0f} s"]
                yield f"| {n_frames:,} | {what} | {' | '.join(cells)} |"


#: Without times: those of a lap begin anew.
COLUMNS = ["frame_id", "line", "offset_m", "is_valid", "is_continuous", "lri"]


def write_long_drive(folder: Path, n_frames: int) -> tuple[Path, Path]:
    """A recording of so many frames, and its ground truth."""
    drive = simulate("quickstart", seed=1, frames=12_000, n_lanes=N_LANES)
    recording, truth = folder / "lines.parquet", folder / "truth.txt"
    schema = pa.Table.from_pandas(
        drive.log.to_pandas().reset_index()[COLUMNS], preserve_index=False
    ).schema
    writer = parquet.ParquetWriter(recording, schema)
    with writer, truth.open("w", encoding="utf-8") as lines:
        for lap in laps(drive, n_frames):
            writer.write_table(
                pa.Table.from_pandas(lap.log.to_pandas().reset_index()[COLUMNS], schema)
            )
            rows = lap.truth.astype(int).itertuples()
            lines.writelines(f"{k};{lane};{crossing}\n" for k, lane, crossing in rows)
    return recording, truth


def laps(drive: SimulatedDrive, n_frames: int) -> Iterator[SimulatedDrive]:
    """A drive again and again, so many frames in all, with ids that count them."""
    for first in range(0, n_frames, len(drive.log)):
        part = slice(0, n_frames - first)
        log, truth = drive.log.take(part), drive.truth.iloc[part]
        log = replace(log, frame_id=log.frame_id + first)
        yield replace(drive, log=log, truth=truth.set_axis(truth.index + first))


def peak(command: Sequence[str]) -> tuple[float, float]:
    """The largest memory of a process that tells it, MB, and its seconds. Raises RuntimeError where
    it fails."""
    begun = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return int(done.stderr.split()[-1]) * 1024 / 1e6, time.perf_counter() - begun


if __name__ == "__main__":
    for line in memory_lines([*map(int, sys.argv[1:])] or LENGTHS):
        print(line, flush=True)
