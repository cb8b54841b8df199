"""Pictures of a map of lanes: from above, and its roads drawn out straight."""

from __future__ import annotations

import contextlib
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from egolane_pgm.maps.lane_graph import LaneGraph, joins_from, metres_per_degree
from egolane_pgm.types import BoolArray, FloatArray, InputError
from egolane_pgm.views.answers import INK
from egolane_pgm.views.style import axes_at, new_figure, put_title, text_colour

#: Under every picture that shows their data.
ATTRIBUTION = "© OpenStreetMap contributors, ODbL"

#: A lane's width, metres, in a map drawn to scale without a tag `width:lanes`.
LANE_M = 3.6

#: Widths of lanes that may be right, metres.
_WIDTHS_M = (1.5, 10.0)

#: More segments than this are no picture that one can read.
MOST_SEGMENTS = 5_000

#: Number of the longest roads that are drawn out straight.
MOST_ROADS = 8

#: Where a road parts or two meet, its lanes move from where they were to the way's own line over
#: this length.
_BLEND_M = 120.0

#: Narrower pictures, metres, number the lanes; and show the number of lanes where it changes.
_PLACE_M, _SMALL_M = 700.0, 3_000.0

#: The arrows that say where a road leads, metres.
_ARROW_M = 18.0

_UNKNOWN = "#d9d9d9"
_COLOURS = ("#fbe3b0", "#cfe1f0", "#8fc1e3", "#3f8fc4", "#0b5a94", "#00294a")
_ROAD_INCHES, _MAP_INCHES, _WIDTH = 0.95, 6.2, 9.0


def lane_map_figure(graph: LaneGraph, around: tuple[float, float, float] | None = None) -> Figure:
    """The roads of a map from above, and below them the longest ones drawn out straight.

    - around: latitude, longitude and metres: only what lies so near, lanes drawn to width and
      numbered. On a whole map they are drawn wider, at the right of the way's line.

    Raises InputError where nothing is there, or more than one could see.
    """
    point = _metres(graph, around)
    shown = np.ones(len(graph), dtype=bool) if around is None else _near(graph, point, around[2])
    if not shown.any():
        raise InputError("map: no road lies there")
    if shown.sum() > MOST_SEGMENTS:
        raise InputError(
            f"map: {shown.sum()} segments are too many for a picture; name a place (around)"
        )
    roads = _roads(graph)[:MOST_ROADS] if around is None else []
    low, high = _corners(point, around)
    across, up = (high - low).tolist()
    wide = _WIDTH - 1.0
    tall = float(np.clip(wide * up / across, 2.0, _MAP_INCHES))
    # The scale is that of the side that fits less well; the other shows more.
    fill = (np.array([wide, tall]) * max(across / wide, up / tall) - (high - low)) / 2
    low, high = low - fill, high + fill
    lane_m = max(LANE_M, float((high - low).max()) / 260) if around is None else LANE_M
    height = 0.4 + tall + 0.75 + (0.55 + _ROAD_INCHES * len(roads) if roads else 0.0)
    figure = new_figure(_WIDTH, height)
    ax = axes_at(figure, 0.85, 0.4, wide, tall)
    ax.set(
        xlim=(low[0], high[0]),
        ylim=(low[1], high[1]),
        xlabel="metres to the east",
        ylabel="metres to the north",
    )
    _draw_map(ax, graph, point, shown, lane_m)
    drawn = "to scale" if lane_m == LANE_M else f"drawn {lane_m / LANE_M:.0f} times as wide"
    put_title(figure, f"Lanes from above, {drawn}")
    for k, road in enumerate(roads):
        top = 0.4 + tall + 1.2 + _ROAD_INCHES * k
        _draw_road(axes_at(figure, 1.75, top, _WIDTH - 1.9, _ROAD_INCHES - 0.35), graph, road)
    if roads:
        figure.text(
            0.12 / _WIDTH,
            1 - (0.4 + tall + 0.8) / height,
            "The longest roads drawn out, driving to the right, left lane above; km along the road",
            fontsize=9,
            color=INK,
        )
    figure.text(1 - 0.12 / _WIDTH, 0.06 / height, ATTRIBUTION, fontsize=7, ha="right", color=INK)
    return figure


# --- from above --------------------------------------------------------------------------------


def _metres(graph: LaneGraph, around: tuple[float, float, float] | None) -> FloatArray:
    """The points (P, 2), metres to the east and to the north of the picture's middle."""
    middle = (graph.point.min(axis=0) + graph.point.max(axis=0)) / 2
    if around is not None:
        middle = np.array(around[:2])
    north, east = metres_per_degree(middle[0])
    metres: FloatArray = (graph.point - middle)[:, ::-1] * np.array([east, north])
    return metres


