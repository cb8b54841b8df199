"""Trips over two real maps (© OpenStreetMap contributors, ODbL), and a recorded drive with GNSS."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("osmium")
pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.matching import match
from egolane_pgm.maps.osm import read_osm
from tests.conftest import needs_compiler
from tests.kits.lane_maps import random_trip
from tests.kits.tracks import rotterdam_receivers, rotterdam_road
from tests.reference.nearest_road import lock_on_road

A9, A4 = "north-bayreuth_A9_A70", "bautzen_A4"


def folder(name: str) -> Path:
    """A folder of EGOLANE_DATA."""
    path = Path(os.environ.get("EGOLANE_DATA", "")) / name
    if not os.environ.get("EGOLANE_DATA") or not path.is_dir():
        pytest.skip(f"needs EGOLANE_DATA with a folder {name}")
    return path


@pytest.fixture(scope="module")
def maps() -> dict[str, LaneGraph]:
    return {name: read_osm(folder("maps") / f"{name}.osm") for name in (A9, A4)}


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


def test_every_receiver_is_within_metres_of_its_road() -> None:
    data = folder("tracks").parent
    road = rotterdam_road(data)
    for name, drove in rotterdam_receivers(data).items():
        found = match(road, drove)
        assert (found.segment >= 0).all(), name
        assert np.median(np.abs(found.offset_m)) < 3
        assert np.abs(found.offset_m).max() < 12


def test_gross_outliers_in_a_recorded_drive_are_rejected() -> None:
    data = folder("tracks").parent
    road, drove = rotterdam_road(data), rotterdam_receivers(data)["GoPro"]
    rng = np.random.default_rng(0)
    wrong = np.sort(rng.choice(np.arange(10, len(drove) - 10), 40, replace=False))
    latitude = drove.latitude.copy()
    latitude[wrong] += rng.choice([-1, 1], 40) * rng.uniform(0.005, 0.05, 40)
    spoilt = replace(drove, latitude=latitude)
    found = match(road, spoilt)
    assert found.is_outlier[wrong].all()
    assert found.is_outlier.sum() == len(wrong)
