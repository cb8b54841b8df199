"""EM: the most probable tables of a network, given evidence and known values of hidden nodes.

The prior of each row of a table is Dirichlet(1 + strength * row). Its mode is the row itself, and
it weighs as much as `strength` frames. An entry that is above zero at the start stays above zero,
however rarely it is used; a zero is part of the structure and stays zero.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled, counted_tables, takes_any_model, with_tables
from egolane_pgm.inference.expected_counts import expected_counts
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray

#: The iterations end when the log posterior grows by less than this, nats per frame.
TOLERANCE = 1e-6

#: A row with a smaller expected count keeps its start: its counts have lost their digits.
_NEGLIGIBLE = 1e-280

#: Nodes with more values are not searched for values with the same tables.
_FEW = 10

_SMALLEST = float(np.finfo(np.float64).tiny)

#: The prior's weight, frames per row, of tables for which no other one is given.
STRENGTH = 100.0

#: The M step of a table in a form of its own: from its expected counts to its values and their log
#: prior, relative to the start.
Step = Callable[[FloatArray], tuple[FloatArray, float]]

#: Evidence, known values and the beginnings of sequences, as `expected_counts` takes them.
Data = tuple[Evidence, Mapping[str, IntArray], BoolArray | None]

#: The M step of a network: from the expected counts of its tables to the network and its log prior.
Maximise = Callable[[Mapping[SliceNode, FloatArray]], tuple[Compiled, float]]


@dataclass(frozen=True)
class Learned:
    """The result of EM or of `gradient_fit`.

    - compiled: the network with its learned tables; `compiled.network` is the one of pgmpy.
    - log_posterior (I,): log evidence plus log prior (0 for the declared tables), before each
      iteration and after the last; of `gradient_fit` the log-loss per block in place of the log
      evidence, with the other sign, at the start and at the end.
    - is_impossible (T,): marks frames whose evidence, together with the known values, has
      probability zero.
    - numbers (D,): of tied parameters, by `gradient_fit`. draws (K, D): of their posterior.
    """

    compiled: Compiled
    log_posterior: FloatArray
    is_impossible: BoolArray
    numbers: FloatArray = field(default_factory=lambda: np.zeros(0))
    draws: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def tables(self) -> dict[SliceNode, Table]:
        """The `counted_tables`, learned or unchanged."""
        return counted_tables(self.compiled)


def iterate(
    compiled: Compiled,
    log_prior: float,
    data: Data,
    maximise: Maximise,
    iterations: int,
) -> Learned:
    """Run EM from a network and its log prior until the log posterior hardly grows."""
    history: list[float] = []
    while True:
        expected = expected_counts(compiled, *data)
        history.append(expected.log_evidence + log_prior)
        gain = history[-1] - history[-2] if len(history) > 1 else np.inf
        if gain <= TOLERANCE * max(1, len(data[0])) or len(history) > iterations:
            return Learned(compiled, np.array(history), expected.is_impossible)
        compiled, log_prior = maximise(expected.counts)


@takes_any_model
def fit_tables(
    compiled: Compiled,
    evidence: Evidence,
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
    *,
    nodes: Container[str] | None = None,
    strength: float | Mapping[str, float] = STRENGTH,
    iterations: int = 200,
    steps: Mapping[SliceNode, Step] | None = None,
    start: Mapping[SliceNode, Table] | None = None,
) -> Learned:
    """Find the most probable tables by EM, starting from the tables of the compiled network.

    - evidence: T frames, of one recording or of several joined (`Evidence.concat`).
    - known, is_first: as `expected_counts`.
    - nodes: the nodes whose tables are learned; by default all that can be.
    - strength: of the prior, frames per row; by name of the node if they differ (100 for others).
    - iterations: the largest number of iterations.
    - steps: the M steps of tables that have a form of their own.
    - start: tables to start from instead; the prior stays around those of the network.

    A node that has the same table in the first frame and later keeps one table. Warns of values
    that have the same tables, which EM cannot tell apart. Raises InputError as `expected_counts`,
    and for a negative strength.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> fitted = ego.fit_tables(run.model.compiled, run.evidence, iterations=3)
    >>> bool(fitted.log_posterior[-1] > fitted.log_posterior[0])
    True
    """
    weights = strength.values() if isinstance(strength, Mapping) else (strength,)
    if not all(0 <= weight < np.inf for weight in weights):
        raise InputError(f"strength: {strength} is not a number of frames, 0 or more")
    declared, steps = counted_tables(compiled), steps or {}
    free = {node: table for node, table in declared.items() if node not in steps}
    now = {**declared, **(start or {})}
    for name in set(compiled.hidden).difference(known or (), compiled.observed):
        if twins := _same_values({**compiled.tables, **now}, name):
            first, second = (compiled.values[name][k] for k in twins)
            note = f"{name}: {first} and {second} have the same tables, so EM cannot tell them"
            warnings.warn(f"{note} apart; give it others (start)", UserWarning, stacklevel=2)
    of_steps = dict.fromkeys(steps, 0.0)

    def current() -> tuple[Compiled, float]:
        log_prior = sum(
            strength_of(strength, node[0]) * _log_ratio(table, now[node])
            for node, table in free.items()
        )
        return with_learned(compiled, now), log_prior + sum(of_steps.values())

    def maximise(counts: Mapping[SliceNode, FloatArray]) -> tuple[Compiled, float]:
        for node, step in steps.items():
            values, of_steps[node] = step(counts[node])
            now[node] = Table(node, declared[node].parents, values)
        for node, table in free.items():
            if nodes is None or node[0] in nodes:
                weight = strength_of(strength, node[0])
                rows = _most_probable(counts[node], table.values, weight)
                now[node] = Table(node, table.parents, rows)
        return current()

    return iterate(*current(), (evidence, known or {}, is_first), maximise, iterations)


def _same_values(tables: Mapping[SliceNode, Table], name: str) -> tuple[int, int] | None:
    """Return two values of a node that can be exchanged in all tables, or None."""
    n_values = tables[name, 0].values.shape[-1]
    for pair in combinations(range(n_values), 2) if n_values <= _FEW else ():
        order = np.arange(n_values)
        order[[*pair]] = order[[*pair[::-1]]]
        exchanged = True
        for table in tables.values():
            values = table.values
            for axis, (other, _) in enumerate((*table.parents, table.node)):
                values = values.take(order, axis) if other == name else values
            exchanged &= np.array_equal(values, table.values)
        if exchanged:
            return pair
    return None


def strength_of(strength: float | Mapping[str, float], node: str) -> float:
    """The prior's weight for a node, frames per row."""
    return strength.get(node, STRENGTH) if isinstance(strength, Mapping) else strength


def drawn_tables(
    declared: Mapping[SliceNode, Table], rng: np.random.Generator
) -> dict[SliceNode, Table]:
    """Tables to start from: means of the declared rows and random ones; zeros stay zero."""
    drawn = {}
    for node, table in declared.items():
        rows = rng.exponential(size=table.values.shape) * (table.values > 0)
        rows /= rows.sum(axis=-1, keepdims=True)
        drawn[node] = Table(node, table.parents, (table.values + rows) / 2)
    return drawn


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


def _log_ratio(declared: Table, now: Table) -> float:
    """The log prior of a table for a strength of one frame, relative to the declared table."""
    old, new = declared.values, now.values
    allowed = old > 0
    return float((old[allowed] * (np.log(new[allowed]) - np.log(old[allowed]))).sum())
