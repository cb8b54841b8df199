"""Conditional probability tables with named axes, and their declaration as a pgmpy network.

Tables are written as in the paper: the parents' values select the row, the node's values are the
columns. So `values` has one axis per parent, in the order of `parents`, and the node's axis last.
A node of a slice is the pair (name, slice): slice 0 is time t, slice 1 is time t + 1.
"""

from __future__ import annotations

import contextlib
import logging
import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import FloatArray, InputError, Observed

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

SliceNode = tuple[str, int]

VE_SUFFIX = "_ve"


def discretised_normal(
    mean: float,
    sigma: float,
    n: int,
    normal: str = "density",
    widths: Sequence[float] | None = None,
) -> FloatArray:
    """F(N(mean, sigma^2)) over lanes 1..n, (n,), summing to one (section "HMM with Transient
    Failure Model").

    mean, sigma: in lanes. normal: "density" takes the density at the lane centres (what the
    authors computed), "integral" the integral across each lane (what the text describes).
    widths: (n,) lane widths in units of the nominal lane, default all 1; lane 1 starts at 0.5,
    so that with equal widths the centres are 1..n.
    """
    edges, centres = lane_edges(n, widths)
    if normal == "density":
        return _density(centres - mean, sigma)
    distance = np.maximum(0.0, np.maximum(edges[:-1] - mean, mean - edges[1:]))
    # A tiny sigma overflows to infinitely many standard deviations, which is what is meant.
    with np.errstate(over="ignore"):
        z = (edges - mean) / sigma / math.sqrt(2.0)
    # Near the mean the difference of erf, far from it that of the tails on the lane's
    # side: small masses keep their digits both ways.
    middle = np.diff([math.erf(v) for v in z])
    right = -np.diff([math.erfc(v) for v in z])
    left = np.diff([math.erfc(-v) for v in z])
    mass = np.where(z[:-1] > 0.5, right, np.where(z[1:] < -0.5, left, middle))
    return _normalised(mass, distance)


def _density(offset: FloatArray, sigma: float) -> FloatArray:
    """The density at some offsets from the mean, (..., n) lanes, summing to one."""
    with np.errstate(over="ignore", invalid="ignore"):
        exponent = -0.5 * (offset / sigma) ** 2
        mass = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
    return _normalised(mass, offset)


def _normalised(mass: FloatArray, offset: FloatArray) -> FloatArray:
    """Masses (..., n) that sum to one; where all are zero (or NaN: infinitely many standard
    deviations from every lane) the limit, all on the nearest lane."""
    total = mass.sum(axis=-1, keepdims=True)
    if not (total > 0).all():
        distance = np.abs(offset)
        nearest = distance == distance.min(axis=-1, keepdims=True)
        mass = np.where(total > 0, mass, nearest)
        total = mass.sum(axis=-1, keepdims=True)
    return np.asarray(mass / total, dtype=np.float64)


def lane_edges(n: int, widths: Sequence[float] | None = None) -> tuple[FloatArray, FloatArray]:
    """Edges (n + 1,) and centres (n,) of the lanes, in units of the nominal lane, from 0.5 on."""
    widths_array = np.ones(n) if widths is None else np.asarray(widths, dtype=np.float64)
    edges = 0.5 + np.concatenate([[0.0], np.cumsum(widths_array)])
    return edges, (edges[:-1] + edges[1:]) / 2


def lane_normals(
    sigma: float, n: int, normal: str = "density", widths: Sequence[float] | None = None
) -> FloatArray:
    """Row i: F of a normal around the centre of lane i + 1; (n, n), rows sum to one."""
    _, centres = lane_edges(n, widths)
    if normal == "density":
        return _density(centres - centres[:, None], sigma)
    return np.stack([discretised_normal(c, sigma, n, normal, widths) for c in centres])


def binary(ok: float, bad: float) -> FloatArray:
    """[[ok, 1 - ok], [1 - bad, bad]]: how well OK and BAD are kept (Tables `tab:cptsensor`,
    `tab:cptri`)."""
    return np.array([[ok, 1 - ok], [1 - bad, bad]])


def uniform(*shape: int) -> FloatArray:
    """Uniform over the last axis."""
    return np.full(shape, 1.0 / shape[-1])


@dataclass(frozen=True)
class Table:
    """P(node | parents): values (*cardinalities of the parents, cardinality of the node)."""

    node: SliceNode
    parents: tuple[SliceNode, ...]
    values: FloatArray

    def __post_init__(self) -> None:
        # A search makes thousands per second: the usual case costs two passes, NaN fails it too.
        if self.values.ndim == len(self.parents) + 1:
            off = np.abs(self.values.sum(axis=-1) - 1).max()
            if self.values.min() >= 0 and off <= 1e-9:
                return
        name = f"P({_spell(self.node)} | {', '.join(map(_spell, self.parents)) or 'nothing'})"
        if self.values.ndim != len(self.parents) + 1:
            raise InputError(
                f"{name}: the table has {self.values.ndim} axes, needs {len(self.parents) + 1}:"
                " one per parent and the node's own"
            )
        if not np.isfinite(self.values).all() or (self.values < 0).any():
            raise InputError(f"{name}: the table has a negative or NaN entry")
        raise InputError(f"{name}: the rows of the table must sum to one")


