"""The tables of an experiment's graph, learned from its recording by EM (`em`).

What is found is kept by name, as parameters are: `tables.Lane.first` and `tables.Lane.next` of a
node with another table in the first frame than later, `tables.WOR` of a node with one table. The
numbers of a table stand in one row, with the axes in the order of
`expected_counts.counted_tables`, the last one fastest.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from egolane_pgm.drive import Drive, evidence_on
from egolane_pgm.experiment import Experiment, Learning
from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.expected_counts import FREE, counted_tables
from egolane_pgm.learning.em import Training, fit_tables_pooled, with_learned
from egolane_pgm.model import Model, with_parameters
from egolane_pgm.parameters import Parameter, Value, resolve_parameters
from egolane_pgm.plugins import declared_parameters, plugin_errors
from egolane_pgm.types import BoolArray, InputError, IntArray, suggestion

#: What the name of a learned table begins with.
PREFIX = "tables."

#: What it ends with where the node has two tables, by slice.
_SUFFIXES = (".first", ".next")


def learning_of(experiment: Experiment) -> Learning:
    """The experiment's `learning`, or the defaults."""
    return experiment.learning or Learning()


def check_tables(model: Model, experiment: Experiment) -> dict[SliceNode, Table]:
    """The tables that are learned, with the values that learning starts from. Raises InputError for
    a graph that has none, and for a node in `learning.tables` without one."""
    source = experiment.source
    open_ = {
        node: table
        for node, table in counted_tables(starting(model, experiment).compiled).items()
        if not np.isin(table.values, (0.0, 1.0)).all()
    }
    if not open_:
        raise InputError(
            f"{source}: the evidence rule {experiment.evidence} cannot be learned, nor can the"
            f" graph {experiment.graph}: each of its tables is certain or selected by an input;"
            " search parameters with `egolane tune`"
        )
    wanted = learning_of(experiment).tables
    if wanted is None:
        return open_
    names = {name for name, _ in open_}
    if not wanted:
        raise InputError(
            f"{source}: learning.tables: names no table; leave it out to learn all of"
            f" {', '.join(sorted(names))}"
        )
    for name in wanted:
        if name not in names:
            raise InputError(
                f"{source}: learning.tables: '{name}' has no table to learn"
                f"{suggestion(name, names)}"
            )
    return {node: table for node, table in open_.items() if node[0] in wanted}


def free_numbers(tables: Mapping[SliceNode, Table]) -> int:
    """Count the numbers in some tables that are free: zeros stay zero, and rows sum to one."""
    return sum(
        int(np.maximum(np.count_nonzero(table.values > 0, axis=-1) - 1, 0).sum())
        for table in tables.values()
    )


def training_in(drive: Drive, train: IntArray) -> Training:
    """What tables are learned from in the annotated frames `train` of a drive and the frames
    between them; without ground truth in the frames `train` of the log.

    With `learning.labels` the lane of a frame is known from its label, except in crossing frames.
    """
    recorded = drive.recorded
    used = training_frames(drive.rows, train, len(recorded.log))
    lane = np.full(len(recorded.log), FREE, dtype=np.int64)
    if learning_of(drive.experiment).labels:
        labelled = train[~drive.truth.is_crossing[train]]
        lane[recorded.scored[labelled]] = drive.truth.lane[labelled] - 1
    # Of the whole log: a rule may look at the frames before.
    evidence = evidence_on(drive, drive.model).filtered.take(used)
    is_first = np.diff(np.flatnonzero(used), prepend=-2) > 1
    return Training(evidence, {"Lane": lane[used]}, is_first)


def fit_graph(
    model: Model, experiment: Experiment, training: Sequence[Training]
) -> dict[str, Value]:
    """The tables learned from one recording, or from several pooled.

    Warns of a lane without a label, which keeps its first guess, of frames that the graph does not
    allow, and of what `seen_before` lists.
    """
    notes = seen_before(model, experiment)
    options = learning_of(experiment)
    if options.labels:
        lanes = {lane for each in training for lane in np.unique(each.known["Lane"]).tolist()}
        notes += [
            f"{experiment.source}: no frame to learn from has lane {k + 1}; it keeps its first"
            " guess"
            for k in range(experiment.n_lanes)
            if k not in lanes
        ]
    start = starting(model, experiment).compiled
    fitted = fit_tables_pooled(
        start,
        training,
        nodes={name for name, _ in check_tables(model, experiment)},
        strength=options.strength,
        iterations=options.iterations,
    )
    impossible = int(fitted.is_impossible.sum())
    if impossible == len(fitted.is_impossible):
        raise InputError(
            f"{experiment.source}: none of the {impossible} frames to learn from can be under graph"
            f" {experiment.graph}, evidence and label together, so there is nothing to learn;"
            " do the evidence rule and the graph fit together?"
        )
    if impossible:
        notes.append(
            f"{experiment.source}: {impossible} frame(s) to learn from cannot be under graph"
            f" {experiment.graph}, evidence and label together; both are left out there"
        )
    if len(fitted.log_posterior) > options.iterations:
        notes.append(
            f"{experiment.source}: learning stopped after {options.iterations} iterations, before"
            " it stood still; learning.iterations allows more"
        )
    for note in notes:
        warnings.warn(note, UserWarning, stacklevel=2)
    return {
        name: tuple(table.values.ravel().tolist())
        for name, table in _by_name(start, fitted.tables).items()
    }


