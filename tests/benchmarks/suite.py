"""The measurements themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from egolane_pgm.evidence import counting
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.scoring.confusion import assigned_lane, confusion
from egolane_pgm.types import FloatArray, IntArray
from tests.benchmarks import bench_camera, bench_cold, bench_memory, peers
from tests.benchmarks.bench_tune import markdown, tune_lines
from tests.benchmarks.data import N_LANES, Data, load, parameter_sets
from tests.benchmarks.position import position_rows
from tests.benchmarks.timing import Row, duel, machine, table, take_turns
from tests.benchmarks.workbench import workbench_rows
from tests.reference import counting as plain_counting
from tests.reference import inference as reference

N_SETS = 100
NOTE = """\
Every time ends with the belief over lanes, made from the evidence vectors; ours has the log
evidence of each frame as well. Where confusions differ from dynamax's, it is that dynamax lifts
probabilities below 1e-15 to that: hmmlearn and plain NumPy agree with ours. In position in lane
the evidence vectors are the likelihoods of the states, and where others are compared the motion is
held still for all."""


def run_all(rounds: int) -> str:
    """Measure everything, print each row when it is there, and give the whole text back."""
    said = []
    for line in _all_lines(rounds):
        print(line, flush=True)
        said.append(line)
    return "\n".join(said) + "\n"


def _all_lines(rounds: int) -> Iterator[str]:
    data = load()
    yield f"Measured on {data.source}.\n{machine()}.\n"
    yield from table(_rows(data, rounds))
    yield f"\n{NOTE}\n"
    yield from markdown(tune_lines())
    yield f"\n{bench_camera.markdown(bench_camera.camera_lines())}"
    yield bench_cold.markdown(bench_cold.cold_lines())
    yield from bench_memory.memory_lines()


def _rows(data: Data, rounds: int) -> Iterator[Row]:
    for part in (
        evidence_rows,
        filter_rows,
        exact_rows,
        many_rows,
        position_rows,
        workbench_rows,
    ):
        yield from part(data, rounds)


def evidence_rows(data: Data, rounds: int) -> list[Row]:
    def ours() -> FloatArray:
        made = counting.evidence(data.log, N_LANES, data.parameters)
        return made.likelihoods["DetectorOutput"]

    def plain() -> FloatArray:
        made = plain_counting.evidence(data.log, N_LANES, data.parameters)
        return made.likelihoods["DetectorOutput"]

    return [duel("evidence", ours, "plain NumPy", plain, len(data.log), rounds)]


def filter_rows(data: Data, rounds: int) -> list[Row]:
    rows = []
    for method in METHODS:

        def ours(method: str = method) -> FloatArray:
            return filter_beliefs(data.compiled, data.evidence, method).lane

        def plain(method: str = method) -> FloatArray:
            return reference.filter_beliefs(data.compiled, data.evidence, method).lane

        what = f"filter, {method}"
        rows.append(duel(what, ours, "plain NumPy", plain, len(data.log), min(rounds, 5)))
    return rows


def exact_rows(data: Data, rounds: int) -> list[Row]:
    """One sequence. Ours is the whole call, with its checks and the log evidence of each frame."""

    def ours() -> FloatArray:
        return filter_beliefs(data.compiled, data.evidence, "exact").lane

    others: dict[str, peers.Filter | None] = {
        **{name: make(data.compiled, data.evidence) for name, make in peers.HMMLEARN.items()},
        "dynamax, jit": peers.dynamax_filter([data.compiled], data.evidence),
    }
    what = "filter, exact, 8 joint states"
    return [duel(what, ours, name, run, len(data.log), rounds) for name, run in others.items()]


def many_rows(data: Data, rounds: int) -> list[Row]:
    """100 parameter sets, to the beliefs over lanes; compared by their confusions."""
    models = parameter_sets(data.compiled, N_SETS)
    lane, is_crossing = data.truth["true_lane"], data.truth["is_crossing"]

    def ours() -> list[FloatArray]:
        return [filter_beliefs(model, data.evidence, "exact").lane for model in models]

    def confusions(beliefs: Any) -> IntArray:
        return np.stack([confusion(assigned_lane(b), lane, is_crossing, N_LANES) for b in beliefs])

    others: dict[str, Callable[[], Any] | None] = {}
    for name, make in peers.HMMLEARN.items():
        runs = [make(model, data.evidence) for model in models]
        others[name] = None if runs[0] is None else one_after_the_other(runs)
    others["dynamax, jit of vmap"] = peers.dynamax_filter(models, data.evidence)
    installed = {name: run for name, run in others.items() if run is not None}
    times = take_turns({"ours": ours} | installed, max(3, rounds // 4))
    found, rows = confusions(ours()), []
    what = f"filter, exact, {N_SETS} parameter sets"
    for name, run in others.items():
        differ = (confusions(run()) != found).any(axis=(1, 2)).sum() if run else 0
        difference = f"{differ} of {N_SETS} confusions" if run else ""
        frames = N_SETS * len(data.log)
        rows.append(Row(what, times["ours"], frames, name, times.get(name), difference))
    return rows


def one_after_the_other(runs: list[peers.Filter | None]) -> Callable[[], object]:
    """A function that calls each."""
    return lambda: [run() for run in runs if run is not None]
