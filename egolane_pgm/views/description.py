"""Descriptions of graphs, evidence rules and detectors, as plain data and as text."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.graphs.cpds import Table
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.parameters import Parameters
from egolane_pgm.plugins import plugin_errors
from egolane_pgm.views.network import structure_of
from egolane_pgm.views.tables import page, table, wrapped

#: Tables with more numbers are in the JSON only.
MAX_PRINTED = 1000

#: The suffix of a parent in the previous frame.
_BEFORE = " before"


# --- as data -------------------------------------------------------------------------------------


def describe_graph(module: ModuleType, compiled: Compiled, *, numbers: bool) -> dict[str, Any]:
    """The nodes of a compiled graph with their roles, its edges, tables and parameters.

    - numbers: add the `values` of each table, with an axis per parent; the node's axis is last.
    """
    structure = structure_of(compiled)
    nodes = [
        {"name": name, "role": kind, "values": list(compiled.values.get(name, ()))}
        for name, kind in structure.kind.items()
    ]
    tables = []
    for name in (name for name, s in compiled.tables if s == 0 and name not in compiled.inputs):
        is_one = compiled.has_one_table(name)
        frames = ("every frame",) if is_one else ("first frame", "later frames")
        tables += [_table(of, compiled.tables[name, k], numbers) for k, of in enumerate(frames)]
    return {
        **_head("graph", module),
        "n_lanes": compiled.cardinality.get("Lane"),
        "joint_states": compiled.n_states,
        "nodes": nodes,
        "edges": {"within": structure.within, "across": structure.across},
        "tables": tables,
        "parameters": _parameters(module),
    }


def describe_rule(module: ModuleType, defaults: Parameters) -> dict[str, Any]:
    """The evidence that a rule gives, and its parameters. defaults: of every parameter."""
    reason = None
    if hasattr(module, "looks_ahead"):
        with plugin_errors(module, "evidence"):
            reason = module.looks_ahead(defaults)
    keys = getattr(module, "PROVIDES", ())
    return {
        **_head("evidence rule", module),
        "gives": [key if isinstance(key, str) else list(key) for key in keys],
        "inputs": list(getattr(module, "INPUTS", ())),
        "detector_only": getattr(module, "TENTATIVE", None),
        "looks_ahead": reason,
        "can_learn": hasattr(module, "fit"),
        "parameters": _parameters(module),
    }


def describe_detector(module: ModuleType) -> dict[str, Any]:
    """Whether a detector needs `stereo` pictures, and its parameters."""
    found = {"stereo": bool(module.STEREO), "parameters": _parameters(module)}
    return {**_head("detector", module), **found}


def _head(kind: str, module: ModuleType) -> dict[str, Any]:
    about = inspect.cleandoc(module.__doc__ or "")
    return {"kind": kind, "file": str(module.__file__), "about": about}


def _table(frames: str, table: Table, numbers: bool) -> dict[str, Any]:
    name, now = table.node
    axes = [parent if s == now else parent + _BEFORE for parent, s in table.parents]
    shape = list(table.values.shape)
    found = {"node": name, "frames": frames, "axes": [*axes, name], "shape": shape}
    return {**found, "values": table.values} if numbers else found


def _parameters(module: ModuleType) -> list[dict[str, Any]]:
    return [
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
    return "\n".join([*lines, "", *_parameter_lines(found["parameters"])])


def _graph_lines(found: Mapping[str, Any]) -> list[str]:
    lines = ["", f"nodes ({found['n_lanes']} lanes, {found['joint_states']} joint states)"]
    roles = {node["name"]: node["role"] for node in found["nodes"]}
    values = {node["name"]: node["values"] for node in found["nodes"]}
    width = max(map(len, roles))
    for name, role in roles.items():
        text = _values_text(values[name])
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
            lines.append(_numbers_text(each, values))
    lines[-1] = lines[-1].rstrip()
    return lines


def _values_text(names: Sequence[str]) -> str:
    first = int(names[0]) if names and names[0].isdecimal() else 0
    if len(names) > 6 and list(names) == [str(first + k) for k in range(len(names))]:
        return f"{names[0]} to {names[-1]}"
    return ", ".join(names)


def _numbers_text(found: Mapping[str, Any], names: Mapping[str, Sequence[str]]) -> str:
    """A table of probabilities: a row for each combination of the parents' values."""
    values = found["values"]
    if values.size > MAX_PRINTED:
        return f"    {values.size} numbers, which JSON lists"
    *given, node = found["axes"]
    of_parents = (names[axis.removesuffix(_BEFORE)] for axis in given)
    rows = [", ".join(combination) for combination in itertools.product(*of_parents)]
    cells = np.reshape(values, (len(rows), -1))
    frame = pd.DataFrame(cells, index=pd.Index(rows, name=", ".join(given) or " "))
    printed = table(frame.set_axis(list(names[node]), axis=1), dict.fromkeys(names[node], ".4g"))
    return f"\n{page([printed])}\n"


def _rule_lines(found: Mapping[str, Any]) -> list[str]:
    keys = [
        key if isinstance(key, str) else " and ".join(key) + ", jointly" for key in found["gives"]
    ]
    lines = ["", "gives, for each frame"]
    lines += [f"  the likelihood of {key}" for key in keys] or ["  unknown (no PROVIDES)"]
    lines += [f"  the value of the input {name}" for name in found["inputs"]]
    if found["detector_only"]:
        lines.append(f"  {found['detector_only']} is also the detector's own answer")
    if found["looks_ahead"]:
        lines.append(wrapped(f"  it is not causal: {found['looks_ahead']}", 2))
    if found["can_learn"]:
        lines.append("  it learns from a recording (`egolane learn`)")
    return lines


def _parameter_lines(parameters: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = ["parameters" if parameters else "parameters: none"]
    for each in parameters:
        facts = [each["kind"] + (" (or one per lane)" if each["per_lane"] else "")]
        facts.append(f"default {_short(each['default'])}")
        facts.append(f"searched {_short(each['range'])}" if each["range"] else "not searched")
        text = each["meaning"]
        if each["choices"]:
            number = "" if each["kind"] == "choice" else "a number or "
            text = f"{number}{' or '.join(each['choices'])}: {text}"
        lines += [wrapped(f"  {each['name']}  {', '.join(facts)}", 4), wrapped(f"      {text}")]
    return lines


def _short(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return " to ".join(map(_short, value)) if len(value) == 2 else f"{len(value)} numbers"
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
