"""EM: the most probable tables of a network, given evidence, known values of hidden nodes and a
Dirichlet prior around the starting tables.

The prior of each row is Dirichlet(1 + strength * row). Its mode is the row itself, and it weighs as
much as `strength` frames. An entry that is above zero at the start stays above zero, however rarely
it is used; a zero is part of the structure and stays zero.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.inference.expected_counts import counted_tables, expected_counts
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray

#: The iterations end when the log posterior grows by less than this, nats per frame.
TOLERANCE = 1e-6

#: A row with a smaller expected count keeps its start: its counts have lost their digits.
_NEGLIGIBLE = 1e-280

_SMALLEST = float(np.finfo(np.float64).tiny)

#: The M step of a table in a form of its own: from its expected counts to its values and their log
#: prior, relative to the start.
Step = Callable[[FloatArray], tuple[FloatArray, float]]


@dataclass(frozen=True)
class LearnedTables:
    """The result of EM.

    - tables: `counted_tables`, learned or unchanged.
    - compiled: the network with these tables; `compiled.network` is the one of pgmpy.
    - log_posterior (I,): log evidence plus log prior (0 for the starting tables), before each
      iteration and after the last.
    - is_impossible (T,): marks frames whose evidence, together with the known values, has
      probability zero.
    """

    tables: Mapping[SliceNode, Table]
    compiled: Compiled
    log_posterior: FloatArray
    is_impossible: BoolArray


def fit_tables(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
    *,
    nodes: Container[str] | None = None,
    strength: float = 100.0,
    iterations: int = 200,
    steps: Mapping[SliceNode, Step] | None = None,
) -> LearnedTables:
    """Find the most probable tables by EM, starting from the tables of the compiled network.

    - evidence: T frames, of one recording or of several joined (`Evidence.joined`).
    - known, is_first: as `expected_counts`.
    - nodes: the nodes whose tables are learned; by default all that can be.
    - strength: of the prior, frames per row.
    - iterations: the largest number of iterations.
    - steps: the M steps of tables that have a form of their own.

    A node that has the same table in the first frame and later keeps one table. Raises InputError
    as `expected_counts`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> fitted = ego.fit_tables(run.model.compiled, run.evidence, iterations=3)
    >>> bool(fitted.log_posterior[-1] > fitted.log_posterior[0])
    True
    """
    start, steps = counted_tables(compiled), steps or {}
    free = {node: table for node, table in start.items() if node not in steps}
    now = dict(start)
    history: list[float] = []
    of_steps = dict.fromkeys(steps, 0.0)
    while True:
        learned = with_learned(compiled, now)
        expected = expected_counts(learned, evidence, known, is_first)
        log_prior = strength * _log_prior(free, now) + sum(of_steps.values())
        history.append(expected.log_evidence + log_prior)
        gain = history[-1] - history[-2] if len(history) > 1 else np.inf
        if gain <= TOLERANCE * max(1, len(evidence)) or len(history) > iterations:
            return LearnedTables(now, learned, np.array(history), expected.is_impossible)
        for node, step in steps.items():
            values, of_steps[node] = step(expected.counts[node])
            now[node] = Table(node, start[node].parents, values)
        for node, table in free.items():
            if nodes is None or node[0] in nodes:
                rows = _most_probable(expected.counts[node], table.values, strength)
                now[node] = Table(node, table.parents, rows)


def with_learned(compiled: Compiled, learned: Mapping[SliceNode, Table]) -> Compiled:
    """Replace `counted_tables` of a network; a node with one table has it in both slices."""
    first = [
        Table((name, 0), tuple((parent, 0) for parent, _ in table.parents), table.values)
        for (name, s), table in learned.items()
        if s == 1 and name in compiled.one_table
    ]
    return with_tables(compiled, [*first, *learned.values()])


def _most_probable(counts: FloatArray, start: FloatArray, strength: float) -> FloatArray:
    weight = counts + strength * start
    total = weight.sum(axis=-1, keepdims=True)
    is_used = total > _NEGLIGIBLE
    rows = np.where(is_used, weight / np.where(is_used, total, 1.0), start)
    # Allowed entries stay above zero, down to the smallest normal number.
    return np.where((start > 0) & (rows == 0), np.minimum(start, _SMALLEST), rows)


def _log_prior(start: Mapping[SliceNode, Table], now: Mapping[SliceNode, Table]) -> float:
    """The log prior of all tables for a strength of one frame, relative to the starting tables."""
    total = 0.0
    for node, table in start.items():
        old, new = table.values, now[node].values
        allowed = old > 0
        total += float((old[allowed] * (np.log(new[allowed]) - np.log(old[allowed]))).sum())
    return total
