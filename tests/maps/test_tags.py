"""What the tags of a way say about its lanes."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.maps.tags import KEYS, Direction, directions


def read(drives_left: bool = False, **tags: object) -> tuple[tuple[Direction, ...], list[str]]:
    """Tags with _ for : in their keys."""
    given = {
        key.replace("_", ":").replace("both:", "both_"): str(value) for key, value in tags.items()
    }
    given = {"highway": "motorway", **given}
    assert set(given) <= set(KEYS)
    found, problems = directions(tuple(given.get(key) for key in KEYS), drives_left)
    return found, list(problems)


def test_a_motorway_is_a_oneway_whose_line_is_in_the_middle() -> None:
    (way,), problems = read(lanes=3)
    assert way == Direction(False, 3, (1.5, 1.5), False, "", "", "")
    assert not problems


@pytest.mark.parametrize(
    ("placement", "place"),
    [("right_of:1", 1.0), ("left_of:1", 0.0), ("middle_of:2", 1.5), ("right_of:3", 3.0)],
)
def test_placement_counts_lanes_from_the_left_edge(placement: str, place: float) -> None:
    (way,), problems = read(lanes=3, placement=placement)
    assert (way.placement, way.is_placed, problems) == ((place, place), True, [])


def test_a_line_that_moves_has_a_place_at_each_end() -> None:
    (way,), _ = read(lanes=2, placement_start="right_of:1", placement_end="right_of:2")
    assert way.placement == (1.0, 2.0)
    (way,), problems = read(lanes=2, placement="transition")
    assert math.isnan(way.placement[0])
    assert math.isnan(way.placement[1])
    assert not problems


def test_a_oneway_drawn_backwards_is_driven_from_its_end() -> None:
    (way,), _ = read(oneway="-1", lanes=2, placement_start="right_of:1", placement_end="right_of:2")
    assert way.is_backward
    assert way.placement == (2.0, 1.0)


@pytest.mark.parametrize("lanes", ["two", "3;4", "0", "40", "-1", "2.5"])
def test_a_number_of_lanes_that_makes_no_sense_is_unknown_and_said(lanes: str) -> None:
    (way,), problems = read(lanes=lanes, turn_lanes="none|none|slight_right")
    assert way.n_lanes == 0
    assert math.isnan(way.placement[0])
    assert problems == [f"lanes={lanes} is no number from 1 to 30, the lanes are unknown"]


@pytest.mark.parametrize("placement", ["right_of:3", "left_of:0", "right_of:x", "middle"])
def test_a_placement_that_contradicts_the_lanes_is_unknown_and_said(placement: str) -> None:
    (way,), problems = read(lanes=2, placement=placement)
    assert way.n_lanes == 2
    assert math.isnan(way.placement[0])
    assert problems == [f"placement={placement} of 2 lanes is no place, it is ignored"]


def test_lists_of_lanes_tell_their_number_where_no_tag_does() -> None:
    (way,), problems = read(turn_lanes="none|none|slight_right")
    assert (way.n_lanes, way.turn, problems) == (3, "none|none|slight_right", [])
    (way,), problems = read(lanes=2, change_lanes="yes|no|no")
    assert (way.n_lanes, way.change) == (2, "")
    assert problems == ["change:lanes lists 3 lanes of 2, it is ignored"]


def test_a_road_for_both_directions_is_two() -> None:
    trunk = {"highway": "trunk", "lanes": 3, "lanes_forward": 2, "lanes_backward": 1}
    (there, back), problems = read(**trunk, turn_lanes_forward="through|right")
    assert not problems
    assert (there.n_lanes, back.n_lanes) == (2, 1)
    assert (there.turn, back.turn) == ("through|right", "")
    # The line is in the middle of three lanes: half a lane into the two, or beside the one.
    assert (there.placement[0], back.placement[0]) == (0.5, -0.5)
    (there, back), _ = read(drives_left=True, **trunk)
    assert (there.placement[0], back.placement[0]) == (1.5, 1.5)
    (there, back), _ = read(**trunk, placement_forward="left_of:1")
    assert (there.placement[0], back.placement[0]) == (0.0, 0.0)
    (there, back), _ = read(**trunk, placement_backward="right_of:1")
    assert (there.placement[0], back.placement[0]) == (-1.0, 1.0)


def test_an_even_number_of_lanes_is_half_for_each_direction() -> None:
    assert [way.n_lanes for way in read(highway="trunk", lanes=4)[0]] == [2, 2]
    assert [way.n_lanes for way in read(highway="trunk", lanes=3)[0]] == [0, 0]
    assert [way.n_lanes for way in read(highway="trunk", lanes=3, lanes_both_ways=1)[0]] == [1, 1]
    assert [way.n_lanes for way in read(highway="trunk", lanes=5, lanes_forward=3)[0]] == [3, 2]
    assert [way.n_lanes for way in read(highway="trunk")[0]] == [0, 0]


def test_links_are_oneways_but_for_those_with_lanes_against_them() -> None:
    assert len(read(highway="motorway_link", lanes=1)[0]) == 1
    assert len(read(highway="motorway_link", lanes_backward=1)[0]) == 2
    assert len(read(highway="motorway_link", oneway="no")[0]) == 2
    assert len(read(highway="trunk", junction="roundabout")[0]) == 1


@given(
    st.lists(
        st.one_of(
            st.none(),
            st.sampled_from(["1", "3", "yes", "no", "-1", "a|b", "|", "right_of:2", "transition"]),
            st.text(max_size=8),
        ),
        min_size=len(KEYS) - 1,
        max_size=len(KEYS) - 1,
    ),
    st.booleans(),
)
def test_no_tags_can_break_the_reader(values: list[str | None], drives_left: bool) -> None:
    found, _ = directions(("trunk", *values), drives_left)
    for way in found:
        assert 0 <= way.n_lanes <= 30
        for text in (way.turn, way.change, way.width):
            assert not text or not way.n_lanes or text.count("|") + 1 == way.n_lanes
