"""A drive frame by frame: the time from a frame's lines to its belief, and the memory held.

`python -m tests.benchmarks.bench_stream [FRAMES]` prints these tables alone; the second one, what
the process holds after up to FRAMES frames (default 100,000), only then. Frames are made before the
clock starts. On a busy computer the frames in which another process had its turn are the slow ones:
the time of this process alone is beside it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.loading import load_experiment
from egolane_pgm.online import online, read_messages
from egolane_pgm.types import FloatArray, IntArray, LineLog
from tests.benchmarks.data import BONUS_VALUE, N_LANES, PARAMETERS, load
from tests.kits.streams import messages, over_and_over

ROOT = Path(__file__).parents[2]
HEADER = ("a streamed frame", "median", "99th percentile", "worst", "of this process")
FRAMES = 5000
#: Frames that are not counted: kernels are loaded in the first, and the lane width is found.
WARM_UP = 1000

#: (what, microseconds on the clock (T,), of this process alone (T,))
Line = tuple[str, FloatArray, FloatArray]


def zero_label() -> Experiment:
    """Position in lane with generic constants, from the frames so far."""
    return load_experiment(ROOT / "experiments" / "zero_label.yaml", [f"n_lanes={N_LANES}"])


def paper() -> Experiment:
    """The paper's graph with the parameters of run 1."""
    given = {**PARAMETERS, "bonus_value": BONUS_VALUE}
    changes = [f"n_lanes={N_LANES}", *(f"parameters.{k}={v}" for k, v in given.items())]
    return load_experiment(ROOT / "experiments" / "quickstart.yaml", changes)


def stream_lines(log: LineLog, n_frames: int = FRAMES) -> list[Line]:
    """(what, times) of everything that is measured."""
    lines: list[Line] = []
    for what, experiment in (("zero label", zero_label()), ("the paper's graph", paper())):
        rate = experiment.recording.frame_rate
        logs = list(over_and_over(log, n_frames + WARM_UP, rate))
        given = [*messages(log)][: n_frames + WARM_UP]
        runs: list[tuple[str, Callable[[Iterable], Iterator], list]] = [
            ("lines to belief", lambda xs, e=experiment: online(e, xs), logs),
            (
                "a JSON line to belief",
                lambda xs, e=experiment: online(e, read_messages(e, xs)),
                given,
            ),
        ]
        lines += [(f"{what}: {between}", *timed(run, frames)) for between, run, frames in runs]
    return lines


def timed(run: Callable[[Iterable], Iterator], frames: list) -> tuple[FloatArray, FloatArray]:
    """How long each frame took after the first WARM_UP, in microseconds: on the clock, and of this
    process alone."""
    begun: list[tuple[int, int]] = []
    ended: list[tuple[int, int]] = []

    def given() -> Iterator:
        for frame in frames:
            begun.append((time.perf_counter_ns(), time.thread_time_ns()))
            yield frame

    for _ in run(given()):
        ended.append((time.perf_counter_ns(), time.thread_time_ns()))
    took: IntArray = np.array(ended) - np.array(begun)
    clock, own = took[WARM_UP:].T / 1e3
    return clock, own


def markdown(lines: list[Line]) -> str:
    """The lines as a Markdown table."""

    def three(times: FloatArray) -> list[str]:
        return [f"{us:,.0f} us" for us in (*np.percentile(times, [50, 99]), times.max())]

    rows = [f"| {' | '.join(HEADER)} |", "|---|---:|---:|---:|---:|"]
    rows += [
        f"| {what} | {' | '.join(three(clock))} | {' / '.join(three(own))} |"
        for what, clock, own in lines
    ]
    return "\n".join(rows) + "\n"


def memory_lines(log: LineLog, n_frames: int) -> Iterator[str]:
    """A line of Markdown after 1,000, 10,000, ... frames: what the process holds in memory."""
    experiment = zero_label()
    begun = time.perf_counter()
    yield "| frames | resident memory | frames per second |\n|---:|---:|---:|"
    logs = over_and_over(log, n_frames, experiment.recording.frame_rate)
    for count, _ in enumerate(online(experiment, logs), start=1):
        if count >= 1000 and (count in (10**k for k in range(3, 10)) or count == n_frames):
            rate = count / (time.perf_counter() - begun)
            yield f"| {count:,} | {resident_mb():.1f} MB | {rate:,.0f} |"


def resident_mb() -> float:
    """The memory that this process holds, in MB; NaN where the system does not say it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    except OSError:
        return float("nan")
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    data = load()
    print(f"Measured on {data.source}.\n\n{markdown(stream_lines(data.log))}", flush=True)
    for row in memory_lines(data.log, int(sys.argv[1]) if sys.argv[1:] else 100_000):
        print(row, flush=True)
