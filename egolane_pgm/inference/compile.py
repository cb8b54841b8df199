"""Compile a two-slice network into arrays over its joint state.

`graphs.from_pgmpy` reads the tables. Networks that do not fit the roles below are refused here,
naming the node, so the filters do not check again. Each node has one role:

- An input is a root whose value is given in every frame. It selects among its children's tables.
- A function is a hidden node that is determined by other nodes of its frame.
- A plain emission is a node without children that has one evidence, alone or jointly with others.
  It depends on its frame only and on no input, by the same table in every frame.
- Every other node, hidden or observed, is in the joint state.

A joint state has one value for each node of the last kind; the filters propagate a belief over the
joint states. If later frames do not depend on a node, the rows of the transition are equal for all
its values, so that the next step sums it out. Evidence of a node in the joint state is the
likelihood of the states with these values.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from itertools import chain
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, check_tables, declare, ve_name
from egolane_pgm.graphs.from_pgmpy import read_network
from egolane_pgm.types import Evidence, FloatArray, InputError, IntArray, Observed, suggestion

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

P = ParamSpec("P")
R = TypeVar("R")

#: The nodes whose values are lanes.
LANES = ("Lane", "DetectorOutput")

#: More joint states than this are refused.
MAX_STATES = 4096


@dataclass(frozen=True)
class Group:
    """The evidence of a node, or of several nodes jointly.

    observed: the key of the evidence. K is the number of joint values of its nodes, the first one's
    vary slowest. emission (S, K): P(values | joint state), 0 if they differ from those in the joint
    state. only (S,): the only possible value in each joint state, None if a state has several.
    """

    observed: Observed
    emission: FloatArray
    only: IntArray | None


class Placement(NamedTuple):
    """The place of a table in the arrays. It is multiplied into `target`: "prior", "transition" or
    the number of a group (its emission). `indices`, a broadcastable array per axis, select its
    entries."""

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
    column (N, S): the value of each of the N nodes of the joint state; the values of all of them
        are numbered consecutively.
    indicator (S, M): beliefs over the joint state (T, S) times this are the concatenated marginals
        of the hidden nodes (T, M).
    parts: the columns of each hidden node in `indicator`, nodes of the joint state first.
    prior (U, S): P(joint state of the first frame), before its evidence.
    transition (U, S, S): row is the previous state.
    groups: the emissions, one for each key of the evidence.
    places: the place of each table in these arrays.
    tables: the table of every node but the virtual-evidence ones, in both slices.
    one_table: the nodes with the same table in the first frame and in all later ones.
    values: the names of each of these nodes' values.
    start (n,): likelihood of the lane before the first frame (`with_initial_lane`), or None.
    """

    hidden: tuple[str, ...]
    state_nodes: tuple[str, ...]
    n_states: int
    inputs: tuple[str, ...]
    cardinality: Mapping[str, int]
    node_value: Mapping[str, IntArray]
    column: IntArray
    indicator: FloatArray
    parts: Mapping[str, slice]
    prior: FloatArray
    transition: FloatArray
    groups: tuple[Group, ...]
    places: Mapping[SliceNode, Placement]
    tables: Mapping[SliceNode, Table]
    one_table: Collection[str]
    values: Mapping[str, tuple[str, ...]]
    start: FloatArray | None = None

    def __repr__(self) -> str:
        nodes = " x ".join(f"{name} ({self.cardinality[name]})" for name in self.state_nodes)
        seen = ", ".join(key if isinstance(key, str) else "+".join(key) for key in self.observed)
        return f"Compiled({nodes}: {self.n_states} joint states; observes {seen})"

    @property
    def observed(self) -> tuple[Observed, ...]:
        """The keys that the evidence must have."""
        return tuple(group.observed for group in self.groups)

    @property
    def network(self) -> DynamicBayesianNetwork:
        """The network in pgmpy, declared from the tables, with the names of the values.

        The tables of its virtual-evidence nodes (`WOR_ve`) are placeholders; for frames with their
        evidence see `unrolled`.
        """
        return declare(self.tables.values(), self.observed, self.values)


def counted_tables(compiled: Compiled) -> dict[SliceNode, Table]:
    """Return the tables with counts: both slices of a node with two tables, else slice 1.

    Functions and tables that an input selects are left out.
    """
    nodes = [(n, 1) if n in compiled.one_table else (n, s) for n, s in compiled.places]
    return {
        node: compiled.tables[node]
        for node in nodes
        if not any(parent in compiled.inputs for parent, _ in compiled.tables[node].parents)
    }


def free_parameters(tables: Mapping[SliceNode, Table], bases: Iterable[SliceNode] = ()) -> int:
    """Return the number of free numbers of the tables of later frames.

    These are the entries above zero but one of each row.

    - bases: nodes whose table repeats the value before with one probability; its other entries are
      counted without the repetition, and one for it.

    Tables of the first frame alone do not count: one frame of a sequence informs them, and the
    logarithm of one, in BIC, is zero (Friedman, Murphy and Russell 1998).
    """
    bases = set(bases)
    total = 0
    for node in (node for node in tables if node[1] == 1):
        # Repetition adds to one value of each row only.
        values = tables[node].values.min(axis=-2) if node in bases else tables[node].values
        total += int(np.maximum((values > 0).sum(axis=-1) - 1, 0).sum()) + (node in bases)
    return total


