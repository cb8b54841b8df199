"""Reads a graph that is written in YAML alone: nodes, edges and, for each node, a table function.

    nodes:            # per node n_lanes, a number of values, or the names of its values
      Lane: n_lanes
      SensorState: [OK, BAD]
      DetectorOutput: n_lanes
    hidden: [Lane, SensorState]
    observed: [DetectorOutput]              # [[A, B]]: A and B jointly
    edges:
      within: [Lane -> DetectorOutput, SensorState -> DetectorOutput]
      across: [Lane -> Lane, SensorState -> SensorState]       # from t to t+1
    parameters:
      sigma1: {kind: sigma, default: 0.4, bounds: [0, 3], doc: how far a lane is left}
    tables:
      Lane:
        first: uniform                                          # in the first frame
        next: {normal: {around: Lane before, sigma: sigma1}}    # later
      DetectorOutput:
        stack: {over: SensorState, OK: {normal: {around: Lane, sigma: 0.5}}, BAD: uniform}

Optional keys are `inputs`, `unused` (evidence that the graph does not use) and `description`. A
parent at time t of a node at t+1 is written `<name> before`. A number may be replaced by the name
of a parameter or by `1 - <name>`. A parameter with a value per lane can be used inside a `stack`
over the lanes, where each lane takes its own value. A search moves every parameter, within `bounds`
or those that follow from its kind; `bounds: null` keeps it from that. The table functions:

    uniform    every value is equally likely
    normal     {around, sigma}: F of a normal around the parent's lane; optional: shift (lanes),
               how (density or integral), widths (of the lanes)
    binary     {of, ok, bad}: an OK parent gives OK with probability ok, a BAD one BAD with bad
    identity   {of}: the node has the parent's value
    rows       {of, values}: the probabilities as numbers; of: a parent, a list of them, or absent;
               a row that ends in `rest` is filled up to a sum of one
    stack      {over, <value>: table, ..., else: table}: one table for each value of the parent
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from pydantic import FiniteFloat

from egolane_pgm.experiment import Section, load_yaml, validated
from egolane_pgm.graphs.cpds import (
    SliceNode,
    Table,
    binary,
    declare,
    lane_normals,
    previous,
    uniform,
)
from egolane_pgm.parameters import Parameter, Parameters, check_names
from egolane_pgm.types import (
    FloatArray,
    InputError,
    Observed,
    all_problems,
    suggestion,
)

#: What the name of a parent at time t ends with.
_BEFORE = " before"

_KEYS = (
    *("description", "nodes", "hidden", "observed", "inputs", "unused", "edges"),
    *("parameters", "tables"),
)


class _Declared(Section):
    """A parameter of a graph; see `Parameter`."""

    kind: Literal["sigma", "probability", "positive", "non_negative", "integer", "choice"]
    default: Any
    bounds: tuple[FiniteFloat, FiniteFloat] | None = None
    doc: str = "see the graph file"
    choices: tuple[Any, ...] = ()
    per_lane: bool = False
    lowest: int = 0


@dataclass(frozen=True)
class _Graph:
    """The content of a file, checked but not yet evaluated; every mapping goes by node.

    - values: how many values the node has; None stands for n_lanes
    - names: the names of its values, for the nodes that give them
    - within, across: its parents in the same slice, and those in the slice before
    - tables: its table, or a mapping with `first` and `next`
    """

    values: Mapping[str, int | None]
    names: Mapping[str, tuple[str, ...]]
    within: Mapping[str, tuple[str, ...]]
    across: Mapping[str, tuple[str, ...]]
    tables: Mapping[str, Any]


@dataclass(frozen=True)
class _Place:
    """The node whose table a table function makes, and what the function may use.

    - where: how error messages begin
    - size: how many values the node has
    - parents, names: how many values each parent has, and their names
    - lane: index of the lane in an enclosing stack over the lanes, otherwise None
    - lanes: the parents that have n_lanes values
    """

    where: str
    size: int
    parents: Mapping[str, int]
    names: Mapping[str, Sequence[str]]
    parameters: Parameters
    n_lanes: int
    lane: int | None
    lanes: frozenset[str]


#: What a table function makes: the parents that it uses, and an array with an axis for each of them
#: and the node's own axis last.
_Made = tuple[tuple[str, ...], FloatArray]


def load_graph_file(path: Path, name: str, where: str) -> ModuleType:
    """Makes a module from a YAML file, with the names of a graph in Python (HIDDEN, OBSERVED,
    PARAMETERS, tables, build, ...).

    - name: name of the new module
    - where: how error messages begin

    Raises InputError for a file that is missing or whose parts do not fit together. An error
    inside a table is found only when `tables` or `build` is called.
    """
    if not path.is_file():
        raise InputError(f"{where}: no file {path}")
    try:
        content = load_yaml(path)
    except InputError as error:
        raise InputError(*(f"{where}: {line}" for line in error.lines)) from None
    here = f"{where}: {path.name}"
    with all_problems() as part:
        with part():
            _check_keys(content, _KEYS, here)
        for key in ("nodes", "hidden", "observed", "tables"):
            with part():
                if not content.get(key):
                    raise InputError(f"{here}: {key}: is missing")
        with part():
            declared = _read_parameters(content.get("parameters") or {}, here)
    with all_problems() as part:
        values, names = _read_nodes(content["nodes"], here)
        with part():
            graph = _read_graph(content, values, names, here)
        with part():
            observed = _read_observed(content, "observed", here)
            _check_nodes(_flat(observed), values, f"{here}: observed")
        with part():
            hidden = _read_names(content, "hidden", here)
            _check_nodes(hidden, values, f"{here}: hidden")
        with part():
            inputs = _read_names(content, "inputs", here)
            _check_nodes(inputs, values, f"{here}: inputs")
        with part():
            unused = _read_observed(content, "unused", here)
    module = ModuleType(name, content.get("description"))

    def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
        return _tables(graph, inputs, n_lanes, parameters)

    def build(n_lanes: int, parameters: Parameters) -> Any:
        return declare(tables(n_lanes, parameters), observed)

    contents: dict[str, Any] = {
        "__file__": str(path),
        "HIDDEN": hidden,
        "OBSERVED": observed,
        "INPUTS": inputs,
        "UNUSED": unused,
        "VALUES": graph.names,
        "PARAMETERS": declared,
        "tables": tables,
        "build": build,
    }
    for attribute, value in contents.items():
        setattr(module, attribute, value)
    return module


def _check_keys(section: Any, known: Iterable[str], where: str) -> None:
    if not isinstance(section, Mapping):
        raise InputError(f"{where}: needs keys and values, got {section!r}")
    check_names(known, section, where)


def _check_nodes(listed: Iterable[str], known: Iterable[str], where: str) -> None:
    unknown = [node for node in listed if node not in known]
    if unknown:
        raise InputError(*(f"{where}: no node '{n}'{suggestion(n, known)}" for n in unknown))


def _read_names(content: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    listed = content.get(key) or []
    if not isinstance(listed, list):
        raise InputError(f"{where}: {key}: needs a list of nodes, got {listed!r}")
    return tuple(map(str, listed))


def _read_observed(content: Mapping[str, Any], key: str, where: str) -> tuple[Observed, ...]:
    listed = content.get(key) or []
    if not isinstance(listed, list):
        raise InputError(f"{where}: {key}: needs a list of nodes, got {listed!r}")
    return tuple(tuple(map(str, o)) if isinstance(o, list) else str(o) for o in listed)


def _flat(observed: Iterable[Observed]) -> list[str]:
    return [name for key in observed for name in ((key,) if isinstance(key, str) else key)]


def _read_nodes(nodes: Any, where: str) -> tuple[dict[str, int | None], dict[str, tuple[str, ...]]]:
    """How many values each node has, None for n_lanes; and their names, where it gives them."""
    if not isinstance(nodes, Mapping):
        raise InputError(f"{where}: nodes: needs a number of values for each name")
    values: dict[str, int | None] = {}
    names: dict[str, tuple[str, ...]] = {}
    for node, given in nodes.items():
        if given == "n_lanes":
            values[str(node)] = None
        elif isinstance(given, list) and given:
            names[str(node)] = tuple(map(str, given))
            values[str(node)] = len(given)
        elif isinstance(given, int) and not isinstance(given, bool) and given > 0:
            values[str(node)] = given
        else:
            raise InputError(
                f"{where}: nodes.{node}: {given!r} is not n_lanes, a number of values or a list"
                " of their names"
            )
    return values, names


def _read_graph(
    content: Mapping[str, Any],
    values: Mapping[str, int | None],
    names: Mapping[str, tuple[str, ...]],
    where: str,
) -> _Graph:
    edges = content.get("edges") or {}
    _check_keys(edges, ("within", "across"), f"{where}: edges")
    within, across = (
        _read_edges(edges.get(kind) or [], values, f"{where}: edges.{kind}")
        for kind in ("within", "across")
    )
    tables = content["tables"]
    _check_keys(tables, values, f"{where}: tables")
    missing = [n for n in values if n not in tables and n not in (content.get("inputs") or ())]
    if missing:
        raise InputError(*(f"{where}: tables.{node}: is missing" for node in missing))
    return _Graph(values, names, within, across, tables)


def _read_edges(edges: Any, known: Iterable[str], where: str) -> dict[str, tuple[str, ...]]:
    parents: dict[str, tuple[str, ...]] = dict.fromkeys(known, ())
    for edge in edges if isinstance(edges, list) else [edges]:
        ends = [end.strip() for end in str(edge).split("->")]
        if len(ends) != 2:
            raise InputError(f"{where}: {edge!r} is not an edge, e.g. 'Lane -> DetectorOutput'")
        for end in ends:
            if end not in parents:
                raise InputError(f"{where}: {edge}: no node '{end}'{suggestion(end, parents)}")
        parents[ends[1]] += (ends[0],)
    return parents


def _read_parameters(section: Any, where: str) -> tuple[Parameter, ...]:
    if not isinstance(section, Mapping):
        raise InputError(f"{where}: parameters: needs a kind and a default for each name")
    found = []
    with all_problems() as part:
        for name, given in section.items():
            with part():
                found.append(_read_parameter(str(name), given, f"{where}: parameters.{name}"))
    return tuple(found)


def _read_parameter(name: str, given: Any, where: str) -> Parameter:
    if not isinstance(given, Mapping):
        raise InputError(f"{where}: needs keys and values, got {given!r}")
    read = validated(_Declared, given, where)
    spec = Parameter(
        name,
        read.kind,
        read.default,
        read.doc,
        search=read.bounds if "bounds" in read.model_fields_set else "auto",
        choices=tuple(map(str, read.choices)),
        per_lane=read.per_lane,
        lowest=read.lowest,
    )
    size = len(read.default) if isinstance(read.default, list) else 1
    spec.check(read.default, size, f"{where}.default")
    return spec


# --- tables -------------------------------------------------------------------------------------


def _tables(
    graph: _Graph, inputs: Sequence[str], n_lanes: int, parameters: Parameters
) -> list[Table]:
    size = {node: n_lanes if k is None else k for node, k in graph.values.items()}
    names = {
        node: graph.names.get(
            node, [str(k + (graph.values[node] is None)) for k in range(size[node])]
        )
        for node in size
    }
    tables: list[Table] = []
    with all_problems() as part:
        for node in size:
            with part():
                tables += _tables_of(node, graph, inputs, size, names, n_lanes, parameters)
    return tables


def _tables_of(
    node: str,
    graph: _Graph,
    inputs: Sequence[str],
    size: Mapping[str, int],
    names: Mapping[str, Sequence[str]],
    n_lanes: int,
    parameters: Parameters,
) -> list[Table]:
    """The tables of a node in the first slice and in the next."""
    spec = graph.tables.get(node, "uniform")
    by_slice = isinstance(spec, Mapping) and set(spec) & {"first", "next"}
    if by_slice and set(spec) != {"first", "next"}:
        raise InputError(f"tables.{node}: needs first and next, has {', '.join(spec)}")
    if not by_slice and graph.across[node]:
        raise InputError(
            f"tables.{node}: has a parent in the slice before, so it needs first and next"
        )
    tables = []
    for s in (0, 1):
        which = ("first", "next")[s]
        given: dict[str, SliceNode] = {p: (p, s) for p in graph.within[node]}
        if s == 1:
            given |= {p + _BEFORE: previous(p) for p in graph.across[node]}
        place = _Place(
            f"tables.{node}.{which}" if by_slice else f"tables.{node}",
            size[node],
            {p: size[n] for p, (n, _) in given.items()},
            {p: names[n] for p, (n, _) in given.items()},
            parameters,
            n_lanes,
            None,
            frozenset(p for p, (n, _) in given.items() if graph.values[n] is None),
        )
        used, values = _evaluate(spec[which] if by_slice else spec, place)
        if set(used) != set(given) and node not in inputs:
            raise InputError(
                f"{place.where}: the table uses {', '.join(used) or 'no parent'}, its edges"
                f" come from {', '.join(given) or 'nowhere'}"
            )
        tables.append(Table((node, s), tuple(given[p] for p in used), values))
    return tables


def _evaluate(spec: Any, place: _Place) -> _Made:
    """The table that a spec asks for: a function's name, or {name: arguments}."""
    if isinstance(spec, Mapping) and len(spec) == 1:
        [(function, arguments)] = spec.items()
    else:
        function, arguments = spec, None
    if not isinstance(function, str) or function not in _FUNCTIONS:
        shown = function if isinstance(function, str) else repr(function)
        raise InputError(
            f"{place.where}: unknown table function '{shown}'"
            f"{suggestion(str(function), _FUNCTIONS)}"
        )
    make, needed, optional = _FUNCTIONS[function]
    arguments = {} if arguments is None else arguments
    where = f"{place.where}: {function}"
    if optional != ("*",):
        _check_keys(arguments, (*needed, *optional), where)
    for key in needed:
        if not isinstance(arguments, Mapping) or key not in arguments:
            raise InputError(f"{where} needs {', '.join(needed)}; {key} is missing")
    return make(arguments, place)


