"""Compile a two-slice network into arrays over its joint state.

`graphs.from_pgmpy` reads the tables. Networks that do not fit the roles below are refused here,
naming the node, so the filters do not check again. Each node has one role:

- An input is a root whose value is given in every frame. It selects among its children's tables.
- A function is a hidden node that is determined by other nodes of its frame.
- A plain emission is an observed node that depends on its frame only and on no input, by the same
  table in every frame. Its children, if any, are plain emissions.
- Every other node, hidden or observed, is in the joint state.

A joint state has one value for each node of the last kind; the filters propagate a belief over the
joint states. If later frames do not depend on a node, the rows of the transition are equal for all
its values, so that the next step sums it out. Evidence of a node in the joint state is the
likelihood of the states with these values.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

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

#: Why an observed node is in the joint state.
_NOT_PLAIN = "an edge across the slices, an input, a carried child or another first table"


@dataclass(frozen=True)
class Group:
    """Observed nodes with a common emission table.

    observed: the keys of the evidence, in order. nodes: the network nodes that index the columns.
    sizes: their cardinalities; K is their product. axes: per observed key the positions of its
    nodes in `nodes`. emission (S, K): P(nodes | joint state). mask (S, K): 1 if the joint state and
    the column agree on all nodes that are in both, else 0.
    """

    observed: tuple[Observed, ...]
    nodes: tuple[str, ...]
    sizes: tuple[int, ...]
    axes: tuple[tuple[int, ...], ...]
    emission: FloatArray
    mask: FloatArray


class Placement(NamedTuple):
    """The array that a table is a factor of: `target` is "prior", "transition" or the number of a
    group (its emission), `indices` (a broadcastable array per axis) select the table's entries."""

    target: str | int
    indices: tuple[IntArray, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Compiled:
    """A network as arrays: S joint states, U joint values of the inputs (1 without inputs).

    hidden: the nodes of the beliefs.
    state_nodes: the nodes of the joint state, the largest one last; the first one's values vary
        slowest.
    n_states: the number S of joint states.
    inputs: the input nodes, the first one's values vary slowest in U.
    cardinality: of every node.
    node_value: the value of each hidden node and each node of the joint state, (S,).
    prior (U, S): P(joint state of the first frame), before its evidence.
    transition (U, S, S): row is the previous state.
    groups: the emissions.
    places: the array that each table is a factor of.
    tables: the table of every node but the virtual-evidence ones, in both slices.
    values: the names of each of these nodes' values.
    start (n,): likelihood of the lane before the first frame (`with_initial_lane`), or None.
    """

    hidden: tuple[str, ...]
    state_nodes: tuple[str, ...]
    n_states: int
    inputs: tuple[str, ...]
    cardinality: Mapping[str, int]
    node_value: Mapping[str, IntArray]
    prior: FloatArray
    transition: FloatArray
    groups: tuple[Group, ...]
    places: Mapping[SliceNode, Placement]
    tables: Mapping[SliceNode, Table]
    values: Mapping[str, tuple[str, ...]]
    start: FloatArray | None = None

    def __repr__(self) -> str:
        nodes = " x ".join(f"{name} ({self.cardinality[name]})" for name in self.state_nodes)
        seen = ", ".join(key if isinstance(key, str) else "+".join(key) for key in self.observed)
        return f"Compiled({nodes}: {self.n_states} joint states; observes {seen})"

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
        """The network in pgmpy, declared from the tables, with the names of the values.

        The tables of its virtual-evidence nodes (`WOR_ve`) are placeholders; for frames with their
        evidence see `unrolled`.
        """
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
    values: Mapping[str, Sequence[str]] | None = None,
) -> Compiled:
    """Compile a pgmpy network into the arrays that the filters take.

    - network: a `DynamicBayesianNetwork`, before or after `initialize_initial_state()`; a
      `DiscreteBayesianNetwork` of two slices, with nodes named `Lane_0` and `Lane_1`; or the path
      of a BIF or XMLBIF file with such a network.
    - observed: the nodes, or tuples of nodes, with evidence.
    - hidden: the nodes of the beliefs; by default Lane and all nodes that are neither observed nor
      inputs.
    - inputs: nodes without parents whose value is known in every frame.
    - values: names of nodes' values, instead of the network's. By default those of LANES count
      from 1 and those of any other node from 0.

    Warns of observed nodes without a virtual-evidence child, which is added. Raises InputError,
    naming the node or the file, for anything that the filters do not support.

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
    >>> ego.filter_beliefs(compiled, seen).lane.round(3).tolist()
    [[0.8, 0.2], [0.919, 0.081]]
    """
    for what, given in (("observed", observed), ("hidden", hidden), ("inputs", inputs)):
        if isinstance(given, str):
            raise InputError(f"{what}: needs a list of nodes, e.g. [{given!r}]")
    observed = [key if isinstance(key, str) else tuple(key) for key in observed]
    declared = read_network(network)
    names_of = {key: (key,) if isinstance(key, str) else key for key in observed}
    if hidden is None:
        others = {*inputs, *map(ve_name, observed), *chain.from_iterable(names_of.values())}
        nodes = dict.fromkeys(name for name, _ in declared.tables)
        hidden = [name for name in nodes if name == "Lane" or name not in others]
    tables, missing = _without_virtual_evidence(declared.tables, names_of)
    compiled = compile_tables(
        list(tables.values()),
        observed=tuple(observed),
        hidden=tuple(hidden),
        inputs=tuple(inputs),
        values={**declared.values, **(values or {})},
    )
    if missing:
        warnings.warn(
            f"{NOTE}the network has no {', '.join(missing)}: missing"
            " virtual-evidence nodes are added",
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
    """Compile tables without importing pgmpy, which takes a second.

    - tables: of all nodes but the virtual-evidence ones, in both slices.
    - observed, hidden, inputs, values: as in `compile`.

    Raises InputError, naming the node, for tables that do not fit each other.
    """
    of_node = {table.node: table for table in tables}
    names_of = {key: (key,) if isinstance(key, str) else key for key in observed}
    _check_declared(of_node, hidden, names_of, observed, inputs)
    check_tables(tables, observed)
    aligned = {}
    for (name, s), table in of_node.items():
        parents = tuple((p, s) for p, _ in of_node[name, 1].parents)
        if table.parents != parents and sorted(table.parents) == sorted(parents):
            table = _in_order(table, parents)
        aligned[name, s] = table
    size = {name: t.values.shape[-1] for (name, s), t in of_node.items() if s == 0}
    nodes = tuple(dict.fromkeys(chain.from_iterable(names_of.values())))
    functions, emissions, state = _parts(aligned, hidden, nodes, inputs)
    if not state:
        raise InputError(
            f"every hidden node ({', '.join(hidden)}) is a constant, so there is nothing to filter"
        )
    n_states = math.prod(size[n] for n in state)
    if n_states > MAX_STATES:
        seen = [n for n in state if n not in hidden]
        why = f"; {', '.join(seen)}: observed, but no plain emission ({_NOT_PLAIN})" if seen else ""
        sizes = " x ".join(f"{n} {size[n]}" for n in state)
        raise InputError(
            f"the joint state has {n_states} values ({sizes}), more than {MAX_STATES}{why}"
        )
    node_value = _value_of(state, size)
    for name in functions:
        table = aligned[name, 1]
        value = table.values.argmax(axis=-1)[tuple(node_value[p] for p, _ in table.parents)]
        node_value[name] = np.broadcast_to(value, n_states)
    groups = _groups(aligned, names_of, emissions, size, node_value, n_states)
    n_inputs = math.prod(size[n] for n in inputs)
    names = {}
    for node, n_values in size.items():
        names[node] = tuple(map(str, (values or {}).get(node, default_values(node, n_values))))
        if len(set(names[node])) != n_values or len(names[node]) != n_values:
            raise InputError(
                f"{node}: has {n_values} values, but their names are {', '.join(names[node])}"
            )
    blank = Compiled(
        hidden,
        tuple(state),
        n_states,
        inputs,
        {**size, **{ve_name(key): 2 for key in observed}},
        node_value,
        np.ones((n_inputs, n_states)),
        np.ones((n_inputs, n_states, n_states)),
        groups,
        _places(aligned, state, groups, emissions, node_value, _value_of(inputs, size)),
        aligned,
        names,
    )
    return _filled(blank, aligned)


def default_values(node: str, size: int) -> tuple[str, ...]:
    """Return the default names of a node's values: LANES count from 1, all others from 0."""
    first = 1 if node in LANES else 0
    return tuple(map(str, range(first, first + size)))


def with_tables(compiled: Compiled, tables: Iterable[Table]) -> Compiled:
    """Return the network with new numbers in some of its tables, without using pgmpy.

    The numbers may change a node's role: a function may become uncertain, an emission's table may
    differ between the slices. The network is then compiled again.

    Raises InputError, naming the node, for a table with other parents or another shape.
    """
    now = dict(compiled.tables)
    for table in tables:
        name, s = table.node
        if name not in compiled.cardinality:
            raise InputError(f"{name}: the compiled network has no such node (slice {s})")
        if table.node not in now:
            continue  # a virtual-evidence node
        old = now[table.node]
        if table.parents != old.parents and sorted(table.parents) == sorted(old.parents):
            table = _in_order(table, old.parents)
        now[table.node] = table
        if table.parents != old.parents or table.values.shape != old.values.shape:
            raise InputError(f"{name}: the table has other parents or another shape than before")
    functions = compiled.functions
    plain = [n[0] for n, place in compiled.places.items() if isinstance(place.target, int)]
    keeps_layout = all(_is_same(now[name, 0], now[name, 1]) for name in plain) and all(
        np.array_equal(now[name, s].values, compiled.tables[name, s].values)
        for name in functions
        for s in (0, 1)
    )
    if keeps_layout:
        filled = _filled(compiled, now)
    else:
        filled = compile_tables(
            list(now.values()),
            observed=compiled.observed,
            hidden=compiled.hidden,
            inputs=compiled.inputs,
            values=compiled.values,
        )
    return filled if compiled.start is None else with_initial_lane(filled, compiled.start)


def with_initial_lane(compiled: Compiled, start: FloatArray) -> Compiled:
    """Return the network with virtual evidence of Lane before the first frame.

    - start (n,): the likelihood of each lane, not all 0. The prior is 0 for an input that excludes
      all these lanes.
    """
    prior = compiled.prior * start[compiled.node_value["Lane"]]
    total = prior.sum(axis=1, keepdims=True)
    return replace(compiled, prior=prior / np.where(total > 0, total, 1), start=start)


def _filled(compiled: Compiled, tables: Mapping[SliceNode, Table]) -> Compiled:
    """Return the network with the arrays of these tables; their roles must be unchanged."""
    arrays: dict[str | int, FloatArray] = {
        "prior": np.ones_like(compiled.prior),
        "transition": np.ones_like(compiled.transition),
        **{g: group.mask.copy() for g, group in enumerate(compiled.groups)},
    }
    for node, place in compiled.places.items():
        arrays[place.target] *= tables[node].values[place.indices]
    return replace(
        compiled,
        prior=arrays["prior"],
        transition=arrays["transition"],
        groups=tuple(replace(group, emission=arrays[g]) for g, group in enumerate(compiled.groups)),
        tables=tables,
    )


def _in_order(table: Table, parents: tuple[SliceNode, ...]) -> Table:
    """Return the table with its parents in this order."""
    order = [table.parents.index(p) for p in parents]
    return Table(table.node, parents, table.values.transpose(*order, len(order)))


def _is_same(first: Table, later: Table) -> bool:
    """Return whether two tables of a node, with parents in the same order, differ by slice only."""
    return later.parents == tuple((p, 1) for p, _ in first.parents) and (
        first.values is later.values or np.allclose(first.values, later.values, rtol=0, atol=1e-12)
    )


# --- roles ----------------------------------------------------------------------------------------


def _without_virtual_evidence(
    tables: Mapping[SliceNode, Table], names_of: Mapping[Observed, tuple[str, ...]]
) -> tuple[dict[SliceNode, Table], list[str]]:
    """Return the tables of all other nodes, and the missing virtual-evidence nodes."""
    ve = {ve_name(key): names for key, names in names_of.items()}
    kept = {}
    for (name, s), table in tables.items():
        if name not in ve:
            kept[name, s] = table
        elif table.values.shape[-1] != 2:
            raise InputError(f"{name}: a virtual-evidence node is binary")
        elif set(table.parents) != {(n, s) for n in ve[name]}:
            raise InputError(f"{name}: its parents must be {', '.join(ve[name])} in the same slice")
    for table in kept.values():
        for parent, _ in table.parents:
            if parent in ve:
                raise InputError(f"{parent}: a virtual-evidence node may not have children")
    return kept, [name for name in ve if (name, 0) not in tables]


def _check_declared(
    tables: Mapping[SliceNode, Table],
    hidden: Sequence[str],
    names_of: Mapping[Observed, tuple[str, ...]],
    observed: Sequence[Observed],
    inputs: Sequence[str],
) -> None:
    """Raise InputError if the declaration does not fit the tables."""
    seen = list(chain.from_iterable(names_of.values()))
    names = {name for name, _ in tables}
    for name in (*hidden, *inputs, *seen):
        if name not in names:
            raise InputError(
                f"{name}: declared, but not a node of the network{suggestion(name, names)}"
            )
    for declared in (hidden, inputs, map(ve_name, observed), *names_of.values()):
        for key, times in Counter(declared).items():
            if times > 1:
                raise InputError(f"{key}: declared more than once")
    for name in sorted(names.difference(hidden, inputs, seen)):
        raise InputError(f"{name}: neither hidden, observed, input nor virtual evidence")
    if not hidden:
        raise InputError("no hidden node is declared, so there is nothing to filter")
    for name in inputs:
        if name in hidden or name in seen:
            what = "hidden" if name in hidden else "observed"
            raise InputError(f"{name}: is declared both {what} and input")
        if any(table.parents for (node, _), table in tables.items() if node == name):
            raise InputError(f"{name}: an input node may not have parents")
        if any((name, 0) in table.parents for (_, s), table in tables.items() if s == 1):
            raise InputError(f"{name}: an input acts within its slice only")


def _parts(
    tables: Mapping[SliceNode, Table],
    hidden: Sequence[str],
    nodes: Sequence[str],
    inputs: Collection[str],
) -> tuple[list[str], set[str], list[str]]:
    """Return the functions in topological order, the plain emissions, and the nodes of the joint
    state. nodes: the observed ones."""
    plain, previous = set(), set()
    for (name, s), table in tables.items():
        if s == 1:
            previous |= {p for p, ps in table.parents if ps == 0}
            is_chosen = any(p in inputs for p, _ in table.parents)
            if not is_chosen and _is_same(tables[name, 0], table):
                plain.add(name)
    emissions = plain.intersection(nodes).difference(hidden)
    others = [table for (name, _), table in tables.items() if name not in emissions]
    while others:
        for parent, _ in others.pop().parents:
            if parent in emissions:
                emissions.remove(parent)
                others += [tables[parent, 0], tables[parent, 1]]
    sources = {}
    for name in hidden:
        table = tables[name, 1]
        is_drawn = name not in plain or name in previous
        if not is_drawn and np.isin(table.values, (0.0, 1.0)).all():
            sources[name] = [p for p, _ in table.parents]
    functions = [name for name in TopologicalSorter(sources).static_order() if name in sources]
    carried = [n for n in dict.fromkeys((*hidden, *nodes)) if n not in {*sources, *emissions}]
    # The largest node last, so that its values are contiguous in memory.
    state = sorted(carried, key=lambda name: tables[name, 0].values.shape[-1])
    return functions, emissions, state


# --- arrays ---------------------------------------------------------------------------------------


def _value_of(nodes: Sequence[str], cardinality: Mapping[str, int]) -> dict[str, IntArray]:
    """Return the value of each node in each joint value; the first node's vary slowest."""
    sizes = [cardinality[n] for n in nodes]
    values = np.indices(sizes).reshape(len(sizes), math.prod(sizes))
    return dict(zip(nodes, values, strict=True))


def _groups(
    tables: Mapping[SliceNode, Table],
    names_of: Mapping[Observed, tuple[str, ...]],
    emissions: Collection[str],
    size: Mapping[str, int],
    node_value: Mapping[str, IntArray],
    n_states: int,
) -> tuple[Group, ...]:
    """Return the groups in the order declared. Keys share a group if their plain emissions are
    linked by an edge or a common virtual-evidence node."""
    observed = list(names_of)
    clusters: list[tuple[set[str], list[int]]] = []
    for k, key in enumerate(observed):
        linked = {n for n in names_of[key] if n in emissions}
        for name in list(linked):
            linked |= {p for p, _ in tables[name, 1].parents if p in emissions}
        members = [k]
        for cluster in list(clusters):
            if cluster[0] & linked:
                clusters.remove(cluster)
                linked |= cluster[0]
                members = sorted(cluster[1] + members)
        clusters.append((linked, members))
    groups = []
    for members in sorted(members for _, members in clusters):
        keys = tuple(observed[k] for k in members)
        nodes = tuple(dict.fromkeys(chain.from_iterable(map(names_of.__getitem__, keys))))
        sizes = tuple(size[n] for n in nodes)
        axes = tuple(tuple(map(nodes.index, names_of[key])) for key in keys)
        mask = np.ones((n_states, math.prod(sizes)))
        for name, column in _value_of(nodes, size).items():
            if name in node_value:
                mask *= node_value[name][:, None] == column
        groups.append(Group(keys, nodes, sizes, axes, mask, mask))
    return tuple(groups)


def _places(
    tables: Mapping[SliceNode, Table],
    state: Sequence[str],
    groups: Sequence[Group],
    emissions: Collection[str],
    node_value: Mapping[str, IntArray],
    input_value: Mapping[str, IntArray],
) -> dict[SliceNode, Placement]:
    """Return the placement of the tables of the joint state and of plain emissions."""
    places = {}
    for name in state:
        for s, target in ((0, "prior"), (1, "transition")):
            indices = []
            for node, at in (*tables[name, s].parents, (name, s)):
                # The axes: inputs, state at t, and in the transition state at t + 1.
                is_input = node in input_value
                shape = [1] * (2 + s)
                shape[0 if is_input else 1 + at] = -1
                indices.append((input_value if is_input else node_value)[node].reshape(shape))
            places[name, s] = Placement(target, tuple(indices))
    for g, group in enumerate(groups):
        column = _value_of(group.nodes, dict(zip(group.nodes, group.sizes, strict=True)))
        for name in group.nodes:
            if name in emissions:
                nodes = [n for n, _ in (*tables[name, 1].parents, (name, 1))]
                places[name, 1] = Placement(
                    g, tuple(column[n] if n in column else node_value[n][:, None] for n in nodes)
                )
    return places
