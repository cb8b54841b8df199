"""What a graph, an evidence rule or a detector is, as plain data and as text for a terminal."""

from __future__ import annotations

import inspect
import itertools
import re
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from egolane_pgm.graphs.cpds import Table
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.parameters import Parameter, Parameters
from egolane_pgm.plugins import plugin_errors
from egolane_pgm.views.structure import structure_of
from egolane_pgm.views.tables import line_width, wrapped

#: A table of more numbers is not printed: nobody reads them, and they are in the JSON.
MAX_PRINTED = 1000

#: What follows the name of a parent in the frame before.
_BEFORE = " before"

#: The end of a parameter's meaning that names its place in the paper.
_SOURCE = re.compile(r"(?:; |, )?((?:\w+ of )?(?:Tables?|Figure|equation|section) [`\"].*)$")


# --- as data ------------------------------------------------------------------------------------


def describe_graph(module: ModuleType, compiled: Compiled, *, numbers: bool) -> dict[str, Any]:
    """A compiled graph: its `nodes` with their `role`, its `edges`, `tables` and `parameters`.

    - numbers: the tables have their `values` too, one axis per parent and the node's own last.
    """
    structure = structure_of(compiled)
    nodes = [
        {"name": name, "role": kind, "values": list(compiled.values.get(name, ()))}
        for name, kind in structure.kind.items()
    ]
    tables = []
    for name, _ in [node for node in compiled.tables if node[1] == 0]:
        first, later = compiled.tables[name, 0], compiled.tables[name, 1]
        if name in compiled.inputs:
            continue
        if compiled.has_one_table(name):
            tables.append(_table("every frame", first, numbers))
        else:
            tables.append(_table("first frame", first, numbers))
            tables.append(_table("later frames", later, numbers))
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
    """An evidence rule: what it `gives`, and its `parameters`.

    - defaults: the value of every parameter, for what the rule says of itself.
    """
    reason = None
    if hasattr(module, "looks_ahead"):
        with plugin_errors(module, "evidence"):
            reason = module.looks_ahead(defaults)
    return {
        **_head("evidence rule", module),
        "gives": [
            key if isinstance(key, str) else list(key) for key in getattr(module, "PROVIDES", ())
        ],
        "inputs": list(getattr(module, "INPUTS", ())),
        "detector_only": getattr(module, "TENTATIVE", None),
        "looks_ahead": reason,
        "can_learn": hasattr(module, "fit"),
        "parameters": _parameters(module),
    }


def describe_detector(module: ModuleType) -> dict[str, Any]:
    """A detector: whether it needs `stereo` pictures, and its `parameters`."""
    return {
        **_head("detector", module),
        "stereo": bool(module.STEREO),
        "parameters": _parameters(module),
    }


def _head(kind: str, module: ModuleType) -> dict[str, Any]:
    about = inspect.cleandoc(module.__doc__ or "")
    return {"kind": kind, "file": str(module.__file__), "about": about}


def _table(frames: str, table: Table, numbers: bool) -> dict[str, Any]:
    name, now = table.node
    axes = [parent if s == now else parent + _BEFORE for parent, s in table.parents]
    found = {
        "node": name,
        "frames": frames,
        "axes": [*axes, name],
        "shape": list(table.values.shape),
    }
    return {**found, "values": table.values} if numbers else found


def _parameters(module: ModuleType) -> list[dict[str, Any]]:
    return [_parameter(spec) for spec in getattr(module, "PARAMETERS", ())]


def _parameter(spec: Parameter) -> dict[str, Any]:
    source = _SOURCE.search(spec.doc)
    return {
        "name": spec.name,
        "kind": spec.kind,
        "default": spec.default,
        "choices": list(spec.choices),
        "per_lane": spec.per_lane,
        "range": spec.search_range if spec.is_searched else None,
        "is_searched": spec.is_searched,
        "meaning": spec.doc[: source.start()] if source else spec.doc,
        "source": source[1] if source else None,
    }


# --- as text ------------------------------------------------------------------------------------


