"""Trips over the two real maps: how often the road is right, what another library says, how fast.

The maps are those of OpenStreetMap (© OpenStreetMap contributors, ODbL).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("osmium")
pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.matching import lock_on_road, match
from egolane_pgm.maps.osm import read_osm
from tests.conftest import needs_compiler
from tests.kits.lane_maps import random_trip

A9, A4 = "north-bayreuth_A9_A70", "bautzen_A4"


@pytest.fixture(scope="module")
def maps() -> dict[str, LaneGraph]:
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "maps"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("real maps: needs EGOLANE_DATA with a folder maps")
    return {name: read_osm(folder / f"{name}.osm") for name in (A9, A4)}


@needs_compiler
def test_simulated_trips_are_on_the_right_way_99_percent_of_the_time(
    maps: dict[str, LaneGraph],
) -> None:
    rng = np.random.default_rng(0)
    counts = dict.fromkeys(("offline", "online", "baseline", "all"), 0)
    for graph in maps.values():
        for _ in range(40):
            positions, segment = random_trip(graph, rng)
            counts["all"] += len(segment)
            for online in (False, True):
                table = locate(graph, positions, online=online)
                assert len(table) == len(segment)
                counts["online" if online else "offline"] += (table.segment == segment).sum()
            counts["baseline"] += (lock_on_road(graph, positions).segment == segment).sum()
    assert counts["offline"] >= 0.99 * counts["all"]
    assert counts["online"] >= 0.98 * counts["all"]
    assert counts["baseline"] < counts["online"]


def test_leuven_map_matching_agrees(maps: dict[str, LaneGraph]) -> None:
    pytest.importorskip("leuvenmapmatching")
    from tests.reference.leuven import Leuven

    graph = maps[A9]
    leuven = Leuven(graph)
    rng = np.random.default_rng(0)
    same = n = 0
    for _ in range(4):
        positions, _ = random_trip(graph, rng, longest_m=5000)
        theirs = leuven.match(positions)
        same += (theirs == match(graph, positions).segment).sum()
        n += len(theirs)
    assert n > 150
    assert same >= 0.98 * n
