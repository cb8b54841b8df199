"""A graph written in YAML alone: nodes, edges and, for each node, a table function by name.

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

and, as wanted, `inputs`, `unused` (evidence that the graph does without) and `description`. A
parent in the slice before is written `<name> before`. Where a number is needed there may be the
name of a parameter, or `1 - <name>`; one with a value per lane has its own in each lane of a
`stack` over Lane. The table functions:

    uniform    every value alike
    normal     {around, sigma}: F of a normal around the parent's lane; optional: shift (lanes),
               how (density or integral), widths (of the lanes)
    binary     {of, ok, bad}: OK is kept with probability ok, BAD with bad
    identity   {of}: the parent's value
    rows       {of, values}: the numbers; of: a parent, a list of them, or absent; a row that ends
               in `rest` is filled up to one
    stack      {over, <value>: table, ..., else: table}: a table for each value of the parent
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from egolane_pgm.experiment import load_yaml
from egolane_pgm.graphs._yaml_tables import Place, check_keys, evaluate
from egolane_pgm.graphs.cpds import SliceNode, Table, declare, previous
from egolane_pgm.types import InputError, Observed, Parameter, Parameters, suggestion

#: What a parent's name ends with where it is the node in the slice before.
BEFORE = " before"

_KEYS = (
    *("description", "nodes", "hidden", "observed", "inputs", "unused", "edges"),
    *("parameters", "tables"),
)
_PARAMETER_KEYS = ("kind", "default", "bounds", "doc", "choices", "per_lane", "lowest")
_KINDS = ("sigma", "probability", "positive", "non_negative", "integer", "choice")


@dataclass(frozen=True)
class _Graph:
    """What a file says. values: per node its number of values (None: n_lanes). within, across:
    per node its parents. tables: per node its table, or first and next."""

    values: Mapping[str, int | None]
    names: Mapping[str, tuple[str, ...]]
    within: Mapping[str, tuple[str, ...]]
    across: Mapping[str, tuple[str, ...]]
    tables: Mapping[str, Any]


def load_yaml_graph(path: Path, name: str, where: str) -> ModuleType:
    """A module that has what a graph file has (HIDDEN, OBSERVED, PARAMETERS, tables, build, ...).

    Raises InputError starting with `where` for a file that is missing or does not fit together;
    what is wrong in a table is found when it is built.
    """
    if not path.is_file():
        raise InputError(f"{where}: no file {path}")
    try:
        content = load_yaml(path)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    here = f"{where}: {path.name}"
    check_keys(content, _KEYS, here)
    for key in ("nodes", "hidden", "observed", "tables"):
        if not content.get(key):
            raise InputError(f"{here}: {key}: is missing")
    graph = _read_graph(content, here)
    module = ModuleType(name, content.get("description"))
    observed = _observed(content, here)
    known = set(graph.values)
    hidden = _names(content, "hidden", here)
    inputs = _names(content, "inputs", here)
    for key, listed in (("hidden", hidden), ("inputs", inputs), ("observed", _flat(observed))):
        for node in listed:
            if node not in known:
                raise InputError(f"{here}: {key}: no node '{node}'{suggestion(node, known)}")

    def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
        return _tables(graph, inputs, n_lanes, parameters)

    def build(n_lanes: int, parameters: Parameters) -> Any:
        return declare(tables(n_lanes, parameters), observed)

    contents: dict[str, Any] = {
        "__file__": str(path),
        "HIDDEN": hidden,
        "OBSERVED": observed,
        "INPUTS": inputs,
        "UNUSED": tuple(
            tuple(u) if isinstance(u, list) else str(u) for u in content.get("unused") or ()
        ),
        "VALUES": {node: names for node, names in graph.names.items() if node in hidden},
        "PARAMETERS": _parameters(content.get("parameters") or {}, here),
        "tables": tables,
        "build": build,
    }
    for attribute, value in contents.items():
        setattr(module, attribute, value)
    return module


def _names(content: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    listed = content.get(key) or []
    if not isinstance(listed, list):
        raise InputError(f"{where}: {key}: needs a list of nodes, got {listed!r}")
    return tuple(map(str, listed))


def _observed(content: Mapping[str, Any], where: str) -> tuple[Observed, ...]:
    listed = content["observed"]
    if not isinstance(listed, list):
        raise InputError(f"{where}: observed: needs a list of nodes, got {listed!r}")
    return tuple(tuple(map(str, o)) if isinstance(o, list) else str(o) for o in listed)


def _flat(observed: Iterable[Observed]) -> list[str]:
    return [name for key in observed for name in ((key,) if isinstance(key, str) else key)]


def _read_graph(content: Mapping[str, Any], where: str) -> _Graph:
    nodes = content["nodes"]
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
    edges = content.get("edges") or {}
    check_keys(edges, ("within", "across"), f"{where}: edges")
    within, across = (
        _parents(edges.get(kind) or [], values, f"{where}: edges.{kind}")
        for kind in ("within", "across")
    )
    tables = content["tables"]
    check_keys(tables, values, f"{where}: tables")
    for node in values:
        if node not in tables and node not in (content.get("inputs") or ()):
            raise InputError(f"{where}: tables.{node}: is missing")
    return _Graph(values, names, within, across, tables)


def _parents(edges: Any, known: Iterable[str], where: str) -> dict[str, tuple[str, ...]]:
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


def _parameters(section: Any, where: str) -> tuple[Parameter, ...]:
    if not isinstance(section, Mapping):
        raise InputError(f"{where}: parameters: needs a kind and a default for each name")
    found = []
    for name, given in section.items():
        here = f"{where}: parameters.{name}"
        check_keys(given, _PARAMETER_KEYS, here)
        kind = given.get("kind")
        if kind not in _KINDS:
            raise InputError(f"{here}: unknown kind '{kind}'{suggestion(str(kind), _KINDS)}")
        if "default" not in given:
            raise InputError(f"{here}: default: is missing")
        bounds = given.get("bounds")
        if bounds is not None and not (isinstance(bounds, list) and len(bounds) == 2):
            raise InputError(f"{here}: bounds: needs [low, high], got {bounds!r}")
        spec = Parameter(
            str(name),
            kind,
            given["default"],
            str(given.get("doc", "see the graph file")),
            search=None if bounds is None else (float(bounds[0]), float(bounds[1])),
            choices=tuple(map(str, given.get("choices") or ())),
            per_lane=bool(given.get("per_lane", False)),
            lowest=int(given.get("lowest", 0)),
        )
        default = given["default"]
        spec.check(default, len(default) if isinstance(default, list) else 1, f"{here}.default")
        found.append(spec)
    return tuple(found)


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
    tables = []
    for node in size:
        spec = graph.tables.get(node, "uniform")
        by_slice = isinstance(spec, Mapping) and set(spec) & {"first", "next"}
        if by_slice and set(spec) != {"first", "next"}:
            raise InputError(f"tables.{node}: needs first and next, has {', '.join(spec)}")
        if not by_slice and graph.across[node]:
            raise InputError(
                f"tables.{node}: has a parent in the slice before, so it needs first and next"
            )
        for s in (0, 1):
            part = ("first", "next")[s]
            given: dict[str, SliceNode] = {p: (p, s) for p in graph.within[node]}
            if s == 1:
                given |= {p + BEFORE: previous(p) for p in graph.across[node]}
            place = Place(
                f"tables.{node}.{part}" if by_slice else f"tables.{node}",
                size[node],
                {p: size[n] for p, (n, _) in given.items()},
                {p: names[n] for p, (n, _) in given.items()},
                parameters,
                n_lanes,
                None,
                frozenset(p for p, (n, _) in given.items() if graph.values[n] is None),
            )
            used, values = evaluate(spec[part] if by_slice else spec, place)
            if set(used) != set(given) and node not in inputs:
                raise InputError(
                    f"{place.where}: the table uses {', '.join(used) or 'no parent'}, its edges"
                    f" come from {', '.join(given) or 'nowhere'}"
                )
            tables.append(Table((node, s), tuple(given[p] for p in used), values))
    return tables
