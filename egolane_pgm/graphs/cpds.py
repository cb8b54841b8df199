"""Conditional probability tables with named axes, and their declaration as a pgmpy network.

Tables are written as in the paper: the parents' values select the row, the columns are the node's
own values. The array of a table therefore has one axis per parent, in the order in which the
parents are listed, and the node's own axis last. A node of one slice is the pair (name, slice):
slice 0 is time t, slice 1 is time t + 1.

>>> import egolane_pgm as ego
>>> ego.cpds.uniform(4)
array([0.25, 0.25, 0.25, 0.25])
"""

from __future__ import annotations

import contextlib
import graphlib
import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import FloatArray, InputError, Observed

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

SliceNode = tuple[str, int]

#: The end of the name of a virtual-evidence node.
VE_SUFFIX = "_ve"

#: The note at the virtual-evidence nodes of a declared network.
PLACEHOLDER = (
    "virtual evidence: this table is a placeholder; ego.unrolled or Result.network(evidence=True)"
    " gives frames whose tables hold their evidence"
)


def discretised_normal(
    mean: float | FloatArray,
    sigma: float,
    n: int,
    normal: str = "density",
    widths: Sequence[float] | None = None,
) -> FloatArray:
    """The paper's F(N(mean, sigma^2)): a normal as probabilities of the lanes 1 to n (section "HMM
    with Transient Failure Model").

    - mean: one mean, or an array (...) of them, lanes
    - sigma: standard deviation, lanes
    - normal: "density" takes the density at the lane centres, as the authors computed it;
      "integral" takes the integral across each lane, as the text describes it
    - widths: (n,) width of each lane in units of the nominal lane, all 1 by default

    Returns (..., n); each row sums to one.
    """
    edges, centres = lane_edges(n, widths)
    mean = np.asarray(mean, dtype=np.float64)[..., None]
    if normal == "density":
        distance = np.abs(centres - mean)
        with np.errstate(over="ignore", invalid="ignore"):
            exponent = -0.5 * (distance / sigma) ** 2
            mass = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
    else:
        distance = np.maximum(0.0, np.maximum(edges[:-1] - mean, mean - edges[1:]))
        # With a tiny sigma this overflows to infinity, which gives the right limit.
        with np.errstate(over="ignore"):
            z = (edges - mean) / sigma / math.sqrt(2.0)
        # A lane near the mean takes the difference of erf; a lane far from it takes the difference
        # of the tails on its own side. Small masses keep their digits in this way.
        middle, right, left = np.diff(erf(z)), -np.diff(erfc(z)), np.diff(erfc(-z))
        mass = np.where(z[..., :-1] > 0.5, right, np.where(z[..., 1:] < -0.5, left, middle))
    total = mass.sum(axis=-1, keepdims=True)
    if not (total > 0).all():
        # Every lane is infinitely many standard deviations away, the nearest one least so.
        nearest = distance == distance.min(axis=-1, keepdims=True)
        mass = np.where(total > 0, mass, nearest)
        total = mass.sum(axis=-1, keepdims=True)
    return np.asarray(mass / total, dtype=np.float64)


def erf(z: FloatArray) -> FloatArray:
    """Return the error function. Importing that of scipy takes longer than most runs use it."""
    return np.array([math.erf(x) for x in z.flat]).reshape(z.shape)


def erfc(z: FloatArray) -> FloatArray:
    """Return the complementary error function."""
    return np.array([math.erfc(x) for x in z.flat]).reshape(z.shape)


def normal_cdf(z: FloatArray) -> FloatArray:
    """Return the standard normal distribution function."""
    return np.asarray(0.5 * erfc(-z / math.sqrt(2.0)))


