"""The joins of ways, on drawn roads."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.maps.osm import join_ways, read_osm, with_joins
from tests.kits.lane_maps import lane_map
from tests.kits.osm_files import write_osm

MOTORWAY = {"highway": "motorway"}


def test_no_car_turns_back_where_a_road_for_both_directions_ends(tmp_path: Path) -> None:
    nodes = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (1000.0, 0.0)}
    trunk = {"highway": "trunk", "lanes": 2}
    ways = [(10, [1, 2], trunk), (11, [2, 3], {**trunk, "lanes": 4})]
    graph = read_osm(write_osm(tmp_path / "both.osm", nodes, ways))
    assert len(graph) == 4
    assert sorted(zip(graph.before.tolist(), graph.after.tolist(), strict=True)) == [(0, 2), (3, 1)]


def test_a_ring_is_one_segment_that_leads_to_itself(tmp_path: Path) -> None:
    corners = {k: (300 * math.cos(k * 0.7), 300 * math.sin(k * 0.7)) for k in range(9)}
    ways = [(10, [0, 1, 2, 3, 4], MOTORWAY), (11, [4, 5, 6, 7, 8, 0], MOTORWAY)]
    graph = read_osm(write_osm(tmp_path / "ring.osm", corners, ways))
    assert len(graph) == 1
    assert (graph.before.tolist(), graph.after.tolist()) == ([0], [0])
    np.testing.assert_array_equal(graph.point[0], graph.point[-1])


@given(st.lists(st.integers(1, 5), min_size=2, max_size=8), st.integers(0, 1_000_000))
def test_joining_ways_keeps_the_road_as_it_is(n_lanes: list[int], seed: int) -> None:
    """Ways of 100 m to the east, in any order."""
    lines = [[(100.0 * k, 0.0), (100.0 * (k + 1), 0.0)] for k in range(len(n_lanes))]
    graph = lane_map(lines, n_lanes)
    order = np.random.default_rng(seed).permutation(len(graph))
    mixed = replace(
        graph,
        name=np.full(len(graph), "A 1", dtype=object),
        **{name: getattr(graph, name)[order] for name in ("way", "n_lanes")},
        point=graph.point.reshape(-1, 2, 2)[order].reshape(-1, 2),
    )
    short = join_ways(with_joins(mixed))
    changes = sum(one != other for one, other in pairwise(n_lanes))
    assert len(short) == changes + 1
    assert len(short.before) == changes
    assert len(short.point) == len(n_lanes) + len(short)
    assert short.length_m.sum() == pytest.approx(graph.length_m.sum())
    ends = short.point[short.first[1:] - 1]
    np.testing.assert_array_equal(ends[short.before], short.point[short.first[short.after]])
