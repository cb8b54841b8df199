"""Which edge helps? Search the edges of a graph, each structure fitted by EM and judged.

The judges `log_loss` and `accuracy` look at Lane in held-out frames, `log_evidence` at the lines of
held-out frames, `bic` at the lines of all frames. Log evidence and BIC say how well a graph
describes the lines; on the recordings of the paper they ranked graphs nearly opposite to the
held-out lanes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd

from egolane_pgm.drives import Drive
from egolane_pgm.graphs.cpds import Table
from egolane_pgm.inference.compile import Compiled, compile_tables, with_initial_lane
from egolane_pgm.inference.expected_counts import counted_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import Model, make_evidence, training_key
from egolane_pgm.scoring.bootstrap import Interval, bootstrap_interval
from egolane_pgm.scoring.confusion import assigned_lane, log_loss_per_frame
from egolane_pgm.studies.em import fit_tables
from egolane_pgm.studies.fits import learnable_nodes, start_of_learning, training_of
from egolane_pgm.studies.graph_file import graph_yaml
from egolane_pgm.studies.structures import (
    Edge,
    Structure,
    edges_of,
    free_numbers,
    repetition_step,
    with_node,
    with_structure,
)
from egolane_pgm.studies.study import Fold, everything
from egolane_pgm.tools.files import make_directory, write_yaml
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import Evidence, FloatArray, InputError

#: The judges, and what each one says.
JUDGES = {
    "log_loss": "gain in held-out log-loss of Lane, nats per frame",
    "accuracy": "gain in held-out accuracy of Lane",
    "log_evidence": "gain in held-out log evidence of the lines, nats per frame; it ranked graphs"
    " nearly opposite to held-out lanes",
    "bic": "gain in BIC over all frames, nats per frame; it judges the lines, and ranked graphs"
    " nearly opposite to held-out lanes",
}

#: Structures whose tables have more numbers than this are not tried.
MOST_NUMBERS = 2000

#: The largest number of EM steps for each structure.
ITERATIONS = 50


@dataclass(frozen=True)
class Problem:
    """What structures are tried on.

    - model: the graph to start from.
    - tables: of the graph to start from, with new nodes.
    - hidden: the hidden nodes.
    - drives: of the same number of lanes.
    - evidence: of each drive.
    - folds: held out in turn.
    - judge: one of JUDGES.
    - seed: of the start of new edges.
    """

    model: Model
    tables: tuple[Table, ...]
    hidden: tuple[str, ...]
    drives: tuple[Drive, ...]
    evidence: tuple[Evidence, ...]
    folds: tuple[Fold, ...]
    judge: str
    seed: int


@dataclass(frozen=True)
class Judged:
    """A structure, fitted.

    - values: per drive the value of each annotated frame (K,) under the judge, larger is better;
      NaN in crossing frames.
    - numbers: free numbers of its tables.
    - log_evidence: of all frames, with the fit to them, natural logarithm.
    - bic: log evidence less half the logarithm of the number of frames for each free number.
    """

    values: tuple[FloatArray, ...]
    numbers: int
    log_evidence: float
    bic: float

    @property
    def mean(self) -> float:
        """The mean over drives of the mean over frames."""
        return float(np.mean([np.nanmean(each) for each in self.values]))


@dataclass(frozen=True)
class Exploration:
    """The answer to "which edge helps?".

    - edges: a row per candidate, the best first: `edge`, `change` (add or remove), `gain` alone,
      its 95 % interval over blocks of frames of all drives (`low`, `high`), the number of drives in
      which it helps (`drives`), free numbers (`numbers`), and in how many of the searches it was
      chosen (`chosen`).
    - structures: a row per structure that was tried: `edges`, `score`, `numbers`, `log_evidence`,
      `bic`.
    - best: the edges in which the best structure differs from the start.
    - gain: of the best structure over the start, with its interval.
    - model: the best structure, fitted to all frames.
    - judge: one of JUDGES.
    - directory: where it is saved; None in memory.
    """

    edges: pd.DataFrame
    structures: pd.DataFrame
    best: Structure
    gain: Interval
    model: Model
    judge: str
    directory: Path | None = None

    def save(self, directory: Path) -> None:
        """Write edges.csv, structures.csv and the best graph, best.graph.yaml."""
        make_directory(directory)
        self.edges.to_csv(directory / "edges.csv", index=False)
        self.structures.to_csv(directory / "structures.csv", index=False)
        content = graph_yaml(self.model, f"edges chosen by {self.judge}: {self.changes}")
        write_yaml(directory / "best.graph.yaml", content)

    @property
    def gains(self) -> dict[tuple[str, str, int], float]:
        """What each edge that was added gains alone, by parent, child and lag."""
        alone = self.edges[self.edges["change"] == "add"].set_index("edge")["gain"]
        added = [edge for edge in self.best if str(edge) in alone]
        return {(e.parent, e.child, e.lag): float(alone[str(e)]) for e in added}

    @property
    def meaning(self) -> str:
        """What the judge says."""
        return JUDGES[self.judge]

    @property
    def changes(self) -> str:
        """The edges in which the best structure differs from the start, as text."""
        return ", ".join(map(str, sorted(self.best))) or "none"


def make_problem(
    drives: Sequence[Drive],
    folds: Sequence[Fold],
    *,
    judge: str = "log_loss",
    nodes: Sequence[tuple[str, int]] = (),
    seed: int = 0,
) -> Problem:
    """Prepare a search over the edges of the graph of some drives.

    - nodes: hidden nodes to add, with their numbers of values.

    Raises InputError for drives of different lanes, and for a judge without its data.
    """
    model = drives[0].model
    if judge not in JUDGES:
        raise InputError(f"judge: '{judge}' is not one of {', '.join(JUDGES)}")
    if len({drive.model.n_lanes for drive in drives}) > 1:
        raise InputError("explore: the drives differ in n_lanes; explore them apart")
    if judge != "bic" and not folds:
        raise InputError(f"judge: {judge} needs held-out frames (folds); without them take bic")
    if judge in ("log_loss", "accuracy") and not all(drive.has_truth for drive in drives):
        raise InputError(f"judge: {judge} needs ground truth; without it take log_evidence or bic")
    learnable_nodes(model)
    start = start_of_learning(model).compiled
    tables = list(start.tables.values())
    for name, size in nodes:
        if name in start.cardinality or size < 2:
            raise InputError(f"node {name}={size}: needs a new name and two values or more")
        tables = with_node(tables, name, size)
    hidden = (*start.hidden, *(name for name, _ in nodes))
    evidence = tuple(make_evidence(drive.model, drive.log)[0] for drive in drives)
    return Problem(model, tuple(tables), hidden, tuple(drives), evidence, tuple(folds), judge, seed)


def candidates(problem: Problem, most_parents: int = 3) -> list[Edge]:
    """Return the edges that may be added, and those that may be taken away.

    Inputs get no parents and Lane keeps its memory. An edge is left out if its child had more than
    `most_parents` parents, or if the network could not be compiled.
    """
    names = list(dict.fromkeys(table.node[0] for table in problem.tables))
    inputs = problem.model.compiled.inputs
    there = edges_of(problem.tables)
    found = [edge for edge in there if edge != Edge("Lane", "Lane", 1)]
    for child in names:
        if child in inputs:
            continue
        n_parents = sum(edge.child == child for edge in there)
        for parent in names:
            for lag in (0, 1):
                edge = Edge(child, parent, lag)
                is_loop = lag == 0 and parent == child
                if not is_loop and edge not in there:
                    found.append(edge)
        if Edge(child, child, 1) not in there:
            found.append(Edge(child, child, 1, repeats=True))
        if n_parents >= most_parents:
            found = [edge for edge in found if edge.child != child or edge in there]
    return [edge for edge in found if compiled_of(problem, frozenset({edge})) is not None]


def compiled_of(problem: Problem, structure: Structure) -> Compiled | None:
    """Return the network of a structure before the fit; None if it is none that can be filtered."""
    both_forms = {edge.child for edge in structure if edge.repeats} & {
        edge.child for edge in structure if edge.parent == edge.child and not edge.repeats
    }
    # EM does not learn tables that an input selects.
    of_input = any(edge.parent in problem.model.compiled.inputs for edge in structure)
    tables, _ = with_structure(problem.tables, structure, problem.seed)
    if both_forms or of_input or max(table.values.size for table in tables) > MOST_NUMBERS:
        return None
    start = problem.model.compiled
    try:
        compiled = compile_tables(
            tables, observed=start.observed, hidden=problem.hidden, inputs=start.inputs,
            values=start.values,
        )  # fmt: skip
    except InputError:
        return None
    return compiled if start.start is None else with_initial_lane(compiled, start.start)


def fitted(problem: Problem, structure: Structure, fold: Fold) -> tuple[Compiled, float, int, int]:
    """Fit a structure to the training frames of a fold.

    Returns the network, the log evidence of the training frames, their number, and the number of
    free numbers.
    """
    compiled = compiled_of(problem, structure)
    if compiled is None:
        changed = ", ".join(map(str, sorted(structure)))
        raise InputError(f"explore: {changed}: no network that can be filtered")
    _, bases = with_structure(problem.tables, structure, problem.seed)
    options = problem.model.experiment.fit
    parts = [
        training_of(drive, train, labels=options.labels, evidence=evidence)
        for drive, evidence, train in zip(problem.drives, problem.evidence, fold.train, strict=True)
        if len(train)
    ]
    evidence, lanes, begins = zip(*parts, strict=True)
    joined, is_first = Evidence.concat(evidence), np.concatenate(begins)
    learned = fit_tables(
        compiled, joined, {"Lane": np.concatenate(lanes)}, is_first,
        strength=options.strength, iterations=ITERATIONS,
        steps={node: repetition_step(base, options.strength) for node, base in bases.items()},
    )  # fmt: skip
    log_evidence = filter_beliefs(learned.compiled, joined, is_first=is_first).log_evidence
    numbers = free_numbers(counted_tables(learned.compiled), bases)
    return learned.compiled, float(log_evidence.sum()), len(joined), numbers


def judged(problem: Problem, structure: Structure) -> Judged:
    """Fit and judge a structure."""
    whole = everything(problem.drives)
    _, log_evidence, n_frames, numbers = fitted(problem, structure, whole)
    bic = log_evidence - numbers / 2 * math.log(n_frames)
    values = [np.full(len(drive), np.nan) for drive in problem.drives]
    if problem.judge == "bic":
        values = [np.full(len(drive), bic / n_frames) for drive in problem.drives]
    for fold in problem.folds if problem.judge != "bic" else ():
        compiled, *_ = fitted(problem, structure, fold)
        for k, (drive, evidence) in enumerate(zip(problem.drives, problem.evidence, strict=True)):
            if len(fold.test[k]):
                values[k][fold.test[k]] = _judge(problem, drive, evidence, compiled)[fold.test[k]]
    for drive, value in zip(problem.drives, values, strict=True):
        value[drive.is_crossing[drive.rows]] = np.nan
    return Judged(tuple(values), numbers, log_evidence, bic)


def _judge(problem: Problem, drive: Drive, evidence: Evidence, compiled: Compiled) -> FloatArray:
    """Return the value of each annotated frame (K,)."""
    beliefs, rows = filter_beliefs(compiled, evidence), drive.rows
    if problem.judge == "log_evidence":
        return np.asarray(beliefs.log_evidence[rows])
    lane, true = beliefs.lane[rows], drive.true_lane[rows]
    if problem.judge == "log_loss":
        return -log_loss_per_frame(lane, true)
    return np.asarray(assigned_lane(lane) == true, dtype=np.float64)


def gain_of(found: Judged, start: Judged) -> Interval:
    """Return the gain of a structure over another one, with its paired interval."""
    pairs = zip(found.values, start.values, strict=True)
    counts = [
        np.stack([np.nan_to_num(a - b), (~np.isnan(a)).astype(np.float64)], axis=1)
        for a, b in pairs
    ]
    return bootstrap_interval(counts, lambda sums: np.asarray(sums[..., 0] / sums[..., 1], float))


class _Tried:
    """The structures that were tried, kept on disk if there is a directory."""

    def __init__(
        self, problem: Problem, jobs: int, cluster: str | None, directory: Path | None
    ) -> None:
        from joblib import Memory

        self.problem, self.jobs, self.cluster = problem, jobs, cluster
        self.found: dict[Structure, Judged] = {}
        memory = Memory(None if directory is None else directory / "tried", verbose=0)
        self.judge: Callable[[Structure], Judged] = partial(memory.cache(judged), problem)

    def __call__(self, structures: Sequence[Structure]) -> None:
        new = [each for each in dict.fromkeys(structures) if each not in self.found]
        done = parallel(self.judge, new, jobs=self.jobs, cluster=self.cluster)
        counted = bar(done, total=len(new), unit="graph")
        for each, result in zip(new, counted, strict=True):
            self.found[each] = result


def explore(
    problem: Problem,
    edges: Sequence[Edge],
    *,
    trials: int = 0,
    searches: int = 1,
    most_parents: int = 3,
    directory: Path | None = None,
    jobs: int = 1,
    cluster: str | None = None,
) -> Exploration:
    """Try each edge alone, then search the best set of edges.

    - edges: the candidates.
    - trials: 0 for a greedy search, which adds the best edge as long as one helps; otherwise the
      number of trials of an Optuna study in which each edge is on or off.
    - searches: with another seed each; `chosen` counts over them.
    - directory: structures that were tried are kept there, so that a repeated call goes on.
    """
    for edge in edges:
        if compiled_of(problem, frozenset({edge})) is None:
            raise InputError(
                f"edge '{edge}': with it the graph has a circle, or more joint states or numbers"
                " than can be filtered, or a table that an input selects and EM does not learn"
            )
    chosen: list[Structure] = []
    for k in range(max(1, searches)):
        tried = _Tried(replace(problem, seed=problem.seed + k), jobs, cluster, directory)
        start: Structure = frozenset()
        tried([start, *(frozenset({edge}) for edge in edges)])
        search = partial(_optuna, trials=trials) if trials else _greedy
        chosen.append(search(tried, edges, most_parents=most_parents))
        if k == 0:
            first = tried
    rows = [_edge_row(first, edge, chosen) for edge in edges]
    table = pd.DataFrame(rows).sort_values("gain", ascending=False, ignore_index=True)
    structures = pd.DataFrame(
        [
            {
                "edges": ", ".join(map(str, sorted(structure))),
                "score": each.mean,
                "numbers": each.numbers,
                "log_evidence": each.log_evidence,
                "bic": each.bic,
            }
            for structure, each in first.found.items()
        ]
    ).sort_values("score", ascending=False, ignore_index=True)
    best, nothing = chosen[0], first.found[frozenset()]
    compiled, *_ = fitted(problem, best, everything(problem.drives))
    origin = training_key(drive.experiment for drive in problem.drives)
    model = replace(problem.model, compiled=compiled, learned_from=origin)
    gain = gain_of(first.found[best], nothing)
    done = Exploration(table, structures, best, gain, model, problem.judge, directory)
    if directory is not None:
        done.save(directory)
    return done


def _edge_row(tried: _Tried, edge: Edge, chosen: Sequence[Structure]) -> dict[str, Any]:
    alone, start = tried.found[frozenset({edge})], tried.found[frozenset()]
    gain = gain_of(alone, start)
    per_drive = [np.nanmean(a - b) for a, b in zip(alone.values, start.values, strict=True)]
    return {
        "edge": str(edge),
        "change": "remove" if edge in edges_of(tried.problem.tables) else "add",
        "gain": gain.estimate,
        "low": gain.low,
        "high": gain.high,
        "drives": int(np.sum(np.array(per_drive) > 0)),
        "numbers": alone.numbers - start.numbers,
        "chosen": sum(edge in each for each in chosen),
    }


def _greedy(tried: _Tried, edges: Sequence[Edge], *, most_parents: int) -> Structure:
    """Change the edge that gains most, as long as the mean gain is positive."""
    now: Structure = frozenset()
    while True:
        allowed = [
            now | {edge}
            for edge in edges
            if edge not in now and _is_allowed(tried.problem, now | {edge}, most_parents)
        ]
        tried(allowed)
        best = max(allowed, key=lambda each: tried.found[each].mean, default=now)
        if best == now or tried.found[best].mean <= tried.found[now].mean:
            return now
        now = best


def _optuna(tried: _Tried, edges: Sequence[Edge], *, trials: int, most_parents: int) -> Structure:
    """Search with each edge on or off; a set that is no network is pruned."""
    problem = tried.problem
    sampler = optuna.samplers.TPESampler(seed=problem.seed, multivariate=True)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    study.enqueue_trial({str(edge): False for edge in edges})

    def score(trial: optuna.Trial) -> float:
        on = frozenset(e for e in edges if trial.suggest_categorical(str(e), [False, True]))
        if not _is_allowed(problem, on, most_parents):
            raise optuna.TrialPruned
        tried([on])
        return tried.found[on].mean

    for _ in bar(range(trials), unit="trial"):
        study.optimize(score, n_trials=1)
    return frozenset(edge for edge in edges if study.best_params[str(edge)])


def _is_allowed(problem: Problem, structure: Structure, most_parents: int) -> bool:
    tables, _ = with_structure(problem.tables, structure, problem.seed)
    before = {table.node: len(table.parents) for table in problem.tables}
    grown = [table for table in tables if len(table.parents) > before[table.node]]
    few = all(len(table.parents) <= most_parents for table in grown)
    return few and compiled_of(problem, structure) is not None
