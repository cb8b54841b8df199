"""Writes a network as it is declared: a picture of its two slices, or text for other programs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Patch, Rectangle

from egolane_pgm.graphs.cpds import SliceNode
from egolane_pgm.graphs.flat import bif
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.tools.files import write_text
from egolane_pgm.types import InputError
from egolane_pgm.views.structure import KINDS, Structure, graphviz, structure_of
from egolane_pgm.views.style import FORMATS, write_figure

#: How the name of a file ends that a network can be written to.
ENDINGS = (*FORMATS, ".dot", ".bif")

Place = tuple[float, float]

# Kinds of nodes differ in lightness, outline and shape as well as in hue, so that colour is not
# needed.
_FILL = {
    "hidden": "#ffffff",
    "function": "#ffffff",
    "observed": "#a9c1d6",
    "input": "#f2dfb3",
    "virtual evidence": "#4d5a66",
}
_INK, _TEMPORAL, _FRAME = "#222222", "#b3541e", "#f4f4f2"
_RADIUS, _SMALL = 0.52, 0.17

# Distances in the units of the radii: between columns, between rows, down to virtual evidence.
_COLUMN, _ROW, _EVIDENCE_ROW = 1.5, 1.5, 1.2
_SLICE_GAP, _MARGIN = 1.3, 0.75
_INCHES = 0.82


@dataclass(frozen=True)
class _Drawing:
    """The place and radius of each node, and the size of one slice."""

    structure: Structure
    place: Mapping[SliceNode, Place]
    radius: Mapping[SliceNode, float]
    width: float
    height: float
    step: float


def _layers(structure: Structure) -> list[list[str]]:
    """The names in layers, by the longest path to them from a root within a slice."""
    within = nx.DiGraph(structure.within)
    within.add_nodes_from(structure.kind)
    try:
        layers = [set(layer) for layer in nx.topological_generations(within)]
    except nx.NetworkXUnfeasible:
        raise InputError(
            "network: the edges within a slice form a cycle, it cannot be drawn"
        ) from None
    return [[name for name in structure.kind if name in layer] for layer in layers]


def _columns(layers: Sequence[Sequence[str]], structure: Structure) -> dict[str, float]:
    """The horizontal place of each name: below the middle of its parents, if there is room."""
    x: dict[str, float] = {}
    for layer in layers:
        parents = [[x[a] for a, b in structure.within if b == name] for name in layer]
        wanted = np.array([np.mean(of) if of else i * _COLUMN for i, of in enumerate(parents)])
        order = np.argsort(wanted, kind="stable")
        steps = np.arange(len(layer)) * _COLUMN
        placed = np.maximum.accumulate(wanted[order] - steps) + steps
        placed += np.mean(wanted[order] - placed)
        x.update(zip((layer[k] for k in order), placed.tolist(), strict=True))
    return {name: x[name] - min(x.values()) for name in structure.kind}


def _rows(layers: Sequence[Sequence[str]], structure: Structure) -> dict[str, float]:
    """The vertical place of each name, 0 at the top.

    A name with arrows to or from the other slice gets a row of its own, so that these arrows run
    between the slices without crossing another node.
    """
    temporal = {name for edge in structure.across for name in edge}
    y: dict[str, float] = {}
    at = _ROW
    for layer in layers:
        shared = [name for name in layer if name not in temporal]
        for row in [[name] for name in layer if name in temporal] + ([shared] if shared else []):
            is_small = all(structure.kind[name] == "virtual evidence" for name in row)
            at -= _EVIDENCE_ROW if is_small else _ROW
            y.update(dict.fromkeys(row, at))
    return y


def _lay_out(structure: Structure) -> _Drawing:
    if not structure.kind:
        raise InputError("network: it has no nodes, nothing to draw")
    layers = _layers(structure)
    x, y = _columns(layers, structure), _rows(layers, structure)
    width, height = max(x.values()), -min(y.values())
    step = width + 2 * _MARGIN + _SLICE_GAP
    place = {(name, s): (x[name] + s * step, y[name]) for name in x for s in (0, 1)}
    radius = {
        (name, s): _SMALL if kind == "virtual evidence" else _RADIUS
        for name, kind in structure.kind.items()
        for s in (0, 1)
    }
    return _Drawing(structure, place, radius, width, height, step)


def _curvature(start: SliceNode, end: SliceNode, drawing: _Drawing) -> float:
    """The smallest bend (`rad` of matplotlib's arc3) with which an arrow clears all other nodes."""
    ends = np.array([drawing.place[start], drawing.place[end]])
    others = [node for node in drawing.place if node not in (start, end)]
    if not others:
        return 0.0
    middle = np.array([drawing.place[node] for node in others])
    radius = np.array([drawing.radius[node] for node in others])
    across = (ends[1] - ends[0])[::-1] * (1, -1)
    s = np.linspace(0.0, 1.0, 60)[:, np.newaxis]

    def room(bend: float) -> float:
        control = ends.mean(axis=0) + bend * across
        curve = (1 - s) ** 2 * ends[0] + 2 * s * (1 - s) * control + s**2 * ends[1]
        distance = np.linalg.norm(curve[:, np.newaxis] - middle, axis=2).min(axis=0)
        return float((distance - radius).min())

    bends = (0.0, 0.12, -0.12, 0.22, -0.22, 0.32, -0.32, 0.45, -0.45)
    return next((bend for bend in bends if room(bend) > 0.1), max(bends, key=room))


def _wrapped(name: str) -> str:
    """A name with one word per line, split at capitals and underscores."""
    words = re.findall(r"[A-Z]+(?![a-z])\d*|[A-Z]?[a-z0-9]+|[^A-Za-z_]+", name)
    return "\n".join(words) if words else name


def _draw_node(ax: Axes, node: SliceNode, drawing: _Drawing) -> Patch:
    (x, y), radius = drawing.place[node], drawing.radius[node]
    kind = drawing.structure.kind[node[0]]
    patch: Patch = Circle((x, y), radius)
    if kind == "input":
        half = 0.85 * radius
        patch = Rectangle((x - half, y - half), 2 * half, 2 * half)
    patch.set(facecolor=_FILL[kind], edgecolor=_INK, linewidth=1.2, zorder=3)
    patch.set_gid(f"node {node[0]} {node[1]}")
    ax.add_patch(patch)
    if kind == "function":
        inner = {"fill": False, "edgecolor": _INK, "linewidth": 0.9, "zorder": 4}
        ax.add_patch(Circle((x, y), radius - 0.06, **inner))
    if kind == "virtual evidence":
        label = node[0].replace("+", "\n+ ")
        ax.text(x, y - radius - 0.08, label, fontsize=7, color=_INK, ha="center", va="top")
        return patch
    label = _wrapped(node[0])
    longest = max(len(line) for line in label.split("\n"))
    size = min(9.5, 78 / longest, 34 / (label.count("\n") + 1))
    ax.text(x, y, label, fontsize=size, color=_INK, ha="center", va="center", zorder=5)
    return patch


def _draw_arrow(
    ax: Axes, start: SliceNode, end: SliceNode, drawing: _Drawing, drawn: Mapping[SliceNode, Patch]
) -> None:
    is_temporal = start[1] != end[1]
    arrow = FancyArrowPatch(
        drawing.place[start],
        drawing.place[end],
        connectionstyle=f"arc3,rad={_curvature(start, end, drawing)}",
        patchA=drawn[start],
        patchB=drawn[end],
        shrinkA=0,
        shrinkB=1,
        arrowstyle="-|>,head_length=5,head_width=2.8",
        color=_TEMPORAL if is_temporal else _INK,
        linewidth=1.9 if is_temporal else 1.1,
        zorder=2,
    )
    arrow.set_gid(f"edge {start[0]} {start[1]} {end[0]} {end[1]}")
    ax.add_patch(arrow)


def _legend(structure: Structure) -> dict[str, tuple[Line2D, ...]]:
    """The marks of the legend by their labels; a function's is two circles."""
    entries: dict[str, tuple[Line2D, ...]] = {}
    for kind in KINDS:
        look: dict[str, Any] = {
            "marker": "s" if kind == "input" else "o",
            "markerfacecolor": _FILL[kind],
        }
        sizes = (10, 7) if kind == "function" else (6,) if kind == "virtual evidence" else (10,)
        if kind in structure.kind.values():
            entries["function of its parents" if kind == "function" else kind] = tuple(
                Line2D([], [], ls="none", markeredgecolor=_INK, markersize=size, **look)
                for size in sizes
            )
    entries["within a frame"] = (Line2D([], [], color=_INK, linewidth=1.1),)
    if structure.across:
        entries["to the next frame"] = (Line2D([], [], color=_TEMPORAL, linewidth=1.9),)
    return entries


def network_figure(structure: Structure) -> Figure:
    """Draws the two slices side by side, as in the paper's Figure
    `fig:model`.

    Hidden nodes are white circles, functions of other nodes have a double outline, observed nodes
    are blue-grey, inputs are squares, and virtual-evidence nodes are small and dark.

    Raises InputError for a network without nodes or with a cycle.
    """
    drawing = _lay_out(structure)
    entries = _legend(structure)
    across = max((drawing.width + drawing.step + 2 * _MARGIN + 0.1) * _INCHES, 4.8)
    down = (drawing.height + 2 * _MARGIN + 0.5) * _INCHES
    columns = min(len(entries), max(2, int(across / 1.55)))
    # The legend's lines below the network.
    below = 0.15 + 0.24 * -(-len(entries) // columns)
    figure = Figure(figsize=(across, down + below))
    ax = figure.add_axes((0.0, below / (down + below), 1.0, down / (down + below)))
    ax.set_xlim(-_MARGIN - 0.05, drawing.width + drawing.step + _MARGIN + 0.05)
    ax.set_ylim(-drawing.height - _MARGIN - 0.05, _MARGIN + 0.45)
    ax.set_aspect("equal")
    ax.axis("off")
    for s, title in enumerate(("frame $t$", "frame $t + 1$")):
        ax.add_patch(
            FancyBboxPatch(
                (s * drawing.step - _MARGIN, -drawing.height - _MARGIN),
                drawing.width + 2 * _MARGIN,
                drawing.height + 2 * _MARGIN,
                boxstyle="round,pad=0,rounding_size=0.2",
                facecolor=_FRAME,
                edgecolor="none",
                zorder=0,
            )
        )
        middle = s * drawing.step + drawing.width / 2
        ax.text(middle, _MARGIN + 0.1, title, ha="center", fontsize=10)
    drawn = {node: _draw_node(ax, node, drawing) for node in drawing.place}
    for start, end in structure.edges:
        _draw_arrow(ax, start, end, drawing, drawn)
    ax.legend(
        [*entries.values()],
        [*entries],
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=columns,
        labelspacing=0.7,
        frameon=False,
        fontsize=8.5,
        handletextpad=0.6,
        columnspacing=1.6,
    )
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
