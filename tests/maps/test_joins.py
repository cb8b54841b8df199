"""How lanes continue: on two real maps, on their mirror images, and on drawn roads."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.maps.joins import with_joins
from egolane_pgm.maps.lane_graph import LaneGraph, joins_from
from egolane_pgm.maps.osm import joined, of_ways, read_osm
from tests.kits.lane_maps import lane_map
from tests.kits.osm_files import write_mirrored, write_osm

MOTORWAY = {"highway": "motorway"}
LINK = {"highway": "motorway_link"}


@pytest.fixture(scope="module", params=["bautzen_A4", "north-bayreuth_A9_A70"])
def extract(request: pytest.FixtureRequest) -> Path:
    path = Path(os.environ.get("EGOLANE_DATA", ".")) / "maps" / f"{request.param}.osm"
    if not path.is_file():
        pytest.skip("maps of motorways: needs EGOLANE_DATA with a folder maps")
    return path


def between_motorways(graph: LaneGraph) -> np.ndarray:
    return (graph.kind[graph.before] == "motorway") & (graph.kind[graph.after] == "motorway")


def test_lanes_of_the_real_motorways_begin_and_end_at_the_right(extract: Path) -> None:
    graph = of_ways(extract)
    rows = between_motorways(graph)
    changed = rows & (graph.n_lanes[graph.before] != graph.n_lanes[graph.after])
    n_joins, n_changed = {"bautzen_A4": (15, 7), "north-bayreuth_A9_A70": (60, 12)}[extract.stem]
    assert (rows.sum(), changed.sum()) == (n_joins, n_changed)
    np.testing.assert_array_equal(graph.shift[rows], 0)
    # At the right lies the change, or the link that comes or leaves.
    np.testing.assert_array_equal(graph.side[changed], 1)
    assert set(graph.source[changed]) == {"placement"}


def test_the_mirror_image_of_a_map_has_the_mirror_images_of_its_joins(
    extract: Path, tmp_path: Path
) -> None:
    graph = of_ways(extract)
    path = write_mirrored(extract, tmp_path / "mirrored.osm")
    with pytest.warns(UserWarning, match="traffic is taken to keep to the left"):
        mirrored = of_ways(path)
    np.testing.assert_array_equal(mirrored.way, graph.way)
    for name in ("before", "after", "join", "source", "n_lanes"):
        np.testing.assert_array_equal(getattr(mirrored, name), getattr(graph, name), err_msg=name)
    np.testing.assert_array_equal(mirrored.side, -graph.side)
    gained = graph.n_lanes[graph.after] - graph.n_lanes[graph.before]
    np.testing.assert_array_equal(mirrored.shift, gained - graph.shift)
    np.testing.assert_allclose(mirrored.placement, graph.n_lanes[:, None] - graph.placement)


def test_lanes_that_part_and_meet_add_up_on_the_real_maps() -> None:
    """Where roads meet in a motorway, lanes are conserved 6 times of 6 (and where links of the
    interchange do, once of once); where it parts, 4 of 5: the fifth has a lane that leads to both.
    """
    folder = Path(os.environ.get("EGOLANE_DATA", ".")) / "maps"
    if not folder.is_dir():
        pytest.skip("maps of motorways: needs EGOLANE_DATA with a folder maps")
    more: dict[str, list[int]] = {"parts": [], "meets": []}
    for path in sorted(folder.glob("*.osm")):
        graph = of_ways(path)
        for here, there, what in (
            (graph.before, graph.after, "parts"),
            (graph.after, graph.before, "meets"),
        ):
            three_links = graph.way == 184420576
            for k in np.flatnonzero((graph.kind == "motorway") | three_links):
                arms = there[here == k]
                if len(arms) > 1:
                    more[what].append(int(graph.n_lanes[arms].sum() - graph.n_lanes[k]))
    assert sorted(more["parts"]) == [0, 0, 0, 0, 1]
    assert more["meets"] == [0] * 7


def test_ways_are_joined_where_nothing_changes_and_keep_their_length(extract: Path) -> None:
    graph = of_ways(extract)
    short = joined(graph)
    assert len(short) < 0.7 * len(graph)
    assert short.length_m.sum() == pytest.approx(graph.length_m.sum())
    assert (short.n_lanes * short.length_m).sum() == pytest.approx(
        (graph.n_lanes * graph.length_m).sum()
    )
    ends = short.first[1:] - 1
    np.testing.assert_array_equal(
        short.point[ends[short.before]], short.point[short.first[:-1][short.after]]
    )
    assert (np.diff(short.before) >= 0).all()
    # Every join that changes something is still there.
    kept = (graph.n_lanes[graph.before] != graph.n_lanes[graph.after]).sum()
    assert (short.n_lanes[short.before] != short.n_lanes[short.after]).sum() == kept


# --- drawn roads -------------------------------------------------------------------------------


def straight(tmp_path: Path, first: dict, then: dict, *, drives_left: bool = False) -> LaneGraph:
    """A motorway to the east, of two ways with these tags."""
    nodes = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (1000.0, 0.0)}
    ways = [(10, [1, 2], {**MOTORWAY, **first}), (11, [2, 3], {**MOTORWAY, **then})]
    return of_ways(write_osm(tmp_path / "road.osm", nodes, ways), drives_left=drives_left)


@pytest.mark.parametrize(
    ("first", "then", "shift", "source", "side"),
    [
        ({"lanes": 2}, {"lanes": 2}, 0, "placement", 0),
        ({"lanes": 2}, {"lanes": 3, "placement": "right_of:1"}, 0, "placement", 1),
        ({"lanes": 2}, {"lanes": 3, "placement": "right_of:2"}, 1, "placement", -1),
        ({"lanes": 3, "placement": "right_of:2"}, {"lanes": 2}, -1, "placement", -1),
        ({"lanes": 2}, {"lanes": 4, "placement": "right_of:2"}, 1, "placement", 0),
        # A line in the middle of both may as well be one that nobody placed.
        ({"lanes": 2}, {"lanes": 4}, 0, "driving side", 1),
        ({"lanes": 4}, {"lanes": 4, "placement": "right_of:1"}, 0, "lane count", 0),
        (
            {"lanes": 3, "turn:lanes": "merge_to_right|none|none"},
            {"lanes": 2},
            -1,
            "turn:lanes",
            -1,
        ),
        ({"lanes": 3, "turn:lanes": "||slight_right"}, {"lanes": 2}, 0, "turn:lanes", 1),
        ({"lanes": 2}, {"lanes": 3}, 0, "driving side", 1),
        ({"lanes": 2}, {"lanes": 3, "placement": "middle_of:2"}, 0, "driving side", 1),
        ({}, {"lanes": 3}, math.nan, "", 0),
    ],
)
def test_where_lanes_continue_along_a_road(
    tmp_path: Path, first: dict, then: dict, shift: float, source: str, side: int
) -> None:
    graph = straight(tmp_path, first, then)
    assert graph.join.tolist() == ["same"]
    np.testing.assert_array_equal(graph.shift, [shift])
    assert (graph.source[0], graph.side[0]) == (source, side)


def test_traffic_at_the_left_has_its_lanes_begin_there(tmp_path: Path) -> None:
    graph = straight(tmp_path, {"lanes": 2}, {"lanes": 3}, drives_left=True)
    assert (graph.shift[0], graph.source[0], graph.side[0]) == (1, "driving side", -1)


def parting(tmp_path: Path, n: int, upper: dict, lower: dict, **tags: object) -> LaneGraph:
    """A road to the east that parts; the upper branch leads to the left."""
    nodes = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (900.0, 60.0), 4: (900.0, -60.0)}
    ways = [
        (10, [1, 2], {**MOTORWAY, "lanes": n, **tags}),
        (11, [2, 3], upper),
        (12, [2, 4], lower),
    ]
    return of_ways(write_osm(tmp_path / "parting.osm", nodes, ways))


def test_an_exit_at_the_left_takes_the_left_lanes(tmp_path: Path) -> None:
    graph = parting(tmp_path, 4, {**LINK, "lanes": 1}, {**MOTORWAY, "lanes": 3})
    assert graph.join.tolist() == ["exit", "exit"]
    assert graph.way[graph.after].tolist() == [11, 12]
    assert (graph.shift.tolist(), graph.side.tolist()) == ([0, -1], [-1, -1])
    assert graph.source.tolist() == ["lane count", "lane count"]


def test_a_fork_says_which_arm_is_which_and_shares_one_lane_at_most(tmp_path: Path) -> None:
    two = {**MOTORWAY, "lanes": 2}
    for n, shifts in ((4, [0, -2]), (3, [0, -1]), (5, [math.nan] * 2), (2, [math.nan] * 2)):
        graph = parting(tmp_path, n, two, two)
        assert graph.join.tolist() == ["fork", "fork"]
        assert graph.side.tolist() == [-1, 1]
        np.testing.assert_array_equal(graph.shift, shifts)


def test_arrows_say_which_lanes_serve_an_exit(tmp_path: Path) -> None:
    graph = parting(
        tmp_path,
        4,
        {**MOTORWAY, "lanes": 3},
        {**LINK, "lanes": 2},
        **{"turn:lanes": "none|none|through;slight_right|slight_right"},
    )
    assert graph.shift.tolist() == [0, -2]
    assert set(graph.source) == {"turn:lanes"}


def test_an_exit_whose_road_is_not_on_the_map_leads_from_the_lane_with_its_arrow(
    tmp_path: Path,
) -> None:
    nodes = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (900.0, -60.0)}
    ways = [
        (10, [1, 2], {**MOTORWAY, "lanes": 3, "turn:lanes": "none|none|slight_right"}),
        (11, [2, 3], {**LINK, "lanes": 1}),
    ]
    graph = of_ways(write_osm(tmp_path / "cut.osm", nodes, ways))
    assert (graph.join[0], graph.shift[0], graph.side[0]) == ("exit", -2, 1)


def test_lanes_of_roads_that_meet_come_beside_one_another(tmp_path: Path) -> None:
    nodes = {1: (0.0, 60.0), 2: (0.0, -60.0), 3: (400.0, 0.0), 4: (900.0, 0.0)}
    ways = [
        (10, [1, 3], {**MOTORWAY, "lanes": 2}),
        (11, [2, 3], {**LINK, "lanes": 1}),
        (12, [3, 4], {**MOTORWAY, "lanes": 3}),
    ]
    graph = of_ways(write_osm(tmp_path / "meeting.osm", nodes, ways))
    assert graph.join.tolist() == ["entry", "entry"]
    assert (graph.shift.tolist(), graph.side.tolist()) == ([0, 2], [1, 1])
    ways[1] = (11, [2, 3], {**MOTORWAY, "lanes": 1})
    graph = of_ways(write_osm(tmp_path / "meeting.osm", nodes, ways))
    assert graph.join.tolist() == ["merge", "merge"]
    assert (graph.shift.tolist(), graph.side.tolist()) == ([0, 2], [-1, 1])


def test_nobody_turns_back_where_a_road_for_both_directions_ends(tmp_path: Path) -> None:
    nodes = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (1000.0, 0.0)}
    trunk = {"highway": "trunk", "lanes": 2}
    ways = [(10, [1, 2], trunk), (11, [2, 3], {**trunk, "lanes": 4})]
    graph = of_ways(write_osm(tmp_path / "both.osm", nodes, ways))
    assert len(graph) == 4
    assert sorted(zip(graph.before.tolist(), graph.after.tolist(), strict=True)) == [(0, 2), (3, 1)]


def test_a_ring_is_one_segment_that_leads_to_itself(tmp_path: Path) -> None:
    corners = {k: (300 * math.cos(k * 0.7), 300 * math.sin(k * 0.7)) for k in range(9)}
    ways = [(10, [0, 1, 2, 3, 4], MOTORWAY), (11, [4, 5, 6, 7, 8, 0], MOTORWAY)]
    graph = read_osm(write_osm(tmp_path / "ring.osm", corners, ways))
    assert len(graph) == 1
    assert (graph.before.tolist(), graph.after.tolist()) == ([0], [0])
    np.testing.assert_array_equal(graph.line(0)[0], graph.line(0)[-1])
    assert joins_from(graph).tolist() == [0, 1]


# --- any road ----------------------------------------------------------------------------------

#: Numbers of lanes of ways that follow one another, each with the lane that its line is right of.
ROADS = st.lists(
    st.integers(1, 5).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, n), st.booleans())),
    min_size=2,
    max_size=8,
)


def road(ways: list[tuple[int, int, bool]], sign: int = 1) -> tuple[LaneGraph, np.ndarray]:
    """Ways of 100 m to the east (or, mirrored, to the west), and which have a placement."""
    lines = [[(sign * 100.0 * k, 0.0), (sign * 100.0 * (k + 1), 0.0)] for k in range(len(ways))]
    n_lanes = np.array([n for n, _, _ in ways])
    is_placed = np.array([said for *_, said in ways])
    place = np.where(is_placed, [k for _, k, _ in ways], n_lanes / 2)
    place = place if sign > 0 else n_lanes - place
    graph = lane_map(lines, n_lanes.tolist(), [])
    return replace(graph, placement=np.stack([place, place], axis=1)), is_placed


@given(ROADS)
def test_lanes_keep_to_the_line_and_at_least_one_goes_on(ways: list[tuple[int, int, bool]]) -> None:
    graph = with_joins(*road(ways))
    assert graph.before.tolist() == list(range(len(ways) - 1))
    n, n_next = graph.n_lanes[:-1], graph.n_lanes[1:]
    moved = graph.placement[1:, 0] - graph.placement[:-1, 1]
    by_line = graph.source == "placement"
    np.testing.assert_array_equal(graph.shift[by_line], moved[by_line])
    assert ((graph.shift > -n) & (graph.shift < n_next)).all()
    both = np.array([one[2] and other[2] for one, other in pairwise(ways)])
    goes_on = (moved > -n) & (moved < n_next)
    np.testing.assert_array_equal(by_line[both], goes_on[both])


@given(ROADS)
def test_a_mirrored_road_has_mirrored_shifts(ways: list[tuple[int, int, bool]]) -> None:
    graph = with_joins(*road(ways))
    mirrored = with_joins(*road(ways, -1), drives_left=True)
    np.testing.assert_array_equal(
        mirrored.shift, graph.n_lanes[1:] - graph.n_lanes[:-1] - graph.shift
    )
    np.testing.assert_array_equal(mirrored.side, -graph.side)
    np.testing.assert_array_equal(mirrored.source, graph.source)


@given(ROADS, st.integers(0, 1_000_000))
def test_joining_ways_keeps_the_road_as_it_is(ways: list[tuple[int, int, bool]], seed: int) -> None:
    graph, is_placed = road(ways)
    order = np.random.default_rng(seed).permutation(len(graph))
    mixed = replace(
        graph,
        name=np.full(len(graph), "A 1", dtype=object),
        **{name: getattr(graph, name)[order] for name in ("way", "n_lanes", "placement")},
        point=graph.point.reshape(-1, 2, 2)[order].reshape(-1, 2),
    )
    short = joined(with_joins(mixed, is_placed[order]))
    changes = sum(
        (one[0], graph.placement[k, 0]) != (other[0], graph.placement[k + 1, 0])
        for k, (one, other) in enumerate(pairwise(ways))
    )
    assert len(short) == changes + 1
    assert len(short.before) == changes
    assert len(short.point) == len(ways) + len(short)
    assert short.length_m.sum() == pytest.approx(graph.length_m.sum())
    ends = short.point[short.first[1:] - 1]
    np.testing.assert_array_equal(ends[short.before], short.point[short.first[short.after]])
