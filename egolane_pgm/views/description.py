"""Descriptions of graphs, evidence rules and detectors, as data and as text."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.parameters import Parameters
from egolane_pgm.plugins import plugin_errors
from egolane_pgm.views.network import structure_of
from egolane_pgm.views.tables import page, table, wrapped

#: Longer tables are in the JSON only.
MAX_PRINTED = 1000

#: The suffix of a parent in the previous frame.
_BEFORE = " before"


# --- as data -------------------------------------------------------------------------------------


def describe_graph(module: ModuleType, compiled: Compiled, *, numbers: bool) -> dict[str, Any]:
    """The nodes of a compiled graph with their roles, its edges, tables and parameters.

    - numbers: add the `values` of each table: an axis per parent, then the axis of the node.
    """
    structure = structure_of(compiled)
    tables: list[dict[str, Any]] = []
    for name in (name for name, s in compiled.tables if s == 0 and name not in compiled.inputs):
        frames = ["first frame", "later frames"]
        for s, when in enumerate(["every frame"] if name in compiled.one_table else frames):
            each = compiled.tables[name, s]
            parents = [parent + _BEFORE * (t != s) for parent, t in each.parents]
            axes, shape = [*parents, name], list(each.values.shape)
            tables.append({"node": name, "frames": when, "axes": axes, "shape": shape})
            if numbers:
                tables[-1]["values"] = each.values
    return {
        "kind": "graph",
        "n_lanes": compiled.cardinality.get("Lane"),
        "joint_states": compiled.n_states,
        "nodes": [
            {"name": name, "role": role, "values": list(compiled.values.get(name, ()))}
            for name, role in structure.kind.items()
        ],
        "edges": {"within": structure.within, "across": structure.across},
        "tables": tables,
        **_of_module(module),
    }


def describe_rule(module: ModuleType, defaults: Parameters) -> dict[str, Any]:
    """The evidence that a rule gives, and its parameters. defaults: of every parameter."""
    reason = None
    if hasattr(module, "looks_ahead"):
        with plugin_errors(module, "evidence"):
            reason = module.looks_ahead(defaults)
    keys = getattr(module, "PROVIDES", ())
    return {
        "kind": "evidence rule",
        "gives": [key if isinstance(key, str) else list(key) for key in keys],
        "inputs": list(getattr(module, "INPUTS", ())),
        "detector_only": getattr(module, "TENTATIVE", None),
        "looks_ahead": reason,
        "can_learn": hasattr(module, "fit"),
        **_of_module(module),
    }


def describe_detector(module: ModuleType) -> dict[str, Any]:
    """Whether a detector needs `stereo` pictures, and its parameters."""
    return {"kind": "detector", "stereo": bool(module.STEREO), **_of_module(module)}


def _of_module(module: ModuleType) -> dict[str, Any]:
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
        for spec in getattr(module, "PARAMETERS", ())
    ]
    about = inspect.cleandoc(module.__doc__ or "")
    return {"file": str(module.__file__), "about": about, "parameters": parameters}


# --- as text -------------------------------------------------------------------------------------


def description_text(found: Mapping[str, Any]) -> str:
    """A description as text that fits the terminal."""
    lines = [f"{found['kind']} {found['name']}"]
    lines += [found["file"]] if found["file"] != found["name"] else []
    if found["about"]:
        lines += ["", wrapped(" ".join(found["about"].split("\n\n")[0].split()))]
    if found["kind"] == "graph":
        lines += _graph_lines(found)
    elif found["kind"] == "evidence rule":
        lines += _rule_lines(found)
    else:
        lines += ["", "cameras: two, as a stereo pair" if found["stereo"] else "cameras: one"]
    lines += ["", "parameters" if found["parameters"] else "parameters: none"]
    for each in found["parameters"]:
        searched = f"searched {_short(each['range'])}" if each["range"] else "not searched"
        facts = (
            f"{each['kind']}{' (or one per lane)' * each['per_lane']},"
            f" default {_short(each['default'])}, {searched}"
        )
        text = each["meaning"]
        if each["choices"]:
            number = "a number or " * (each["kind"] != "choice")
            text = f"{number}{' or '.join(each['choices'])}: {text}"
        lines += [wrapped(f"  {each['name']}  {facts}", 4), wrapped(f"      {text}")]
    return "\n".join(lines)


def _graph_lines(found: Mapping[str, Any]) -> list[str]:
    lines = ["", f"nodes ({found['n_lanes']} lanes, {found['joint_states']} joint states)"]
    nodes = {node["name"]: node for node in found["nodes"]}
    width = max(map(len, nodes))
    for name, node in nodes.items():
        values, role = node["values"], node["role"]
        text = ", ".join(values)
        if len(values) > 6 and values[0].isdecimal():
            text = f"{values[0]} to {values[-1]}"
        if role == "virtual evidence":
            of = [parent for parent, child in found["edges"]["within"] if child == name]
            text = f"the likelihood of {', '.join(of)}"
        lines.append(wrapped(f"  {name:{width}}  {role:16}  {text}", width + 20))
    lines += ["", "tables (the edges of the graph; the axes are the parents and the node itself)"]
    for each in found["tables"]:
        *given, node = each["axes"]
        frames = "" if each["frames"] == "every frame" else f"  ({each['frames']})"
        shape = " x ".join(map(str, each["shape"]))
        text = f"  P({node}{' | ' if given else ''}{', '.join(given)})"
        lines.append(wrapped(f"{text:58} {shape}{frames}", 2))
        if "values" in each:
            names = [nodes[axis.removesuffix(_BEFORE)]["values"] for axis in each["axes"]]
            lines.append(_numbers_text(each, names))
    lines[-1] = lines[-1].rstrip()
    return lines


def _numbers_text(found: Mapping[str, Any], names: Sequence[Sequence[str]]) -> str:
    """A table of probabilities: a row for each combination of the parents' values."""
    values = found["values"]
    if values.size > MAX_PRINTED:
        return f"    {values.size} numbers, in the JSON only"
    rows = [", ".join(combination) for combination in itertools.product(*names[:-1])]
    parents = pd.Index(rows, name=", ".join(found["axes"][:-1]) or " ")
    frame = pd.DataFrame(np.reshape(values, (len(rows), -1)), parents, list(names[-1]))
    return f"\n{page([table(frame, dict.fromkeys(frame, '.4g'))])}\n"


def _rule_lines(found: Mapping[str, Any]) -> list[str]:
    keys = [
        key if isinstance(key, str) else " and ".join(key) + ", jointly" for key in found["gives"]
    ]
    lines = ["", "gives, for each frame"]
    lines += [f"  the likelihood of {key}" for key in keys] or ["  unknown (no PROVIDES)"]
    lines += [f"  the value of the input {name}" for name in found["inputs"]]
    if found["detector_only"]:
        lines.append(f"  {found['detector_only']} is also the answer of the detector alone")
    if found["looks_ahead"]:
        lines.append(wrapped(f"  it is not causal: {found['looks_ahead']}", 2))
    if found["can_learn"]:
        lines.append("  it learns from a recording (`egolane learn`)")
    return lines


def _short(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return " to ".join(map(_short, value)) if len(value) == 2 else f"{len(value)} numbers"
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