def compiled_of(given: Any, evidence: Evidence | None = None) -> Compiled:
    """Return the arrays of anything with a model (a result, a study, ...), or of a pgmpy network.

    - evidence: a network observes its nodes; without it those with a virtual-evidence child, or
      else all without children.

    Raises InputError for anything else.
    """
    found = getattr(given, "model", given)
    found = getattr(found, "compiled", found)
    if isinstance(found, Compiled):
        return found
    if not hasattr(found, "get_cpds"):
        kind = type(given).__name__
        raise InputError(f"{kind} is not a model: give a result, a study, a model or a network")
    if evidence is not None:
        return compile(found, observed=[*evidence.likelihoods], inputs=[*evidence.inputs])
    tables = read_network(found).tables
    names = dict.fromkeys(name for name, _ in tables)
    parents = {name for table in tables.values() for name, _ in table.parents}
    seen = [name for name in names if ve_name(name) in names]
    leaves = [name for name in names if name not in {*parents, "Lane"}]
    return compile(found, observed=seen or leaves)


def takes_any_model(
    function: Callable[Concatenate[Compiled, P], R],
) -> Callable[Concatenate[Any, P], R]:
    """Let a function of a compiled network take anything that `compiled_of` takes."""

    @functools.wraps(function)
    def called(model: Any, /, *args: P.args, **kwargs: P.kwargs) -> R:
        if not isinstance(model, Compiled):
            given = (each for each in (*args, *kwargs.values()) if isinstance(each, Evidence))
            model = compiled_of(model, next(given, None))
        return function(model, *args, **kwargs)

    return called


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
    - values: names of nodes' values, instead of the network's. By default the values of LANES are
      counted from 1, of any other node from 0.

    A virtual-evidence child that an observed node does not have is added. Raises InputError, naming
    the node or the file, for anything that the filters do not support.

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
    >>> compiled = ego.compile(network, observed=["Line"])
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
    ve = {ve_name(key): names for key, names in names_of.items()}
    tables = []
    for (name, s), table in declared.tables.items():
        if name not in ve:
            tables.append(table)
        elif set(table.parents) != {(n, s) for n in ve[name]}:
            raise InputError(f"{name}: its parents must be {', '.join(ve[name])} in the same slice")
    return compile_tables(
        tables,
        observed=tuple(observed),
        hidden=tuple(hidden),
        inputs=tuple(inputs),
        values={**declared.values, **(values or {})},
    )


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
    check_tables(tables)
    aligned = {}
    for (name, s), table in of_node.items():
        parents = tuple((p, s) for p, _ in of_node[name, 1].parents)
        if table.parents != parents and sorted(table.parents) == sorted(parents):
            order = [table.parents.index(p) for p in parents]
            table = Table(table.node, parents, table.values.transpose(*order, len(order)))
        aligned[name, s] = table
    one_table = set()
    for (name, s), first in aligned.items():
        later = aligned[name, 1]
        if s == 0 and later.parents == tuple((p, 1) for p, _ in first.parents):
            is_shared = first.values is later.values
            if is_shared or np.abs(first.values - later.values).max() <= 1e-12:
                one_table.add(name)
    size = {name: t.values.shape[-1] for (name, s), t in of_node.items() if s == 0}
    functions, emissions, state = _roles(aligned, one_table, hidden, names_of, inputs)
    if not state:
        raise InputError(
            f"every hidden node ({', '.join(hidden)}) is a constant, so there is nothing to filter"
        )
    n_states = math.prod(size[n] for n in state)
    n_inputs = math.prod(size[n] for n in inputs)
    if n_states > MAX_STATES:
        product = " x ".join(f"{n} {size[n]}" for n in state)
        raise InputError(
            f"the joint state has {n_states} values ({product}), more than {MAX_STATES}"
        )
    node_value = _values_in(state, size)
    first_column = np.cumsum([0, *(size[n] for n in state)])[:-1, None]
    column = np.stack(list(node_value.values())) + first_column
    for name in functions:
        table = aligned[name, 1]
        value = table.values.argmax(axis=-1)[tuple(node_value[p] for p, _ in table.parents)]
        node_value[name] = np.broadcast_to(value, n_states)
    parts = {}
    end = 0
    indicator = []
    for name in sorted(hidden, key=lambda name: state.index(name) if name in state else len(state)):
        parts[name] = slice(end, end := end + size[name])
        indicator.append(node_value[name][:, None] == np.arange(size[name]))
    arrays: dict[str | int, FloatArray] = {
        "prior": np.ones((n_inputs, n_states)),
        "transition": np.ones((n_inputs, n_states, n_states)),
    }
    places: dict[SliceNode, Placement] = {}
    input_value = _values_in(inputs, size)
    for name in state:
        for s, target in ((0, "prior"), (1, "transition")):
            indices = []
            for node, at in (*aligned[name, s].parents, (name, s)):
                # The axes: inputs, state at t, and in the transition state at t + 1.
                is_input = node in input_value
                shape = [1] * (2 + s)
                shape[0 if is_input else 1 + at] = -1
                indices.append((input_value if is_input else node_value)[node].reshape(shape))
            places[name, s] = Placement(target, tuple(indices))
    for g, nodes in enumerate(names_of.values()):
        shown = _values_in(nodes, size)
        arrays[g] = np.ones((n_states, math.prod(size[n] for n in nodes)))
        for name, value in shown.items():
            if name in emissions:
                axes = (n for n, _ in (*aligned[name, 1].parents, (name, 1)))
                places[name, 1] = Placement(
                    g, tuple(shown[n] if n in shown else node_value[n][:, None] for n in axes)
                )
            else:
                arrays[g] *= node_value[name][:, None] == value
    for used, place in places.items():
        arrays[place.target] *= aligned[used].values[place.indices]
    groups = []
    for g, key in enumerate(observed):
        is_certain = np.isin(arrays[g], (0.0, 1.0)).all()
        groups.append(Group(key, arrays[g], arrays[g].argmax(axis=1) if is_certain else None))
    names = {}
    for node, n_values in size.items():
        first_name = int(node in LANES)
        numbers = range(first_name, first_name + n_values)
        names[node] = tuple(map(str, (values or {}).get(node, numbers)))
        if len(set(names[node])) != n_values or len(names[node]) != n_values:
            raise InputError(
                f"{node}: has {n_values} values, but their names are {', '.join(names[node])}"
            )
    return Compiled(
        hidden,
        tuple(state),
        n_states,
        inputs,
        {**size, **{ve_name(key): 2 for key in observed}},
        node_value,
        column,
        np.concatenate(indicator, axis=1, dtype=np.float64),
        parts,
        arrays["prior"],
        arrays["transition"],
        tuple(groups),
        places,
        aligned,
        frozenset(one_table),
        names,
    )


