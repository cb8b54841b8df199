"""What the tags of a way say about its lanes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.maps.tags import KEYS, Direction, directions


def read(**tags: object) -> tuple[tuple[Direction, ...], list[str]]:
    """Tags with _ for : in their keys."""
    given = {
        key.replace("_", ":").replace("both:", "both_"): str(value) for key, value in tags.items()
    }
    given = {"highway": "motorway", **given}
    assert set(given) <= set(KEYS)
    found, problems = directions(tuple(given.get(key) for key in KEYS))
    return found, list(problems)


def test_a_motorway_is_a_oneway() -> None:
    (way,), problems = read(lanes=3)
    assert way == Direction(False, 3)
    assert not problems


def test_a_oneway_drawn_backwards_is_driven_from_its_end() -> None:
    (way,), _ = read(oneway="-1", lanes=2)
    assert way == Direction(True, 2)


@pytest.mark.parametrize("lanes", ["two", "3;4", "0", "40", "-1", "2.5"])
def test_a_number_of_lanes_that_makes_no_sense_is_unknown_and_said(lanes: str) -> None:
    (way,), problems = read(lanes=lanes, turn_lanes="none|none|slight_right")
    assert way.n_lanes == 0
    assert problems == [f"lanes={lanes} is no number from 1 to 30, the lanes are unknown"]


def test_lists_of_lanes_tell_their_number_where_no_tag_does() -> None:
    (way,), problems = read(turn_lanes="none|none|slight_right")
    assert (way.n_lanes, problems) == (3, [])
    (way,), problems = read(lanes=2, change_lanes="yes|no|no")
    assert way.n_lanes == 2
    assert problems == ["change:lanes lists 3 lanes of 2, it is ignored"]


def test_a_road_for_both_directions_is_two() -> None:
    trunk = {"highway": "trunk", "lanes": 3, "lanes_forward": 2, "lanes_backward": 1}
    (there, back), problems = read(**trunk, turn_lanes_forward="through|right")
    assert not problems
    assert (there.n_lanes, back.n_lanes) == (2, 1)


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
            st.sampled_from(["1", "3", "yes", "no", "-1", "a|b", "|"]),
            st.text(max_size=8),
        ),
        min_size=len(KEYS) - 1,
        max_size=len(KEYS) - 1,
    )
)
def test_no_tags_can_break_the_reader(values: list[str | None]) -> None:
    found, _ = directions(("trunk", *values))
    for way in found:
        assert 0 <= way.n_lanes <= 30
