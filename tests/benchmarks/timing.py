"""Taking turns with a stopwatch, and the table of what it showed."""

from __future__ import annotations

import platform
import random
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from statistics import median

import numpy as np

HEADER = ("what", "time", "compared with", "its time", "ratio", "largest difference")


@dataclass(frozen=True)
class Row:
    """One line of the table. seconds, their_seconds: medians; None where nothing was measured.
    frames: what `seconds` is divided by to give a time per frame, 0 where that means nothing."""

    what: str
    seconds: float
    frames: int = 0
    against: str = ""
    their_seconds: float | None = None
    difference: str = ""


def take_turns(contestants: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """The median time of each contestant in seconds, after a first call of each that does not
    count. In each round everyone has a turn, in random order: caches and clock are not what the
    one before left behind, always the same."""
    order = random.Random(0)
    for run in contestants.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, run in order.sample(list(contestants.items()), len(contestants)):
            start = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - start)
    return {name: median(values) for name, values in times.items()}


def duel(
    what: str,
    ours: Callable[[], np.ndarray],
    against: str,
    theirs: Callable[[], np.ndarray] | None,
    frames: int,
    rounds: int,
) -> Row:
    """Ours and another's, in turns. theirs: None for what is not installed."""
    times = take_turns({"ours": ours} | ({"theirs": theirs} if theirs else {}), rounds)
    difference = largest_difference(ours(), theirs()) if theirs else ""
    return Row(what, times["ours"], frames, against, times.get("theirs"), difference)


def table(rows: Iterable[Row]) -> Iterator[str]:
    """The rows as a Markdown table, each when it is there."""
    yield f"| {' | '.join(HEADER)} |"
    yield "|" + "---|" * len(HEADER)
    for row in rows:
        yield f"| {' | '.join(cells(row))} |"


def cells(row: Row) -> list[str]:
    theirs, ratio = "", ""
    if row.their_seconds is not None:
        theirs = duration(row.their_seconds, row.frames)
        ratio = f"{_three_digits(row.their_seconds / row.seconds)} x"
    elif row.against:
        theirs = "not installed"
    ours = duration(row.seconds, row.frames)
    return [row.what, ours, row.against, theirs, ratio, row.difference]


def largest_difference(a: np.ndarray, b: np.ndarray) -> str:
    """Between two arrays, to one digit."""
    return f"{np.abs(np.asarray(a) - np.asarray(b)).max():.1g}"


def duration(seconds: float, frames: int) -> str:
    """`0.263 ms (26.4 ns per frame)`."""
    text = _with_unit(seconds)
    return f"{text} ({_with_unit(seconds / frames)} per frame)" if frames else text


def _with_unit(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{_three_digits(seconds / size)} {unit}"
    return f"{_three_digits(seconds / 1e-9)} ns"


def _three_digits(value: float) -> str:
    return f"{value:.3g}" if value < 1000 else f"{value:,.0f}"


def machine() -> str:
    """The machine in general terms, and the versions that matter."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    cores = 0
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        cores, model = len(names), names[0] if names else model
    versions = [f"Python {platform.python_version()}"]
    for package in ("numpy", "numba", "hmmlearn", "dynamax", "jax", "pgmpy", "pyagrum"):
        try:
            versions.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    return f"{model}, {cores or 'unknown number of'} cores, one thread used; {', '.join(versions)}"
