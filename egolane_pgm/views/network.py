"""Writes a network as it is declared: a picture of its two slices, or text for other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, FancyArrowPatch, FancyBboxPatch, Rectangle

from egolane_pgm.graphs.cpds import SliceNode
from egolane_pgm.graphs.flat import bif
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.tools.files import write_text
from egolane_pgm.types import InputError
from egolane_pgm.views.answers import INK
from egolane_pgm.views.structure import Structure, graphviz, structure_of
from egolane_pgm.views.style import FORMATS, axes_at, new_figure, write_figure

#: How the name of a file ends that a network can be written to.
ENDINGS = (*FORMATS, ".dot", ".bif")

Node = Ellipse | Rectangle

# Kinds of nodes differ in lightness, outline and shape as well as in hue, so that colour is not
# needed.
_FILL = {
    "hidden": "#ffffff",
    "function": "#ffffff",
    "observed": "#a9c1d6",
    "input": "#f2dfb3",
    "virtual evidence": "#4d5a66",
}
_TEMPORAL, _FRAME = "#b3541e", "#f4f4f2"
_RADIUS, _SMALL = 0.52, 0.17

# Distances in the units of the radii: between columns and rows, down to virtual evidence, between
# the slices, around them; and inches of a unit.
_STEP, _EVIDENCE_STEP, _SLICE_GAP, _MARGIN, _INCHES = 1.5, 1.2, 1.3, 0.75, 0.82


def _places(structure: Structure) -> dict[str, tuple[float, float]]:
    """The middle of each node of a slice: a name below its parents, and right below them if there
    is room. The upper left one is at (0, 0)."""
    depth = dict.fromkeys(structure.kind, 0)
    for _ in depth:
        for parent, child in structure.within:
            depth[child] = max(depth[child], depth[parent] + 1)
    temporal = {name for edge in structure.across for name in edge}
    x: dict[str, float] = {}
    y: dict[str, float] = {}
    at = _STEP
    for layer in range(max(depth.values()) + 1):
        names = [name for name in depth if depth[name] == layer]
        parents = [[x[a] for a, b in structure.within if b == name] for name in names]
        wanted = np.array([np.mean(of) if of else i * _STEP for i, of in enumerate(parents)])
        order = np.argsort(wanted, kind="stable")
        steps = np.arange(len(names)) * _STEP
        placed = np.maximum.accumulate(wanted[order] - steps) + steps
        placed += np.mean(wanted[order] - placed)
        x.update(zip((names[k] for k in order), placed.tolist(), strict=True))
        # A name with arrows to or from the other slice gets a row of its own, so that these arrows
        # run between the slices without crossing another node.
        shared = [name for name in names if name not in temporal]
        for row in [[name] for name in names if name in temporal] + [shared] * bool(shared):
            is_small = all(structure.kind[name] == "virtual evidence" for name in row)
            at -= _EVIDENCE_STEP if is_small else _STEP
            y.update(dict.fromkeys(row, at))
    return {name: (x[name] - min(x.values()), y[name]) for name in structure.kind}


def _bend(start: SliceNode, end: SliceNode, nodes: dict[SliceNode, Node]) -> float:
    """The smallest bend (`rad` of matplotlib's arc3) with which an arrow clears all other nodes."""
    ends = np.array([nodes[start].get_center(), nodes[end].get_center()])
    others = [patch for node, patch in nodes.items() if node not in (start, end)]
    if not others:
        return 0.0
    middle = np.array([patch.get_center() for patch in others])
    radius = np.array([patch.get_width() / 2 for patch in others])
    across = (ends[1] - ends[0])[::-1] * (1, -1)
    s = np.linspace(0.0, 1.0, 60)[:, np.newaxis]

    def room(bend: float) -> float:
        control = ends.mean(axis=0) + bend * across
        curve = (1 - s) ** 2 * ends[0] + 2 * s * (1 - s) * control + s**2 * ends[1]
        distance = np.linalg.norm(curve[:, np.newaxis] - middle, axis=2).min(axis=0)
        return float((distance - radius).min())

    bends = (0.0, 0.12, -0.12, 0.22, -0.22, 0.32, -0.32, 0.45, -0.45)
    return next((bend for bend in bends if room(bend) > 0.1), max(bends, key=room))


def _draw_node(ax: Axes, name: str, kind: str, x: float, y: float) -> Node:
    radius = _SMALL if kind == "virtual evidence" else _RADIUS
    look: dict[str, Any] = {"edgecolor": INK, "linewidth": 1.2, "zorder": 3}
    if kind == "input":
        side = 1.7 * radius
        node: Node = Rectangle((x - side / 2, y - side / 2), side, side, fc=_FILL[kind], **look)
    else:
        node = Circle((x, y), radius, fc=_FILL[kind], **look)
    ax.add_patch(node)
    if kind == "function":
        ax.add_patch(Circle((x, y), radius - 0.06, fill=False, **look))
    if kind == "virtual evidence":
        label = name.replace("+", "\n+ ")
        ax.text(x, y - radius - 0.08, label, fontsize=7, color=INK, ha="center", va="top")
        return node
    # One word per line, split at capitals and underscores.
    words = re.findall(r"[A-Z]+(?![a-z])\d*|[A-Z]?[a-z0-9]+|[^A-Za-z_]+", name) or [name]
    size = min(9.5, 78 / max(map(len, words)), 34 / len(words))
    text = "\n".join(words)
    ax.text(x, y, text, fontsize=size, color=INK, ha="center", va="center", zorder=4)
    return node


def _draw_arrow(ax: Axes, start: SliceNode, end: SliceNode, nodes: dict[SliceNode, Node]) -> None:
    is_temporal = start[1] != end[1]
    arrow = FancyArrowPatch(
        *np.array([nodes[start].get_center(), nodes[end].get_center()]).tolist(),
        connectionstyle=f"arc3,rad={_bend(start, end, nodes)}",
        patchA=nodes[start],
        patchB=nodes[end],
        shrinkA=0,
        shrinkB=1,
        arrowstyle="-|>,head_length=5,head_width=2.8",
        color=_TEMPORAL if is_temporal else INK,
        linewidth=1.9 if is_temporal else 1.1,
        zorder=2,
    )
    arrow.set_gid(f"edge {start[0]} {start[1]} {end[0]} {end[1]}")
    ax.add_patch(arrow)


def _legend(structure: Structure) -> dict[str, tuple[Line2D, ...]]:
    """The marks of the legend by their labels; a function's is two circles."""
    entries: dict[str, tuple[Line2D, ...]] = {}
    for kind, fill in _FILL.items():
        if kind in structure.kind.values():
            sizes = {"function": (10, 7), "virtual evidence": (6,)}.get(kind, (10,))
            marker = "s" if kind == "input" else "o"
            entries["function of its parents" if kind == "function" else kind] = tuple(
                Line2D([], [], ls="none", marker=marker, mfc=fill, mec=INK, markersize=size)
                for size in sizes
            )
    entries["within a frame"] = (Line2D([], [], color=INK, linewidth=1.1),)
    if structure.across:
        entries["to the next frame"] = (Line2D([], [], color=_TEMPORAL, linewidth=1.9),)
    return entries


def network_figure(structure: Structure) -> Figure:
    """Draws the two slices side by side, as in the paper's Figure `fig:model`.

    Hidden nodes are white circles, functions of other nodes have a double outline, observed nodes
    are blue-grey, inputs are squares, and virtual-evidence nodes are small and dark.
    """
    places = _places(structure)
    width, height = max(x for x, _ in places.values()), -min(y for _, y in places.values())
    step = width + 2 * _MARGIN + _SLICE_GAP
    entries = _legend(structure)
    across = max((width + step + 2 * _MARGIN + 0.1) * _INCHES, 4.8)
    columns = min(len(entries), max(2, int(across / 1.55)))
    # The legend's lines below the network.
    below = 0.15 + 0.24 * -(-len(entries) // columns)
    down = (height + 2 * _MARGIN + 0.5) * _INCHES
    figure = new_figure(across, down + below)
    ax = axes_at(figure, 0, 0, across, down)
    ax.set(
        xlim=(-_MARGIN - 0.05, width + step + _MARGIN + 0.05),
        ylim=(-height - _MARGIN - 0.05, _MARGIN + 0.45),
        aspect="equal",
    )
    ax.axis("off")
    nodes: dict[SliceNode, Node] = {}
    for s, title in enumerate(("frame $t$", "frame $t + 1$")):
        corner, size = (s * step - _MARGIN, -height - _MARGIN), 2 * _MARGIN
        ax.add_patch(
            FancyBboxPatch(
                corner, width + size, height + size, boxstyle="round,pad=0,rounding_size=0.2",
                facecolor=_FRAME, edgecolor="none", zorder=0,
            )
        )  # fmt: skip
        ax.text(s * step + width / 2, _MARGIN + 0.1, title, ha="center", fontsize=10)
        for name, (x, y) in places.items():
            nodes[name, s] = _draw_node(ax, name, structure.kind[name], s * step + x, y)
            nodes[name, s].set_gid(f"node {name} {s}")
    for start, end in structure.edges:
        _draw_arrow(ax, start, end, nodes)
    ax.legend(
        [*entries.values()], [*entries], loc="upper center", bbox_to_anchor=(0.5, 0.0),
        ncols=columns, labelspacing=0.7, frameon=False, fontsize=8.5, handletextpad=0.6,
        columnspacing=1.6,
    )  # fmt: skip
    return figure


def write_network(compiled: Compiled, path: str | Path) -> None:
    """Writes a network in the form that the ending of the path names.

    - .png, .svg, .pdf: a picture, as `network_figure` draws it.
    - .dot: the same for Graphviz, as text.
    - .bif: both slices with their tables, for other programs (`egolane_pgm.graphs.flat.bif`).
      Virtual-evidence nodes, which have no numbers of their own, are left out.

    Raises InputError for another ending, for what `bif` cannot hold, and for a file that cannot be
    written.
    """
    ending = Path(path).suffix.lower()
    if ending == ".dot":
        write_text(path, graphviz(structure_of(compiled)), make_folder=True)
    elif ending == ".bif":
        write_text(path, bif(compiled.tables.values(), compiled.values), make_folder=True)
    else:
        write_figure(lambda: network_figure(structure_of(compiled)), path)


def check_ending(path: str | Path) -> None:
    """Raises InputError for a path that `write_network` does not know the ending of."""
    if Path(path).suffix.lower() not in ENDINGS:
        raise InputError(
            f"{path}: a network is written to a file that ends in {', '.join(ENDINGS)}"
        )
