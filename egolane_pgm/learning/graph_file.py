"""A graph written as YAML with its tables in numbers, as `graphs.yaml_graph` reads it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, ve_name
from egolane_pgm.model import Model
from egolane_pgm.types import FloatArray

#: Digits of a number in the file: rows still sum to one far within what a graph may be off.
_DIGITS = 12


def graph_yaml(model: Model, tables: Sequence[Table], description: str) -> dict[str, Any]:
    """The keys of a YAML graph with the nodes and edges of the model's graph and these tables.

    It is for the model's number of lanes only, and has no parameters.
    """
    graph = model.graph
    left_out = {*map(ve_name, graph.OBSERVED)}
    by_node = {table.node: table for table in tables if table.node[0] not in left_out}
    names = list(dict.fromkeys(name for name, _ in by_node))
    inputs = tuple(getattr(graph, "INPUTS", ()))
    values = getattr(graph, "VALUES", {})
    across: list[str] = []
    within: list[str] = []
    for name in names:
        for parent, s in by_node[name, 1].parents:
            (within if s == 1 else across).append(f"{parent} -> {name}")
    content: dict[str, Any] = {
        "description": description,
        "nodes": {
            name: [str(v) for v in values[name]]
            if name in values
            else int(by_node[name, 1].values.shape[-1])
            for name in names
        },
        "hidden": list(graph.HIDDEN),
        "observed": [list(key) if isinstance(key, tuple) else key for key in graph.OBSERVED],
        "inputs": list(inputs),
        "unused": [
            list(key) if isinstance(key, tuple) else key for key in getattr(graph, "UNUSED", ())
        ],
        "edges": {"within": within, "across": across},
        "tables": {
            name: _table(by_node[name, 0], by_node[name, 1], name in model.compiled.state_nodes)
            for name in names
            if name not in inputs
        },
    }
    return {key: value for key, value in content.items() if value not in ([], "")}


def _table(first: Table, later: Table, persists: bool) -> dict[str, Any]:
    if persists:
        return {"first": _rows(first), "next": _rows(later)}
    return _rows(later)


def _rows(table: Table) -> dict[str, Any]:
    of = [_parent(table.node, parent) for parent in table.parents]
    rows: dict[str, Any] = {"of": of} if of else {}
    return {"rows": {**rows, "values": _rounded(table.values).tolist()}}


def _parent(node: SliceNode, parent: SliceNode) -> str:
    return parent[0] if parent[1] == node[1] else f"{parent[0]} before"


def _rounded(values: FloatArray) -> FloatArray:
    flat = [float(f"{v:.{_DIGITS}g}") for v in values.ravel()]
    return np.reshape(flat, values.shape)
