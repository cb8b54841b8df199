"""A declared two-slice network, turned into arrays over the joint hidden state.

All validation of a graph is here: what the filters get is known to be well formed. pgmpy's CPDs
are aligned by node name, never by position.

What is accepted: hidden nodes that persist (have an edge across the slices) and hidden nodes that
are deterministic functions of others in the same slice; observed nodes, each with a virtual-
evidence child, or tuples of nodes with one virtual-evidence child; input nodes, roots whose value
is given in every frame and selects the transition. The joint state is the product of the
persistent nodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, ve_name
from egolane_pgm.inference._roles import Roles, read_tables, same_within
from egolane_pgm.types import FloatArray, InputError, IntArray, Observed

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork


@dataclass(frozen=True)
class Group:
    """Observed nodes that one emission table is about.

    observed: the keys of the evidence, in order. nodes: the network nodes that index the columns.
    sizes: their cardinalities; K is their product. axes: per observed key the positions of its
    nodes in `nodes`. emission (S, K): P(nodes | joint state). mask (S, K): 0 where a hidden node
    is observed directly and the column is not the state's own value, else 1.
    """

    observed: tuple[Observed, ...]
    nodes: tuple[str, ...]
    sizes: tuple[int, ...]
    axes: tuple[tuple[int, ...], ...]
    emission: FloatArray
    mask: FloatArray


@dataclass(frozen=True)
class Compiled:
    """A network as arrays, S joint states, U joint values of the inputs (1 without inputs).

    hidden: every hidden node, persistent ones and functions. state_nodes: the persistent ones,
    whose values, first slowest, number the joint states. cardinality: of every node.
    node_value (H, S): the value of each hidden node in each joint state.
    inputs: input nodes, first slowest in U. prior (U, S): the first frame before its evidence.
    transition (U, S, S): row is the state before. groups: the emissions. places: per table where
    its entries go.
    """

    hidden: tuple[str, ...]
    state_nodes: tuple[str, ...]
    inputs: tuple[str, ...]
    cardinality: Mapping[str, int]
    node_value: IntArray
    prior: FloatArray
    transition: FloatArray
    groups: tuple[Group, ...]
    places: Mapping[SliceNode, Placement]
    _functions: Mapping[SliceNode, Table]

    @property
    def n_states(self) -> int:
        """Number of joint states."""
        return int(self.node_value.shape[1])

    @property
    def observed(self) -> tuple[Observed, ...]:
        """The keys that the evidence must have."""
        return tuple(key for group in self.groups for key in group.observed)


@dataclass(frozen=True)
class Placement:
    """Where a conditional table goes: `indices` (one broadcastable array per axis of the table,
    parents first, node last) select its entries for the array that `kind` names."""

    kind: str
    group: int
    parents: tuple[SliceNode, ...]
    shape: tuple[int, ...]
    indices: tuple[IntArray, ...]


def compile_network(
    network: DynamicBayesianNetwork,
    hidden: Sequence[str],
    observed: Sequence[Observed],
    inputs: Sequence[str] = (),
) -> Compiled:
    """The arrays of a declared network.

    Raises InputError, naming the node, for anything that the filters could not honour.
    """
    tables = read_tables(network)
    roles = Roles(tables, tuple(hidden), tuple(observed), tuple(inputs))
    return _assemble(roles, tables)


def with_tables(compiled: Compiled, tables: Iterable[Table]) -> Compiled:
    """The same structure with new tables, without touching pgmpy.

    Raises InputError naming the node whose table is missing, has other parents or another shape,
    or belongs to the structure: a hidden node that is a function keeps its function.
    """
    by_node = {table.node: table for table in tables}
    for name, s in by_node:
        if name not in compiled.cardinality:
            raise InputError(f"{name}: the compiled network has no such node (slice {s})")
    for node, place in compiled.places.items():
        if node not in by_node:
            raise InputError(f"{node[0]}: no table for slice {node[1]}")
        by_node[node] = table = _aligned(by_node[node], place)
        first = by_node.get((node[0], 0), table)
        if place.kind == "emission" and first is not table and not same_within(first, table):
            raise InputError(f"{node[0]}: its table differs between the slices")
    for node, fixed in compiled._functions.items():
        if node in by_node and not _is_equal(by_node[node], fixed):
            raise InputError(f"{node[0]}: another function needs the network compiled anew")
    prior, transition, emissions = _fill(compiled, by_node)
    groups = tuple(
        replace(group, emission=emission)
        for group, emission in zip(compiled.groups, emissions, strict=True)
    )
    return replace(compiled, prior=prior, transition=transition, groups=groups)


def _aligned(table: Table, place: Placement) -> Table:
    """The table with its parents in the order of the compiled one."""
    if table.parents != place.parents and set(table.parents) == set(place.parents):
        order = [table.parents.index(p) for p in place.parents]
        values = table.values.transpose(*order, len(order))
        table = Table(table.node, place.parents, values)
    if table.parents != place.parents or table.values.shape != place.shape:
        raise InputError(
            f"{table.node[0]}: the table has other parents or another shape than before"
        )
    return table


def _is_equal(table: Table, other: Table) -> bool:
    return table.parents == other.parents and np.array_equal(table.values, other.values)


def _assemble(roles: Roles, tables: Mapping[SliceNode, Table]) -> Compiled:
    n_states = len(roles.values[roles.state[0]])
    n_inputs = math.prod(roles.cardinality[n] for n in roles.inputs)
    groups = [_group(roles, keys) for keys in _joined(roles)]
    input_value: dict[str, IntArray] = {}
    if roles.inputs:
        sizes = [roles.cardinality[n] for n in roles.inputs]
        digits = np.indices(sizes).reshape(len(sizes), -1)
        input_value = dict(zip(roles.inputs, digits, strict=True))

    plan: dict[SliceNode, Placement] = {}
    for name in roles.state:
        for s, kind in ((0, "prior"), (1, "transition")):
            table = tables[name, s]
            indices = []
            for node, node_slice in (*table.parents, (name, s)):
                if node in input_value:
                    shape = (-1, 1) if s == 0 else (-1, 1, 1)
                    indices.append(input_value[node].reshape(shape))
                else:
                    before = s == 1 and node_slice == 0
                    shape = (1, -1) if s == 0 else (1, -1, 1) if before else (1, 1, -1)
                    indices.append(roles.values[node].reshape(shape))
            plan[name, s] = Placement(kind, -1, table.parents, table.values.shape, tuple(indices))
    for g, group in enumerate(groups):
        column = dict(
            zip(group.nodes, np.indices(group.sizes).reshape(len(group.sizes), -1), strict=True)
        )
        for name in group.nodes:
            if name in roles.values:
                continue
            table = tables[name, 1]
            indices = [
                column[node][None, :] if node in column else roles.values[node][:, None]
                for node, _ in (*table.parents, (name, 1))
            ]
            plan[name, 1] = Placement(
                "emission", g, table.parents, table.values.shape, tuple(indices)
            )
    blank = Compiled(
        roles.hidden,
        roles.state,
        roles.inputs,
        roles.cardinality,
        np.stack([roles.values[name] for name in roles.hidden]),
        np.ones((n_inputs, n_states)),
        np.ones((n_inputs, n_states, n_states)),
        tuple(groups),
        plan,
        {(name, s): tables[name, s] for name in roles.functions for s in (0, 1)},
    )
    return with_tables(blank, tables.values())


def _joined(roles: Roles) -> list[list[Observed]]:
    """Evidence keys that must share one emission table: those whose unobserved variables are
    linked by an edge or by a common virtual-evidence node. In the order declared: Jeffrey's rule
    does not commute."""
    clusters: list[tuple[set[str], list[Observed]]] = []
    for key in roles.observed:
        leaves = {n for n in roles.ve[ve_name(key)] if n in roles.leaves}
        linked = leaves | {
            p for n in leaves for p, _ in roles.tables[n, 1].parents if p in roles.leaves
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
    joined = [sorted(keys, key=roles.observed.index) for _, keys in clusters]
    return sorted(joined, key=lambda keys: roles.observed.index(keys[0]))


def _group(roles: Roles, keys: list[Observed]) -> Group:
    nodes = tuple(dict.fromkeys(n for key in keys for n in roles.ve[ve_name(key)]))
    sizes = tuple(roles.cardinality[n] for n in nodes)
    axes = tuple(tuple(nodes.index(n) for n in roles.ve[ve_name(key)]) for key in keys)
    mask = np.ones((len(roles.values[roles.state[0]]), math.prod(sizes)))
    columns = np.indices(sizes).reshape(len(sizes), -1)
    for k, name in enumerate(nodes):
        if name in roles.values:
            mask *= roles.values[name][:, None] == columns[k][None, :]
    return Group(tuple(keys), nodes, sizes, axes, mask, mask)


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