def description_text(found: Mapping[str, Any]) -> str:
    """A description as text, no line of which is wider than a terminal of 100 columns, but for
    names that are."""
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
    width = max(len(node["name"]) for node in found["nodes"])
    parents: dict[str, list[str]] = {node["name"]: [] for node in found["nodes"]}
    for parent, child in found["edges"]["within"]:
        parents[child].append(parent)
    for node in found["nodes"]:
        name, role = node["name"], node["role"]
        evidence = f"the likelihood of {', '.join(parents[name])}"
        said = evidence if role == "virtual evidence" else _values(node["values"])
        lines.append(
            wrapped(f"  {name:{width}}  {role:{len('virtual evidence')}}  {said}", width + 20)
        )
    roles = {node["name"]: node["role"] for node in found["nodes"]}
    for title, which in (("within a frame", "within"), ("to the next frame", "across")):
        children: dict[str, list[str]] = {}
        for parent, child in found["edges"][which]:
            if roles[child] != "virtual evidence":
                children.setdefault(parent, []).append(child)
        lines += ["", f"edges {title}"]
        for parent, names in children.items():
            lines.append(wrapped(f"  {parent:{width}}  -> {', '.join(names)}", width + 5))
    lines += ["", "tables (the axes are the parents and the node itself)"]
    values = {node["name"]: node["values"] for node in found["nodes"]}
    for table in found["tables"]:
        *given, node = table["axes"]
        frames = "" if table["frames"] == "every frame" else f"  ({table['frames']})"
        shape = " x ".join(map(str, table["shape"]))
        text = f"  P({node}{' | ' if given else ''}{', '.join(given)})"
        lines.append(wrapped(f"{text:58} {shape}{frames}", 2))
        if "values" in table:
            lines += _numbers(table, values)
    return lines


def _values(names: Sequence[str]) -> str:
    first = int(names[0]) if names[0].isdecimal() else 0
    if len(names) > 6 and list(names) == [str(first + k) for k in range(len(names))]:
        return f"{names[0]} to {names[-1]}"
    return ", ".join(names)


def _numbers(table: Mapping[str, Any], names: Mapping[str, Sequence[str]]) -> list[str]:
    """The rows of a table, one for each combination of the parents' values."""
    values = table["values"]
    if values.size > MAX_PRINTED:
        return [f"    {values.size} numbers, which the JSON has"]
    *given, node = table["axes"]
    of_parents = (names[axis.removesuffix(_BEFORE)] for axis in given)
    labels = ["", *map(", ".join, itertools.product(*of_parents))]
    margin = max(map(len, labels))
    per_line = max(1, (line_width() - margin - 4) // 10)
    rows = values.reshape(len(labels) - 1, -1)
    cells = [
        [f"{name:>10}" for name in names[node]],
        *([f"{p:10.4g}" for p in row] for row in rows),
    ]
    lines = []
    for label, row in zip(labels, cells, strict=True):
        for k in range(0, len(row), per_line):
            lines.append(f"    {'' if k else label:{margin}}" + "".join(row[k : k + per_line]))
    return lines


def _rule_lines(found: Mapping[str, Any]) -> list[str]:
    keys = [
        key if isinstance(key, str) else " and ".join(key) + ", jointly" for key in found["gives"]
    ]
    lines = ["", "gives, for each frame"]
    lines += [f"  the likelihood of {key}" for key in keys] or ["  what it does not say (PROVIDES)"]
    lines += [f"  the value of the input {name}" for name in found["inputs"]]
    if found["detector_only"]:
        lines.append(f"  {found['detector_only']} is also the detector's own answer")
    if found["looks_ahead"]:
        lines.append(wrapped(f"  it is not causal: {found['looks_ahead']}", 2))
    if found["can_learn"]:
        lines.append("  it learns from a recording (`egolane learn`)")
    return lines


def _parameter_lines(parameters: Sequence[Mapping[str, Any]]) -> list[str]:
    if not parameters:
        return ["parameters: none"]
    rows = [["parameters", "kind", "default", "in a search"]]
    for each in parameters:
        kind = each["kind"] + (", or per lane" if each["per_lane"] else "")
        search = _short(each["range"]) if each["is_searched"] else "held fixed"
        rows.append([f"  {each['name']}", kind, _short(each["default"]), search])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    first, *others = (
        "  ".join(f"{text:{w}}" for text, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )
    lines = [first]
    for line, each in zip(others, parameters, strict=True):
        said = "; ".join(filter(None, (each["meaning"], each["source"])))
        if each["choices"]:
            number = "" if each["kind"] == "choice" else "a number or "
            said = f"{number}{' or '.join(each['choices'])}: {said}"
        lines += [line, wrapped(f"      {said}")]
    return lines


def _short(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return " to ".join(map(_short, value)) if len(value) == 2 else f"{len(value)} numbers"
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
