"""Read a graph from YAML: nodes and, for each of them, a table of numbers.

    nodes:            # per node a number of values, or the names of its values
      Lane: 2
      SensorState: [OK, BAD]
      DetectorOutput: 2
    hidden: [Lane, SensorState]
    observed: [DetectorOutput]              # [[A, B]]: A and B jointly
    tables:
      Lane:
        first: {rows: {values: [0.5, 0.5]}}                    # in the first frame
        next: {rows: {of: [Lane before], values: [[0.9, 0.1], [0.1, 0.9]]}}
      SensorState:
        first: {rows: {values: [0.5, 0.5]}}
        next: {rows: {of: [SensorState before], values: [[0.9, 0.1], [0.2, 0.8]]}}
      DetectorOutput:                                          # the same in all frames
        rows:
          of: [SensorState, Lane]
          values: [[[0.8, 0.2], [0.2, 0.8]], [[0.5, 0.5], [0.5, 0.5]]]

`of` names the parents, and so the edges; a parent at time t of a node at t+1 is `<name> before`.
`values` has an axis for each of them, in their order, and the node's own last: each innermost row
sums to one.
Optional keys are `inputs` (nodes whose values are given in every frame, without a table), `bounds`
(of inputs that are columns of the recording: `{Rain: [0.5, 2]}` gives three values), `unused`
(evidence that the graph does not use) and `description`. Such a graph has no parameters, and its
number of lanes is fixed: a graph with parameters, or for any number of lanes, is written in Python.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from egolane_pgm.contracts import Graph
from egolane_pgm.experiment import Origin, Section, validated
from egolane_pgm.graphs.cpds import Table, uniform
from egolane_pgm.parameters import check_names
from egolane_pgm.plugins import same
from egolane_pgm.tools.files import read_yaml
from egolane_pgm.types import FloatArray, InputError, problems_in, suggestion

#: The end of the name of a parent at time t.
_BEFORE = " before"


def _values(given: Any) -> Any:
    if isinstance(given, list) and given:
        return tuple(map(str, given))
    if isinstance(given, int) and not isinstance(given, bool) and given > 0:
        return given
    raise ValueError("needs a number of values, or a list of their names")


class _Rows(Section):
    of: tuple[str, ...] = ()
    values: list[Any]


class _Table(Section):
    rows: _Rows


class _Tables(Section):
    first: _Table
    next: _Table


class _Graph(Section):
    """The keys of a file."""

    description: str | None = None
    nodes: dict[str, Annotated[Any, BeforeValidator(_values)]]
    hidden: tuple[str, ...]
    observed: tuple[str | tuple[str, ...], ...]
    inputs: tuple[str, ...] = ()
    bounds: dict[str, tuple[float, ...]] = Field(default_factory=dict)
    unused: tuple[str | tuple[str, ...], ...] = ()
    tables: dict[str, dict[str, Any]]
    learned_from: Origin | None = None


def load_graph_file(path: Path, name: str, where: str) -> Graph:
    """Read a graph from a YAML file. Raises InputError if its parts do not fit together."""
    with problems_in(where):
        keys = read_yaml(path, "nodes: {Lane: 2}")
        if not {"nodes", "tables"} & keys.keys():
            raise InputError(
                f"{path.name}: has no nodes and no tables, so it is not a graph; an experiment is"
                f" run by `egolane run {path.name}`"
            )
        return graph_of(keys, name, path.name, file=str(path))


def graph_of(keys: Mapping[str, Any], name: str, where: str, *, file: str = "") -> Graph:
    """Make a graph from the keys of a YAML file. Raises InputError if they do not fit together."""
    graph = validated(_Graph, keys, where)
    with problems_in(where):
        tables = _tables(graph)
    return Graph(
        name=name,
        file=file,
        about=graph.description or "",
        hidden=graph.hidden,
        observed=graph.observed,
        inputs=graph.inputs,
        bounds=graph.bounds,
        unused=graph.unused,
        learned_from=graph.learned_from,
        values={n: values for n, values in graph.nodes.items() if not isinstance(values, int)},
        tables=functools.partial(same, tables),
        keys=keys,
    )


def _tables(graph: _Graph) -> list[Table]:
    """The tables of all nodes in the first slice and in the next."""
    size = {n: v if isinstance(v, int) else len(v) for n, v in graph.nodes.items()}
    _check_nodes(graph.hidden, size, "hidden")
    _check_nodes(graph.inputs, size, "inputs")
    _check_nodes(graph.bounds, graph.inputs, "bounds")
    for key in graph.observed:
        _check_nodes([key] if isinstance(key, str) else key, size, "observed")
    check_names([n for n in size if n not in graph.inputs], graph.tables, "tables")
    tables = []
    for node, n_values in size.items():
        where = f"tables.{node}"
        if node in graph.inputs:
            tables += [Table((node, s), (), uniform(n_values)) for s in (0, 1)]
            continue
        if node not in graph.tables:
            raise InputError(f"{where}: is missing")
        given = graph.tables[node]
        if {"first", "next"} & set(given):
            both = validated(_Tables, given, where)
            slices = [(f"{where}.first", both.first.rows), (f"{where}.next", both.next.rows)]
        else:
            slices = [(where, validated(_Table, given, where).rows)] * 2
        for s, (place, rows) in enumerate(slices):
            parents = [
                (name.removesuffix(_BEFORE), 0 if name.endswith(_BEFORE) else s) for name in rows.of
            ]
            _check_nodes([name for name, _ in parents], size, f"{place}: of")
            if s == 0 and any(name.endswith(_BEFORE) for name in rows.of):
                raise InputError(
                    f"{place}: has a parent in the frame before; a node has such a table"
                    " under `next`, and one without it under `first`"
                )
            shape = (*(size[name] for name, _ in parents), n_values)
            values = _numbers(rows.values, shape, place)
            tables.append(Table((node, s), tuple(parents), values))
    return tables


def _numbers(rows: list[Any], shape: tuple[int, ...], where: str) -> FloatArray:
    needs = " x ".join(map(str, shape))
    try:
        values = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        # Text, or rows of different lengths.
        raise InputError(f"{where}: needs {needs} numbers, has others") from None
    if values.shape != shape:
        has = " x ".join(map(str, values.shape))
        raise InputError(f"{where}: needs {needs} numbers, has {has}")
    return values


def _check_nodes(listed: Iterable[str], known: Iterable[str], where: str) -> None:
    for node in listed:
        if node not in known:
            raise InputError(f"{where}: no node '{node}'{suggestion(node, known)}")
