"""Descriptions of graphs, evidence rules and detectors, as data and as text."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.contracts import Detector, Graph, Plugin, Rule
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.parameters import Parameters
from egolane_pgm.plugins import plugin_errors
from egolane_pgm.views.network import structure_of
from egolane_pgm.views.tables import Table, page, table, wrapped

#: Longer tables are in the JSON only.
MAX_PRINTED = 1000

#: The suffix of a parent in the previous frame.
_BEFORE = " before"


# --- as data -------------------------------------------------------------------------------------


def describe_graph(graph: Graph, compiled: Compiled, *, numbers: bool) -> dict[str, Any]:
    """The nodes of a compiled graph with their roles, its edges, tables and parameters.

    - numbers: add the `values` of each table: an axis per parent, then the axis of the node.
    """
    structure = structure_of(compiled)
    return {
        "kind": "graph",
        "n_lanes": compiled.cardinality.get("Lane"),
        "joint_states": compiled.n_states,
        "nodes": [
            {"name": name, "role": role, "values": list(compiled.values.get(name, ()))}
            for name, role in structure.kind.items()
        ],
        "edges": {"within": structure.within, "across": structure.across},
        "tables": describe_tables(compiled, numbers=numbers),
        **_of_plugin(graph),
    }


def describe_tables(compiled: Compiled, *, numbers: bool = True) -> list[dict[str, Any]]:
    """The tables of a compiled graph, without its inputs; see `describe_graph`."""
    tables: list[dict[str, Any]] = []
    for name in (name for name, s in compiled.tables if s == 0 and name not in compiled.inputs):
        frames = ["first frame", "later frames"]
        for s, when in enumerate(["every frame"] if name in compiled.one_table else frames):
            each = compiled.tables[name, s]
            parents = [parent + _BEFORE * (t != s) for parent, t in each.parents]
            axes = [*parents, name]
            shape = list(each.values.shape)
            tables.append({"node": name, "frames": when, "axes": axes, "shape": shape})
            if numbers:
                tables[-1]["values"] = each.values
    return tables


def describe_rule(rule: Rule, defaults: Parameters) -> dict[str, Any]:
    """The evidence that a rule gives, and its parameters. defaults: of every parameter."""
    reason = None
    if rule.looks_ahead is not None:
        with plugin_errors(rule, "evidence"):
            reason = rule.looks_ahead(defaults)
    return {
        "kind": "evidence rule",
        "gives": [key if isinstance(key, str) else list(key) for key in rule.provides],
        "inputs": list(rule.inputs),
        "detector_only": rule.tentative or None,
        "looks_ahead": reason,
        "can_learn": rule.fit is not None,
        **_of_plugin(rule),
    }


def describe_detector(detector: Detector) -> dict[str, Any]:
    """Whether a detector needs `stereo` pictures, and its parameters."""
    return {"kind": "detector", "stereo": detector.stereo, **_of_plugin(detector)}


def _of_plugin(plugin: Plugin) -> dict[str, Any]:
    """The file of a plugin, its docstring and its parameters."""
    parameters = [
        {
            "name": spec.name,
            "kind": spec.kind,
            "default": spec.default,
            "choices": list(spec.choices),
            "per_lane": spec.per_lane,
            "range": spec.search_range if spec.is_searched else None,
            "meaning": spec.doc,
        }
        for spec in plugin.parameters
    ]
    about = inspect.cleandoc(plugin.about)
    return {"file": plugin.file, "about": about, "parameters": parameters}


# --- as text -------------------------------------------------------------------------------------


def description_text(found: Mapping[str, Any]) -> str:
    """A description as text that fits the terminal."""
    head = f"{found['kind']} {found['name']}"
    head += f"\n{found['file']}" * (found["file"] != found["name"])
    parts: list[str | Table] = [head]
    parts.append(" ".join(found["about"].split("\n\n")[0].split()))
    if found["kind"] == "graph":
        parts += _graph_parts(found)
    elif found["kind"] == "evidence rule":
        parts.append(_rule_text(found))
    else:
        parts.append("cameras: two, as a stereo pair" if found["stereo"] else "cameras: one")
    lines = ["parameters" if found["parameters"] else "parameters: none"]
    for each in found["parameters"]:
        searched = f"searched {_short(each['range'])}" if each["range"] else "not searched"
        kind = each["kind"] + " (or one per lane)" * each["per_lane"]
        facts = f"{kind}, default {_short(each['default'])}, {searched}"
        words = " or ".join(each["choices"])
        if words and each["kind"] != "choice":
            words = f"a number or {words}"
        lines.append(wrapped(f"  {each['name']}  {facts}", 4))
        lines.append(f"      {words}{': ' * bool(words)}{each['meaning']}")
    return page([*parts, "\n".join(lines)])


def _graph_parts(found: Mapping[str, Any]) -> list[str | Table]:
    """Tables of the nodes and of the probability tables, and their numbers."""
    names = {node["name"]: node["values"] for node in found["nodes"]}
    nodes = pd.DataFrame(found["nodes"]).set_index("name").rename_axis("node")
    nodes["values"] = [
        f"{v[0]} to {v[-1]}" if len(v) > 6 and v[0].isdecimal() else ", ".join(v)
        for v in nodes["values"]
    ]
    is_evidence = nodes["role"] == "virtual evidence"
    rows: list[list[str]] = []
    numbers: list[str | Table] = []
    for each in found["tables"]:
        *given, node = each["axes"]
        rows.append([node, ", ".join(given), " x ".join(map(str, each["shape"]))])
        if "values" in each:
            name, frame = table_frame(each, names)
            is_long = frame.size > MAX_PRINTED
            numbers.append(f"{name}{': in the JSON only' * is_long}")
            numbers += [] if is_long else [table(frame, dict.fromkeys(frame, ".4g"))]
    tables = pd.DataFrame(rows, columns=["table of", "given", "size"]).set_index("table of")
    return [
        f"{found['n_lanes']} lanes, {found['joint_states']} joint states",
        table(nodes[~is_evidence]),
        f"virtual evidence: {', '.join(nodes.index[is_evidence])}",
        table(tables),
        *numbers,
    ]


def table_frame(
    described: Mapping[str, Any], names: Mapping[str, Sequence[str]]
) -> tuple[str, pd.DataFrame]:
    """The name of a table, P(node given parents), and a row per combination of parents' values.

    - described: one of `describe_tables`, with its values.
    - names: of each node's values.
    """
    *given, node = described["axes"]
    *parents, own = (names[axis.removesuffix(_BEFORE)] for axis in described["axes"])
    labels = [", ".join(combination) for combination in itertools.product(*parents)]
    index = pd.Index(labels, name=", ".join(given) or " ")
    frame = pd.DataFrame(np.reshape(described["values"], (len(labels), -1)), index, list(own))
    return f"P({node}{' given ' * bool(given)}{', '.join(given)})", frame


def _rule_text(found: Mapping[str, Any]) -> str:
    keys = [
        key if isinstance(key, str) else " and ".join(key) + ", jointly" for key in found["gives"]
    ]
    lines = ["gives, for each frame"]
    lines += [f"  the likelihood of {key}" for key in keys] or ["  unknown (no PROVIDES)"]
    lines += [f"  the value of the input {name}" for name in found["inputs"]]
    if found["detector_only"]:
        lines.append(f"  {found['detector_only']} is also the answer of the detector alone")
    if found["looks_ahead"]:
        lines.append(f"  it is not causal: {found['looks_ahead']}")
    if found["can_learn"]:
        lines.append("  it learns from a recording (`egolane learn`)")
    return "\n".join(lines)


def _short(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return " to ".join(map(_short, value)) if len(value) == 2 else f"{len(value)} numbers"
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