def _near(graph: LaneGraph, point: FloatArray, reach_m: float) -> BoolArray:
    """Which segments, (S,), come as near to the middle as this."""
    lines = [point[graph.first[k] : graph.first[k + 1]] for k in range(len(graph))]
    return np.array(
        [(np.abs(_resampled(line, 20.0)[0]) <= reach_m).all(axis=1).any() for line in lines]
    )


def _corners(
    point: FloatArray, around: tuple[float, float, float] | None
) -> tuple[FloatArray, FloatArray]:
    """The lower left and the upper right corner of what is to be seen, metres."""
    if around is not None:
        return np.full(2, -around[2]), np.full(2, around[2])
    low, high = point.min(axis=0), point.max(axis=0)
    margin = 0.04 * float((high - low).max()) + 30.0
    return low - margin, high + margin


def _draw_map(
    ax: Axes, graph: LaneGraph, point: FloatArray, shown: BoolArray, lane_m: float
) -> None:
    to_scale = lane_m == LANE_M
    extra = _extra(graph)
    polygons, colours, edges = [], [], []
    # Links first: the roads that they leave lie on top of them.
    is_link = np.char.endswith(graph.kind, "_link")
    for k in sorted(np.flatnonzero(shown), key=lambda k: (not is_link[k], k)):
        line, along = _resampled(point[graph.first[k] : graph.first[k + 1]], lane_m)
        n, fill = max(int(graph.n_lanes[k]), 1), _colour(int(graph.n_lanes[k]))
        width = _widths(graph, int(k), n) if to_scale else np.full(n, lane_m)
        across = np.concatenate([[0.0], np.cumsum(width)])
        left = _left_edge(graph, int(k), along, extra[k], across) if to_scale else 0 * along
        normal = _normals(line)
        sides = [line + (left + at)[:, None] * normal for at in across]
        polygons += [np.concatenate([a, b[::-1]]) for a, b in pairwise(sides)]
        colours += [fill] * n
        edges += [sides[0], sides[-1]]
        if to_scale and np.ptp(ax.get_xlim()) < _PLACE_M:
            _number_lanes(ax, sides, along, n, fill)
            _draw_direction(ax, sides, along)
    ax.add_collection(PolyCollection(polygons, facecolors=colours, edgecolors="white", lw=0.4))
    ax.add_collection(LineCollection(edges, colors=INK, lw=0.5 if to_scale else 0.25))
    _mark_changes(ax, graph, point, shown)
    numbers = sorted({int(n) for n in graph.n_lanes[shown]})
    ax.legend(
        handles=[
            Patch(facecolor=_colour(n), edgecolor=INK, lw=0.5, label=str(n) if n else "unknown")
            for n in numbers
        ],
        title="lanes",
        fontsize=8,
        title_fontsize=8,
        loc="best",
    )


def _widths(graph: LaneGraph, k: int, n: int) -> FloatArray:
    """The widths of a segment's n lanes, metres; those that its tag lacks are LANE_M."""
    width = np.full(n, LANE_M)
    for lane, word in enumerate(str(graph.width[k]).split("|")[:n]):
        with contextlib.suppress(ValueError):
            if _WIDTHS_M[0] <= float(word) <= _WIDTHS_M[1]:
                width[lane] = float(word)
    return width


def _left_edge(
    graph: LaneGraph, k: int, along: FloatArray, extra: FloatArray, across: FloatArray
) -> FloatArray:
    """How far the left edge lies to the right of the way's line, metres, at each place along it.

    - across (n + 1,): the lines of the lanes, metres from the left edge.
    """
    lanes = np.arange(len(across))
    start, end = np.nan_to_num(graph.placement[k], nan=lanes[-1] / 2)
    total = max(float(along[-1]), 1e-6)
    reach = min(_BLEND_M, total)
    from_start = extra[0] * np.clip(1 - along / reach, 0, 1)
    to_end = extra[1] * np.clip(1 - (total - along) / reach, 0, 1)
    line = np.interp(start + (end - start) * along / total, lanes, across)
    edge: FloatArray = (from_start + to_end) * LANE_M - line
    return edge


