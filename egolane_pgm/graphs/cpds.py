"""Conditional probability tables with named axes, and their declaration as a pgmpy network.

Tables are written as in the paper: the parents' values select the row, the columns are the node's
values. The array of a table has one axis per parent, in order, and the node's axis last. A node of
a slice is the pair (name, slice): slice 0 is time t, slice 1 is time t + 1.

>>> import egolane_pgm as ego
>>> ego.cpds.uniform(4)
array([0.25, 0.25, 0.25, 0.25])
"""

from __future__ import annotations

import contextlib
import graphlib
import logging
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import FloatArray, InputError, Observed

if TYPE_CHECKING:
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.models import DiscreteBayesianNetwork, DynamicBayesianNetwork

SliceNode = tuple[str, int]

#: The end of the name of a virtual-evidence node.
VE_SUFFIX = "_ve"


def lane_normals(sigma: float, n: int) -> FloatArray:
    """Return the paper's F(N(mean, sigma^2)), (n, n): a row per mean, which is lane 1 to n.

    F is the density at the lane centres divided by its sum over the lanes, as the authors computed
    it; the text of section "HMM with Transient Failure Model" describes the integral across each
    lane.

    - sigma: standard deviation, lanes
    """
    lanes = np.arange(1.0, n + 1)
    distance = np.abs(lanes - lanes[:, None])
    with np.errstate(over="ignore"):
        squares = (distance / sigma) * (distance / sigma)
    mass = np.exp(-0.5 * squares)
    return np.asarray(mass / mass.sum(axis=1, keepdims=True))


def normal_cdf(x: FloatArray) -> FloatArray:
    """Return the cumulative distribution function of the standard normal, of the shape of x."""
    # Importing scipy.special takes longer than most runs spend in it.
    values = [0.5 * math.erfc(-each / math.sqrt(2.0)) for each in x.flat]
    return np.array(values).reshape(x.shape)


def binary(ok: float, bad: float) -> FloatArray:
    """Return [[ok, 1 - ok], [1 - bad, bad]]: P(OK | OK) is `ok`, P(BAD | BAD) is `bad` (Tables
    `tab:cptsensor`, `tab:cptri`)."""
    return np.array([[ok, 1 - ok], [1 - bad, bad]])


def sticky(*stay: float) -> FloatArray:
    """Return a table (k, k): value i stays with probability `stay[i]`, else all others are equally
    likely."""
    k = len(stay)
    return np.stack([np.where(np.arange(k) == i, p, (1 - p) / (k - 1)) for i, p in enumerate(stay)])


def uniform(*shape: int) -> FloatArray:
    """Return an array of this shape that is uniform over its last axis."""
    return np.full(shape, 1.0 / shape[-1])


@dataclass(frozen=True)
class Table:
    """P(node | parents).

    values: one axis per parent, in the order of `parents`, and the node's axis last.

    Raises InputError, naming node and parents, if an axis is missing, an entry is negative or NaN,
    or a row does not sum to one.
    """

    node: SliceNode
    parents: tuple[SliceNode, ...]
    values: FloatArray

    def __post_init__(self) -> None:
        # Quick, because a search builds thousands of tables per second; NaN fails both comparisons.
        n_axes = len(self.parents) + 1
        if self.values.ndim != n_axes:
            has = f"the table has {self.values.ndim} axes, needs {n_axes}"
            problem = f"{has}: one per parent and the node's own"
        elif not self.values.min() >= 0:
            problem = "the table has a negative or NaN entry"
        elif not np.abs(self.values.sum(axis=-1) - 1).max() <= 1e-9:
            problem = "the rows of the table must sum to one"
        else:
            return
        given = ", ".join(map(spell, self.parents)) or "nothing"
        raise InputError(f"P({spell(self.node)} | {given}): {problem}")


def spell(node: SliceNode) -> str:
    """Return a node of a slice as messages name it."""
    return f"{node[0]} at t" if node[1] == 0 else f"{node[0]} at t+1"


