"""Where `egolane run` spends its time from cold: a process of its own for each turn.

`python -m tests.benchmarks.bench_cold [ROUNDS]` prints this table alone. It is processor time,
which a busy computer lengthens less than the time on the clock. Kernels are compiled and kept
before; the last line is a run that finds none.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from statistics import median
from typing import Any

ROOT = Path(__file__).parents[2]
PAPER, QUICKSTART = "experiments/paper/run01_italy_ml.yaml", "experiments/quickstart.yaml"
REST = "everything else"

#: The functions that are timed, and what they do. What one of them does for another counts there.
PARTS = (
    ("egolane_pgm.drives", "compile_model", "graph and rule; numba loads kernels"),
    ("egolane_pgm.running", "read_drives", "reading recording and labels"),
    ("egolane_pgm.running", "make_evidence", "evidence"),
    ("egolane_pgm.running", "filter_beliefs", "filter"),
    ("egolane_pgm.result", "score", "scores, with intervals"),
    ("egolane_pgm.result", "digest", "checksums"),
    ("egolane_pgm.result:Result", "save", "writing tables"),
    ("egolane_pgm.views.style", "write_figure", "drawing strips.png"),
)


def cold_lines(rounds: int = 5) -> list[tuple[str, float]]:
    """(what, seconds of processor time) of each part, medians."""
    experiment = PAPER if os.environ.get("EGOLANE_DATA") else QUICKSTART
    with tempfile.TemporaryDirectory() as folder:
        turns = [_turn(experiment, Path(folder)) for _ in range(rounds + 1)][1:]
        compiled = _turn(experiment, Path(folder), NUMBA_CACHE_DIR=f"{folder}/empty")
    parts = [(what, median(turn[what] for turn in turns)) for what in turns[0]]
    without = [sum(turn.values()) - turn["matplotlib"] - turn[PARTS[-1][2]] for turn in turns]
    return [
        *parts,
        (f"`egolane run {experiment}`", median(sum(turn.values()) for turn in turns)),
        ("the same with --no-figures", median(without)),
        ("the same with no kernel compiled before", sum(compiled.values())),
    ]


def markdown(lines: Sequence[tuple[str, float]]) -> str:
    """The lines as a Markdown table."""
    rows = [f"| {what} | {seconds:.2f} s |" for what, seconds in lines]
    return "\n".join(["| a run from cold | processor time |", "|---|---:|", *rows]) + "\n"


def _turn(experiment: str, folder: Path, **environment: str) -> dict[str, float]:
    """One run in a process of its own: seconds by part."""
    # Of installed packages Python has compiled the source.
    given = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    report = folder / "report.json"
    words = [experiment, "--out", str(folder / "result")]
    command = [sys.executable, "-m", "tests.benchmarks.bench_cold", str(report), *words]
    subprocess.run(
        command, cwd=ROOT, env={**given, **environment}, check=True, stdout=subprocess.DEVNULL
    )
    found: dict[str, float] = json.loads(report.read_text(encoding="utf-8"))
    return found


def _inside(report: Path, words: list[str]) -> None:
    """Run a command in this process, which has just begun, and write where its time went."""
    spent = {"Python itself": _now()}
    at_work: list[str] = []
    since = [_now()]

    @contextlib.contextmanager
    def part(what: str) -> Iterator[None]:
        _close(what)
        try:
            yield
        finally:
            _close(None)

    def _close(begun: str | None) -> None:
        now = _now()
        if at_work:
            spent[at_work[-1]] = spent.get(at_work[-1], 0.0) + now - since[0]
        since[0] = now
        at_work.append(begun) if begun else at_work.pop()

    def timed(function: Any, what: str) -> Any:
        def call(*given: Any, **named: Any) -> Any:
            with part(what):
                return function(*given, **named)

        return call

    with part("importing numba"):
        import_module("egolane_pgm.tools.jit")
    with part("other imports"):
        import_module("egolane_pgm.verbs.run")
        command = import_module("egolane_pgm.command").egolane
    with part("matplotlib"):
        import_module("egolane_pgm.views.strips")
    for place, name, what in PARTS:
        module = resolve_name(place)
        setattr(module, name, timed(getattr(module, name), what))
    with part(REST):
        command(["run", *words], standalone_mode=False)
    spent[REST] = spent.pop(REST)
    report.write_text(json.dumps(spent), encoding="utf-8")


def _now() -> float:
    """The processor time of this process and of those that it waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


if __name__ == "__main__":
    if len(sys.argv) > 2:
        _inside(Path(sys.argv[1]), sys.argv[2:])
    else:
        print(markdown(cold_lines(*map(int, sys.argv[1:]))))
