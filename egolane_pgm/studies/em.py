"""EM: the most probable tables of a network, given the evidence, what is known of the hidden nodes,
and a Dirichlet prior around the tables that it starts from.

The prior of each row is Dirichlet(1 + strength * row). Its mode is the row itself, and it weighs as
much as `strength` frames. An entry that is above zero at the start stays above zero, however rarely
it is used; an entry that is zero is a statement about the structure and stays zero.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, declare
from egolane_pgm.graphs.from_pgmpy import read_network
from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.inference.expected_counts import Expected, counted_tables, expected_counts
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

#: The iterations end where the log posterior grows by less than this, nats per frame.
TOLERANCE = 1e-6

#: A row that is expected to be used less often than this keeps its start: its counts have lost
#: their digits.
_NOTHING = 1e-280

_SMALLEST = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Training:
    """What the tables are learned from in one recording.

    - evidence: T frames.
    - known, is_first: as `expected_counts`.
    """

    evidence: Evidence
    known: Mapping[str, IntArray] = field(default_factory=dict)
    is_first: BoolArray | None = None


@dataclass(frozen=True)
class Fitted:
    """What EM found.

    tables: those of `counted_tables`, learned or left as they were.
    compiled: the network with these tables.
    log_posterior (I,): log evidence plus log prior (0 for the starting tables), before each
        iteration and after the last.
    is_impossible (T,): marks frames whose evidence, together with what is known, the tables do not
        allow; of several recordings one behind the other.
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
) -> Fitted:
    """The most probable tables, by EM from those of the compiled network.

    - known, is_first: as `expected_counts`.
    - nodes: whose tables are learned, by default all that can be.
    - strength: of the prior, frames per row.

    A node that has the same table in the first frame and later keeps one table. Raises InputError
    as `expected_counts`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> fitted = ego.fit_tables(run.model.compiled, run.evidence, iterations=3)
    >>> bool(fitted.log_posterior[-1] > fitted.log_posterior[0])
    True
    """
    training = [Training(evidence, known or {}, is_first)]
    return fit_tables_pooled(
        compiled, training, nodes=nodes, strength=strength, iterations=iterations
    )


def fit_tables_pooled(
    compiled: Compiled,
    training: Sequence[Training],
    *,
    nodes: Container[str] | None = None,
    strength: float = 100.0,
    iterations: int = 200,
) -> Fitted:
    """As `fit_tables`, from several recordings.

    Their expected counts are added, so the tables are those of the recordings one behind the
    other, each with its own beginning. Beyond `training` it takes the memory of the longest one.
    """
    start = counted_tables(compiled)
    now = dict(start)
    history: list[float] = []
    enough = TOLERANCE * max(1, sum(len(each.evidence) for each in training))
    while True:
        learned = with_learned(compiled, now)
        expected = _expected(learned, training)
        history.append(expected.log_evidence + strength * _log_prior(start, now))
        is_still = len(history) > 1 and history[-1] - history[-2] <= enough
        if is_still or len(history) > iterations:
            return Fitted(now, learned, np.array(history), expected.is_impossible)
        for node, table in start.items():
            if nodes is None or node[0] in nodes:
                rows = _most_probable(expected.counts[node], table.values, strength)
                now[node] = Table(node, table.parents, rows)


def _expected(compiled: Compiled, training: Sequence[Training]) -> Expected:
    """The expected counts of all recordings, added in their order."""
    each = [expected_counts(compiled, one.evidence, one.known, one.is_first) for one in training]
    return Expected(
        {node: np.sum([one.counts[node] for one in each], axis=0) for node in each[0].counts},
        sum(one.log_evidence for one in each),
        np.concatenate([one.is_impossible for one in each]),
    )


def with_learned(compiled: Compiled, learned: Mapping[SliceNode, Table]) -> Compiled:
    """The network with some of its `counted_tables` changed; of a node that has one table, that of
    the first frame as well."""
    first = [
        Table((name, 0), tuple((parent, 0) for parent, _ in table.parents), table.values)
        for (name, s), table in learned.items()
        if s == 1 and compiled.has_one_table(name)
    ]
    return with_tables(compiled, [*first, *learned.values()])


def learned_network(
    network: DynamicBayesianNetwork, learned: Fitted | Compiled
) -> DynamicBayesianNetwork:
    """A network of pgmpy with what was learned in its tables: a new network of both slices in full,
    with the names of nodes and values of the old one.

    - network: what was compiled; it stays as it is.
    - learned: what `fit_tables` gave, or any network that was compiled from this one.

    Raises InputError, naming the node, where the tables belong to another network.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> fitted = ego.fit_tables(run.model.compiled, run.evidence, iterations=3)
    >>> network = ego.learned_network(run.model.network, fitted)
    >>> print(network, network.check_model())
    DynamicBayesianNetwork with 12 nodes and 12 edges True
    """
    compiled = learned if isinstance(learned, Compiled) else learned.compiled
    declared = read_network(network)
    for node, table in compiled.tables.items():
        own = declared.tables.get(node)
        has_parents = own is not None and {*own.parents} == {*table.parents}
        if own is None or not has_parents or own.values.size != table.values.size:
            raise InputError(f"{node[0]}: the network has no such table; is it what was compiled?")
    return declare({**declared.tables, **compiled.tables}.values(), (), declared.values)


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
        total += float((old[allowed] * (np.log(new[allowed]) - np.log(old[allowed]))).sum())
    return total
