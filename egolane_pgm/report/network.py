"""Draws a network as it is declared: the two slices of a dynamic Bayesian network."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch

from egolane_pgm.graphs.cpds import VE_SUFFIX
from egolane_pgm.report.style import write_figure
from egolane_pgm.types import InputError

#: A node of one slice: its name and 0 (time t) or 1 (time t + 1).
Node = tuple[str, int]

Place = tuple[float, float]

# Kinds of nodes differ in lightness and outline as well as in hue, so that colour is not needed.
_FILL = {"hidden": "#ffffff", "observed": "#a9c1d6", "evidence": "#4d5a66"}
_RADIUS = {"hidden": 0.52, "observed": 0.52, "evidence": 0.17}
_INK, _TEMPORAL, _FRAME = "#222222", "#b3541e", "#f4f4f2"

# Distances in the units of the radii: between columns, between rows, down to virtual evidence.
_COLUMN, _ROW, _EVIDENCE_ROW = 1.5, 1.5, 1.2
_SLICE_GAP, _MARGIN = 1.3, 0.75
_INCHES = 0.82


class TwoSliceNetwork(Protocol):
    """The part of a pgmpy DynamicBayesianNetwork that is drawn."""

    def nodes(self) -> Iterable[Node]:
        """All nodes of both slices."""

    def edges(self) -> Iterable[tuple[Node, Node]]:
        """All edges, parent first."""


@dataclass(frozen=True)
class _Drawing:
    """The place of each node, the kind of each name, and the size of one slice."""

    place: Mapping[Node, Place]
    kind: Mapping[str, str]
    edges: Sequence[tuple[Node, Node]]
    width: float
    height: float

    def radius(self, node: Node) -> float:
        return _RADIUS[self.kind[node[0]]]


def _kinds(names: Sequence[str], edges: Sequence[tuple[str, str]]) -> dict[str, str]:
    """The kind of each name: evidence (`<name>_ve`), observed (a parent of one) or hidden."""
    observed = {parent for parent, child in edges if child.endswith(VE_SUFFIX)}
    return {
        name: "evidence"
        if name.endswith(VE_SUFFIX)
        else "observed"
        if name in observed
        else "hidden"
        for name in names
    }


def _layers(names: Sequence[str], edges: Sequence[tuple[str, str]]) -> list[list[str]]:
    """The names in layers, by the longest path to them from a root within a slice."""
    depth = dict.fromkeys(names, 0)
    for _ in range(len(names) + 1):
        before = dict(depth)
        for parent, child in edges:
            depth[child] = max(depth[child], depth[parent] + 1)
        if depth == before:
            return [[n for n in names if depth[n] == d] for d in range(max(depth.values()) + 1)]
    raise InputError("network: the edges within a slice form a cycle, it cannot be drawn")


def _spread(wanted: Sequence[float]) -> list[float]:
    """The positions nearest to the wanted ones that keep their order and are a column apart."""
    order = np.argsort(wanted, kind="stable")
    values = np.array(wanted, dtype=float)[order]
    steps = np.arange(len(values)) * _COLUMN
    placed = np.maximum.accumulate(values - steps) + steps
    placed += float(np.mean(values - placed))
    result = np.empty(len(values))
    result[order] = placed
    return [float(x) for x in result]


def _columns(layers: Sequence[Sequence[str]], parents: Mapping[str, list[str]]) -> dict[str, float]:
    """The horizontal place of each name: below the middle of its parents, if there is room."""
    x: dict[str, float] = {}
    for layer in layers:
        wanted = [
            float(np.mean([x[p] for p in parents[name]])) if parents[name] else i * _COLUMN
            for i, name in enumerate(layer)
        ]
        x.update(zip(layer, _spread(wanted), strict=True))
    left = min(x.values())
    return {name: value - left for name, value in x.items()}


def _rows(
    layers: Sequence[Sequence[str]], temporal: set[str], kind: Mapping[str, str]
) -> dict[str, float]:
    """The vertical place of each name, 0 at the top.

    A name with arrows to or from the other slice gets a row of its own, so that these arrows run
    between the slices without crossing another node.
    """
    y: dict[str, float] = {}
    at = _ROW
    for layer in layers:
        shared = [name for name in layer if name not in temporal]
        for row in [[name] for name in layer if name in temporal] + ([shared] if shared else []):
            at -= _EVIDENCE_ROW if all(kind[name] == "evidence" for name in row) else _ROW
            y.update(dict.fromkeys(row, at))
    return y


def _lay_out(network: TwoSliceNetwork) -> _Drawing:
    nodes = [(str(name), int(time)) for name, time in network.nodes()]
    edges = [((str(a), int(s)), (str(b), int(t))) for (a, s), (b, t) in network.edges()]
    if not nodes:
        raise InputError("network: it has no nodes, nothing to draw")
    for name, time in nodes:
        if time not in (0, 1):
            raise InputError(f"network: node {name} is in slice {time}, only 0 and 1 can be drawn")
    names = list(dict.fromkeys(name for name, _ in nodes))
    inside = list(dict.fromkeys((a, b) for (a, s), (b, t) in edges if s == t))
    temporal = {name for (a, s), (b, t) in edges if s != t for name in (a, b)}
    kind = _kinds(names, inside)
    layers = _layers(names, inside)
    x = _columns(layers, {name: [a for a, b in inside if b == name] for name in names})
    y = _rows(layers, temporal, kind)
    width, height = max(x.values()), -min(y.values())
    step = width + 2 * _MARGIN + _SLICE_GAP
    place = {(name, time): (x[name] + time * step, y[name]) for name, time in nodes}
    return _Drawing(place, kind, edges, width, height)


def _curvature(start: Node, end: Node, drawing: _Drawing) -> float:
    """The smallest bend (`rad` of matplotlib's arc3) with which an arrow clears all other nodes."""
    (x0, y0), (x1, y1) = drawing.place[start], drawing.place[end]
    s = np.linspace(0.0, 1.0, 60)
    best, widest = 0.0, -np.inf
    others = [node for node in drawing.place if node not in (start, end)]
    for bend in (0.0, 0.12, -0.12, 0.22, -0.22, 0.32, -0.32, 0.45, -0.45):
        cx, cy = (x0 + x1) / 2 + bend * (y1 - y0), (y0 + y1) / 2 - bend * (x1 - x0)
        px = (1 - s) ** 2 * x0 + 2 * s * (1 - s) * cx + s**2 * x1
        py = (1 - s) ** 2 * y0 + 2 * s * (1 - s) * cy + s**2 * y1
        room = min(
            (
                float(np.hypot(px - x, py - y).min()) - drawing.radius(node)
                for node in others
                for x, y in (drawing.place[node],)
            ),
            default=np.inf,
        )
        if room > 0.1:
            return bend
        if room > widest:
            best, widest = bend, room
    return best


def _wrapped(name: str) -> str:
    """A name with one word per line, split at capitals and underscores."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+|[^A-Za-z_]+", name)
    return "\n".join(words) if words else name


def _draw_node(ax: Axes, node: Node, drawing: _Drawing) -> Circle:
    (x, y), kind, radius = drawing.place[node], drawing.kind[node[0]], drawing.radius(node)
    circle = Circle((x, y), radius, facecolor=_FILL[kind], edgecolor=_INK, linewidth=1.2, zorder=3)
    circle.set_gid(f"node {node[0]} {node[1]}")
    ax.add_patch(circle)
    if kind == "observed":
        inner = {"fill": False, "edgecolor": _INK, "linewidth": 0.9, "zorder": 4}
        ax.add_patch(Circle((x, y), radius - 0.06, **inner))
    if kind == "evidence":
        ax.text(x, y - radius - 0.08, node[0], fontsize=7, color=_INK, ha="center", va="top")
        return circle
    label = _wrapped(node[0])
    longest = max(len(line) for line in label.split("\n"))
    size = min(9.5, 78 / longest, 34 / (label.count("\n") + 1))
    ax.text(x, y, label, fontsize=size, color=_INK, ha="center", va="center", zorder=5)
    return circle


def _draw_legend(ax: Axes, drawing: _Drawing) -> None:
    def marker(kind: str, size: float, label: str) -> Line2D:
        return Line2D(
            [],
            [],
            linestyle="none",
            marker="o",
            markerfacecolor=_FILL[kind],
            markeredgecolor=_INK,
            markersize=size,
            label=label,
        )

    labels = {"hidden": "hidden", "observed": "observed", "evidence": "virtual evidence"}
    entries = [
        marker(kind, 6 if kind == "evidence" else 10, label)
        for kind, label in labels.items()
        if kind in drawing.kind.values()
    ]
    entries.append(Line2D([], [], color=_INK, linewidth=1.1, label="within a frame"))
    if any(a[1] != b[1] for a, b in drawing.edges):
        entries.append(Line2D([], [], color=_TEMPORAL, linewidth=1.9, label="to the next frame"))
    ax.legend(
        handles=entries,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=3 if drawing.width < 3 else len(entries),
        labelspacing=0.7,
        frameon=False,
        fontsize=8.5,
        handletextpad=0.6,
        columnspacing=1.6,
    )


def network_figure(network: TwoSliceNetwork) -> Figure:
    """The figure of `draw_network`: the two slices side by side, as in the paper's Figure
    `fig:model`.

    network: anything with the `nodes()` and `edges()` of a pgmpy DynamicBayesianNetwork, where a
    node is (name, slice). Hidden nodes are white. Observed nodes, those with a child `<name>_ve`,
    are blue-grey with a double outline; these children are small and dark.

    Raises InputError for a network without nodes, with a cycle, or with more than two slices.
    """
    drawing = _lay_out(network)
    step = drawing.width + 2 * _MARGIN + _SLICE_GAP
    across = (drawing.width + step + 2 * _MARGIN + 0.1) * _INCHES
    down = (drawing.height + 2 * _MARGIN + 0.5) * _INCHES
    # The legend needs room below the network, and on both sides of a narrow one.
    figure = Figure(figsize=(max(across, 4.8), down + 0.65))
    ax = figure.add_axes((0.0, 0.6 / (down + 0.65), 1.0, down / (down + 0.65)))
    ax.set_xlim(-_MARGIN - 0.05, drawing.width + step + _MARGIN + 0.05)
    ax.set_ylim(-drawing.height - _MARGIN - 0.05, _MARGIN + 0.45)
    ax.set_aspect("equal")
    ax.axis("off")
    for time in sorted({node[1] for node in drawing.place}):
        ax.add_patch(
            FancyBboxPatch(
                (time * step - _MARGIN, -drawing.height - _MARGIN),
                drawing.width + 2 * _MARGIN,
                drawing.height + 2 * _MARGIN,
                boxstyle="round,pad=0,rounding_size=0.2",
                facecolor=_FRAME,
                edgecolor="none",
                zorder=0,
            )
        )
        title = ("frame $t$", "frame $t + 1$")[time]
        ax.text(time * step + drawing.width / 2, _MARGIN + 0.1, title, ha="center", fontsize=10)
    circles = {node: _draw_node(ax, node, drawing) for node in drawing.place}
    for start, end in drawing.edges:
        is_temporal = start[1] != end[1]
        arrow = FancyArrowPatch(
            drawing.place[start],
            drawing.place[end],
            connectionstyle=f"arc3,rad={_curvature(start, end, drawing)}",
            patchA=circles[start],
            patchB=circles[end],
            shrinkA=0,
            shrinkB=1,
            arrowstyle="-|>,head_length=5,head_width=2.8",
            color=_TEMPORAL if is_temporal else _INK,
            linewidth=1.9 if is_temporal else 1.1,
            zorder=2,
        )
        arrow.set_gid(f"edge {start[0]} {start[1]} {end[0]} {end[1]}")
        ax.add_patch(arrow)
    _draw_legend(ax, drawing)
    return figure


def draw_network(network: TwoSliceNetwork, path: str | Path) -> None:
    """Draws a network. Raises InputError as `network_figure` and `write_figure` do."""
    write_figure(lambda: network_figure(network), path)