def _spell(node: SliceNode) -> str:
    return f"{node[0]} at t" if node[1] == 0 else f"{node[0]} at t+1"


def previous(name: str) -> SliceNode:
    """The node in the slice before, as a parent in `dynamics`."""
    return (name, 0)


def prior(name: str, values: ArrayLike, given: Sequence[str] = ()) -> list[Table]:
    """P(name in the first frame | given in the first frame)."""
    parents = tuple((g, 0) for g in given)
    return [Table((name, 0), parents, np.asarray(values, dtype=np.float64))]


def dynamics(name: str, given: Sequence[str | SliceNode], values: ArrayLike) -> list[Table]:
    """P(name at t+1 | given): `previous(x)` is x at t, a plain name is the node at t+1."""
    parents = tuple((g, 1) if isinstance(g, str) else g for g in given)
    return [Table((name, 1), parents, np.asarray(values, dtype=np.float64))]


def within(name: str, given: Sequence[str], values: ArrayLike) -> list[Table]:
    """P(name | given in the same slice), the same table in both slices."""
    array = np.asarray(values, dtype=np.float64)
    return [Table((name, s), tuple((g, s) for g in given), array) for s in (0, 1)]


def ve_name(observed: Observed) -> str:
    """The name of the virtual-evidence node of an observed node or tuple."""
    return (observed if isinstance(observed, str) else "+".join(observed)) + VE_SUFFIX


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """pgmpy's warnings, log lines and progress bars, kept from the user's terminal."""
    logger = logging.getLogger("pgmpy")
    level = logger.level
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logger.setLevel(logging.CRITICAL)
        try:
            from pgmpy.global_vars import config

            shown = config.get_show_progress()
            config.set_show_progress(False)
            try:
                yield
            finally:
                config.set_show_progress(shown)
        finally:
            logger.setLevel(level)


def declare(tables: Iterable[Table], observed: Iterable[Observed]) -> DynamicBayesianNetwork:
    """The pgmpy network of these tables, both slices in full, with a virtual-evidence child for
    each observed node or tuple (its table is a placeholder: 1/2 everywhere).

    Raises InputError naming the nodes where a table does not fit its parents.
    """
    with quiet():
        import networkx as nx
        from pgmpy.factors.discrete import TabularCPD
        from pgmpy.models import DynamicBayesianNetwork
        from pgmpy.models.DynamicBayesianNetwork import DynamicNode

        tables = list(tables)
        cardinality: dict[SliceNode, int] = {}
        for table in tables:
            if table.node in cardinality:
                raise InputError(f"{_spell(table.node)}: there are two tables for it")
            cardinality[table.node] = table.values.shape[-1]
        for table in tables:
            for parent, size in zip(table.parents, table.values.shape, strict=False):
                if parent not in cardinality:
                    raise InputError(
                        f"{_spell(table.node)} has the parent {_spell(parent)},"
                        " for which there is no table"
                    )
                if cardinality[parent] != size:
                    raise InputError(
                        f"{_spell(table.node)}: its table has {size} rows for"
                        f" {_spell(parent)}, which has {cardinality[parent]} values"
                    )
        for target in observed:
            names = (target,) if isinstance(target, str) else target
            for name in names:
                if (name, 0) not in cardinality:
                    raise InputError(f"observed node {name}: there is no table for it")
            sizes = [cardinality[name, 0] for name in names]
            tables += within(ve_name(target), names, np.full((*sizes, 2), 0.5))
        network = DynamicBayesianNetwork()
        network.add_nodes_from(dict.fromkeys(t.node[0] for t in tables))
        edges = {(parent, table.node) for table in tables for parent in table.parents}
        for table in tables:
            for parent in table.parents:
                if parent[1] == table.node[1] == 1:
                    # pgmpy mirrors an edge inside slice 0 into slice 1, so both need it.
                    if ((parent[0], 0), (table.node[0], 0)) not in edges:
                        raise InputError(
                            f"{_spell(table.node)} depends on {_spell(parent)}, but"
                            f" {table.node[0]} in the first frame does not: give its prior the"
                            " same parent"
                        )
                else:
                    _add_edge(network, parent, table.node)
        for parent, child in sorted(edges):
            if parent[1] == child[1] == 0 and ((parent[0], 1), (child[0], 1)) not in edges:
                raise InputError(
                    f"{_spell(child)} depends on {_spell(parent)}, but {child[0]} at t+1 does not"
                    f" depend on {parent[0]} at t+1: give its dynamics the same parent"
                )
        for table in tables:
            if table.node[1] == 1:
                # pgmpy gives a node its second slice only with an edge there.
                nx.DiGraph.add_node(network, DynamicNode(*table.node))
            # pgmpy wants the node's axis first, the parents' combinations as columns.
            columns = table.values.reshape(-1, table.values.shape[-1]).T
            network.add_cpds(
                TabularCPD(
                    table.node,
                    len(columns),
                    columns,
                    evidence=list(table.parents),
                    evidence_card=list(table.values.shape[:-1]),
                )
            )
        return network


def _add_edge(network: DynamicBayesianNetwork, parent: SliceNode, child: SliceNode) -> None:
    try:
        network.add_edge(parent, child)
    except (ValueError, NotImplementedError) as error:
        raise InputError(f"{_spell(child)} cannot depend on {_spell(parent)}: {error}") from error