def previous(name: str) -> SliceNode:
    """Return the node at time t, as a parent in `dynamics`."""
    return (name, 0)


def prior(name: str, values: ArrayLike, given: Sequence[str] = ()) -> list[Table]:
    """Return P(name in the first frame | given in the first frame)."""
    parents = tuple((node, 0) for node in given)
    return [Table((name, 0), parents, np.asarray(values, dtype=np.float64))]


def dynamics(name: str, given: Sequence[str | SliceNode], values: ArrayLike) -> list[Table]:
    """Return P(name at t+1 | given). In `given`, `previous(x)` is x at t, a plain name x at t+1."""
    parents = tuple((node, 1) if isinstance(node, str) else node for node in given)
    return [Table((name, 1), parents, np.asarray(values, dtype=np.float64))]


def within(name: str, given: Sequence[str], values: ArrayLike) -> list[Table]:
    """Return P(name | given in the same slice), a table for each of the two slices."""
    array = np.asarray(values, dtype=np.float64)
    return [*prior(name, array, given), *dynamics(name, given, array)]


def ve_name(observed: Observed) -> str:
    """Return the name of the virtual-evidence node of an observed node or tuple."""
    return (observed if isinstance(observed, str) else "+".join(observed)) + VE_SUFFIX


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence pgmpy's warnings and log lines."""
    logger = logging.getLogger("pgmpy")
    level = logger.level
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logger.setLevel(logging.CRITICAL)
        try:
            yield
        finally:
            logger.setLevel(level)


def declare(
    tables: Iterable[Table],
    observed: Iterable[Observed],
    values: Mapping[str, Sequence[str]] | None = None,
) -> DynamicBayesianNetwork:
    """Declare the tables as a pgmpy network with both slices in full.

    - observed: nodes, or tuples of nodes observed jointly. Each gets a binary child `<name>_ve` for
      virtual evidence, whose table is a placeholder (1/2 everywhere); `unrolled` gives frames whose
      tables hold their evidence
    - values: the names of each node's values (pgmpy's state names), by default numbers from 0

    Raises InputError as `check_tables`.
    """
    tables = list(tables)
    check_tables(tables)
    cardinality = {table.node: table.values.shape[-1] for table in tables}
    for target in observed:
        names = (target,) if isinstance(target, str) else target
        sizes = [cardinality[name, 0] for name in names]
        tables += within(ve_name(target), names, np.full((*sizes, 2), 0.5))
    with quiet():
        from pgmpy.models import DynamicBayesianNetwork
        from pgmpy.models.DynamicBayesianNetwork import DynamicNode

        network = DynamicBayesianNetwork()
        network.add_nodes_from(dict.fromkeys(t.node[0] for t in tables))
        for table in tables:
            for parent in table.parents:
                # pgmpy copies an edge inside slice 0 into slice 1.
                if not parent[1] == table.node[1] == 1:
                    network.add_edge(parent, table.node)
        for table in tables:
            if table.node[1] == 1:
                # pgmpy adds a node to the second slice only together with an edge.
                super(DynamicBayesianNetwork, network).add_node(DynamicNode(*table.node))
            network.add_cpds(tabular_cpd(table, values or {}))
        return network


def tabular_cpd(
    table: Table,
    values: Mapping[str, Sequence[str]],
    name_of: Callable[[SliceNode], Any] = lambda node: node,
) -> TabularCPD:
    """Return a table as pgmpy's CPD.

    - values: the names of each node's values, by default numbers from 0
    - name_of: returns the name of a node in pgmpy
    """
    from pgmpy.factors.discrete import TabularCPD

    axes = zip((*table.parents, table.node), table.values.shape, strict=True)
    names = {name_of(node): list(values.get(node[0], range(size))) for node, size in axes}
    *parents, node = names
    # In pgmpy the node's values are rows and the parents' combinations columns.
    columns = table.values.reshape(-1, table.values.shape[-1]).T
    return TabularCPD(node, len(columns), columns, parents, list(table.values.shape[:-1]), names)


