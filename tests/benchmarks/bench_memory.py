"""Memory against the length of a drive: `egolane run` with and without `--chunk-frames`.

`python -m tests.benchmarks.bench_memory [FRAMES ...]` prints a table for drives of
so many frames (10,000 and 100,000 by default; a day at 30 frames a second has 2,592,000). A drive
is a simulated one with its ground truth. Each run is a process of its own, without figures; its
peak is `VmHWM`, which Linux counts, less that of Python alone.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate

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


def write_long_drive(folder: Path, n_frames: int) -> tuple[Path, Path]:
    """A recording of so many frames, and its ground truth."""
    drive = simulate("quickstart", seed=1, frames=n_frames, n_lanes=N_LANES)
    recording, truth = folder / "lines.parquet", folder / "truth.txt"
    write_table(recording, drive.log)
    write_ground_truth(truth, drive.truth)
    return recording, truth


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
