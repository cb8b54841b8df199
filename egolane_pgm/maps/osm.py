"""Reads the motorways and trunk roads of an extract of OpenStreetMap as a lane graph."""

from __future__ import annotations

import warnings
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.maps.joins import with_joins
from egolane_pgm.maps.lane_graph import LaneGraph, along_points, metres_per_degree
from egolane_pgm.maps.tags import KEYS, KINDS, Direction, directions
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import NOTE, BoolArray, FloatArray, InputError, IntArray

#: The largest number of warnings about the tags of a map.
MOST_WARNINGS = 8


def read_osm(path: str | Path, *, drives_left: bool | None = None) -> LaneGraph:
    """The lanes of the motorways and trunk roads of an `.osm` or `.osm.pbf` extract, and how they
    continue. Needs the extra `maps`.

    - drives_left: traffic keeps to the left. By default it follows from the carriageways of the
      motorways: where traffic keeps to the right, the opposite one lies at the left.

    The places of all nodes of the file are kept in memory while it is read (16 bytes each): take
    the roads out of a large extract first (`osmium tags-filter`).

    Warns of tags that make no sense, whose lanes are then unknown, and of nodes without
    coordinates, which are left out. Raises InputError for a file that cannot be read as a map, one
    without such a road, and where osmium is not installed.
    """
    return joined(of_ways(path, drives_left=drives_left))


def of_ways(path: str | Path, *, drives_left: bool | None = None) -> LaneGraph:
    """As `read_osm`, before ways are joined: each is a segment, or several where another shares a
    point with it."""
    raw = _read(path)
    if drives_left is None:
        drives_left = _seems_to_drive_left(raw)
        if drives_left:
            warnings.warn(
                f"{NOTE}{path}: opposite carriageways lie at the right, so traffic is taken to keep"
                " to the left",
                UserWarning,
                stacklevel=3,
            )
    tags = [directions(values, drives_left) for values in raw.tags]
    _warn(path, raw, [problems for _, problems in tags])
    ways, is_placed = _segments(raw, [ways for ways, _ in tags])
    return with_joins(ways, is_placed, drives_left=drives_left)


# --- the file ----------------------------------------------------------------------------------


#: The number of places at which the side of traffic is found, and the largest distance, metres, of
#: a carriageway there.
SIDE_PLACES, SIDE_M = 100, 80.0


@dataclass(frozen=True)
class _Raw:
    """W ways as they are drawn.

    - point (P, 2): latitude, longitude; first (W + 1,): where each way's begin.
    - tags: the different sets of tags; tag_set (W,): which one each way has.
    - names: the different names; name (W,): which one each way has.
    """

    way: IntArray
    point: FloatArray
    first: IntArray
    tags: Sequence[tuple[str | None, ...]]
    tag_set: IntArray
    names: Sequence[str]
    name: IntArray