def flat_network(
    tables: Iterable[Table], values: Mapping[str, Sequence[str]], between: str = "@"
) -> DiscreteBayesianNetwork:
    """Return tables of any number of frames as a pgmpy network without time.

    - tables: the second part of their nodes is a frame, not a slice.
    - values: the names of each node's values, by default 0, 1, ...
    - between: stands between a node's name and its frame
    """
    with quiet():
        from pgmpy.models import DiscreteBayesianNetwork

        network = DiscreteBayesianNetwork()
        for table in tables:
            cpd = tabular_cpd(table, values, lambda node: f"{node[0]}{between}{node[1]}")
            network.add_node(cpd.variable)
            network.add_edges_from([(p, cpd.variable) for p in cpd.variables[1:]])
            network.add_cpds(cpd)
        return network


def bif(tables: Iterable[Table], values: Mapping[str, Sequence[str]]) -> str:
    """Return two slices as BIF, without loss: nodes are `Lane_0` and `Lane_1`.

    Raises InputError, naming the node, for names that the format cannot hold.
    """
    network = flat_network(tables, values, between="_")
    for cpd in network.cpds:
        for name in map(str, cpd.state_names[cpd.variable]):
            # The characters that pgmpy's reader takes for syntax.
            if not name or name != name.strip() or set(name) & set(',;(){}"/\n'):
                raise InputError(f"{cpd.variable}: a BIF file cannot hold the value name {name!r}")
        if not re.fullmatch(r"[\w.-]+", cpd.variable):
            raise InputError(f"{cpd.variable}: a BIF file cannot hold this name of a node")
    with quiet():
        from pgmpy.readwrite import BIFWriter

        return str(BIFWriter(network))


def check_tables(tables: Iterable[Table]) -> None:
    """Check that the tables of two slices fit each other.

    Raises InputError, naming the nodes, if a table is missing or given twice, for an edge back in
    time, a cycle, edges that differ between the slices, and for a node whose number of values
    differs between the slices or from a child's table.
    """
    tables = sorted(tables, key=lambda table: table.node[1])
    parents: dict[SliceNode, tuple[SliceNode, ...]] = {}
    size: dict[str, int] = {}
    for table in tables:
        name = table.node[0]
        n_values = table.values.shape[-1]
        if table.node in parents:
            raise InputError(f"{spell(table.node)}: there are two tables for it")
        if size.setdefault(name, n_values) != n_values:
            raise InputError(
                f"{name}: has {size[name]} values in the first frame and {n_values} later"
            )
        parents[table.node] = table.parents
    for table in tables:
        name, s = table.node
        for (parent, at), rows in zip(table.parents, table.values.shape, strict=False):
            if (parent, at) not in parents:
                raise InputError(
                    f"{spell(table.node)} has the parent {spell((parent, at))}, for which there"
                    " is no table"
                )
            if at > s:
                raise InputError(
                    f"{name}: an edge from {parent} leads from slice 1 back to slice 0"
                )
            if size[parent] != rows:
                raise InputError(
                    f"{name}: its table has {rows} rows for {parent}, which has {size[parent]}"
                    " values"
                )
    try:
        graphlib.TopologicalSorter(parents).prepare()
    except graphlib.CycleError as error:
        cycle = " -> ".join(name for name, _ in error.args[1])
        raise InputError(f"the edges within a slice form a cycle: {cycle}") from None
    for node in sorted(parents):
        s = node[1]
        other = (node[0], 1 - node[1])
        for name, at in sorted(parents[node]):
            if at == s and (name, 1 - s) not in parents.get(other, ()):
                raise InputError(
                    f"{spell(node)} depends on {spell((name, s))}, but {spell(other)} does not"
                    f" depend on {spell((name, 1 - s))}: give both tables the same parent"
                )