def _parent(name: Any, place: _Place, size: int | None = None) -> str:
    """Checks that `name` is a parent and, where `size` is given, that it has so many values."""
    if name not in place.parents:
        raise InputError(
            f"{place.where}: '{name}' is no parent by the edges"
            f"{suggestion(str(name), place.parents)}"
        )
    if size is not None and place.parents[name] != size:
        raise InputError(
            f"{place.where}: {name} has {place.parents[name]} values, here it needs {size}"
        )
    return str(name)


def _read_number(given: Any, place: _Place) -> float:
    """Reads a number, a parameter's name, or `1 - <name>`."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return float(given)
    match = re.fullmatch(r"(1\s*-\s*)?([^\W\d]\w*)", str(given).strip())
    if match is None:
        raise InputError(f"{place.where}: {given!r} is no number and no parameter")
    value = _parameter(match[2], place)
    if isinstance(value, tuple):
        if place.lane is None:
            raise InputError(
                f"{place.where}: {match[2]} has a value per lane; use it in a stack over the lanes"
            )
        value = value[place.lane]
    if isinstance(value, str):
        raise InputError(f"{place.where}: {match[2]} is a choice, not a number")
    return 1 - float(value) if match[1] else float(value)


def _parameter(name: str, place: _Place) -> Any:
    if name not in place.parameters:
        raise InputError(
            f"{place.where}: no parameter '{name}'{suggestion(name, place.parameters)}"
        )
    return place.parameters[name]


def _uniform(_: Mapping[str, Any], place: _Place) -> _Made:
    return (), uniform(place.size)


def _normal(given: Mapping[str, Any], place: _Place) -> _Made:
    parent = _parent(given["around"], place, place.size)
    if place.size != place.n_lanes:
        raise InputError(f"{place.where}: normal is for nodes with n_lanes values")
    sigma = _read_number(given["sigma"], place)
    if sigma <= 0:
        raise InputError(f"{place.where}: sigma {sigma} must be greater than 0")
    how = given.get("how", "density")
    how = how if how in ("density", "integral") else _parameter(str(how), place)
    if how not in ("density", "integral"):
        raise InputError(f"{place.where}: how: '{how}' is neither density nor integral")
    widths: Any = given.get("widths", 1.0)
    widths = _parameter(widths, place) if isinstance(widths, str) else widths
    widths = widths if isinstance(widths, (tuple, list)) else (float(widths),) * place.n_lanes
    shift = _read_number(given.get("shift", 0.0), place)
    return (parent,), lane_normals(sigma, place.n_lanes, how, widths, shift)


def _binary(given: Mapping[str, Any], place: _Place) -> _Made:
    if place.size != 2:
        raise InputError(f"{place.where}: binary is for nodes with 2 values, not {place.size}")
    parent = _parent(given["of"], place, 2)
    return (parent,), binary(_read_number(given["ok"], place), _read_number(given["bad"], place))


def _identity(given: Mapping[str, Any], place: _Place) -> _Made:
    return (_parent(given["of"], place, place.size),), np.eye(place.size)


def _rows(given: Mapping[str, Any], place: _Place) -> _Made:
    of = given.get("of", [])
    parents = tuple(_parent(p, place) for p in (of if isinstance(of, list) else [of]))
    shape = (*(place.parents[p] for p in parents), place.size)

    def read(values: Any, shape: tuple[int, ...]) -> Any:
        if not isinstance(values, list) or len(values) != shape[0]:
            raise InputError(
                f"{place.where}: rows needs {' x '.join(map(str, shape))} numbers, got {values!r}"
            )
        if len(shape) > 1:
            return [read(row, shape[1:]) for row in values]
        *first, last = values
        numbers = [_read_number(v, place) for v in first]
        return [*numbers, 1 - sum(numbers) if last == "rest" else _read_number(last, place)]

    return parents, np.array(read(given["values"], shape), dtype=np.float64)


def _stack(given: Mapping[str, Any], place: _Place) -> _Made:
    over = _parent(given["over"], place)
    names = place.names[over]
    branches = {str(key): table for key, table in given.items() if key != "over"}
    for key in branches:
        if key not in names and key != "else":
            raise InputError(
                f"{place.where}: stack: {over} has no value '{key}'{suggestion(key, names)}"
            )
    made = []
    for k, name in enumerate(names):
        if name not in branches and "else" not in branches:
            raise InputError(f"{place.where}: stack: no table for {over} {name}, and no else")
        inner = _Place(
            f"{place.where}.{name}",
            place.size,
            {p: size for p, size in place.parents.items() if p != over},
            place.names,
            place.parameters,
            place.n_lanes,
            k if over in place.lanes else place.lane,
            place.lanes,
        )
        made.append(_evaluate(branches.get(name, branches.get("else")), inner))
    parents = tuple(dict.fromkeys(p for used, _ in made for p in used))
    shape = (*(place.parents[p] for p in parents), place.size)
    return (over, *parents), np.stack([_spread(one, parents, shape) for one in made])


def _spread(made: _Made, parents: Sequence[str], shape: tuple[int, ...]) -> FloatArray:
    """Repeats a table along the parents that it does not depend on, so that it has all axes."""
    used, values = made
    order = [used.index(p) for p in parents if p in used]
    ordered = values.transpose(*order, len(used))
    kept = [size if p in used else 1 for p, size in zip(parents, shape, strict=False)]
    return np.broadcast_to(ordered.reshape(*kept, shape[-1]), shape)


#: Table functions by name: the function, the arguments that it needs, and those that are optional
#: ("*": any).
_FUNCTIONS: Mapping[
    str, tuple[Callable[[Mapping[str, Any], _Place], _Made], tuple[str, ...], tuple[str, ...]]
] = {
    "uniform": (_uniform, (), ()),
    "normal": (_normal, ("around", "sigma"), ("shift", "how", "widths")),
    "binary": (_binary, ("of", "ok", "bad"), ()),
    "identity": (_identity, ("of",), ()),
    "rows": (_rows, ("values",), ("of",)),
    "stack": (_stack, ("over",), ("*",)),
}