def with_tables(compiled: Compiled, tables: Iterable[Table]) -> Compiled:
    """Return the network with new numbers in some of its tables, without using pgmpy.

    The numbers may change a node's role: a function may become uncertain, an emission's table may
    differ between the slices.

    Raises InputError, naming the node, for a table with other parents or values.
    """
    now = dict(compiled.tables)
    for table in tables:
        name, s = table.node
        if name not in compiled.cardinality:
            raise InputError(f"{name}: the compiled network has no such node (slice {s})")
        if table.node not in now:
            continue  # a virtual-evidence node
        old = now[table.node]
        now[table.node] = table
        n_values = old.values.shape[-1]
        if set(table.parents) != set(old.parents) or table.values.shape[-1] != n_values:
            raise InputError(f"{name}: the table has other parents or values than before")
    new = compile_tables(
        list(now.values()),
        observed=compiled.observed,
        hidden=compiled.hidden,
        inputs=compiled.inputs,
        values=compiled.values,
    )
    return new if compiled.start is None else with_initial_lane(new, compiled.start)


def with_initial_lane(compiled: Compiled, start: FloatArray) -> Compiled:
    """Return the network with virtual evidence of Lane before the first frame.

    - start (n,): the likelihood of each lane, not all 0. The prior is 0 for an input that excludes
      all these lanes.
    """
    prior = compiled.prior * start[compiled.node_value["Lane"]]
    total = prior.sum(axis=1, keepdims=True)
    return replace(compiled, prior=prior / np.where(total > 0, total, 1), start=start)


def _values_in(nodes: Sequence[str], size: Mapping[str, int]) -> dict[str, IntArray]:
    """Return the value of each node in each joint value; the first node's vary slowest."""
    sizes = [size[n] for n in nodes]
    return dict(zip(nodes, np.indices(sizes).reshape(len(sizes), math.prod(sizes)), strict=True))


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


def _roles(
    tables: Mapping[SliceNode, Table],
    one_table: Collection[str],
    hidden: Sequence[str],
    names_of: Mapping[Observed, tuple[str, ...]],
    inputs: Collection[str],
) -> tuple[list[str], set[str], list[str]]:
    """Return the functions in topological order, the plain emissions, and the nodes of the joint
    state."""
    later = {name: table for (name, s), table in tables.items() if s == 1}
    chosen = {n for n, table in later.items() if any(p in inputs for p, _ in table.parents)}
    previous = {p for table in later.values() for p, s in table.parents if s == 0}
    with_child = {p for table in later.values() for p, _ in table.parents}
    plain = set(one_table) - chosen
    times = Counter(chain.from_iterable(names_of.values()))
    emissions = {n for n in plain - with_child if times[n] == 1 and n not in hidden}
    sources = {
        name: [p for p, _ in later[name].parents]
        for name in hidden
        if name in plain - previous and np.isin(later[name].values, (0.0, 1.0)).all()
    }
    functions = [name for name in TopologicalSorter(sources).static_order() if name in sources]
    carried = [n for n in dict.fromkeys((*hidden, *times)) if n not in {*sources, *emissions}]
    # The largest node last, so that its values are contiguous in memory.
    state = sorted(carried, key=lambda name: later[name].values.shape[-1])
    return functions, emissions, state
