"""Trips over the two real maps: how often the road is right, what another library says, how fast.

The maps are those of OpenStreetMap (© OpenStreetMap contributors, ODbL).
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("osmium")
pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.maps.index import RoadIndex, index_of
from egolane_pgm.maps.joins import optional_lanes
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.lock_on_road import lock_on_road
from egolane_pgm.maps.matching import match
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.maps.positions import Positions
from egolane_pgm.maps.steps import OPTIONAL, SERVED, lanes_along, road_changes
from egolane_pgm.types import FloatArray
from tests.conftest import needs_compiler
from tests.kits.lane_maps import random_trip

A9, A4 = "north-bayreuth_A9_A70", "bautzen_A4"


@pytest.fixture(scope="module")
def maps() -> dict[str, tuple[LaneGraph, RoadIndex]]:
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "maps"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("real maps: needs EGOLANE_DATA with a folder maps")
    graphs = {name: read_osm(folder / f"{name}.osm") for name in (A9, A4)}
    return {name: (graph, index_of(graph)) for name, graph in graphs.items()}


@needs_compiler
def test_the_middle_lane_of_the_a9s_link_leads_to_both_roads(
    maps: dict[str, tuple[LaneGraph, RoadIndex]],
) -> None:
    """Way 203318573, `turn:lanes=none|through;slight_right|slight_right`, parts into two lanes
    each."""
    graph, index = maps[A9]
    joins = np.flatnonzero(graph.way[graph.before] == 203318573)
    assert graph.shift[joins].tolist() == [-1, 0]
    assert optional_lanes(graph, joins).tolist() == ["2", "2"]
    # Without arrows: the lane that continues on both.
    bare = replace(graph, turn=np.full(len(graph), "", dtype=object))
    assert optional_lanes(bare, joins).tolist() == ["2", "2"]
    # At the other splits the arrows lead to one road each.
    parts = np.flatnonzero(np.bincount(graph.before)[graph.before] > 1)
    assert set(optional_lanes(graph, np.setdiff1d(parts, joins))) == {""}
    # A car that takes the right branch.
    here, there = int(graph.before[joins[0]]), int(graph.after[joins[0]])
    way = [graph.line(here), graph.line(there)]
    latitude, longitude = np.concatenate([_every_metre(line) for line in way])[::25].T
    positions = Positions.make(np.arange(len(latitude)) * 1.0, latitude, longitude)
    table = locate(graph, index, positions)
    before = table.segment == here
    assert set(table.next_optional[before]) == {"2"}
    assert "2" not in table.next_optional[table.segment == there]
    found = road_changes(table)
    along = lanes_along(
        table, np.arange(0.0, table.t_s[-1], 0.1), steps=found.vocabulary(), n_lanes=3
    )
    served = along.served[int(along.changes[0]) - 1]
    np.testing.assert_allclose(served, [1 - SERVED, OPTIONAL, SERVED])


def _every_metre(line: FloatArray) -> FloatArray:
    """A line of latitudes and longitudes (P, 2) with points about a metre apart."""
    scale = np.array([111_195.0, 111_195.0 * np.cos(np.radians(line[0, 0]))])
    at = np.concatenate([[0.0], np.hypot(*(np.diff(line, axis=0) * scale).T).cumsum()])
    metres = np.arange(0.0, at[-1])
    return np.stack([np.interp(metres, at, line[:, k]) for k in (0, 1)], axis=1)


@needs_compiler
def test_simulated_trips_are_on_the_right_way_99_percent_of_the_time(
    maps: dict[str, tuple[LaneGraph, RoadIndex]],
) -> None:
    rng = np.random.default_rng(0)
    counts = dict.fromkeys(("offline", "online", "baseline", "all"), 0)
    for graph, index in maps.values():
        for _ in range(40):
            positions, segment = random_trip(graph, index, rng)
            counts["all"] += len(segment)
            for online in (False, True):
                table = locate(graph, index, positions, online=online)
                assert len(table) == len(segment)
                counts["online" if online else "offline"] += (table.segment == segment).sum()
            counts["baseline"] += (lock_on_road(index, positions).segment == segment).sum()
    assert counts["offline"] >= 0.99 * counts["all"]
    assert counts["online"] >= 0.98 * counts["all"]
    assert counts["baseline"] < counts["online"]


def test_leuven_map_matching_agrees(maps: dict[str, tuple[LaneGraph, RoadIndex]]) -> None:
    pytest.importorskip("leuvenmapmatching")
    from tests.reference.leuven import Leuven

    graph, index = maps[A9]
    leuven = Leuven(graph, index)
    rng = np.random.default_rng(0)
    same = n = 0
    for _ in range(4):
        positions, _ = random_trip(graph, index, rng, longest_m=5000)
        theirs = leuven.match(positions)
        same += (theirs == match(graph, index, positions).segment).sum()
        n += len(theirs)
    assert n > 150
    assert same >= 0.98 * n
