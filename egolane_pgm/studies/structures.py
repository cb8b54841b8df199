"""Structures of a graph: edges that are added to its tables or taken away.

A new parent repeats the rows of a table, so that the network does not change before it is fitted;
small random factors let the values of a new hidden node differ. Without a parent a table is the
mean over it. A node that repeats itself has the compact form

    P(x | x before, parents) = rho [x = x before] + (1 - rho) P(x | parents)

with one number instead of a full table of all values before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, dynamics, previous, prior, sticky, uniform
from egolane_pgm.studies.em import Step
from egolane_pgm.types import FloatArray, InputError

#: Random factors of the rows of a new edge are between 1 and 1 plus this.
_JITTER = 0.2

#: The share of repetition before a fit by gradient, and before EM, which hardly leaves a small one.
NOT_REPEATED = 1e-3
REPEATED = 0.5

#: The probability of a new node to stay in its first state, before the fit.
_STAYS = 0.9


@dataclass(frozen=True, order=True)
class Edge:
    """An edge from parent to child.

    - lag: 0 within a frame, 1 from the frame before.
    - repeats: the compact form of an edge from a node to itself.
    """

    child: str
    parent: str
    lag: int
    repeats: bool = False

    def __str__(self) -> str:
        if self.repeats:
            return f"{self.child} repeats itself"
        return f"{self.parent}{'(t-1)' if self.lag else ''} -> {self.child}"


#: The edges in which a graph differs from the one it starts from.
Structure = frozenset[Edge]


def spelled(structure: Structure, there: Collection[Edge]) -> str:
    """Return the changes as text. there: the edges of the graph to start from."""
    return ", ".join(f"{'without ' * (e in there)}{e}" for e in sorted(structure)) or "none"


def edges_of(tables: Iterable[Table]) -> list[Edge]:
    """Return the edges into later frames, which hold in the first frame as far as they can."""
    return [
        Edge(table.node[0], parent, 1 - s)
        for table in tables
        if table.node[1] == 1
        for parent, s in table.parents
    ]


def parse_edge(text: str, nodes: Iterable[str]) -> Edge:
    """Read an edge as `str` writes it. Raises InputError, naming it, for another text."""
    parent, arrow, child = (part.strip() for part in text.partition("->"))
    edge = Edge(child, parent.removesuffix("(t-1)").strip(), int(parent.endswith("(t-1)")))
    if not arrow and text.strip().endswith(" repeats itself"):
        name = text.strip().removesuffix(" repeats itself")
        edge = Edge(name, name, 1, True)
    for name in (edge.parent, edge.child):
        if name not in nodes:
            raise InputError(
                f"edge '{text}': no node '{name}'; write 'Lane -> WOR', 'Lane(t-1) -> WOR' or"
                f" 'WOR repeats itself', of {', '.join(nodes)}"
            )
    return edge


def with_node(tables: Sequence[Table], name: str, size: int) -> list[Table]:
    """Add a hidden node without edges to others, which keeps its value for about ten frames."""
    rows = sticky(*np.linspace(_STAYS, (_STAYS + 1) / 2, size))
    return [*tables, *prior(name, uniform(size)), *dynamics(name, [previous(name)], rows)]


def with_structure(
    tables: Sequence[Table],
    structure: Structure,
    seed: int,
    *,
    new: Collection[str] = (),
    rho: float = NOT_REPEATED,
) -> tuple[list[Table], dict[SliceNode, FloatArray]]:
    """Return the tables with some edges changed, and the tables that repeat, without repetition.

    - structure: edges that the tables have are taken away, others are added.
    - new: hidden nodes that the graph did not have, whose edges get random factors.
    - rho: the share of repetition in the compact form.
    """
    there, rng = set(edges_of(tables)), np.random.default_rng(seed)
    found, bases = {table.node: table for table in tables}, {}
    # Repetition follows the other changes.
    for edge in sorted(structure, key=lambda each: (each not in there, each.repeats, each)):
        shape = [found[name, 1].values.shape[-1] for name in (edge.parent, edge.child)]
        # The same random numbers for both slices.
        factors = rng.uniform(
            1, 1 + _JITTER * (not {edge.parent, edge.child}.isdisjoint(new)), shape
        )
        for s in range(edge.lag, 2):
            node, parent = (edge.child, s), (edge.parent, s - edge.lag)
            parents, values = found[node].parents, found[node].values
            if edge in there:
                values = values.mean(axis=parents.index(parent))
                parents = tuple(each for each in parents if each != parent)
            else:
                parents = (*parents, parent)
                if edge.repeats:
                    bases[node] = values
                    values = repetition(values, rho)
                else:
                    values = values[..., None, :] * factors
                    values /= values.sum(axis=-1, keepdims=True)
            found[node] = Table(node, parents, values)
    return list(found.values()), bases


def repetition(base: FloatArray, rho: float) -> FloatArray:
    """Return the compact form (..., n, n) of a table (..., n): the value before is the last
    parent."""
    n = base.shape[-1]
    return np.asarray(rho * np.eye(n) + (1 - rho) * base[..., None, :])


def repetition_step(base: FloatArray, strength: float) -> Step:
    """Make the M step of a table in the compact form.

    - base (..., n): the table without repetition at the start.
    - strength: of its prior, frames per row.
    """
    now = base
    rho = REPEATED

    def step(counts: FloatArray) -> tuple[FloatArray, float]:
        nonlocal now, rho
        full = repetition(now, rho)
        same = rho * np.eye(base.shape[-1])
        share = np.divide(same, full, out=np.zeros_like(full), where=full > 0)
        repeated = float((counts * share).sum())
        rho = repeated / max(float(counts.sum()), 1e-300)
        own = (counts * (1 - share)).sum(axis=-2) + strength * base
        total = own.sum(axis=-1, keepdims=True)
        now = np.where(total > 0, own / np.where(total > 0, total, 1), base)
        allowed = base > 0
        ratio = np.log(np.maximum(now[allowed], 1e-300)) - np.log(base[allowed])
        return repetition(now, rho), strength * float((base[allowed] * ratio).sum())

    return step
