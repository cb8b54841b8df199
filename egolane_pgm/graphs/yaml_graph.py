"""Reads a graph that is written in YAML: nodes and, for each of them, a table of numbers.

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
Optional keys are `inputs` (nodes whose values are given in every frame, without a table), `unused`
(evidence that the graph does not use) and `description`. Such a graph has no parameters, and its
number of lanes is fixed: a graph with parameters, or for any number of lanes, is written in Python.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from egolane_pgm.experiment import Section, validated
from egolane_pgm.graphs.cpds import Table, declare, uniform
from egolane_pgm.parameters import check_names
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


def _observed(given: Any) -> Any:
    return tuple(map(str, given)) if isinstance(given, list) else str(given)


_Observed = Annotated[Any, BeforeValidator(_observed)]


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
    observed: tuple[_Observed, ...]
    inputs: tuple[str, ...] = ()
    unused: tuple[_Observed, ...] = ()
    #: Of older files; the tables say them.
    edges: Any = None
    tables: dict[str, dict[str, Any]]
    #: The recording that the tables were learned from, see `model.recording_key`.
    learned_from: str | None = None


def load_graph_file(path: Path, name: str, where: str) -> ModuleType:
    """Makes a module from a YAML file, with the names of a graph in Python (HIDDEN, OBSERVED,
    tables, build, ...).

    - name: name of the new module
    - where: how error messages begin

    Raises InputError for a file whose parts do not fit together.
    """
    with problems_in(where):
        graph = validated(_Graph, read_yaml(path, "nodes: {Lane: 2}"), path.name)
        with problems_in(path.name):
            tables = _tables(graph)
    module = ModuleType(name, graph.description)
    module.__dict__.update(
        __file__=str(path),
        HIDDEN=graph.hidden,
        OBSERVED=graph.observed,
        INPUTS=graph.inputs,
        UNUSED=graph.unused,
        LEARNED_FROM=graph.learned_from,
        VALUES={n: values for n, values in graph.nodes.items() if not isinstance(values, int)},
        PARAMETERS=(),
        tables=lambda n_lanes, parameters: tables,
        build=lambda n_lanes, parameters: declare(tables, graph.observed),
    )
    return module


def _tables(graph: _Graph) -> list[Table]:
    """The tables of all nodes in the first slice and in the next."""
    size = {n: v if isinstance(v, int) else len(v) for n, v in graph.nodes.items()}
    with_table = [node for node in size if node not in graph.inputs]
    for key in ("hidden", "observed", "inputs"):
        _check_nodes(_flat(getattr(graph, key)), size, key)
    check_names(with_table, graph.tables, "tables")
    for node in with_table:
        if node not in graph.tables:
            raise InputError(f"tables.{node}: is missing")
    tables = []
    for node, n_values in size.items():
        if node not in with_table:
            tables += [Table((node, s), (), uniform(n_values)) for s in (0, 1)]
            continue
        for s, (where, one) in enumerate(_rows_of(node, graph.tables[node])):
            names = [name.removesuffix(_BEFORE) for name in one.of]
            _check_nodes(names, size, f"{where}: of")
            if s == 0 and names != [*one.of]:
                raise InputError(
                    f"{where}: has a parent in the frame before; a node has such a table"
                    " under `next`, and one without it under `first`"
                )
            slices = [0 if name.endswith(_BEFORE) else s for name in one.of]
            values = _numbers(one, (*(size[name] for name in names), n_values), where)
            parents = tuple(zip(names, slices, strict=True))
            tables.append(Table((node, s), parents, values))
    return tables


def _rows_of(node: str, given: dict[str, Any]) -> list[tuple[str, _Rows]]:
    """The rows of the first slice and those of the next, each with its place in the file."""
    where = f"tables.{node}"
    if {"first", "next"} & set(given):
        both = validated(_Tables, given, where)
        return [(f"{where}.first", both.first.rows), (f"{where}.next", both.next.rows)]
    return [(where, validated(_Table, given, where).rows)] * 2


def _numbers(rows: _Rows, shape: tuple[int, ...], where: str) -> FloatArray:
    try:
        values = np.array(rows.values)
    except ValueError:
        # Rows of different lengths.
        values = np.array(None)
    if values.dtype.kind not in "iuf" or values.shape != shape:
        has = " x ".join(map(str, values.shape)) if values.dtype.kind in "iuf" else "others"
        raise InputError(f"{where}: needs {' x '.join(map(str, shape))} numbers, has {has}")
    return values.astype(np.float64)


def _check_nodes(listed: Iterable[str], known: Iterable[str], where: str) -> None:
    for node in listed:
        if node not in known:
            raise InputError(f"{where}: no node '{node}'{suggestion(node, known)}")


def _flat(listed: Iterable[str | Sequence[str]]) -> list[str]:
    return [name for key in listed for name in ((key,) if isinstance(key, str) else key)]
