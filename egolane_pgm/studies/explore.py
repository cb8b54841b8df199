"""Search the edges of a graph: each structure is fitted and judged.

Two questions have two judges. Which edge helps the answer? A held-out score of the lane, after a
fit to the labels (`gradient_fit`). Which edge is in the data? BIC or held-out log evidence, after
EM. A graph fitted to the labels makes up for much of an edge that it lacks, so the answers differ.

The best of many candidates gains by chance, so a gain has to be larger than what chance gives the
best of them (`bootstrap.beyond_chance`).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
from numpy.typing import NDArray
from scipy.special import stdtrit

from egolane_pgm.drives import Drive, drive_key
from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.identity import data_files, digest, digest_of
from egolane_pgm.inference.compile import (
    Compiled,
    compile_tables,
    counted_tables,
    free_parameters,
    with_initial_lane,
)
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import Model, graph_in_memory, make_evidence, with_own_values
from egolane_pgm.scoring.bootstrap import (
    LEVEL,
    beyond_chance,
    block_gains,
    bootstrap_interval,
)
from egolane_pgm.scoring.scores import SCORES, Score
from egolane_pgm.studies.em import fit_tables, strength_of
from egolane_pgm.studies.fits import (
    drives_digest,
    joined,
    learnable_nodes,
    objective_of_learning,
    start_of_learning,
    strength_of_learning,
    training_of,
)
from egolane_pgm.studies.gradient_fit import fit_tables_to_known
from egolane_pgm.studies.objective import check_objective, drive_summands
from egolane_pgm.studies.search import make_sampler, quiet, settings_of
from egolane_pgm.studies.space import SearchSpace
from egolane_pgm.studies.structures import (
    NOT_REPEATED,
    REPEATED,
    Edge,
    Structure,
    edges_of,
    parse_edge,
    repetition_step,
    spelled,
    with_node,
    with_structure,
)
from egolane_pgm.studies.study import Fold, check_trained, everything, training_of_fold
from egolane_pgm.tools.files import make_directory, write_text, write_yaml
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.tools.kept import kept_tables
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import (
    Beliefs,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    problems_in,
)

#: The judges: any score of held-out frames, or BIC. The description of the gain by the name.
JUDGES = {
    **{name: f"gain in held-out {score.short_label} of Lane" for name, score in SCORES.items()},
    "log_loss": "gain in held-out log-loss of Lane, nats per frame",
    "log_evidence": "gain in held-out log evidence of the lines, nats per frame",
    "bic": "gain in BIC over all frames, nats per frame; it judges the lines",
}

#: The judges that need no ground truth.
_OF_LINES = ("log_evidence", "bic")

#: The largest number of numbers in a table.
MOST_NUMBERS = 2000

#: The largest number of parents of a node that an edge is added to.
MOST_PARENTS = 3

#: The largest number of steps of the fit of each structure.
ITERATIONS = 50


@dataclass(frozen=True)
class Problem:
    """The drives on which structures are judged, and the graph to start from.

    - model: with the graph to start from.
    - tables, hidden: of this graph, with new nodes.
    - drives, evidence: R recordings with the same number of lanes.
    - drive_ids: the number of each recording's drive; several detectors may have recorded one.
    - folds: held out in turn, in order; the last one has all frames and no test frames.
    - judge: one of JUDGES.
    - objective: log_loss or log_evidence, which structures are fitted to.
    - seed: of the start of new edges, and of the sampler.
    """

    model: Model
    tables: tuple[Table, ...]
    hidden: tuple[str, ...]
    drives: tuple[Drive, ...]
    evidence: tuple[Evidence, ...]
    drive_ids: tuple[int, ...]
    folds: tuple[Fold, ...]
    judge: str
    objective: str
    seed: int


@dataclass(frozen=True)
class Exploration:
    """The result of a search of edges.

    - edges: a row per candidate, the best first: `edge`, `change` (add or remove), `gain` alone
      (the mean over recordings of the mean over frames) with its 95 % interval over blocks of
      frames (`gain_low`, `gain_high`), the same over drives (`over_drives`, `_low` and `_high`,
      Student's t; empty for one drive), the number of drives in which it helps (`drives`), free
      parameters (`free_parameters`), whether the gain is more than chance gives the best of all
      candidates (`passes`), and in which share of the resamples it is (`selected`).
    - structures: a row per structure: `edges`, `score`, `free_parameters`, `log_evidence`, `bic`.
    - best: the edges in which the best structure differs from the start; none if nothing passes.
    - gain: of the best structure over the start: `changes` as text, else as in `edges`.
    - gains: of each edge that was added, alone, by parent, child and lag.
    - model: the best structure, fitted to all frames.
    - judge, objective: description of the gains, and what structures were fitted to.
    - by_chance: the gain that chance gives the best candidate; infinite for short recordings.
    - directory: output directory; None in memory.
    """

    edges: pd.DataFrame
    structures: pd.DataFrame
    best: Structure
    gain: Mapping[str, Any]
    gains: Mapping[tuple[str, str, int], float]
    model: Model
    judge: str
    objective: str
    by_chance: float
    directory: Path | None = None


def make_problem(
    drives: Sequence[Drive],
    folds: Sequence[Fold],
    *,
    judge: str | None = None,
    nodes: Sequence[str] = (),
    seed: int = 0,
) -> Problem:
    """Prepare a search over the edges of the graph of some drives.

    - judge: one of JUDGES; by default log_loss, or bic if `fit.objective` is log_evidence. The
      default of `fit.objective` fits the judge.
    - nodes: hidden nodes to add, with their numbers of values, e.g. `Occlusion=2`.

    Raises InputError for drives of different lanes, and for a judge without its data.
    """
    model = drives[0].model
    objective = objective_of_learning(model, of_lines=judge in _OF_LINES)
    judge = judge or ("log_loss" if objective == "log_loss" else "bic")
    check_objective(judge, "judge", JUDGES)
    if len({drive.model.n_lanes for drive in drives}) > 1:
        raise InputError("explore: the drives differ in n_lanes; explore them apart")
    if judge != "bic" and not folds:
        raise InputError(f"judge: {judge} needs held-out frames (folds); or take bic")
    is_scored = [(drive.true_lane[~drive.is_crossing] > 0).any() for drive in drives]
    if judge not in _OF_LINES and not all(is_scored):
        raise InputError(f"judge: {judge} needs ground truth; or take log_evidence or bic")
    for number, fold in enumerate(folds):
        check_trained(fold, number)
    learnable_nodes(model)
    start = start_of_learning(model).compiled
    tables = list(start.tables.values())
    hidden = list(start.hidden)
    for text in nodes:
        name, _, size = map(str.strip, text.partition("="))
        if not name or name in {*start.cardinality, *hidden} or size not in map(str, range(2, 100)):
            raise InputError(f"node: '{text}' is not NEW_NAME=SIZE, e.g. Occlusion=2")
        tables = with_node(tables, name, int(size))
        hidden = [*hidden, name]
    evidence = tuple(make_evidence(drive.model, drive.log)[0] for drive in drives)
    experiments = [drive.experiment for drive in drives]
    keys = [drive_key(e, list(map(digest, data_files(e)))) for e in experiments]
    # Several drives of one recording have the same key.
    names = [d.name if experiments.count(d.experiment) > 1 else "" for d in drives]
    ids, _ = pd.factorize(pd.Series(keys) + names)
    whole = Fold(everything(drives).train, tuple(np.zeros(0, dtype=int) for _ in drives))
    return Problem(
        model, tuple(tables), tuple(hidden), tuple(drives), evidence, tuple(ids.tolist()),
        (whole,) if judge == "bic" else (*folds, whole), judge, objective, seed,
    )  # fmt: skip


def candidates(problem: Problem) -> list[Edge]:
    """Return the edges that may be taken away, and those that may be added, if the network can be
    filtered with the change. Lane keeps its memory."""
    names = list(dict.fromkeys(table.node[0] for table in problem.tables))
    edges = [*edges_of(problem.tables)]
    for child in names:
        edges += [Edge(child, parent, lag) for parent in names for lag in (0, 1)]
        edges.append(Edge(child, child, 1, repeats=True))
    memory = Edge("Lane", "Lane", 1)
    return [e for e in dict.fromkeys(edges) if e != memory and is_allowed(problem, frozenset({e}))]


def is_allowed(problem: Problem, structure: Structure) -> bool:
    """Whether the network of a structure can be filtered."""
    with contextlib.suppress(InputError):
        return bool(made(problem, structure))
    return False


def made(problem: Problem, structure: Structure) -> tuple[Compiled, dict[SliceNode, FloatArray]]:
    """Make the network of a structure before the fit, and its tables without repetition.

    Raises InputError, naming the edges, for a network that cannot be filtered.
    """
    there = set(edges_of(problem.tables))
    with problems_in(f"edge '{spelled(structure, there)}'"):
        after = there ^ structure
        for edge in structure - there:
            if edge.repeats and replace(edge, repeats=False) in after:
                raise InputError(f"{edge.child} has a full table of its repetition")
            parents = [each.parent for each in after if each.child == edge.child]
            if len(parents) > MOST_PARENTS:
                raise InputError(f"{edge.child} has more than {MOST_PARENTS} parents")
            if not set(parents).isdisjoint(problem.model.compiled.inputs):
                raise InputError(f"no table that an input selects is fitted, as of {edge.child}")
        tables, bases = with_structure(
            problem.tables, structure, problem.seed,
            new=set(problem.hidden).difference(problem.model.compiled.hidden),
            rho=NOT_REPEATED if problem.objective == "log_loss" else REPEATED,
        )  # fmt: skip
        if (size := max(table.values.size for table in tables)) > MOST_NUMBERS:
            raise InputError(f"a table has {size} numbers, more than {MOST_NUMBERS}")
        start = problem.model.compiled
        compiled = compile_tables(
            tables, observed=start.observed, hidden=problem.hidden, inputs=start.inputs,
            values=start.values,
        )  # fmt: skip
    return compiled if start.start is None else with_initial_lane(compiled, start.start), bases


def fitted(problem: Problem, structure: Structure, fold: Fold) -> tuple[Compiled, int]:
    """Fit a structure to the training frames of a fold; return also its free parameters."""
    compiled, bases = made(problem, structure)
    options = problem.model.experiment.fit
    given = zip(problem.drives, problem.evidence, fold.train, strict=True)
    data = joined(
        [training_of(d, t, labels=options.labels, evidence=e) for d, e, t in given if len(t)]
    )
    strength = strength_of_learning(problem.model, problem.objective, compiled.cardinality)
    shared: Any = {"strength": strength, "iterations": ITERATIONS}
    if problem.objective == "log_loss":
        learned = fit_tables_to_known(compiled, data, block=options.block, bases=bases, **shared)
    else:
        steps = {n: repetition_step(base, strength_of(strength, n[0])) for n, base in bases.items()}
        learned = fit_tables(compiled, *data, steps=steps, **shared)
    compiled = learned.compiled
    return compiled, free_parameters(counted_tables(compiled), bases)


def judged(problem: Problem, task: tuple[tuple[Edge, ...], int]) -> pd.DataFrame:
    """Fit a structure to the training frames of a fold, and judge it.

    A fit to labels may be worse than none, and an edge then seems to help that only mends the fit:
    the graph to start from is judged with the tables that it declares if these score better.

    - task: the edges of a structure, sorted, and the number of the fold.

    Returns the summands of the judge in each test frame of each recording, zeros if the frame is
    crossing or not trusted; for BIC its share of each frame and 1, as of a mean, all recordings
    one after the other. In `attrs` the free parameters, the log evidence of all frames, and BIC:
    log evidence less half the logarithm of the number of frames for each free parameter.
    """
    structure = frozenset(task[0])
    fold = problem.folds[task[1]]
    compiled, numbers = fitted(problem, structure, fold)
    found = _judgement(problem, compiled, numbers, fold)
    if structure or problem.objective != "log_loss" or not any(map(len, fold.test)):
        return found
    declared = _judgement(problem, made(problem, structure)[0], numbers, fold)
    score = SCORES[problem.judge]
    after, before = (
        float(score.statistic(each.drop(columns="recording").sum().to_numpy()))
        for each in (found, declared)
    )
    return declared if (before > after) == score.is_maximised else found


def _judgement(problem: Problem, compiled: Compiled, numbers: int, fold: Fold) -> pd.DataFrame:
    """The judgement of a network, see `judged`. numbers: of its free parameters."""
    beliefs = [filter_beliefs(compiled, each) for each in problem.evidence]
    # The log evidence of EM includes the known lanes.
    log_evidence = sum(float(each.log_evidence.sum()) for each in beliefs)
    n_frames = sum(map(len, beliefs))
    bic = log_evidence - numbers / 2 * math.log(n_frames)
    if problem.judge == "bic":
        of_frames = np.concatenate([each.log_evidence for each in beliefs])
        shares = of_frames + (bic - log_evidence) / n_frames
        values = [np.stack([shares, np.ones(n_frames)], axis=1)]
    else:
        values = [*map(partial(_summands, problem.judge), problem.drives, beliefs, fold.test)]
    recording = np.repeat(np.arange(len(values)), [len(each) for each in values])
    table = pd.DataFrame(np.concatenate(values)).rename(columns=str).assign(recording=recording)
    table.attrs = {"free_parameters": numbers, "log_evidence": log_evidence, "bic": bic}
    return table


def _summands(judge: str, drive: Drive, beliefs: Beliefs, test: IntArray) -> NDArray[Any]:
    """The summands of a judge in the test frames of a drive."""
    is_used = np.zeros(len(drive), dtype=bool)
    is_used[test] = True
    is_used &= drive.is_trusted & ~drive.is_crossing[drive.rows]
    return drive_summands([drive], [beliefs.take(drive.rows)], [is_used], judge)[0][test]


class Tried:
    """The structures that were tried, kept on disk if there is a directory."""

    def __init__(self, problem: Problem, directory: Path | None, **shared: Any) -> None:
        self.problem = problem
        self.found = dict[tuple[Structure, int], pd.DataFrame]()
        self.folds = range(len(problem.folds))
        self.shared = shared
        if directory is not None:
            make_directory(directory)
        self.folder = None if directory is None else directory / "tried"
        whole = [np.arange(len(drive)) for drive in problem.drives]
        data = drives_digest(problem.drives, whole), problem.tables, problem.folds
        settings = problem.judge, problem.objective, problem.seed
        self.identity = digest_of(data, problem.hidden, settings)

    def __call__(self, structures: Iterable[Structure], folds: Sequence[int] = ()) -> None:
        """Judge structures in some folds, by default in all."""
        tasks = dict.fromkeys((each, fold) for each in structures for fold in folds or self.folds)
        new = [task for task in tasks if task not in self.found]
        items = [(tuple(sorted(structure)), fold) for structure, fold in new]
        keys = [digest_of(self.identity, list(map(str, edges)), fold) for edges, fold in items]

        def make(rows: list[int]) -> Iterator[pd.DataFrame]:
            left = [items[k] for k in rows]
            return parallel(partial(judged, self.problem), left, **self.shared)

        done = kept_tables(self.folder, keys, make)
        self.found.update(zip(new, bar(done, total=len(new), unit="fit"), strict=True))

    def complete(self) -> dict[Structure, dict[str, float]]:
        """The free parameters, log evidence and BIC of structures that were judged in all folds."""
        return {each: row.attrs for (each, k), row in self.found.items() if k == self.folds[-1]}

    def summands(self, structure: Structure) -> list[NDArray[Any]]:
        """The summands of `judged` in all folds so far, per recording."""
        found = [self.found[structure, k] for k in self.folds if (structure, k) in self.found]
        tables = pd.concat(found).set_index("recording").groupby(level=0)
        return [each.to_numpy() for _, each in tables]

    @property
    def judge(self) -> Score:
        """The score; BIC is a mean as the log evidence."""
        return SCORES.get(self.problem.judge, SCORES["log_evidence"])

    def scores(self, structure: Structure) -> FloatArray:
        """The score of each recording, turned so that larger is better."""
        sums = [each.sum(axis=0) for each in self.summands(structure)]
        scores = np.array([self.judge.statistic(each) for each in sums])
        return scores if self.judge.is_maximised else -scores

    def score(self, structure: Structure) -> float:
        """The mean over the recordings."""
        return float(np.mean(self.scores(structure)))

    def sides(self, structure: Structure, start: Structure) -> list[list[NDArray[Any]]]:
        """The summands of a structure and of another one, those that should be larger first."""
        found = [self.summands(structure), self.summands(start)]
        return found if self.judge.is_maximised else found[::-1]

    def gain(self, structure: Structure, start: Structure = frozenset()) -> dict[str, Any]:
        """The gain over another one with its paired intervals, as in `Exploration.edges`."""
        better, worse = self.sides(structure, start)
        ids = list(self.problem.drive_ids[: len(better)])
        found = bootstrap_interval(better, self.judge.statistic, minus=worse, seeds=ids)
        means = pd.Series(self.scores(structure) - self.scores(start)).groupby(ids).mean()
        half = stdtrit(len(means) - 1, (1 + LEVEL) / 2) * means.std() / math.sqrt(len(means))
        names = [name + end for name in ("gain", "over_drives") for end in ("", "_low", "_high")]
        over_drives = means.mean(), means.mean() - half, means.mean() + half
        row = dict(zip(names, (found.estimate, found.low, found.high, *over_drives), strict=True))
        mine, before = (self.complete()[each]["free_parameters"] for each in (structure, start))
        return {**row, "drives": int((means > 0).sum()), "free_parameters": mine - before}

    def tested(
        self, structures: Sequence[Structure], start: Structure
    ) -> tuple[float, FloatArray, FloatArray]:
        """The gain that chance gives the best structure, the gains, and in which share of resamples
        each is larger: `beyond_chance`."""
        gains = []
        for each in structures:
            better, worse = self.sides(each, start)
            ids = self.problem.drive_ids[: len(better)]
            gains.append(block_gains(better, worse, self.judge.statistic, ids))
        if not gains:
            return math.inf, np.zeros(0), np.zeros(0)
        least, selected = beyond_chance(np.array(gains))
        return least, np.array(gains).mean(axis=1), selected


def explore(
    problem: Problem,
    edges: Sequence[str] = (),
    *,
    trials: int = 0,
    sampler: str | optuna.samplers.BaseSampler | None = None,
    pruner: optuna.pruners.BasePruner | None = None,
    directory: Path | None = None,
    jobs: int = 1,
    cluster: str | None = None,
) -> Exploration:
    """Try each edge alone, then search the best set of edges.

    - edges: as `parse_edge` reads them, by default all candidates.
    - trials: 0 for a greedy search, which changes the edge that gains most, as long as there is one
      whose gain passes; otherwise the number of trials of an Optuna study with a switch per edge,
      of which the best set that passes is taken.
    - sampler: Optuna's, or a name as in `fit.sampler`, by default tpe.
    - pruner: Optuna's. A trial reports its mean score after each fold.
    - directory: of the results, and of all fits, which a repeated call reuses.

    Raises InputError for an edge with which the network cannot be filtered.
    """
    names = list(dict.fromkeys(table.node[0] for table in problem.tables))
    named = dict.fromkeys(parse_edge(each, names) for each in edges)
    for edge in named:
        made(problem, frozenset({edge}))
    alone = {edge: frozenset({edge}) for edge in named or candidates(problem)}
    pruner = pruner or optuna.pruners.NopPruner()
    study = _study(problem, list(alone), sampler, pruner)
    tried = Tried(problem, directory, jobs=jobs, cluster=cluster)
    start: Structure = frozenset()
    tried([start, *alone.values()])
    if trials:
        _optuna(tried, list(alone), study, trials)
        sets = [each for each in tried.complete() if each != start]
        best = _best(tried, sets, start)
    else:
        best = _greedy(tried, list(alone))
    there = edges_of(problem.tables)
    gains = {edge: tried.gain(structure) for edge, structure in alone.items()}
    least, gained, selected = tried.tested(list(alone.values()), start)
    rows: list[dict[str, Any]] = []
    for k, (edge, gain) in enumerate(gains.items()):
        row = {"edge": str(edge), "change": "remove" if edge in there else "add", **gain}
        passes = bool(gained[k] > least)
        rows.append({**row, "passes": passes, "selected": float(selected[k])})
    structures: list[dict[str, Any]] = [
        {"edges": spelled(each, there), "score": tried.score(each), **row}
        for each, row in tried.complete().items()
    ]
    changes = spelled(best, there)
    done = Exploration(
        pd.DataFrame(sorted(rows, key=lambda row: -row["gain"])),
        pd.DataFrame(sorted(structures, key=lambda row: -row["score"])),
        best,
        {"changes": changes, **tried.gain(best)},
        {(e.parent, e.child, e.lag): gains[e]["gain"] for e in best if e not in there},
        _model_of(problem, best),
        JUDGES[problem.judge],
        problem.objective,
        least,
        directory,
    )
    if directory is not None:
        write_text(directory / "edges.csv", done.edges.to_csv(index=False))
        write_text(directory / "structures.csv", done.structures.to_csv(index=False))
        about = {"description": f"edges chosen by {problem.judge}: {changes}"}
        graph = graph_in_memory(done.model, done.model.learned_from or "unknown")
        write_yaml(directory / "best.graph.yaml", {**about, **(graph.keys or {})})
    return done


def _model_of(problem: Problem, structure: Structure) -> Model:
    """The model of a structure, fitted to all trusted frames."""
    whole = everything(problem.drives)
    learned, _ = fitted(problem, structure, whole)
    trained = training_of_fold(problem.drives, whole)
    return with_own_values(replace(problem.model, compiled=learned), trained)


def _greedy(tried: Tried, edges: Sequence[Edge]) -> Structure:
    """Change the edge that gains most, as long as one passes."""
    now: Structure = frozenset()
    while True:
        further = [now | {edge} for edge in edges if edge not in now]
        allowed = [each for each in further if is_allowed(tried.problem, each)]
        tried(allowed)
        after = _best(tried, allowed, now)
        if after == now:
            return now
        now = after


def _best(tried: Tried, structures: Sequence[Structure], start: Structure) -> Structure:
    """The structure with the largest score of those whose gain passes, or else the start."""
    least, gained, _ = tried.tested(structures, start)
    better = [each for each, gain in zip(structures, gained, strict=True) if gain > least]
    return max(better, key=tried.score, default=start)


def _study(problem: Problem, edges: Sequence[Edge], sampler: Any, pruner: Any) -> optuna.Study:
    """Make a study with a switch per edge, all off in the first trial."""
    if sampler is None or isinstance(sampler, str):
        experiment = problem.model.experiment
        own = {"sampler": sampler or "tpe", "seed": problem.seed, "objective": ("log_loss",)}
        settings = settings_of(experiment.fit.model_copy(update=own), source=experiment.source)
        switch = optuna.distributions.CategoricalDistribution([False, True])
        sampler = make_sampler(settings, SearchSpace({str(e): switch for e in edges}, {}), 0)
    with quiet():
        study = optuna.create_study(direction="maximize", sampler=sampler, pruner=pruner)
        study.enqueue_trial({str(edge): False for edge in edges})
    return study


def _optuna(tried: Tried, edges: Sequence[Edge], study: optuna.Study, trials: int) -> None:
    """Search; prune a set of edges with which the network cannot be filtered."""

    def score(trial: optuna.Trial) -> float:
        on = frozenset(e for e in edges if trial.suggest_categorical(str(e), [False, True]))
        if not is_allowed(tried.problem, on):
            raise optuna.TrialPruned
        if isinstance(study.pruner, optuna.pruners.NopPruner):
            tried([on])
        for k in tried.folds:
            tried([on], [k])
            trial.report(tried.score(on), k)
            if trial.should_prune():
                raise optuna.TrialPruned
        return tried.score(on)

    with quiet():
        for _ in bar(range(trials), unit="trial"):
            study.optimize(score, n_trials=1)
