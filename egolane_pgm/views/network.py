"""The structure of a network, as a picture of its two slices or in a BIF file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Rectangle

from egolane_pgm.graphs.cpds import SliceNode, bif, ve_name
from egolane_pgm.inference.compile import Compiled, compiled_of
from egolane_pgm.tools.files import write_text
from egolane_pgm.views.style import INK, inline_figure, new_figure, write_figure

Shape = Circle | Rectangle

#: What edges gain, by parent, child and lag.
Gains = Mapping[tuple[str, str, int], float]

#: Fill of each kind of node. Kinds differ in lightness and shape too, so colour is not needed.
_FILL = {
    "hidden": "#ffffff",
    "function": "#ffffff",
    "observed": "#a9c1d6",
    "input": "#f2dfb3",
    "virtual evidence": "#4d5a66",
}
_TEMPORAL = "#b3541e"

#: The bends that are tried for an edge, the straight line first.
_BENDS = (0.0, 0.12, -0.12, 0.22, -0.22, 0.32, -0.32, 0.45, -0.45)

#: Radius of a node, units of the drawing, as all lengths but the last.
_RADIUS = 0.52

#: Radius of a node of virtual evidence, which has no name in it.
_SMALL = 0.17

#: Distance between the centres of two nodes.
_STEP = 1.5

#: Distance between the centre of an outer node and the frame of its slice.
_MARGIN = 0.75

#: Distance between the slices: room for the edges from one to the other.
_GAP = 1.3

#: Inches of a unit.
_INCH = 0.8


class Structure(NamedTuple):
    """Nodes and edges of a network of two slices.

    - kind: by node: "hidden", "function" (of its parents), "observed", "input", "virtual evidence".
    - within, across: edges inside a slice, and from one slice to the next, the parent first.
    """

    kind: Mapping[str, str]
    within: Sequence[tuple[str, str]]
    across: Sequence[tuple[str, str]]


def structure_of(compiled: Compiled) -> Structure:
    """The structure of a compiled network, with its virtual-evidence nodes."""
    kind = {name: "observed" for name, _ in compiled.tables}
    for name in compiled.hidden:
        kind[name] = "hidden" if name in compiled.state_nodes else "function"
    kind |= dict.fromkeys(compiled.inputs, "input")
    within: list[tuple[str, str]] = []
    across: list[tuple[str, str]] = []
    for (name, s), table in compiled.tables.items():
        for parent, t in table.parents:
            (within if s == t else across).append((parent, name))
    for key in compiled.observed:
        kind[ve_name(key)] = "virtual evidence"
        within += [(name, ve_name(key)) for name in ((key,) if isinstance(key, str) else key)]
    return Structure(kind, list(dict.fromkeys(within)), across)


def write_network(compiled: Compiled, path: Path, gains: Gains | None = None) -> None:
    """Write a picture of a network, or both slices with their tables, as BIF (.bif).

    - gains: see `network_figure`.

    Raises InputError for a file that cannot be written.
    """
    if path.suffix.lower() == ".bif":
        write_text(path, bif(compiled.tables.values(), compiled.values))
    else:
        write_figure(lambda: network_figure(structure_of(compiled), gains), path)


# --- the picture ---------------------------------------------------------------------------------


def draw_network(network: Any) -> Figure:
    """Draw the two slices of a network: hidden, observed, input and function nodes.

    - network: a result, its model, or a network as `compile` returns it.

    Raises InputError for anything else.

    >>> import egolane_pgm as ego
    >>> run = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> figure = ego.draw_network(run.model)
    """
    return inline_figure(lambda: network_figure(structure_of(compiled_of(network))))


def network_figure(structure: Structure, gains: Gains | None = None) -> Figure:
    """Draw the two slices side by side, as in the paper's Figure `fig:model`.

    Hidden nodes are white circles, functions have a double outline, observed nodes are blue-grey,
    inputs are squares, and virtual-evidence nodes are small and dark.

    - gains: of edges, by parent, child and lag (0 or 1); these are drawn up to five times
      as wide.
    """
    gains = gains or {}
    most = max([1e-9, *gains.values()])
    places = _places(structure)
    width, height = np.max(list(places.values()), axis=0)
    shift = width + 2 * _MARGIN + _GAP
    wide = (width + shift + 2 * _MARGIN + 0.1) * _INCH
    figure = new_figure(max(wide, 4.8), (height + 2 * _MARGIN + 0.6) * _INCH + 0.7)
    ax = figure.subplots()
    ax.set(
        xlim=(-_MARGIN - 0.05, width + shift + _MARGIN + 0.05),
        ylim=(height + _MARGIN + 0.15, -_MARGIN - 0.45),
        aspect="equal",
    )
    ax.axis("off")
    nodes: dict[SliceNode, Shape] = {}
    for s, title in enumerate(("frame t", "frame t + 1")):
        corner = (s * shift - _MARGIN, -_MARGIN)
        margin = 2 * _MARGIN
        rounded = "round,pad=0,rounding_size=0.2"
        box = FancyBboxPatch(corner, width + margin, height + margin + 0.1, boxstyle=rounded)
        box.set(facecolor="#f4f4f2", edgecolor="none", zorder=0)
        ax.add_patch(box)
        ax.text(s * shift + width / 2, -_MARGIN - 0.1, title, ha="center", fontsize=10)
        for name, (x, y) in places.items():
            nodes[name, s] = _draw_node(ax, name, structure.kind[name], s * shift + x, y)
            nodes[name, s].set_gid(f"node {name} {s}")
    edges = [((a, s), (b, s)) for s in (0, 1) for a, b in structure.within]
    for edge in [*edges, *(((a, 0), (b, 1)) for a, b in structure.across)]:
        (parent, s), (child, t) = edge
        gain = gains.get((parent, child, t - s))
        _draw_edge(ax, edge, nodes, 1.0 if gain is None else 1 + 4 * max(gain, 0.0) / most)
    entries: dict[str, Any] = {}
    for kind in [each for each in _FILL if each in structure.kind.values()]:
        sizes = {"function": (10, 7), "virtual evidence": (5,)}.get(kind, (10,))
        look: Any = {"ls": "", "marker": "os"[kind == "input"], "mfc": _FILL[kind], "mec": INK}
        entries[kind] = tuple(Line2D([], [], ms=size, **look) for size in sizes)
    entries["within a frame"] = Line2D([], [], color=INK, lw=1.1)
    if structure.across:
        entries["to the next frame"] = Line2D([], [], color=_TEMPORAL, lw=1.9)
    if gains:
        entries["wider: gains more"] = Line2D([], [], color=INK, lw=5)
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=3)
    return figure


def _places(structure: Structure) -> dict[str, tuple[float, float]]:
    """The centre (x, y) of each node of a slice, y downwards: children below their parents.

    A node with an edge to the next slice has a separate row, which keeps these edges free.
    """
    depth = dict.fromkeys(structure.kind, 0)
    for _ in depth:
        for parent, child in structure.within:
            depth[child] = max(depth[child], depth[parent] + 1)
    temporal = {name for edge in structure.across for name in edge}
    x: dict[str, float] = {}
    y: dict[str, float] = {}
    at = -_STEP
    for layer in range(max(depth.values()) + 1):
        names = [name for name in depth if depth[name] == layer]
        parents = [[x[a] for a, b in structure.within if b == name] for name in names]
        wanted = np.array([np.mean(of) if of else i * _STEP for i, of in enumerate(parents)])
        order = np.argsort(wanted, kind="stable")
        steps = np.arange(len(names)) * _STEP
        placed = np.maximum.accumulate(wanted[order] - steps) + steps
        placed += np.mean(wanted[order] - placed)
        x.update(zip((names[k] for k in order), placed.tolist(), strict=True))
        shared = [name for name in names if name not in temporal]
        for row in [[name] for name in names if name in temporal] + [shared] * bool(shared):
            is_small = all(structure.kind[name] == "virtual evidence" for name in row)
            at += 0.8 * _STEP if is_small else _STEP
            y.update(dict.fromkeys(row, at))
    return {name: (x[name] - min(x.values()), y[name]) for name in structure.kind}


def _draw_node(ax: Axes, name: str, kind: str, x: float, y: float) -> Shape:
    radius = _SMALL if kind == "virtual evidence" else _RADIUS
    look: dict[str, Any] = {"fc": _FILL[kind], "ec": INK, "lw": 1.2, "zorder": 3}
    node: Shape = Circle((x, y), radius, **look)
    if kind == "input":
        half = 0.85 * radius
        node = Rectangle((x - half, y - half), 2 * half, 2 * half, **look)
    ax.add_patch(node)
    if kind == "function":
        ax.add_patch(Circle((x, y), radius - 0.06, **look))
    if kind == "virtual evidence":
        label = name.replace("+", "\n+ ")
        ax.text(x, y + radius + 0.08, label, fontsize=7, ha="center", va="top")
        return node
    words = re.sub("(?<=[a-z])(?=[A-Z])", "_", name).split("_")
    size = min(9.5, 78 / max(map(len, words)), 34 / len(words))
    ax.text(x, y, "\n".join(words), fontsize=size, ha="center", va="center", zorder=4)
    return node


def _draw_edge(
    ax: Axes,
    edge: tuple[SliceNode, SliceNode],
    nodes: Mapping[SliceNode, Shape],
    width: float = 1.0,
) -> None:
    """Draw an edge with the smallest bend that keeps it clear of all other nodes."""
    start, end = edge
    a, b, *others = np.array(
        [nodes[n].get_center() for n in (*edge, *(n for n in nodes if n not in edge))]
    )
    s = np.linspace(0, 1, 51)[:, None]

    def room(bend: float) -> float:
        control = (a + b) / 2 + bend * (b - a)[::-1] * (1, -1)
        curve = (1 - s) ** 2 * a + 2 * s * (1 - s) * control + s**2 * b
        distances = [float(np.linalg.norm(curve - other, axis=1).min()) for other in others]
        return min([_RADIUS + 0.1, *distances])

    is_temporal = start[1] != end[1]
    arrow = FancyArrowPatch(
        a.tolist(), b.tolist(), patchA=nodes[start], patchB=nodes[end], shrinkA=0, shrinkB=1,
        # The y axis points down, which mirrors the arc.
        connectionstyle=f"arc3,rad={-max(_BENDS, key=room)}",
        arrowstyle="-|>,head_length=5,head_width=2.8",
        color=_TEMPORAL if is_temporal else INK,
        linewidth=width * (1.9 if is_temporal else 1.1),
        zorder=2,
    )  # fmt: skip
    arrow.set_gid(f"edge {start[0]} {start[1]} {end[0]} {end[1]}")
    ax.add_patch(arrow)