def _extra(graph: LaneGraph) -> FloatArray:
    """How far to the right, lanes, (S, 2), each segment's lanes begin and end of where its way's
    line has them: a link is drawn from the road's line, but begins at the lanes that it continues.
    """
    n = np.maximum(graph.n_lanes, 1)[:, None]
    place = np.where(np.isnan(graph.placement), n / 2, graph.placement)
    extra = np.zeros((len(graph), 2))
    before, after = graph.before, graph.after
    off = place[after, 0] - place[before, 1] - graph.shift
    n_out = np.bincount(before, minlength=len(graph))[before]
    n_in = np.bincount(after, minlength=len(graph))[after]
    split = (n_out > 1) & (n_in == 1) & np.isfinite(off)
    merge = (n_in > 1) & (n_out == 1) & np.isfinite(off)
    extra[after[split], 0] = off[split]
    extra[before[merge], 1] = -off[merge]
    return extra


def _number_lanes(ax: Axes, sides: list[FloatArray], along: FloatArray, n: int, fill: str) -> None:
    """The lanes' numbers, every 80 metres and at least once, where there is room for them."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    for at in np.arange(min(40.0, along[-1] / 2), along[-1], 80.0):
        k = int(np.argmin(np.abs(along - at)))
        for lane in range(n):
            x, y = (sides[lane][k] + sides[lane + 1][k]) / 2
            if left < x < right and bottom < y < top:
                ax.text(
                    x, y, str(lane + 1), fontsize=6, ha="center", va="center",
                    color=text_colour(fill),
                )  # fmt: skip


def _draw_direction(ax: Axes, sides: list[FloatArray], along: FloatArray) -> None:
    """A small arrow along the left edge of what is seen of a segment: it leads there."""
    edge = sides[0]
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    low, high = np.array([left, bottom]) + _ARROW_M, np.array([right, top]) - _ARROW_M
    inside = ((edge > low) & (edge < high)).all(axis=1)
    if not inside.any() or np.ptp(along[inside]) < 2 * _ARROW_M:
        return
    at = along[inside].mean() + np.array([-0.5, 0.5]) * _ARROW_M
    middle = np.stack([np.interp(at, along, edge[:, k]) for k in (0, 1)], axis=1)
    _draw_arrow(ax, middle[0], middle[1], 1.0)


def _mark_changes(ax: Axes, graph: LaneGraph, point: FloatArray, shown: BoolArray) -> None:
    """Where the number of lanes of a road changes: on a small map from how many to how many, on one
    of a place also for links, and with the shift s of the lanes."""
    before, after = graph.before, graph.after
    n, n_next = graph.n_lanes[before], graph.n_lanes[after]
    is_link = np.char.endswith(graph.kind, "_link")
    of_link = is_link[before] | is_link[after]
    marked = (n != n_next) & (n > 0) & (n_next > 0) & shown[before] & shown[after]
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    is_place, is_small = right - left < _PLACE_M, right - left < _SMALL_M
    marked &= ~of_link | is_place
    for k in np.flatnonzero(marked):
        last = graph.first[before[k] + 1] - 1
        x, y = point[last]
        if not (left < x < right and bottom < y < top):
            continue
        ahead = point[last] - point[last - 1]
        to_right = np.array([ahead[1], -ahead[0]]) / max(float(np.hypot(*ahead)), 1e-9)
        ax.plot(x, y, "o", ms=4, mfc="white", mec=INK, mew=0.8, zorder=5)
        if not is_small:
            continue
        shift = "?" if np.isnan(graph.shift[k]) else f"{graph.shift[k]:.0f}"
        ax.annotate(
            f"{n[k]}→{n_next[k]}" + (f", s = {shift}" if is_place else ""),
            (x, y),
            # Of two roads at one point the link's label is at the right.
            xytext=tuple(
                (-40 if is_place and not of_link[k] else 40 if is_place else 22) * to_right
            ),
            textcoords="offset points",
            fontsize=8 if is_place else 7,
            ha="center",
            va="center",
            color=INK,
            arrowprops={"arrowstyle": "-", "lw": 0.5, "color": INK},
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85},
            zorder=6,
        )


def _resampled(line: FloatArray, step_m: float) -> tuple[FloatArray, FloatArray]:
    """A line with points at most step_m apart, (K, 2), and how far along each is, (K,)."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    steps = np.linspace(0.0, length[-1], max(int(length[-1] / step_m), 1) + 1)
    along = np.unique(np.concatenate([length, steps]))
    return np.stack([np.interp(along, length, line[:, k]) for k in (0, 1)], axis=1), along


def _normals(line: FloatArray) -> FloatArray:
    """Unit vectors (K, 2) to the right of a line at each of its points."""
    ahead = np.gradient(line, axis=0)
    size = np.maximum(np.hypot(ahead[:, 0], ahead[:, 1]), 1e-9)
    return np.stack([ahead[:, 1], -ahead[:, 0]], axis=1) / size[:, None]


def _colour(n: int) -> str:
    return _COLOURS[min(n, len(_COLOURS)) - 1] if n else _UNKNOWN


