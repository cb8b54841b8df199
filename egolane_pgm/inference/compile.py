"""A declared two-slice network, turned into arrays over its joint state.

`graphs.from_pgmpy` reads the tables, their axes by the names of nodes; what the parts below do not
allow is refused here, naming the node. What the filters get is therefore known to be well formed.

Each node of a network has one of these parts:

- An input is a root whose value is given in every frame. It selects among its children's tables.
- A function is a hidden node whose value follows for certain from other nodes of its frame.
- A plain emission is an observed node that depends on its own frame alone, inputs left out, by the
  same table in every frame, and on which nothing depends but other plain emissions.
- Every other node is in the joint state, whether it is hidden or observed: a node with an edge
  across the slices, a hidden one that is drawn anew in every frame, an observed one that depends on
  an input or that a hidden one depends on.

A joint state is one value for each node of the last kind, and the filters carry a belief over the
joint states from frame to frame. Where later frames do not depend on a node, the rows of the
transition are the same for all its values, and so the step to the next frame sums it out. Evidence
is a likelihood of an observed node's values. If the node is in the joint state, that is the
likelihood of the states with these values, as for a hidden node that is observed directly.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, check_tables, declare, ve_name
from egolane_pgm.graphs.from_pgmpy import read_network
from egolane_pgm.types import NOTE, FloatArray, InputError, IntArray, Observed, suggestion

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

#: The nodes whose values are lanes, or numbers of lanes.
LANES = ("Lane", "DetectorOutput", "Lanes")

#: More joint states than this are refused.
MAX_STATES = 4096

#: A transition or emission array with more entries than this (512 MiB) is refused.
MAX_ENTRIES = 2**26


@dataclass(frozen=True)
class Group:
    """Observed nodes that one emission table is about.

    observed: the keys of the evidence, in order. nodes: the network nodes that index the columns.
    sizes: their cardinalities; K is their product. axes: per observed key the positions of its
    nodes in `nodes`. emission (S, K): P(nodes | joint state). mask (S, K): 0 where the joint state
    has another value of an observed node than the column, else 1.
    """

    observed: tuple[Observed, ...]
    nodes: tuple[str, ...]
    sizes: tuple[int, ...]
    axes: tuple[tuple[int, ...], ...]
    emission: FloatArray
    mask: FloatArray


@dataclass(frozen=True)
class Placement:
    """Where a table goes: `indices` (one broadcastable array per axis of the table) select its
    entries for the array that `kind` names: "prior", "transition" or "emission" (of `group`)."""

    kind: str
    group: int
    indices: tuple[IntArray, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Compiled:
    """A network as arrays: S joint states, U joint values of the inputs (1 without inputs).

    hidden: the nodes that beliefs are about.
    state_nodes: the nodes of the joint state, the one of most values last; their values, the first
        node's slowest, number the joint states.
    inputs: the input nodes, the first one's values slowest in U.
    cardinality: of every node.
    node_value: the value (S,) that each hidden node, and each other one of the joint state, has in
        each joint state.
    prior (U, S): the joint state in the first frame, before its evidence.
    transition (U, S, S): row is the state before.
    groups: the emissions.
    places: where the entries of each table go.
    tables: the table of every node in both slices, with its present numbers; those of virtual-
        evidence nodes are not among them.
    values: the names of each of these nodes' values.
    """

    hidden: tuple[str, ...]
    state_nodes: tuple[str, ...]
    inputs: tuple[str, ...]
    cardinality: Mapping[str, int]
    node_value: Mapping[str, IntArray]
    prior: FloatArray
    transition: FloatArray
    groups: tuple[Group, ...]
    places: Mapping[SliceNode, Placement]
    tables: Mapping[SliceNode, Table]
    values: Mapping[str, tuple[str, ...]]

    def __repr__(self) -> str:
        nodes = " x ".join(f"{name} ({self.cardinality[name]})" for name in self.state_nodes)
        seen = ", ".join(key if isinstance(key, str) else "+".join(key) for key in self.observed)
        return f"Compiled({nodes}: {self.n_states} joint states; observes {seen})"

    @property
    def n_states(self) -> int:
        """Number of joint states."""
        return int(self.prior.shape[1])

    @property
    def functions(self) -> tuple[str, ...]:
        """The hidden nodes that are functions of others."""
        return tuple(name for name in self.hidden if name not in self.state_nodes)

    @property
    def observed(self) -> tuple[Observed, ...]:
        """The keys that the evidence must have."""
        return tuple(key for group in self.groups for key in group.observed)

    @property
    def network(self) -> DynamicBayesianNetwork:
        """The network in pgmpy, declared anew from the tables, with the names of the values."""
        return declare(self.tables.values(), self.observed, self.values)

    def has_one_table(self, name: str) -> bool:
        """Whether a node has the same table in the first frame and in all later ones."""
        return _is_same(self.tables[name, 0], self.tables[name, 1])


def compile(
    network: Any,
    *,
    observed: Sequence[Observed],
    hidden: Sequence[str] | None = None,
    inputs: Sequence[str] = (),
    transition: Sequence[Any] | None = None,
    values: Mapping[str, Sequence[str]] | None = None,
) -> Compiled:
    """Turn a pgmpy network into the arrays that the filters take.

    - network: a `DynamicBayesianNetwork`, before or after `initialize_initial_state()`; a
      `DiscreteBayesianNetwork` of two slices, with nodes named `Lane_0` and `Lane_1`, or of one
      slice; or the name of a BIF or XMLBIF file of either.
    - observed: the nodes, or tuples of nodes, that there is evidence of.
    - hidden: the nodes that beliefs are about, by default all that are neither observed nor inputs,
      and Lane in any case.
    - inputs: nodes without parents whose value is known in every frame.
    - transition: for a network of one slice, pgmpy's `TabularCPD`s of (name, 1) given (name, 0) and
      (name, 1).
    - values: names of nodes' values, in place of those that the network gives. Where neither gives
      any, those of LANES count from 1 and those of any other node from 0.

    Warns of observed nodes without a virtual-evidence child, which is added. Raises InputError,
    naming the node or the file, for anything that the filters could not honour.

    >>> import warnings
    >>> import numpy as np
    >>> import egolane_pgm as ego
    >>> from pgmpy.factors.discrete import TabularCPD
    >>> from pgmpy.models import DynamicBayesianNetwork
    >>> network = DynamicBayesianNetwork([(("Lane", 0), ("Lane", 1)), (("Lane", 0), ("Line", 0))])
    >>> network.add_cpds(
    ...     TabularCPD(("Lane", 0), 2, [[0.5], [0.5]]),
    ...     TabularCPD(("Lane", 1), 2, [[0.9, 0.1], [0.1, 0.9]], [("Lane", 0)], [2]),
    ...     TabularCPD(("Line", 0), 2, [[0.8, 0.2], [0.2, 0.8]], [("Lane", 0)], [2]),
    ... )
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")  # Line has no virtual-evidence node
    ...     compiled = ego.compile(network, observed=["Line"])
    >>> compiled
    Compiled(Lane (2): 2 joint states; observes Line)
    >>> seen = ego.Evidence({"Line": np.array([[1.0, 0.0], [1.0, 0.0]])})
    >>> ego.filter_beliefs(compiled, seen, "exact").lane.round(3).tolist()
    [[0.8, 0.2], [0.919, 0.081]]
    """
    for what, given in (("observed", observed), ("hidden", hidden), ("inputs", inputs)):
        if isinstance(given, str):
            raise InputError(f"{what}: needs a list of nodes, e.g. [{given!r}]")
    observed = [key if isinstance(key, str) else tuple(key) for key in observed]
    declared = read_network(network, transition)
    if hidden is None:
        others = {*inputs, *map(ve_name, observed)}
        others |= {n for key in observed for n in _names(key)}
        nodes = dict.fromkeys(name for name, _ in declared.tables)
        hidden = [name for name in nodes if name == "Lane" or name not in others]
    tables, missing = _without_virtual_evidence(declared.tables, observed)
    names = {**declared.values, **(values or {})}
    compiled = _compile(tables, tuple(hidden), tuple(observed), tuple(inputs), names)
    if missing:
        warnings.warn(
            f"{NOTE}the network has no {', '.join(missing)}: virtual-evidence nodes that are"
            " missing are added",
            UserWarning,
            stacklevel=2,
        )
    return compiled


def compile_tables(
    tables: Sequence[Table],
    *,
    observed: tuple[Observed, ...],
    hidden: tuple[str, ...],
    inputs: tuple[str, ...] = (),
    values: Mapping[str, Sequence[str]] | None = None,
) -> Compiled:
    """What `compile` makes of the network that `cpds.declare` makes of these tables, without
    importing pgmpy, which takes a second.

    - tables: of all nodes but the virtual-evidence ones, in both slices.
    - observed, hidden, inputs, values: as in `compile`.

    Raises InputError, naming the node, for tables that do not fit each other.
    """
    check_tables(tables, observed)
    return _compile({t.node: t for t in tables}, hidden, observed, inputs, values or {})


def default_values(node: str, size: int) -> tuple[str, ...]:
    """The names of the values of a node that has none: those of LANES count from 1."""
    first = 1 if node in LANES else 0
    return tuple(map(str, range(first, first + size)))


def with_tables(compiled: Compiled, tables: Iterable[Table]) -> Compiled:
    """The same network with new numbers in some of its tables, without touching pgmpy.

    Numbers may change which part a node has: a function may become uncertain, the table of an
    emission may come to differ between the slices. The arrays are then laid out anew.

    Raises InputError naming the node whose table has other parents or another shape.
    """
    now = dict(compiled.tables)
    for table in tables:
        name, s = table.node
        if name not in compiled.cardinality:
            raise InputError(f"{name}: the compiled network has no such node (slice {s})")
        if table.node in now:  # the others are those of virtual evidence
            now[table.node] = _like(table, now[table.node])
    if not _keeps_layout(compiled, now):
        return _compile(now, compiled.hidden, compiled.observed, compiled.inputs, compiled.values)
    prior, transition, emissions = _fill(compiled, now)
    groups = tuple(
        replace(group, emission=emission)
        for group, emission in zip(compiled.groups, emissions, strict=True)
    )
    return replace(compiled, prior=prior, transition=transition, groups=groups, tables=now)


def _like(table: Table, old: Table) -> Table:
    """The table with its parents in the order of the old one."""
    table = _in_order(table, old.parents)
    if table.parents != old.parents or table.values.shape != old.values.shape:
        raise InputError(
            f"{table.node[0]}: the table has other parents or another shape than before"
        )
    return table


def _in_order(table: Table, parents: tuple[SliceNode, ...]) -> Table:
    """The table with its parents in this order, if they are its parents."""
    if table.parents == parents or sorted(table.parents) != sorted(parents):
        return table
    order = [table.parents.index(p) for p in parents]
    return Table(table.node, parents, table.values.transpose(*order, len(order)))


def _keeps_layout(compiled: Compiled, now: Mapping[SliceNode, Table]) -> bool:
    for (name, s), place in compiled.places.items():
        if place.kind == "emission" and not _is_same(now[name, 0], now[name, s]):
            return False
    return all(
        np.array_equal(now[name, s].values, compiled.tables[name, s].values)
        for name in compiled.functions
        for s in (0, 1)
    )


def _is_same(first: Table, later: Table) -> bool:
    """Whether two tables of one node, with their parents in the same order, say the same of their
    own slices."""
    return later.parents == tuple((p, 1) for p, _ in first.parents) and (
        first.values is later.values or np.allclose(first.values, later.values, rtol=0, atol=1e-12)
    )


def _fill(
    compiled: Compiled, tables: Mapping[SliceNode, Table]
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    prior = np.ones_like(compiled.prior)
    transition = np.ones_like(compiled.transition)
    emissions = [group.mask.copy() for group in compiled.groups]
    target = {"prior": prior, "transition": transition}
    for node, place in compiled.places.items():
        array = emissions[place.group] if place.kind == "emission" else target[place.kind]
        array *= tables[node].values[place.indices]
    return prior, transition, emissions


# --- which node has which part --------------------------------------------------------------------


def _without_virtual_evidence(
    tables: Mapping[SliceNode, Table], observed: Sequence[Observed]
) -> tuple[dict[SliceNode, Table], list[str]]:
    """The tables of all other nodes, and the virtual-evidence nodes that the network lacks."""
    ve = {ve_name(key): _names(key) for key in observed}
    kept = {node: table for node, table in tables.items() if node[0] not in ve}
    for table in kept.values():
        for parent, _ in table.parents:
            if parent in ve:
                raise InputError(f"{parent}: a virtual-evidence node may not have children")
    for (name, s), table in tables.items():
        if name not in ve:
            continue
        if table.values.shape[-1] != 2:
            raise InputError(f"{name}: a virtual-evidence node is binary")
        if set(table.parents) != {(n, s) for n in ve[name]}:
            raise InputError(f"{name}: its parents must be {', '.join(ve[name])} in the same slice")
    return kept, [name for name in ve if (name, 0) not in tables]


def _names(key: Observed) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else key


@dataclass(frozen=True)
class _Parts:
    """Which node has which part. functions: each one behind those that it is a function of.
    tables: with the parents in the same order in both slices, where the node has one table."""

    tables: Mapping[SliceNode, Table]
    hidden: tuple[str, ...]
    observed: tuple[Observed, ...]
    inputs: tuple[str, ...]
    functions: tuple[str, ...]
    emissions: frozenset[str]
    state: tuple[str, ...]

    @property
    def cardinality(self) -> dict[str, int]:
        """How many values each node has."""
        return {name: t.values.shape[-1] for (name, s), t in self.tables.items() if s == 0}


def _parts(
    tables: Mapping[SliceNode, Table],
    hidden: tuple[str, ...],
    observed: tuple[Observed, ...],
    inputs: tuple[str, ...],
) -> _Parts:
    """The parts of the nodes. Raises InputError where the declaration and the tables disagree."""
    nodes = tuple(dict.fromkeys(n for key in observed for n in _names(key)))
    _check_names({name for name, _ in tables}, hidden, observed, nodes, inputs)
    order = _order_within(tables)
    _check_inputs(tables, hidden, nodes, inputs)
    aligned = {}
    for (name, s), table in tables.items():
        later = tuple((p, s) for p, _ in tables[name, 1].parents)
        aligned[name, s] = _in_order(table, later)
    plain = {
        name
        for name in order
        if _is_same(aligned[name, 0], aligned[name, 1])
        and not any(p in inputs for p, _ in aligned[name, 1].parents)
    }
    emissions = {name for name in nodes if name in plain and name not in hidden}
    # Until each one that is left has no other children.
    while others := {
        parent
        for (child, _), table in tables.items()
        for parent, _ in table.parents
        if child not in emissions and parent in emissions
    }:
        emissions -= others
    looked_back_at = {p for (_, s), t in tables.items() for p, ps in t.parents if ps < s}
    functions = tuple(
        name
        for name in order
        if name in hidden
        and name in plain
        and name not in looked_back_at
        and np.isin(tables[name, 1].values, (0.0, 1.0)).all()
    )
    carried = [n for n in dict.fromkeys((*hidden, *nodes)) if n not in {*functions, *emissions}]
    # The node of most values last: those of its values that follow each other are then next to
    # each other in memory.
    state = tuple(sorted(carried, key=lambda name: tables[name, 0].values.shape[-1]))
    return _Parts(aligned, hidden, observed, inputs, functions, frozenset(emissions), state)


def _check_names(
    names: set[str],
    hidden: Sequence[str],
    observed: Sequence[Observed],
    nodes: Sequence[str],
    inputs: Sequence[str],
) -> None:
    repeats = [*_repeats(hidden), *_repeats(inputs), *_repeats(map(ve_name, observed))]
    for name in (*repeats, *(n for key in observed for n in _repeats(_names(key)))):
        raise InputError(f"{name}: declared more than once")
    for name in (*hidden, *inputs, *nodes):
        if name not in names:
            raise InputError(
                f"{name}: declared, but not a node of the network{suggestion(name, names)}"
            )
    for name in sorted(names - {*hidden, *inputs, *nodes}):
        raise InputError(f"{name}: neither hidden, observed, input nor virtual evidence")
    if not hidden:
        raise InputError("no hidden node is declared, so there is nothing to filter")


def _repeats(names: Iterable[str]) -> list[str]:
    """What occurs more than once."""
    seen: set[str] = set()
    return [n for n in names if n in seen or seen.add(n)]  # type: ignore[func-returns-value]


def _order_within(tables: Mapping[SliceNode, Table]) -> list[str]:
    """The nodes, each one behind its parents in the slice of later frames."""
    parents = {
        name: [p for p, ps in table.parents if ps == 1]
        for (name, s), table in tables.items()
        if s == 1
    }
    return list(TopologicalSorter(parents).static_order())


def _check_inputs(
    tables: Mapping[SliceNode, Table],
    hidden: Sequence[str],
    nodes: Sequence[str],
    inputs: Sequence[str],
) -> None:
    for name in inputs:
        for declared, what in ((hidden, "hidden"), (nodes, "observed")):
            if name in declared:
                raise InputError(f"{name}: is declared both {what} and input")
        if tables[name, 0].parents or tables[name, 1].parents:
            raise InputError(f"{name}: an input node may not have parents")
        if any((name, 0) in t.parents for (_, s), t in tables.items() if s == 1):
            raise InputError(f"{name}: an input acts within its slice only")


# --- arrays ---------------------------------------------------------------------------------------


def _compile(
    tables: Mapping[SliceNode, Table],
    hidden: tuple[str, ...],
    observed: tuple[Observed, ...],
    inputs: tuple[str, ...],
    names: Mapping[str, Sequence[str]],
) -> Compiled:
    parts = _parts(tables, hidden, observed, inputs)
    cardinality = parts.cardinality
    _check_size(parts, cardinality)
    values = _value_names(cardinality, names)
    node_value = _node_values(parts, cardinality)
    n_states = math.prod(cardinality[n] for n in parts.state)
    groups = tuple(_group(keys, cardinality, node_value, n_states) for keys in _joined(parts))
    sizes = [cardinality[n] for n in inputs]
    n_inputs = math.prod(sizes)
    input_value = dict(zip(inputs, np.indices(sizes).reshape(len(sizes), n_inputs), strict=True))
    blank = Compiled(
        hidden,
        parts.state,
        inputs,
        {**cardinality, **{ve_name(key): 2 for key in observed}},
        node_value,
        np.ones((n_inputs, n_states)),
        np.ones((n_inputs, n_states, n_states)),
        groups,
        _places(parts, groups, node_value, input_value),
        parts.tables,
        values,
    )
    return with_tables(blank, ())


#: What makes an observed node a part of the joint state.
_NOT_PLAIN = "an edge across the slices, an input, a carried child or another first table"


def _check_size(parts: _Parts, cardinality: Mapping[str, int]) -> None:
    def sizes(names: Iterable[str]) -> str:
        return " x ".join(f"{n} {cardinality[n]}" for n in names)

    if not parts.state:
        raise InputError(
            f"every hidden node ({', '.join(parts.hidden)}) is a constant, so there is nothing to"
            " filter"
        )
    n_states = math.prod(cardinality[n] for n in parts.state)
    if n_states > MAX_STATES:
        seen = [n for n in parts.state if n not in parts.hidden]
        why = f"; {', '.join(seen)}: observed, but no plain emission ({_NOT_PLAIN})" if seen else ""
        raise InputError(
            f"the joint state has {n_states} values ({sizes(parts.state)}), more than"
            f" {MAX_STATES}{why}"
        )
    n_inputs = math.prod(cardinality[n] for n in parts.inputs)
    if n_inputs * n_states**2 > MAX_ENTRIES:
        raise InputError(
            f"the transition has {n_inputs} x {n_states} x {n_states} entries"
            f" ({sizes((*parts.inputs, *parts.state))}), more than {MAX_ENTRIES}"
        )
    for key in parts.observed:
        of = _names(key)
        if n_states * math.prod(cardinality[n] for n in of) > MAX_ENTRIES:
            raise InputError(
                f"{', '.join(of)}: {sizes(of)} values for {n_states} joint states are more than"
                f" {MAX_ENTRIES} entries"
            )


def _value_names(
    cardinality: Mapping[str, int], given: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    names = {}
    for node, size in cardinality.items():
        names[node] = tuple(map(str, given.get(node, default_values(node, size))))
        if len(set(names[node])) != size or len(names[node]) != size:
            raise InputError(
                f"{node}: has {size} values, but their names are {', '.join(names[node])}"
            )
    return names


def _node_values(parts: _Parts, cardinality: Mapping[str, int]) -> dict[str, IntArray]:
    sizes = [cardinality[n] for n in parts.state]
    digits = np.indices(sizes).reshape(len(sizes), -1)
    values: dict[str, IntArray] = dict(zip(parts.state, digits, strict=True))
    for name in parts.functions:
        table = parts.tables[name, 1]
        index = tuple(values[p] for p, _ in table.parents)
        value = np.asarray(table.values.argmax(axis=-1))[index]
        values[name] = np.broadcast_to(value, digits.shape[1:])
    return values


def _joined(parts: _Parts) -> list[list[Observed]]:
    """Evidence keys that must share one emission table: those whose plain emissions are linked by
    an edge or by a common virtual-evidence node. In the order declared: Jeffrey's rule does not
    commute."""
    clusters: list[tuple[set[str], list[Observed]]] = []
    for key in parts.observed:
        leaves = {n for n in _names(key) if n in parts.emissions}
        linked = leaves | {
            p for n in leaves for p, _ in parts.tables[n, 1].parents if p in parts.emissions
        }
        keys: list[Observed] = [key]
        apart = []
        for nodes, others in clusters:
            if nodes & linked:
                linked |= nodes
                keys = others + keys
            else:
                apart.append((nodes, others))
        clusters = [*apart, (linked, keys)]
    joined = [sorted(keys, key=parts.observed.index) for _, keys in clusters]
    return sorted(joined, key=lambda keys: parts.observed.index(keys[0]))


def _group(
    keys: list[Observed],
    cardinality: Mapping[str, int],
    node_value: Mapping[str, IntArray],
    n_states: int,
) -> Group:
    nodes = tuple(dict.fromkeys(n for key in keys for n in _names(key)))
    sizes = tuple(cardinality[n] for n in nodes)
    axes = tuple(tuple(nodes.index(n) for n in _names(key)) for key in keys)
    mask = np.ones((n_states, math.prod(sizes)))
    columns = np.indices(sizes).reshape(len(sizes), -1)
    for name, column in zip(nodes, columns, strict=True):
        if name in node_value:
            mask *= node_value[name][:, None] == column
    return Group(tuple(keys), nodes, sizes, axes, mask, mask)


def _places(
    parts: _Parts,
    groups: Sequence[Group],
    node_value: Mapping[str, IntArray],
    input_value: Mapping[str, IntArray],
) -> dict[SliceNode, Placement]:
    places: dict[SliceNode, Placement] = {}
    for name in parts.state:
        for s, kind in ((0, "prior"), (1, "transition")):
            indices = []
            for node, of in (*parts.tables[name, s].parents, (name, s)):
                if node in input_value:
                    shape = (-1, 1) if s == 0 else (-1, 1, 1)
                    indices.append(input_value[node].reshape(shape))
                else:
                    shape = (1, -1) if s == 0 else (1, -1, 1) if of == 0 else (1, 1, -1)
                    indices.append(node_value[node].reshape(shape))
            places[name, s] = Placement(kind, -1, tuple(indices))
    for g, group in enumerate(groups):
        columns = np.indices(group.sizes).reshape(len(group.sizes), -1)
        column = dict(zip(group.nodes, columns, strict=True))
        for name in group.nodes:
            if name in parts.emissions:
                index = tuple(
                    column[node][None, :] if node in column else node_value[node][:, None]
                    for node, _ in (*parts.tables[name, 1].parents, (name, 1))
                )
                places[name, 1] = Placement("emission", g, index)
    return places
