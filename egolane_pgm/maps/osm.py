"""Read the motorways and trunk roads of an OpenStreetMap extract as a lane graph."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph, around
from egolane_pgm.maps.tags import KEYS, KINDS, read_lanes
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

#: Segments are not joined if the car would turn by more than this, degrees: no car turns back where
#: a road for both directions ends.
MOST_TURN_DEG = 135.0

#: Length of road over which the turn is measured, metres.
TURN_M = 15.0


def read_osm(path: str | Path) -> LaneGraph:
    """Read the motorways and trunk roads of an `.osm` or `.osm.pbf` extract. Needs the extra
    `maps`.

    All nodes of the file are in memory while it is read (16 bytes each): take the roads out of a
    large extract first (`osmium tags-filter`).

    Warns of invalid tags, whose lanes are unknown, and of ways with nodes without coordinates,
    which are left out. Raises InputError for a file that is not a map or has no such road.
    """
    ways, point = _read(path)
    lanes = ways["tags"].map(read_lanes)
    wrong = lanes[lanes.map(lambda each: len(each[1]) > 0)]
    if len(wrong):
        example = f"way {ways['way'][wrong.index[0]]}: {'; '.join(wrong.iloc[0][1])}"
        _warn(f"{path}: ignored wrong tags of {len(wrong)} way(s), first of {example}")
    segments = _segments(ways, point, np.array([each for each, _ in lanes]))
    return join_ways(with_joins(segments))


def _warn(text: str) -> None:
    warnings.warn(text, UserWarning, stacklevel=3)


# --- the file ----------------------------------------------------------------------------------


def _read(path: str | Path) -> tuple[pd.DataFrame, FloatArray]:
    """W ways: id, name, values of KEYS and number of points; and all points (P, 2) in order,
    latitude and longitude."""
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    with needed(f"{path}", "maps"):
        import osmium
    rows: list[tuple[Any, ...]] = []
    as_bytes = osmium.geom.WKBFactory().create_linestring
    roads: Any = (
        osmium.FileProcessor(str(path), osmium.osm.NODE | osmium.osm.WAY)
        .with_locations("sparse_mem_array")
        .with_filter(osmium.filter.EntityFilter(osmium.osm.WAY))
        .with_filter(osmium.filter.TagFilter(*(("highway", kind) for kind in KINDS)))
    )
    bad_place = (osmium.InvalidLocationError, RuntimeError, ValueError)
    # The nodes that were not found: they come after their ways, or have negative ids.
    later: dict[int, tuple[float, float] | None] = {}
    try:
        for road in roads:
            try:
                # Much faster than a loop over the nodes.
                line: Any = bytes.fromhex(as_bytes(road))[9:]
            except bad_place:
                line = [node.ref for node in road.nodes]
                later |= dict.fromkeys(line)
            get = road.tags.get
            name = get("ref") or get("name") or ""
            rows.append((road.id, name, tuple([get(key) for key in KEYS]), line))
        if later:
            nodes: Any = osmium.FileProcessor(str(path), osmium.osm.NODE)
            if min(later) > 0:
                nodes = nodes.with_filter(osmium.filter.IdFilter(later))
            later |= {
                node.id: (node.lon, node.lat)
                for node in nodes
                if node.id in later and node.location.valid()
            }
    except bad_place as error:
        raise InputError(
            f"{path}: cannot be read as a map: {error} (maps are .osm and .osm.pbf; Overpass writes"
            " .osm after [out:xml])"
        ) from None
    points = bytearray()
    found = []
    for *row, line in rows:
        if isinstance(line, list):
            corners = [corner for corner, _ in groupby(map(later.get, line))]
            if None in corners or len(corners) < 2:
                continue
            line = np.array(corners).tobytes()
        found.append((*row, len(line) // 16))
        points += line
    if not found:
        cure = "; end the Overpass query with `(._;>;); out;`: `out geom` is not read"
        raise InputError(
            f"{path}: no motorway and no trunk road with coordinates (highway={', '.join(KINDS)})"
            + cure * bool(rows)
        )
    if len(found) < len(rows):
        _warn(f"{path}: left out {len(rows) - len(found)} way(s) with nodes that the file lacks")
    point = np.frombuffer(points, dtype="<f8").reshape(-1, 2)[:, ::-1]
    return pd.DataFrame(found, columns=["way", "name", "tags", "size"]), point


# --- segments ----------------------------------------------------------------------------------


def _segments(ways: pd.DataFrame, place: FloatArray, lanes: IntArray) -> LaneGraph:
    """The pieces of the ways, one for each direction of travel.

    - place (P, 2): latitude and longitude of the points.
    - lanes (W, 2): forward and backward, -1 without travel in that direction.
    """
    plane = around(*place.T)
    metres = plane.metres(*place.T)
    of_way = np.concatenate([[0], np.cumsum(ways["size"])])
    # A way is cut at points that it shares with another way, or with itself.
    _, same, times = np.unique(_place_key(metres), return_inverse=True, return_counts=True)
    is_cut = times[same] > 1
    is_cut[of_way[:-1]] = True
    is_cut[of_way[1:] - 1] = True
    cut = np.flatnonzero(is_cut)
    way_of = np.repeat(np.arange(len(ways)), ways["size"])
    is_piece = way_of[cut[:-1]] == way_of[cut[1:]]
    ends = np.stack([cut[:-1], cut[1:]], axis=1)[is_piece]
    way = way_of[ends[:, 0]]

    driven = lanes[way]
    piece, backward = np.nonzero(driven >= 0)
    way = way[piece]
    start = ends[piece, backward]
    stop = ends[piece, 1 - backward]
    size = np.abs(stop - start) + 1
    first = np.concatenate([[0], np.cumsum(size)])
    nth = np.arange(first[-1]) - np.repeat(first[:-1], size)
    point = np.repeat(start, size) + nth * np.repeat(np.sign(stop - start), size)
    none = np.zeros(0, dtype=np.int64)
    return LaneGraph(
        way=ways["way"].to_numpy()[way],
        kind=np.array([tags[0] for tags in ways["tags"]])[way],
        name=np.array(ways["name"], dtype=object)[way],
        n_lanes=driven[piece, backward],
        plane=plane,
        point=metres[point],
        first=first,
        before=none,
        after=none,
    )


def _place_key(metres: FloatArray) -> IntArray:
    """A number for each place, (P,), equal for places within a millimetre."""
    place = np.rint(metres * 1000).astype(np.int64)
    key: IntArray = place[:, 0] * 4_000_000_000 + place[:, 1]
    return key


def with_joins(ways: LaneGraph) -> LaneGraph:
    """The graph with a join from each segment to those that begin at its last point."""
    from shapely import get_coordinates, line_interpolate_point

    n = len(ways)
    begin = ways.point[ways.first[:-1]]
    end = ways.point[ways.first[1:] - 1]
    place = np.unique(_place_key(np.concatenate([begin, end])), return_inverse=True)[1]
    begins = pd.DataFrame({"place": place[:n], "after": np.arange(n)})
    ends = pd.DataFrame({"place": place[n:], "before": np.arange(n)})
    before, after = ends.merge(begins)[["before", "after"]].to_numpy().T
    leaving = get_coordinates(line_interpolate_point(ways.lines, TURN_M)) - begin
    arriving = end - get_coordinates(line_interpolate_point(ways.lines, -TURN_M))
    a, b = arriving[before].T
    x, y = leaving[after].T
    is_way = np.abs(np.degrees(np.arctan2(a * y - b * x, a * x + b * y))) <= MOST_TURN_DEG
    return replace(ways, before=before[is_way], after=after[is_way])


# --- joined ways -------------------------------------------------------------------------------


def join_ways(graph: LaneGraph) -> LaneGraph:
    """Join segments that follow each other and have equal kind, name and number of lanes. A joined
    segment keeps the way of its first one."""
    before = graph.before
    after = graph.after
    alone = (np.bincount(before, minlength=len(graph))[before] == 1) & (
        np.bincount(after, minlength=len(graph))[after] == 1
    )
    alone &= before != after
    for values in (graph.kind, graph.name, graph.n_lanes):
        alone &= values[before] == values[after]
    following = np.full(len(graph), -1)
    following[before[alone]] = after[alone]
    order, begins = _chains(following)

    chain_of = np.empty(len(graph), dtype=np.int64)
    chain_of[order] = np.cumsum(begins) - 1
    # The first point of a following segment is the last one of the segment before.
    skip = (~begins).astype(np.int64)
    size = np.diff(graph.first)[order] - skip
    ends = np.cumsum(size)
    index = np.arange(ends[-1]) + np.repeat(graph.first[order] + skip - (ends - size), size)
    is_tail = np.append(begins[1:], True)
    heads = order[begins]
    tails = order[is_tail]
    # A ring has one join to itself, at its cut.
    stays = ~alone | (chain_of[before] != chain_of[after]) | (tails[chain_of[before]] == before)
    before = chain_of[before[stays]]
    after = chain_of[after[stays]]
    sort = np.lexsort((after, before))
    return replace(
        graph,
        **{name: getattr(graph, name)[heads] for name in ("way", "kind", "name", "n_lanes")},
        point=graph.point[index],
        first=np.concatenate([[0], ends[is_tail]]),
        before=before[sort],
        after=after[sort],
    )


def _chains(following: IntArray) -> tuple[IntArray, BoolArray]:
    """Return all segments (S,), chain by chain, and marks of the first of each chain.

    Chains are in the order of their first segments; rings come last.

    - following (S,): the next segment of each, or -1.
    """
    heads = np.setdiff1d(np.arange(len(following)), following).tolist()
    order = []
    begins = []
    leads_to = following.tolist()
    is_done = bytearray(len(following))
    for start in [*heads, *range(len(following))]:
        at = start
        while at >= 0 and not is_done[at]:
            is_done[at] = 1
            order.append(at)
            begins.append(at == start)
            at = leads_to[at]
    return np.array(order, dtype=np.int64), np.array(begins, dtype=bool)
