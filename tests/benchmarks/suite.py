"""The measurements themselves."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from egolane_pgm.evidence import counting
from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, flat_network, quiet
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.scoring.confusion import assigned_lane, confusion
from egolane_pgm.types import FloatArray, IntArray
from tests.benchmarks import bench_camera, bench_cold, bench_memory, peers
from tests.benchmarks.bench_tune import markdown, tune_lines
from tests.benchmarks.data import N_LANES, Data, load, parameter_sets
from tests.benchmarks.position import position_rows
from tests.benchmarks.timing import Row, duel, largest_difference, machine, table, take_turns
from tests.benchmarks.workbench import workbench_rows
from tests.reference import counting as plain_counting
from tests.reference import inference as reference

ROOT = Path(__file__).parents[2]
EXPERIMENT = Path("experiments/paper/run01_italy_ml.yaml")
N_SETS = 100
PGMPY_FRAMES = 200
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
        together_rows,
        position_rows,
        pgmpy_rows,
        workbench_rows,
        reading_rows,
        command_rows,
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
    """100 parameter sets. Ours ends with their confusions (as a search does), and once more with
    their beliefs over lanes, as the others do."""
    models = parameter_sets(data.compiled, N_SETS)
    lane, is_crossing = data.truth["true_lane"], data.truth["is_crossing"]

    def to_confusions() -> IntArray:
        beliefs = (filter_beliefs(model, data.evidence, "exact").lane for model in models)
        matrices = [confusion(assigned_lane(b), lane, is_crossing, N_LANES) for b in beliefs]
        return np.stack(matrices)

    def to_beliefs() -> FloatArray:
        for model in models:
            last = filter_beliefs(model, data.evidence, "exact").lane
        return last

    ours: dict[str, Callable[[], object]] = {"confusions": to_confusions, "beliefs": to_beliefs}
    others: dict[str, Callable[[], object] | None] = {}
    for name, make in peers.HMMLEARN.items():
        runs = [make(model, data.evidence) for model in models]
        others[name] = None if runs[0] is None else one_after_the_other(runs)
    others["dynamax, jit of vmap"] = peers.dynamax_filter(models, data.evidence)
    installed = {name: run for name, run in others.items() if run is not None}
    times = take_turns(ours | installed, max(3, rounds // 4))

    found = to_confusions()
    rows = []
    for name, run in others.items():
        difference = ""
        if run is not None:
            theirs = [confusion(assigned_lane(b), lane, is_crossing, N_LANES) for b in run()]
            differ = (np.stack(theirs) != found).any(axis=(1, 2))
            difference = f"{differ.sum()} of {N_SETS} confusions"
        for kind in ours:
            rows.append(
                Row(
                    f"filter, exact, {N_SETS} parameter sets, to {kind}",
                    times[kind],
                    N_SETS * len(data.log),
                    name,
                    times.get(name),
                    difference,
                )
            )
    return rows


def one_after_the_other(runs: list[peers.Filter | None]) -> Callable[[], object]:
    """A function that calls each."""
    return lambda: [run() for run in runs if run is not None]


def together_rows(data: Data, rounds: int) -> list[Row]:
    lane, is_crossing = data.truth["true_lane"], data.truth["is_crossing"]

    def run() -> float:
        evidence = counting.evidence(data.log, N_LANES, data.parameters)
        belief = filter_beliefs(data.compiled, evidence, "assumed_density").lane
        counts = confusion(assigned_lane(belief), lane, is_crossing, belief.shape[1])
        return float(np.trace(counts) / counts.sum())

    times = take_turns({"ours": run}, rounds)
    return [Row("evidence, filter and accuracy together", times["ours"], len(data.log))]


def pgmpy_rows(data: Data, rounds: int) -> list[Row]:
    evidence = data.evidence.take(slice(0, PGMPY_FRAMES))
    tables = sensor_failure.tables(N_LANES, data.parameters)
    with quiet():
        from pgmpy.inference import VariableElimination

    def theirs() -> FloatArray:
        before: dict[str, FloatArray] = {}
        lane = []
        for t in range(len(evidence)):
            now = min(t, 1)
            frame = [table for table in tables if table.node[1] == now]
            frame += [Table((name, 0), (), values) for name, values in before.items()]
            for key, rows in evidence.likelihoods.items():
                share = rows[t] / rows[t].max()
                seen = np.stack([1 - share, share], axis=-1)
                frame.append(Table((f"{key}_ve", now), ((str(key), now),), seen))
            found = {f"{key}_ve@{now}": 1 for key in evidence.likelihoods}
            with quiet():
                ask = VariableElimination(flat_network(frame, {})).query
                for name in sensor_failure.HIDDEN:
                    answer: Any = ask([f"{name}@{now}"], evidence=found, show_progress=False)
                    before[name] = np.asarray(answer.values)
            lane.append(before["Lane"])
        return np.array(lane)

    def ours() -> FloatArray:
        return filter_beliefs(data.compiled, evidence, "assumed_density").lane

    start = time.perf_counter()
    expected = theirs()
    their_time = time.perf_counter() - start
    # Ours on the whole recording, per frame: on 200 frames nearly all of it is the call.
    whole = take_turns(
        {"ours": lambda: filter_beliefs(data.compiled, data.evidence, "assumed_density")}, rounds
    )
    return [
        Row(
            f"filter, assumed_density, {PGMPY_FRAMES} frames",
            whole["ours"] / len(data.log) * PGMPY_FRAMES,
            PGMPY_FRAMES,
            "pgmpy, VariableElimination frame by frame",
            their_time,
            largest_difference(ours(), expected),
        )
    ]


def reading_rows(data: Data, rounds: int) -> list[Row]:
    if data.read is None:
        return []
    times = take_turns({"ours": data.read}, max(3, rounds // 4))
    return [Row("reading the bag", times["ours"], len(data.log))]


def command_rows(data: Data, rounds: int) -> list[Row]:
    """Whole commands, each a new process; kernels are in the cache by then."""
    command = shutil.which("egolane", path=str(Path(sys.executable).parent))
    if command is None:
        print("no `egolane` command in this environment: its times are left out")
        return []
    rows = [Row("`egolane --help`", process_time([command, "--help"], 7))]
    if data.read is not None:
        with tempfile.TemporaryDirectory() as folder:
            out = str(Path(folder, "result"))
            words = [command, "run", str(EXPERIMENT), "--no-figures", "--out", out]
            rows.append(Row(f"`egolane run {EXPERIMENT} --no-figures`", process_time(words, 5)))
    return rows


def process_time(words: list[str], times: int) -> float:
    """The median wall time of a command, which is run once more before, in seconds."""
    measured = []
    for _ in range(times + 1):
        start = time.perf_counter()
        subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
        measured.append(time.perf_counter() - start)
    return median(measured[1:])
