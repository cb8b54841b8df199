"""Which node of a declared network is what, and all that is refused because of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, ve_name
from egolane_pgm.types import InputError, IntArray, Observed, suggestion

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

#: More joint states than this are refused.
MAX_STATES = 4096

#: A transition or emission array with more entries than this (512 MiB) is refused.
MAX_ENTRIES = 2**26


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


def _plain(node: Any) -> SliceNode:
    return (str(node[0]), int(node[1]))


def _names(nodes: Iterable[SliceNode]) -> str:
    return (
        ", ".join(sorted(f"{name}[{'t' if s == 0 else 't+1'}]" for name, s in nodes)) or "nothing"
    )


class Roles:
    """Which node is what; raises InputError where the declaration and the tables disagree."""

    def __init__(
        self,
        tables: Mapping[SliceNode, Table],
        hidden: tuple[str, ...],
        observed: tuple[Observed, ...],
        inputs: tuple[str, ...],
    ) -> None:
        self.tables = tables
        self.hidden = hidden
        self.observed = observed
        self.inputs = inputs
        self.cardinality = {name: t.values.shape[-1] for (name, _), t in tables.items()}
        names = set(self.cardinality)
        self.ve = {ve_name(key): (key,) if isinstance(key, str) else key for key in observed}
        listed = [n for key in self.ve.values() for n in key]
        repeats = [*_repeats(hidden), *_repeats(inputs), *_repeats(map(ve_name, observed))]
        for name in (*repeats, *(n for key in self.ve.values() for n in _repeats(key))):
            raise InputError(f"{name}: declared more than once")
        for name in (*hidden, *inputs, *listed):
            if name not in names:
                raise InputError(
                    f"{name}: declared, but not a node of the network{suggestion(name, names)}"
                )
        for name in self.ve:
            if name not in names:
                raise InputError(f"{name}: an observed node needs this virtual-evidence child")
        known = {*hidden, *inputs, *listed, *self.ve}
        for name in sorted(names - known):
            raise InputError(f"{name}: neither hidden, observed, input nor virtual evidence")
        across = {
            name
            for (child, s), table in tables.items()
            for parent, ps in table.parents
            if s == 1 and ps == 0
            for name in (parent, child)
        }
        self.state = tuple(name for name in hidden if name in across)
        self.functions = tuple(name for name in hidden if name not in across)
        self.leaves = tuple(dict.fromkeys(n for n in listed if n not in hidden))
        self._check_leaves(across)
        self._check_inputs(across)
        self._check_ve()
        if not self.state:
            raise InputError(
                f"no hidden node ({', '.join(hidden) or 'none declared'}) has an edge across the"
                " slices, so there is nothing to filter"
            )
        self._check_size()
        digits = np.indices([self.cardinality[n] for n in self.state]).reshape(len(self.state), -1)
        self.values: dict[str, IntArray] = dict(zip(self.state, digits, strict=True))
        self._add_functions()

    def _check_size(self) -> None:
        n_states = math.prod(self.cardinality[n] for n in self.state)
        if n_states > MAX_STATES:
            raise InputError(
                f"the joint hidden state has {n_states} values ({self._sizes(self.state)}), more"
                f" than {MAX_STATES}"
            )
        n_inputs = math.prod(self.cardinality[n] for n in self.inputs)
        if n_inputs * n_states**2 > MAX_ENTRIES:
            raise InputError(
                f"the transition has {n_inputs} x {n_states} x {n_states} entries"
                f" ({self._sizes((*self.inputs, *self.state))}), more than {MAX_ENTRIES}"
            )
        for of in self.ve.values():
            if n_states * math.prod(self.cardinality[n] for n in of) > MAX_ENTRIES:
                raise InputError(
                    f"{', '.join(of)}: {self._sizes(of)} values for {n_states} joint states are"
                    f" more than {MAX_ENTRIES} entries"
                )

    def _sizes(self, names: Iterable[str]) -> str:
        return " x ".join(f"{n} {self.cardinality[n]}" for n in names)

    def _check_leaves(self, across: set[str]) -> None:
        for name in self.leaves:
            if name in across:
                raise InputError(f"{name}: observed nodes may not have edges across the slices")
            if name in self.inputs:
                raise InputError(f"{name}: is declared both observed and input")
            first, later = self.tables[name, 0], self.tables[name, 1]
            if not same_within(first, later):
                raise InputError(f"{name}: its table differs between the slices")
            for parent, _ in first.parents:
                if parent in self.inputs:
                    raise InputError(f"{name}: an observed node may not depend on input {parent}")
        for (child, _), table in self.tables.items():
            for parent, _ in table.parents:
                if parent in self.leaves and child in self.hidden:
                    raise InputError(f"{child}: a hidden node may not depend on observed {parent}")

    def _check_inputs(self, across: set[str]) -> None:
        for name in self.inputs:
            if name in self.hidden:
                raise InputError(f"{name}: is declared both hidden and input")
            if self.tables[name, 0].parents or self.tables[name, 1].parents:
                raise InputError(f"{name}: an input node may not have parents")
            if name in across:
                raise InputError(f"{name}: an input acts within its slice only")

    def _check_ve(self) -> None:
        for name, of in self.ve.items():
            if self.cardinality[name] != 2:
                raise InputError(f"{name}: a virtual-evidence node is binary")
            for s in (0, 1):
                if set(self.tables[name, s].parents) != {(n, s) for n in of}:
                    raise InputError(
                        f"{name}: its parents must be {', '.join(of)} in the same slice"
                    )
            if any(p == name for t in self.tables.values() for p, _ in t.parents):
                raise InputError(f"{name}: a virtual-evidence node may not have children")

    def _add_functions(self) -> None:
        waiting = list(self.functions)
        while waiting:
            ready = [
                name
                for name in waiting
                if all(p in self.values for p, _ in self.tables[name, 1].parents)
            ]
            if not ready:
                raise InputError(
                    f"{waiting[0]}: a hidden node without an edge across the slices must be a"
                    " function of other hidden nodes in its slice"
                )
            for name in ready:
                table = self.tables[name, 1]
                if not same_within(self.tables[name, 0], table):
                    raise InputError(f"{name}: its table differs between the slices")
                if not np.isin(table.values, (0.0, 1.0)).all():
                    raise InputError(
                        f"{name}: a hidden node without an edge across the slices must be a"
                        " deterministic function of its parents (a table of zeros and ones)"
                    )
                index = tuple(self.values[p] for p, _ in table.parents)
                value = np.asarray(table.values.argmax(axis=-1))[index]
                self.values[name] = np.broadcast_to(value, self.values[self.state[0]].shape)
                waiting.remove(name)


def _repeats(names: Iterable[str]) -> list[str]:
    """What occurs more than once."""
    seen: set[str] = set()
    return [n for n in names if n in seen or seen.add(n)]  # type: ignore[func-returns-value]


def same_within(first: Table, later: Table) -> bool:
    """Whether two tables of one node say the same of their own slices, whatever the axis order."""
    names = [p for p, _ in first.parents]
    others = [p for p, _ in later.parents]
    if set(names) != set(others) or any(s != 1 for _, s in later.parents):
        return False
    if names == others and first.values is later.values:
        return True
    aligned = later.values.transpose(*(others.index(n) for n in names), len(names))
    return first.values.shape == aligned.shape and bool(
        np.allclose(first.values, aligned, rtol=0, atol=1e-12)
    )