def training_frames(rows: IntArray, train: IntArray, n_frames: int) -> BoolArray:
    """Marks (T,) the annotated frames that are learned from, and each frame without annotation
    whose annotated neighbours are both among them.

    rows (K,): which of the T frames are annotated.
    train: indices into rows.
    n_frames: T.
    """
    is_train = np.zeros(len(rows), dtype=bool)
    is_train[train] = True
    before = np.searchsorted(rows, np.arange(n_frames), side="right") - 1
    after = np.searchsorted(rows, np.arange(n_frames), side="left")
    return is_train[np.maximum(before, 0)] & is_train[np.minimum(after, len(rows) - 1)]


def with_found(model: Model, found: Mapping[str, Value], experiment: Experiment) -> Model:
    """Put what a fit found, parameters, tables or both, into a model."""
    tables = {name: value for name, value in found.items() if name.startswith(PREFIX)}
    parameters = {name: value for name, value in found.items() if name not in tables}
    if parameters:
        values = _resolved(model, parameters, experiment)
        of_graph = {p.name for p in getattr(model.graph, "PARAMETERS", ())}
        is_of_graph = bool(of_graph & set(parameters))
        model = with_parameters(model, values) if is_of_graph else replace(model, parameters=values)
    if tables:
        start = starting(model, experiment).compiled
        learned = {
            table.node: replace(table, values=np.reshape(tables[name], table.values.shape))
            for name, table in _by_name(start, counted_tables(start)).items()
            if name in tables
        }
        model = replace(model, compiled=with_learned(start, learned))
    return model


def starting(model: Model, experiment: Experiment) -> Model:
    """The model with the tables that learning starts from; see `seen_before`."""
    reset = {p.name: p.default for p in _reset(model, experiment)}
    parameters = _resolved(model, reset, experiment)
    with plugin_errors(model.graph, f"{experiment.source}: graph"):
        return replace(with_parameters(model, parameters), parameters=model.parameters)


def nested_tables(model: Model, found: Mapping[str, Value]) -> dict[str, Any]:
    """The tables among what was found, as nested lists."""
    nested = {}
    for (name, s), table in model.compiled.tables.items():
        for key in (f"{PREFIX}{name}", f"{PREFIX}{name}{_SUFFIXES[s]}"):
            if key in found:
                nested[key] = np.reshape(found[key], table.values.shape).tolist()
    return nested


def seen_before(model: Model, experiment: Experiment) -> list[str]:
    """Notes for a reader of held-out scores, where the experiment's parameters were, or may have
    been, tuned on the frames that are learned from.

    Learning then starts from the defaults of the graph's parameters. Parameters of the evidence
    rule, and tables that stand in the graph as numbers, are kept as they are.
    """
    if experiment.tuned_on not in ("same_frames", "unknown"):
        return []
    where = f"{experiment.source}: tuned_on {experiment.tuned_on}"
    changed = [p.name for p in _reset(model, experiment) if model.parameters[p.name] != p.default]
    kept = [
        p.name
        for p in getattr(model.rule, "PARAMETERS", ())
        if p.is_searched and model.parameters[p.name] != p.default
    ]
    notes = []
    if changed:
        notes.append(f"{where}: learning starts from the defaults of {', '.join(changed)}")
    if kept:
        notes.append(
            f"{where}: {', '.join(kept)} of the evidence rule is kept as given, so held-out scores"
            " may have seen the frames that they are about"
        )
    if experiment.tuned_on == "same_frames" and not _reset(model, experiment):
        notes.append(
            f"{where}: graph {experiment.graph} has no parameters with defaults to start from, so"
            " held-out scores have seen the frames that they are about"
        )
    return notes


def _reset(model: Model, experiment: Experiment) -> list[Parameter]:
    """The graph's parameters that begin from their defaults."""
    if experiment.tuned_on not in ("same_frames", "unknown"):
        return []
    return [p for p in getattr(model.graph, "PARAMETERS", ()) if p.is_searched]


def _resolved(model: Model, given: Mapping[str, Value], experiment: Experiment) -> dict[str, Value]:
    return resolve_parameters(
        declared_parameters(model.rule, model.graph),
        {**model.parameters, **given},
        model.n_lanes,
        f"{experiment.source}: parameters",
    )


def _by_name(compiled: Compiled, tables: Mapping[SliceNode, Table]) -> dict[str, Table]:
    return {
        f"{PREFIX}{name}{'' if compiled.has_one_table(name) else _SUFFIXES[s]}": table
        for (name, s), table in tables.items()
    }