# --- drawn out straight ------------------------------------------------------------------------


def _roads(graph: LaneGraph) -> list[list[tuple[int, float]]]:
    """The roads without their links, longest first: each segment with its place across, the shifts
    so far. Where both roads of a fork go on, they are two."""
    is_link = np.char.endswith(graph.kind, "_link")
    along = ~is_link[graph.before] & ~is_link[graph.after]
    along &= (graph.join != "fork") & (graph.join != "merge")
    rows = np.flatnonzero(along)
    following = dict(zip(graph.before[rows].tolist(), rows.tolist(), strict=True))
    led_to = set(graph.after[rows].tolist())
    done: set[int] = set()
    roads = []
    main = np.flatnonzero(~is_link).tolist()
    for start in [*(k for k in main if k not in led_to), *main]:
        road, at, across = [], start, 0.0
        while at not in done:
            done.add(at)
            road.append((at, across))
            if at not in following:
                break
            row = following[at]
            across -= float(np.nan_to_num(graph.shift[row]))
            at = int(graph.after[row])
        if road:
            roads.append(road)
    return sorted(roads, key=lambda road: -sum(graph.length_m[k] for k, _ in road))


def _draw_road(ax: Axes, graph: LaneGraph, road: list[tuple[int, float]]) -> None:
    start = joins_from(graph)
    arriving = _links_to(graph)
    km, low, high = 0.0, np.inf, -np.inf
    polygons, colours = [], []
    for k, across in road:
        n, end = int(graph.n_lanes[k]), km + float(graph.length_m[k]) / 1000
        for lane in range(max(n, 1)):
            top, bottom = across + lane, across + lane + 1
            polygons.append([(km, top), (end, top), (end, bottom), (km, bottom)])
            colours.append(_colour(n))
        low, high = min(low, across), max(high, across + max(n, 1))
        if end - km > 0:
            ax.text(
                (km + end) / 2, across + max(n, 1) / 2, str(n or "?"), fontsize=7, ha="center",
                va="center", color=text_colour(_colour(n)), clip_on=True,
            )  # fmt: skip
        for row in range(start[k], start[k + 1]):
            if graph.kind[graph.after[row]].endswith("_link"):
                _draw_link(ax, end, across, n, int(graph.side[row]), leaves=True)
        for row in arriving.get(k, ()):
            _draw_link(ax, km, across, n, int(graph.side[row]), leaves=False)
        km = end
    ax.add_collection(PolyCollection(polygons, facecolors=colours, edgecolors="white", lw=0.6))
    ax.set(xlim=(0, km), ylim=(high + 1.2, low - 1.2), yticks=[])
    ax.tick_params(labelsize=7)
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    first = road[0][0]
    label = f"{graph.name[first] or graph.kind[first]} {_bound(graph, road)}"
    ax.text(
        -0.01, 0.5, f"{label}\nway {graph.way[first]}", fontsize=7, ha="right", va="center",
        transform=ax.transAxes, color=INK,
    )  # fmt: skip


def _links_to(graph: LaneGraph) -> dict[int, list[int]]:
    """The joins by which links come to each road that is none."""
    found: dict[int, list[int]] = {}
    is_link = np.char.endswith(graph.kind, "_link")
    for row in np.flatnonzero(is_link[graph.before] & ~is_link[graph.after]):
        found.setdefault(int(graph.after[row]), []).append(int(row))
    return found


def _draw_link(ax: Axes, km: float, across: float, n: int, side: int, *, leaves: bool) -> None:
    """An arrow at the side where a link leaves or comes to the road."""
    edge = across if side < 0 else across + max(n, 1)
    outside = edge + (-1.1 if side < 0 else 1.1)
    tip, tail = (outside, edge) if leaves else (edge, outside)
    _draw_arrow(ax, (km, tail), (km, tip), 0.8)


def _draw_arrow(ax: Axes, tail: Any, tip: Any, width: float) -> None:
    look = {"arrowstyle": "-|>", "lw": width, "color": INK, "mutation_scale": 9 * width}
    ax.annotate("", tip, xytext=tail, arrowprops=look, annotation_clip=False, zorder=4)


def _bound(graph: LaneGraph, road: list[tuple[int, float]]) -> str:
    """Where a road leads, such as "to the north"."""
    start, stop = graph.line(road[0][0])[0], graph.line(road[-1][0])[-1]
    north, east = metres_per_degree(start[0])
    angle = np.degrees(np.arctan2((stop[0] - start[0]) * north, (stop[1] - start[1]) * east))
    names = [
        "east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east",
    ]  # fmt: skip
    return f"to the {names[int(np.rint(angle / 45)) % 8]}"