def lane_edges(n: int, widths: Sequence[float] | None = None) -> tuple[FloatArray, FloatArray]:
    """Edges (n + 1,) and centres (n,) of the lanes, in units of the nominal lane.

    Lane 1 starts at 0.5, so that lanes of width 1 have their centres at 1 to n.
    """
    widths_array = np.ones(n) if widths is None else np.asarray(widths, dtype=np.float64)
    edges = 0.5 + np.concatenate([[0.0], np.cumsum(widths_array)])
    return edges, (edges[:-1] + edges[1:]) / 2


def lane_normals(
    sigma: float,
    n: int,
    normal: str = "density",
    widths: Sequence[float] | None = None,
    shift: float = 0.0,
) -> FloatArray:
    """F of a normal around each lane's centre, moved by `shift` lanes to the right: (n, n), whose
    row i belongs to lane i + 1. The other parameters are those of `discretised_normal`."""
    _, centres = lane_edges(n, widths)
    return discretised_normal(centres + shift, sigma, n, normal, widths)


def binary(ok: float, bad: float) -> FloatArray:
    """[[ok, 1 - ok], [1 - bad, bad]]: an OK parent gives OK with probability `ok`, a BAD one gives
    BAD with probability `bad` (Tables `tab:cptsensor`, `tab:cptri`)."""
    return np.array([[ok, 1 - ok], [1 - bad, bad]])


def sticky(*stay: float) -> FloatArray:
    """(k, k): value i stays with probability `stay[i]`; otherwise each of the other values is
    equally likely."""
    k = len(stay)
    return np.stack([np.where(np.arange(k) == i, p, (1 - p) / (k - 1)) for i, p in enumerate(stay)])


def uniform(*shape: int) -> FloatArray:
    """An array of this shape that is uniform over its last axis."""
    return np.full(shape, 1.0 / shape[-1])


@dataclass(frozen=True)
class Table:
    """P(node | parents).

    values: one axis per parent, in the order of `parents`, and the node's own axis last.
    Raises InputError, naming node and parents, where an axis is missing, an entry is negative or
    NaN, or a row does not sum to one.
    """

    node: SliceNode
    parents: tuple[SliceNode, ...]
    values: FloatArray

    def __post_init__(self) -> None:
        # A search builds thousands of tables per second, so a good table is recognised in two
        # passes; NaN fails both comparisons.
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
    """The node at time t, as a parent in `dynamics`."""
    return (name, 0)


def prior(name: str, values: ArrayLike, given: Sequence[str] = ()) -> list[Table]:
    """P(name in the first frame | given in the first frame)."""
    parents = tuple((node, 0) for node in given)
    return [Table((name, 0), parents, np.asarray(values, dtype=np.float64))]


def dynamics(name: str, given: Sequence[str | SliceNode], values: ArrayLike) -> list[Table]:
    """P(name at t+1 | given). In `given`, `previous(x)` is x at t and a plain name is x at t+1."""
    parents = tuple((node, 1) if isinstance(node, str) else node for node in given)
    return [Table((name, 1), parents, np.asarray(values, dtype=np.float64))]


def within(name: str, given: Sequence[str], values: ArrayLike) -> list[Table]:
    """P(name | given in the same slice): one table for each of the two slices."""
    array = np.asarray(values, dtype=np.float64)
    return [*prior(name, array, given), *dynamics(name, given, array)]


def ve_name(observed: Observed) -> str:
    """The name of the virtual-evidence node of an observed node or tuple."""
    return (observed if isinstance(observed, str) else "+".join(observed)) + VE_SUFFIX


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keeps pgmpy's warnings, log lines and progress bars off the terminal."""
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


