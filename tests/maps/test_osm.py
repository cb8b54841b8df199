"""Extracts of OpenStreetMap as they come, whole and broken."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.types import InputError
from tests.kits.osm_files import write_osm

NODES = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (1000.0, 10.0), 4: (1500.0, 0.0)}
ROAD = {"highway": "motorway", "lanes": 2, "ref": "A 1"}


def test_ways_become_one_segment_where_nothing_changes(tmp_path: Path) -> None:
    ways = [(10, [1, 2], ROAD), (11, [2, 3], ROAD), (12, [3, 4], {**ROAD, "lanes": 3})]
    graph = read_osm(write_osm(tmp_path / "a.osm", NODES, ways))
    assert graph.way.tolist() == [10, 12]
    assert graph.n_lanes.tolist() == [2, 3]
    assert graph.name.tolist() == ["A 1", "A 1"]
    assert graph.first[1] == 3
    assert graph.length_m[0] == pytest.approx(1000, rel=0.001)
    assert (graph.before.tolist(), graph.after.tolist()) == ([0], [1])


def test_a_oneway_drawn_backwards_is_the_road_that_it_is(tmp_path: Path) -> None:
    way = (11, [2, 3], ROAD)
    turned = (11, [3, 2], {**ROAD, "oneway": "-1"})
    there, here = (
        read_osm(write_osm(tmp_path / "a.osm", NODES, [(10, [1, 2], ROAD), middle]))
        for middle in (way, turned)
    )
    for name in LaneGraph.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name), err_msg=name)


def test_a_way_is_cut_where_another_leaves_from_its_middle(tmp_path: Path) -> None:
    nodes = {**NODES, 5: (1300.0, -80.0)}
    ways = [(10, [1, 2, 3, 4], ROAD), (11, [3, 5], {"highway": "motorway_link", "lanes": 1})]
    graph = read_osm(write_osm(tmp_path / "a.osm", nodes, ways))
    assert graph.way.tolist() == [10, 10, 11]
    assert (graph.before.tolist(), graph.after.tolist()) == ([0, 0], [1, 2])


def test_nodes_without_coordinates_are_left_out_and_counted(tmp_path: Path) -> None:
    ways = [(10, [1, 2, 3], ROAD), (11, [3, 8], ROAD), (12, [3, 7, 4], ROAD)]
    path = write_osm(tmp_path / "a.osm", {**NODES, 7: None}, ways)
    with pytest.warns(UserWarning, match=r"a\.osm: left out 2 way\(s\) with nodes that"):
        graph = read_osm(path)
    assert graph.way.tolist() == [10]
    assert graph.first[1] == 3


@pytest.mark.parametrize("change", ["ways first", "negative ids", "both"])
def test_ways_may_come_before_nodes_and_ids_may_be_negative(tmp_path: Path, change: str) -> None:
    # One way repeats a node, and one lacks a node.
    ways = [(10, [1, 2, 2, 3], ROAD), (11, [3, 8], ROAD), (12, [3, 4], {**ROAD, "lanes": 3})]
    usual = write_osm(tmp_path / "a.osm", {**NODES, 8: None}, ways)
    text = usual.read_text()
    if change != "negative ids":
        head, *parts = re.split(r"(?=<(?:node|way) )", text.removesuffix("</osm>"))
        text = "".join([head, *sorted(parts, key=lambda part: part[:2], reverse=True), "</osm>"])
    if change != "ways first":
        text = re.sub('(id|ref)="', r'\1="-', text)
    (tmp_path / "b.osm").write_text(text)
    with pytest.warns(UserWarning, match=r"left out 1 way\(s\) with nodes that"):
        one, other = read_osm(usual), read_osm(tmp_path / "b.osm")
    for name in LaneGraph.__dataclass_fields__:
        there = getattr(one, name)
        there = -there if name == "way" and change != "ways first" else there
        np.testing.assert_array_equal(getattr(other, name), there, err_msg=name)


def test_mistakes_in_tags_are_counted_in_one_warning(tmp_path: Path) -> None:
    ways = [
        (10, [1, 2], {**ROAD, "lanes": "two"}),
        (11, [2, 3], {**ROAD, "lanes": "two"}),
        (12, [3, 4], {**ROAD, "lanes": "2"}),
    ]
    path = write_osm(tmp_path / "a.osm", NODES, ways)
    with pytest.warns(UserWarning, match=r"2 way\(s\), first of way 10: lanes=two is not a number"):
        graph = read_osm(path)
    assert graph.n_lanes.tolist() == [0, 2]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.osm", "<osm version='0.6'><node id='1' lat='1' lon='2'/></osm>", "no motorway and no"),
        ("a.osm", "<osm version='0.6'><node id='1'", "cannot be read as a map"),
        ("a.osm", "<osm version='0.6'><node id='1' lat='north' lon='2'/></osm>", "cannot be read"),
        ("a.osm.pbf", "not at all", "cannot be read as a map"),
        ("nowhere.osm", None, "no such file"),
        (
            "a.json",
            "{}",
            r"No support .* \(maps are \.osm and .*; Overpass writes \.osm after \[out",
        ),
        (
            "a.osm",
            "<osm version='0.6'><way id='1'><nd ref='1' lat='1' lon='2'/>"
            "<nd ref='2' lat='1' lon='3'/><tag k='highway' v='trunk'/></way></osm>",
            r"with coordinates .*; end the Overpass query with `\(\._;>;\); out;`: `out geom` is",
        ),
        ("a.txt", "not at all", "cannot be read as a map: Could not detect file format"),
    ],
)
def test_a_file_without_a_road_is_refused_in_one_line(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as error:
        read_osm(tmp_path / name)
    assert str(tmp_path / name) in str(error.value)
    assert "\n" not in str(error.value)
