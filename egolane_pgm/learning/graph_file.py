"""A graph written as YAML with its tables in numbers, as `graphs.yaml_graph` reads it."""

from __future__ import annotations

from typing import Any

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import default_values
from egolane_pgm.model import Model
from egolane_pgm.types import FloatArray

#: Digits of a number in the file: rows still sum to one far within what a graph may be off.
_DIGITS = 12


def graph_yaml(model: Model, description: str) -> dict[str, Any]:
    """The keys of a YAML graph with the nodes and edges of the model's graph and its tables.

    It is for the model's number of lanes only, and has no parameters.
    """
    compiled, roles = model.compiled, model.roles
    by_node = compiled.tables
    names = list(dict.fromkeys(name for name, _ in by_node))
    across: list[str] = []
    within: list[str] = []
    for name in names:
        for parent, s in by_node[name, 1].parents:
            (within if s == 1 else across).append(f"{parent} -> {name}")
    content: dict[str, Any] = {
        "description": description,
        "nodes": {
            name: list(values)
            if (values := compiled.values[name]) != default_values(name, len(values))
            else len(values)
            for name in names
        },
        "hidden": list(compiled.hidden),
        "observed": [list(key) if isinstance(key, tuple) else key for key in roles.observed],
        "inputs": list(compiled.inputs),
        "unused": [list(key) if isinstance(key, tuple) else key for key in roles.unused],
        "edges": {"within": within, "across": across},
        "tables": {
            name: _rows(by_node[name, 1])
            if compiled.has_one_table(name)
            else {"first": _rows(by_node[name, 0]), "next": _rows(by_node[name, 1])}
            for name in names
            if name not in compiled.inputs
        },
    }
    return {key: value for key, value in content.items() if value not in ([], "")}


def _rows(table: Table) -> dict[str, Any]:
    of = [_parent(table.node, parent) for parent in table.parents]
    rows: dict[str, Any] = {"of": of} if of else {}
    return {"rows": {**rows, "values": _rounded(table.values).tolist()}}


def _parent(node: SliceNode, parent: SliceNode) -> str:
    return parent[0] if parent[1] == node[1] else f"{parent[0]} before"


def _rounded(values: FloatArray) -> FloatArray:
    flat = [float(f"{v:.{_DIGITS}g}") for v in values.ravel()]
    return np.reshape(flat, values.shape)
