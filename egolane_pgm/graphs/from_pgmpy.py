"""Reads a pgmpy network into tables with named axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork


def read_tables(network: DynamicBayesianNetwork) -> dict[SliceNode, Table]:
    """Every CPD as a Table with named axes, checked against the network's edges."""
    names = dict.fromkeys(_plain(n)[0] for n in network.nodes())
    parents: dict[SliceNode, set[SliceNode]] = {(n, s): set() for n in names for s in (0, 1)}
    for start, end in network.edges():
        parents[_plain(end)].add(_plain(start))
    tables: dict[SliceNode, Table] = {}
    for cpd in network.cpds:
        node, *given = (_plain(v) for v in cpd.variables)
        if node in tables:
            raise InputError(f"{node[0]}: two tables for slice {node[1]}")
        if node not in parents or set(given) != parents[node]:
            raise InputError(
                f"{node[0]} in slice {node[1]}: its table is given"
                f" {_names(given)}, its edges come from {_names(parents.get(node, set()))}"
            )
        values = np.moveaxis(np.asarray(cpd.values, dtype=np.float64), 0, -1)
        tables[node] = Table(node, tuple(given), values)
    for node in parents:
        if node not in tables:
            raise InputError(
                f"{node[0]}: no table for slice {node[1]}; declare both slices in full"
            )
    cardinality = {name: tables[name, 0].values.shape[-1] for name in names}
    for table in tables.values():
        name, size = table.node[0], table.values.shape[-1]
        if size != cardinality[name]:
            raise InputError(
                f"{name}: has {cardinality[name]} values in the first frame and {size} later"
            )
        for parent, size in zip(table.parents, table.values.shape, strict=False):
            if cardinality[parent[0]] != size:
                raise InputError(
                    f"{table.node[0]}: its table has {size} rows for {parent[0]}, which has"
                    f" {cardinality[parent[0]]} values"
                )
    return tables


def read_values(network: DynamicBayesianNetwork) -> dict[str, tuple[str, ...]]:
    """The names of the values of every node that has names other than pgmpy's own, 0, 1, ..."""
    names: dict[str, tuple[str, ...]] = {}
    for cpd in network.cpds:
        node, given = _plain(cpd.variable)[0], list(cpd.state_names[cpd.variable])
        if given != list(range(len(given))):
            named = tuple(map(str, given))
            if names.setdefault(node, named) != named:
                raise InputError(f"{node}: the names of its values differ between the slices")
    return names


def _plain(node: Any) -> SliceNode:
    return (str(node[0]), int(node[1]))


def _names(nodes: Iterable[SliceNode]) -> str:
    return (
        ", ".join(sorted(f"{name}[{'t' if s == 0 else 't+1'}]" for name, s in nodes)) or "nothing"
    )