def declare(
    tables: Iterable[Table],
    observed: Iterable[Observed],
    values: Mapping[str, Sequence[str]] | None = None,
) -> DynamicBayesianNetwork:
    """Declares the tables as a pgmpy network with both slices in full.

    - observed: each of them, a node or a tuple of nodes observed jointly, gets a binary child
      `<name>_ve` for virtual evidence, whose table is a placeholder (1/2 everywhere), as is noted
      at it: `network.nodes["WOR_ve", 0]`
    - values: for each node the names of its values (pgmpy's state names); a node without names has
      pgmpy's own, the numbers from 0

    Raises InputError, naming the nodes, where a table is missing, is there twice or does not fit
    its parents, and where the two slices have different edges.
    """
    tables = list(tables)
    check_tables(tables, observed)
    n_given = len(tables)
    cardinality = {table.node: table.values.shape[-1] for table in tables}
    for target in observed:
        names = (target,) if isinstance(target, str) else target
        sizes = [cardinality[name, 0] for name in names]
        tables += within(ve_name(target), names, np.full((*sizes, 2), 0.5))
    with quiet():
        from pgmpy.factors.discrete import TabularCPD
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
            # pgmpy wants the node's values as rows, the parents' combinations as columns.
            columns = table.values.reshape(-1, table.values.shape[-1]).T
            axes = zip((*table.parents, table.node), table.values.shape, strict=True)
            network.add_cpds(
                TabularCPD(
                    table.node,
                    len(columns),
                    columns,
                    evidence=list(table.parents),
                    evidence_card=list(table.values.shape[:-1]),
                    state_names={
                        node: list((values or {}).get(node[0], range(size))) for node, size in axes
                    },
                )
            )
        for table in tables[n_given:]:
            network.nodes[table.node]["note"] = PLACEHOLDER
        return network


def builder(
    tables: Callable[[int, Any], Iterable[Table]], observed: Iterable[Observed]
) -> Callable[[int, Any], DynamicBayesianNetwork]:
    """The `build(n_lanes, parameters)` of a graph file: its `tables`, declared."""
    return lambda n_lanes, parameters: declare(tables(n_lanes, parameters), observed)


def check_tables(tables: Sequence[Table], observed: Iterable[Observed]) -> None:
    """Raise InputError, naming the nodes, where a table is missing, is there twice or does not fit
    its parents, and where the two slices have different edges."""
    parents: dict[SliceNode, tuple[SliceNode, ...]] = {}
    for table in tables:
        if table.node in parents:
            raise InputError(f"{_spell(table.node)}: there are two tables for it")
        parents[table.node] = table.parents
    for node, given in parents.items():
        for parent in given:
            if parent not in parents:
                raise InputError(
                    f"{_spell(node)} has the parent {_spell(parent)}, for which there is no table"
                )
    for key in observed:
        for name in (key,) if isinstance(key, str) else key:
            if (name, 0) not in parents:
                raise InputError(f"observed node {name}: there is no table for it")
    check_structure(tables)
    for node in sorted(parents):
        s, other = node[1], (node[0], 1 - node[1])
        for name, at in sorted(parents[node]):
            if at == s and (name, 1 - s) not in parents.get(other, ()):
                raise InputError(
                    f"{_spell(node)} depends on {_spell((name, s))}, but {_spell(other)} does not"
                    f" depend on {_spell((name, 1 - s))}: give both tables the same parent"
                )


def check_structure(tables: Iterable[Table]) -> None:
    """Raise InputError for an edge back in time, for a cycle within a slice, and for a node that
    has other numbers of values in the first frame and later, or in its own table and a child's."""
    tables = sorted(tables, key=lambda table: table.node[1])
    size: dict[str, int] = {}
    for table in tables:
        name, n_values = table.node[0], table.values.shape[-1]
        if size.setdefault(name, n_values) != n_values:
            raise InputError(
                f"{name}: has {size[name]} values in the first frame and {n_values} later"
            )
    for table in tables:
        name, s = table.node
        for (parent, at), rows in zip(table.parents, table.values.shape, strict=False):
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
        graphlib.TopologicalSorter({table.node: table.parents for table in tables}).prepare()
    except graphlib.CycleError as error:
        cycle = " -> ".join(name for name, _ in error.args[1])
        raise InputError(f"the edges within a slice form a cycle: {cycle}") from None
