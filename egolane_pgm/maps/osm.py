"""Reads the motorways and trunk roads of an extract of OpenStreetMap as a lane graph."""

from __future__ import annotations

import warnings
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.maps.lane_graph import LaneGraph, along_points, metres_per_degree
from egolane_pgm.maps.tags import KEYS, KINDS, Direction, directions
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

#: The largest number of warnings about the tags of a map.
MOST_WARNINGS = 8

#: No road leads on where one would turn back by more than this; measured over TURN_M metres.
MOST_TURN_DEG, TURN_M = 135.0, 15.0


def read_osm(path: str | Path) -> LaneGraph:
    """The lanes of the motorways and trunk roads of an `.osm` or `.osm.pbf` extract, and how they
    continue. Needs the extra `maps`.

    The places of all nodes of the file are kept in memory while it is read (16 bytes each): take
    the roads out of a large extract first (`osmium tags-filter`).

    Warns of tags that make no sense, whose lanes are then unknown, and of nodes without
    coordinates, which are left out. Raises InputError for a file that cannot be read as a map, one
    without such a road, and where osmium is not installed.
    """
    return joined(of_ways(path))


def of_ways(path: str | Path) -> LaneGraph:
    """As `read_osm`, before ways are joined: each is a segment, or several where another shares a
    point with it."""
    raw = _read(path)
    tags = [directions(values) for values in raw.tags]
    _warn(path, raw, [problems for _, problems in tags])
    return with_joins(_segments(raw, [ways for ways, _ in tags]))


# --- the file ----------------------------------------------------------------------------------


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


# --- segments ----------------------------------------------------------------------------------


def _segments(raw: _Raw, ways: list[tuple[Direction, ...]]) -> LaneGraph:
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
    start, stop, way = start[piece], stop[piece], way[piece]

    size = stop - start + 1
    first = np.concatenate([[0], np.cumsum(size)])
    nth = np.arange(first[-1]) - np.repeat(first[:-1], size)
    point = raw.point[
        np.repeat(np.where(is_backward, stop, start), size)
        + nth * np.repeat(np.where(is_backward, -1, 1), size)
    ]
    kind = np.array([values[0] for values in raw.tags])
    none = np.zeros(0, dtype=np.int64)
    return LaneGraph(
        way=raw.way[way],
        kind=kind[raw.tag_set[way]],
        name=np.array(raw.names, dtype=object)[raw.name[way]],
        n_lanes=column(lambda d: d.n_lanes, np.int64),
        point=point,
        first=first,
        length_m=along_points(point, first)[first[1:] - 1],
        before=none,
        after=none,
    )


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


# --- what meets what ---------------------------------------------------------------------------


def with_joins(ways: LaneGraph) -> LaneGraph:
    """The same S segments with the joins between them: J, where one ends and another begins.

    - ways: its own joins are not looked at.
    """
    before, after = _pairs(ways)
    leaving, arriving = _headings(ways, TURN_M)
    turn = (leaving[after] - arriving[before] + 180.0) % 360.0 - 180.0
    goes_on = np.abs(turn) <= MOST_TURN_DEG
    return replace(ways, before=before[goes_on], after=after[goes_on])


def _pairs(ways: LaneGraph) -> tuple[IntArray, IntArray]:
    """The segments of which one ends at the very point where the other begins, sorted."""
    n = len(ways)
    ends = np.rint(
        np.concatenate([ways.point[ways.first[:-1]], ways.point[ways.first[1:] - 1]]) * 1e7
    ).astype(np.int64)
    place = np.unique(ends[:, 0] * 4_000_000_000 + ends[:, 1], return_inverse=True)[1]
    order = np.argsort(place[:n], kind="stable")
    begins = place[:n][order]
    low, high = (np.searchsorted(begins, place[n:], side) for side in ("left", "right"))
    count = high - low
    before = np.repeat(np.arange(n), count)
    nth = np.arange(len(before)) - np.repeat(np.cumsum(count) - count, count)
    return before, order[low[before] + nth]


def _headings(ways: LaneGraph, metres: float) -> tuple[FloatArray, FloatArray]:
    """The direction over the first and over the last metres of each segment, (S,) both: degrees
    from east, to the left."""
    first, last = ways.first[:-1], ways.first[1:] - 1
    length = along_points(ways.point, ways.first)
    # Every point's place on all segments laid one behind the other, so that one search finds all.
    ends = np.cumsum(length[last])
    total = length + np.repeat(ends - length[last], np.diff(ways.first))
    north, east = metres_per_degree(ways.point[first, 0])

    def point_at(target: FloatArray) -> FloatArray:
        after = np.clip(np.searchsorted(total, target), first + 1, last)
        piece = total[after] - total[after - 1]
        share = np.clip((target - total[after - 1]) / np.where(piece > 0, piece, 1.0), 0.0, 1.0)
        start = ways.point[after - 1]
        place: FloatArray = start + share[:, None] * (ways.point[after] - start)
        return place

    def heading(start: FloatArray, stop: FloatArray) -> FloatArray:
        across = (stop - start) * np.stack([north, east], axis=1)
        angle: FloatArray = np.degrees(np.arctan2(across[:, 0], across[:, 1]))
        return angle

    reach = np.minimum(metres, total[last] - total[first])
    return (
        heading(ways.point[first], point_at(total[first] + reach)),
        heading(point_at(total[last] - reach), ways.point[last]),
    )


# --- ways joined across splits that change nothing ---------------------------------------------


def joined(graph: LaneGraph) -> LaneGraph:
    """The same roads with segments joined where one follows the other and nothing changes: kind,
    name, number of lanes. A segment keeps the way of its first."""
    before, after = graph.before, graph.after
    alone = (np.bincount(before, minlength=len(graph))[before] == 1) & (
        np.bincount(after, minlength=len(graph))[after] == 1
    )
    alone &= before != after
    for values in (graph.kind, graph.name, graph.n_lanes):
        alone &= values[before] == values[after]
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
        **{name: getattr(graph, name)[heads] for name in ("way", "kind", "name", "n_lanes")},
        point=graph.point[index],
        first=np.concatenate([[0], ends[np.append(begins[1:], True)]]),
        length_m=np.bincount(chain, weights=graph.length_m[order]).astype(np.float64),
        before=chain_of[before[kept]],
        after=chain_of[after[kept]],
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
