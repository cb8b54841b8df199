"""The structure of a network without its numbers: which node is what, and the edges; as text for
Graphviz."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

from egolane_pgm.graphs.cpds import SliceNode, ve_name
from egolane_pgm.inference.compile import Compiled

Edge = tuple[SliceNode, SliceNode]

#: What a node can be, and how Graphviz draws it: shapes and lightness differ, so that colour is
#: not needed.
_SHAPES = {
    "hidden": "shape=ellipse",
    "function": "shape=ellipse, peripheries=2",
    "observed": 'shape=ellipse, style=filled, fillcolor="#a9c1d6"',
    "input": 'shape=box, style=filled, fillcolor="#f2dfb3"',
    "virtual evidence": (
        'shape=circle, style=filled, fillcolor="#4d5a66", fixedsize=true, width=0.2, label=""'
    ),
}


@dataclass(frozen=True)
class Structure:
    """Nodes and edges of a two-slice network.

    - kind: of each node's name, "hidden", "function", "observed", "input" or "virtual evidence". A
      node that is a function has no probabilities of its own; a node that is both hidden and
      observed counts as hidden.
    - edges: the parent first; slice 0 is time t, slice 1 is time t + 1.
    """

    kind: Mapping[str, str]
    edges: Sequence[Edge]

    @property
    def within(self) -> list[tuple[str, str]]:
        """The edges inside a slice, by name."""
        return list(dict.fromkeys((a, b) for (a, s), (b, t) in self.edges if s == t))

    @property
    def across(self) -> list[tuple[str, str]]:
        """The edges from slice 0 to slice 1, by name."""
        return [(a, b) for (a, s), (b, t) in self.edges if s != t]


def structure_of(compiled: Compiled) -> Structure:
    """The structure of a compiled network, with its virtual-evidence nodes."""
    roles: dict[str, Container[str]] = {
        "input": compiled.inputs,
        "function": compiled.functions,
        "hidden": compiled.hidden,
    }
    kind = {
        name: next((role for role, names in roles.items() if name in names), "observed")
        for name, _ in compiled.tables
    }
    edges = [(parent, node) for node, table in compiled.tables.items() for parent in table.parents]
    for key in compiled.observed:
        kind[ve_name(key)] = "virtual evidence"
        names = (key,) if isinstance(key, str) else key
        edges += [((name, s), (ve_name(key), s)) for s in (0, 1) for name in names]
    return Structure(kind, edges)


def graphviz(structure: Structure) -> str:
    """The structure in Graphviz's language, the slices side by side."""
    lines = ["digraph network {", "  rankdir=TB;", "  node [fontname=Helvetica];"]
    for s, title in enumerate(("frame t", "frame t + 1")):
        lines += [f"  subgraph cluster_{s} {{", f'    label="{title}";', "    color=grey;"]
        for name, kind in structure.kind.items():
            label = "xlabel" if kind == "virtual evidence" else "label"
            look = f"{_SHAPES[kind]}, {label}={_quoted(name)}"
            lines.append(f"    {_quoted(f'{name}_{s}')} [{look}];")
        lines.append("  }")
    for (a, s), (b, t) in structure.edges:
        # Edges to the next frame must not push it below this one.
        look = "" if s == t else ' [color="#b3541e", penwidth=2, constraint=false]'
        lines.append(f"  {_quoted(f'{a}_{s}')} -> {_quoted(f'{b}_{t}')}{look};")
    return "\n".join([*lines, "}", ""])


def _quoted(name: str) -> str:
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