def _read(path: str | Path) -> _Raw:
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    with needed(f"{path}", "maps"):
        import osmium
    way, count, tag_set, name = array("q"), array("q"), array("q"), array("q")
    points = bytearray()
    sets: dict[tuple[str | None, ...], int] = {}
    names: dict[str, int] = {}
    lacking = 0
    as_bytes = osmium.geom.WKBFactory().create_linestring
    roads: Any = (
        osmium.FileProcessor(str(path), osmium.osm.NODE | osmium.osm.WAY)
        .with_locations("sparse_mem_array")
        .with_filter(osmium.filter.EntityFilter(osmium.osm.WAY))
        .with_filter(osmium.filter.TagFilter(*(("highway", kind) for kind in KINDS)))
    )
    try:
        for road in roads:
            # Asking osmium for a whole line is several times as quick as asking for its nodes.
            try:
                line = bytes.fromhex(as_bytes(road))[9:]
            except (osmium.InvalidLocationError, RuntimeError, ValueError):
                line, n_without = _line_of_known(road)
                lacking += n_without
                if not line:
                    continue
            get = road.tags.get
            way.append(road.id)
            count.append(len(line) // 16)
            points += line
            tag_set.append(sets.setdefault(tuple([get(key) for key in KEYS]), len(sets)))
            name.append(names.setdefault(get("ref") or get("name") or "", len(names)))
    except (osmium.InvalidLocationError, RuntimeError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a map: {error}") from None
    if lacking:
        warnings.warn(
            f"{path}: {lacking} nodes of motorways or trunk roads have no coordinates in this"
            " file; they are left out",
            UserWarning,
            stacklevel=4,
        )
    if not way:
        raise InputError(
            f"{path}: no motorway and no trunk road with coordinates (highway={', '.join(KINDS)})"
        )
    point = np.frombuffer(points, dtype="<f8").reshape(-1, 2)[:, ::-1]
    first = np.concatenate([[0], np.cumsum(np.frombuffer(count, dtype=np.int64))])
    numbers = [np.frombuffer(row, dtype=np.int64) for row in (way, tag_set, name)]
    return _Raw(numbers[0], point, first, list(sets), numbers[1], list(names), numbers[2])


def _line_of_known(road: Any) -> tuple[bytes, int]:
    """Longitudes and latitudes of the nodes that have some, and the number of nodes without; no
    bytes where fewer than two different places are left."""
    known = [(node.lon, node.lat) for node in road.nodes if node.location.valid()]
    lacking = len(road.nodes) - len(known)
    line = [here for k, here in enumerate(known) if k == 0 or here != known[k - 1]]
    return (np.array(line, dtype="<f8").tobytes() if len(line) > 1 else b""), lacking


def _warn(path: str | Path, raw: _Raw, problems: list[tuple[str, ...]]) -> None:
    """One line for each thing that is wrong with tags, however many ways have it."""
    n_ways = np.bincount(raw.tag_set, minlength=len(raw.tags))
    found: dict[str, list[int]] = {}
    for tag_set, said in enumerate(problems):
        for problem in said:
            found.setdefault(problem, []).append(tag_set)
    for k, (problem, sets) in enumerate(found.items()):
        if k == MOST_WARNINGS:
            text = f"{len(found) - k} more things are wrong with tags"
        else:
            example = int(raw.way[np.argmax(raw.tag_set == sets[0])])
            total = int(n_ways[sets].sum())
            others = f" and {total - 1} more" if total > 1 else ""
            text = f"way {example}{others}: {problem}"
        warnings.warn(f"{path}: {text}", UserWarning, stacklevel=4)
        if k == MOST_WARNINGS:
            break


def _seems_to_drive_left(raw: _Raw) -> bool:
    """Whether more of the motorways have their opposite carriageway at the right than at the left,
    at places all over the map."""
    get = KEYS.index
    drawn_as_driven = [
        values[get("highway")] == "motorway" and values[get("oneway")] in (None, "yes", "true", "1")
        for values in raw.tags
    ]
    chosen = np.repeat(np.array(drawn_as_driven)[raw.tag_set], np.diff(raw.first))
    chosen[raw.first[1:] - 1] = False
    start = np.flatnonzero(chosen)
    if not len(start):
        return False
    # From south to north, so that what is near is found by two searches.
    start = start[np.argsort(raw.point[start, 0])]
    south = raw.point[start, 0]
    right = left = 0
    for k in np.unique(np.linspace(0, len(start) - 1, SIDE_PLACES).astype(np.int64)):
        metres = np.stack(metres_per_degree(south[k]))
        # A piece whose middle is near begins at most this far away, unless it is very long.
        reach = 5 * SIDE_M / metres[0]
        low, high = np.searchsorted(south, [south[k] - reach, south[k] + reach])
        line = np.stack([raw.point[start[low:high]], raw.point[start[low:high] + 1]])
        middle, ahead = line.mean(axis=0) * metres, (line[1] - line[0]) * metres
        off = middle - middle[k - low]
        near = (np.abs(off) < SIDE_M).all(axis=1)
        (north, east), a, b = off[near].T, ahead[k - low], ahead[near]
        size = np.hypot(*a) * np.hypot(*b.T)
        to_left = (a[1] * north - a[0] * east) / np.hypot(*a)
        opposite = (b @ a < -0.95 * size) & (np.abs(to_left) > 3.0)
        if opposite.any():
            nearest = to_left[opposite][np.argmin(np.abs(to_left[opposite]))]
            left, right = left + int(nearest > 0), right + int(nearest < 0)
    return right > left


# --- segments ----------------------------------------------------------------------------------


def _segments(raw: _Raw, ways: list[tuple[Direction, ...]]) -> tuple[LaneGraph, BoolArray]:
    """The pieces of the ways, in each direction in which they are driven."""
    cut = _shared(raw)
    cut[raw.first[:-1]] = True
    cut[raw.first[1:] - 1] = True
    way_of = np.repeat(np.arange(len(raw.way)), np.diff(raw.first))
    at = np.flatnonzero(cut)
    # A piece leads from one cut to the next of the same way.
    is_piece = way_of[at[:-1]] == way_of[at[1:]]
    start, stop, way = at[:-1][is_piece], at[1:][is_piece], way_of[at[:-1][is_piece]]

    table = [direction for both in ways for direction in both]
    first_row = np.cumsum([0, *(len(both) for both in ways)])
    n_directions = np.diff(first_row)[raw.tag_set[way]]
    piece = np.repeat(np.arange(len(way)), n_directions)
    nth = np.arange(len(piece)) - np.repeat(np.cumsum(n_directions) - n_directions, n_directions)
    row = first_row[raw.tag_set[way[piece]]] + nth

    def column(get: Any, dtype: Any) -> Any:
        return np.array([get(direction) for direction in table], dtype=dtype)[row]

    is_backward = column(lambda d: d.is_backward, bool)
    placement = column(lambda d: d.placement, float)
    start, stop, way = start[piece], stop[piece], way[piece]
    # The tags of a way's ends do not hold at a point between them.
    varies = placement[:, 0] != placement[:, 1]
    for end, is_first in ((0, ~is_backward), (1, is_backward)):
        inner = np.where(is_first, start != raw.first[way], stop != raw.first[way + 1] - 1)
        placement[varies & inner, end] = np.nan

    size = stop - start + 1
    first = np.concatenate([[0], np.cumsum(size)])
    nth = np.arange(first[-1]) - np.repeat(first[:-1], size)
    point = raw.point[
        np.repeat(np.where(is_backward, stop, start), size)
        + nth * np.repeat(np.where(is_backward, -1, 1), size)
    ]
    kind = np.array([values[0] for values in raw.tags])
    return (
        LaneGraph(
            way=raw.way[way],
            kind=kind[raw.tag_set[way]],
            name=np.array(raw.names, dtype=object)[raw.name[way]],
            n_lanes=column(lambda d: d.n_lanes, np.int64),
            placement=placement,
            point=point,
            first=first,
            length_m=along_points(point, first)[first[1:] - 1],
            turn=column(lambda d: d.turn, object),
            change=column(lambda d: d.change, object),
            width=column(lambda d: d.width, object),
            **_NO_JOINS,
        ),
        column(lambda d: d.is_placed, bool),
    )


_NO_JOINS: dict[str, Any] = {
    "before": np.zeros(0, dtype=np.int64),
    "after": np.zeros(0, dtype=np.int64),
    "shift": np.zeros(0),
    "join": np.zeros(0, dtype="<U5"),
    "side": np.zeros(0, dtype=np.int64),
    "source": np.zeros(0, dtype="<U12"),
}


def _shared(raw: _Raw) -> BoolArray:
    """Which points, (P,), several ways have, or one has twice. Two nodes at one place are taken
    for one: editors refuse them."""
    place = np.rint(raw.point * 1e7).astype(np.int64)
    key = place[:, 0] * 4_000_000_000 + place[:, 1]
    order = np.argsort(key)
    again = np.diff(key[order]) == 0
    shared = np.zeros(len(key), dtype=bool)
    shared[order[1:][again]] = True
    shared[order[:-1][again]] = True
    return shared


# --- ways joined across splits that change nothing ---------------------------------------------


def joined(graph: LaneGraph) -> LaneGraph:
    """The same roads with segments joined where one follows the other and nothing changes: kind,
    name, number of lanes, placement, tags lane by lane. A segment keeps the way of its first."""
    before, after = graph.before, graph.after
    alone = (np.bincount(before, minlength=len(graph))[before] == 1) & (
        np.bincount(after, minlength=len(graph))[after] == 1
    )
    alone &= (before != after) & ((graph.shift == 0) | (graph.n_lanes[before] == 0))
    for values in (graph.kind, graph.name, graph.n_lanes, graph.turn, graph.change, graph.width):
        alone &= values[before] == values[after]
    place = graph.placement
    for a, b in (
        (place[before, 0], place[before, 1]),
        (place[before, 1], place[after, 0]),
        (place[after, 0], place[after, 1]),
    ):
        alone &= (a == b) | (np.isnan(a) & np.isnan(b))
    following = np.full(len(graph), -1)
    following[before[alone]] = after[alone]
    order, begins = _chains(following)

    chain = np.cumsum(begins) - 1
    chain_of = np.empty(len(graph), dtype=np.int64)
    chain_of[order] = chain
    # Where a segment follows another, its first point is the other's last.
    skip = (~begins).astype(np.int64)
    size = np.diff(graph.first)[order] - skip
    ends = np.cumsum(size)
    index = np.arange(ends[-1]) + np.repeat(graph.first[order] + skip - (ends - size), size)
    heads, tails = order[begins], order[np.append(begins[1:], True)]
    # A road that closes to a ring has one join to itself, where it was cut.
    stays = ~alone | (chain_of[before] != chain_of[after]) | (tails[chain_of[before]] == before)
    sort = np.lexsort((chain_of[after[stays]], chain_of[before[stays]]))
    kept = np.flatnonzero(stays)[sort]
    return replace(
        graph,
        **{
            name: getattr(graph, name)[heads]
            for name in ("way", "kind", "name", "n_lanes", "turn", "change", "width")
        },
        placement=np.stack([place[heads, 0], place[tails, 1]], axis=1),
        point=graph.point[index],
        first=np.concatenate([[0], ends[np.append(begins[1:], True)]]),
        length_m=np.bincount(chain, weights=graph.length_m[order]).astype(np.float64),
        before=chain_of[before[kept]],
        after=chain_of[after[kept]],
        **{name: getattr(graph, name)[kept] for name in ("shift", "join", "side", "source")},
    )


def _chains(following: IntArray) -> tuple[IntArray, BoolArray]:
    """All segments (S,), chain by chain, and where each chain begins; the order of the chains is
    that of their first segments, and rings begin at their first number.

    - following (S,): the segment that each leads on to, -1 none.
    """
    is_led_to = np.zeros(len(following), dtype=bool)
    is_led_to[following[following >= 0]] = True
    order, begins, leads_to = [], [], following.tolist()
    is_done = bytearray(len(following))
    for start in [*np.flatnonzero(~is_led_to).tolist(), *range(len(following))]:
        at = start
        while at >= 0 and not is_done[at]:
            is_done[at] = 1
            order.append(at)
            begins.append(at == start)
            at = leads_to[at]
    return np.array(order, dtype=np.int64), np.array(begins, dtype=bool)
