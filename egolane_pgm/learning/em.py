"""EM: the most probable tables of a network, given the evidence, what is known of the hidden nodes,
and a Dirichlet prior around the tables that it starts from.

The prior of each row is Dirichlet(1 + strength * row). Its mode is the row itself, and it weighs as
much as `strength` frames. An entry that is above zero at the start stays above zero, however rarely
it is used; an entry that is zero is a statement about the structure and stays zero.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.inference.expected_counts import counted_tables, expected_counts
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray

#: The iterations end where the log posterior grows by less than this, nats per frame.
TOLERANCE = 1e-6

#: A row that is expected to be used less often than this keeps its start: its counts have lost
#: their digits.
_NOTHING = 1e-280

_SMALLEST = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Fitted:
    """What EM found.

    tables: those of `counted_tables`, learned or left as they were.
    log_posterior (I,): log evidence plus log prior (0 for the starting tables), before each
        iteration and after the last.
    is_impossible (T,): marks frames whose evidence, together with what is known, the tables do not
        allow.
    """

    tables: Mapping[SliceNode, Table]
    log_posterior: FloatArray
    is_impossible: BoolArray


def fit_tables(
    compiled: Compiled,
    tables: Sequence[Table],
    evidence: Evidence,
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
    *,
    nodes: Container[str] | None = None,
    strength: float = 100.0,
    iterations: int = 200,
) -> Fitted:
    """The most probable tables, by EM from `tables`.

    known, is_first: as `expected_counts`. nodes: whose tables are learned, default all that can
    be. strength: of the prior, frames per row. Raises InputError as `expected_counts`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> compiled = run.model.compiled
    >>> tables = list(compiled.tables.values())
    >>> fitted = ego.fit_tables(compiled, tables, run.evidence, iterations=3)
    >>> bool(fitted.log_posterior[-1] > fitted.log_posterior[0])
    True
    """
    start = counted_tables(compiled, tables)
    now = dict(start)
    history: list[float] = []
    enough = TOLERANCE * max(1, len(evidence))
    while True:
        changed = with_tables(compiled, with_changed(compiled, tables, now))
        expected = expected_counts(changed, evidence, known, is_first)
        history.append(expected.log_evidence + strength * _log_prior(start, now))
        is_still = len(history) > 1 and history[-1] - history[-2] <= enough
        if is_still or len(history) > iterations:
            return Fitted(now, np.array(history), expected.is_impossible)
        for node, table in start.items():
            if nodes is None or node[0] in nodes:
                rows = _most_probable(expected.counts[node], table.values, strength)
                now[node] = Table(node, table.parents, rows)


def with_changed(
    compiled: Compiled, tables: Sequence[Table], changed: Mapping[SliceNode, Table]
) -> list[Table]:
    """All tables, some of them changed; that of an observed node changes in both slices."""
    every = []
    for table in tables:
        name, s = table.node
        new = changed.get(table.node)
        place = compiled.places.get((name, 1))
        if s == 0 and (name, 1) in changed and place is not None and place.kind == "emission":
            later = changed[name, 1]
            new = Table(table.node, tuple((p, 0) for p, _ in later.parents), later.values)
        every.append(table if new is None else new)
    return every


def _most_probable(counts: FloatArray, start: FloatArray, strength: float) -> FloatArray:
    weight = counts + strength * start
    total = weight.sum(axis=-1, keepdims=True)
    is_used = total > _NOTHING
    rows = np.where(is_used, weight / np.where(is_used, total, 1.0), start)
    # What is allowed stays allowed, down to the smallest numbers there are.
    return np.where((start > 0) & (rows == 0), np.minimum(start, _SMALLEST), rows)


def _log_prior(start: Mapping[SliceNode, Table], now: Mapping[SliceNode, Table]) -> float:
    """The log prior of all tables for a strength of one frame: 0 for the starting tables, less for
    all others."""
    total = 0.0
    for node, table in start.items():
        old, new = table.values, now[node].values
        allowed = old > 0
        total += float((old[allowed] * np.log(new[allowed] / old[allowed])).sum())
    return total
