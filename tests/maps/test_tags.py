"""What the tags of a way say about its lanes."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.maps.tags import KEYS, read_lanes


def read(**tags: object) -> tuple[tuple[int, int], list[str]]:
    """Tags with _ for : in their keys."""
    given = {key.replace("_", ":"): str(value) for key, value in tags.items()}
    given = {"highway": "motorway", **given}
    assert set(given) <= set(KEYS)
    found, problems = read_lanes(tuple(given.get(key) for key in KEYS))
    return found, list(problems)


@pytest.mark.parametrize(
    ("tags", "lanes"),
    [
        # A motorway is a oneway, and so is its link without lanes against it.
        ({"lanes": 3}, (3, -1)),
        ({"oneway": "-1", "lanes": 2}, (-1, 2)),
        # Which way the lanes lead changes with the time of day.
        ({"oneway": "reversible", "lanes": 2}, (0, 0)),
        ({"highway": "motorway_link", "lanes": 1}, (1, -1)),
        ({"highway": "motorway_link", "lanes_backward": 1}, (0, 1)),
        ({"highway": "motorway_link", "oneway": "no"}, (0, 0)),
        ({"highway": "trunk", "junction": "roundabout"}, (0, -1)),
        # Of an even number alone, half goes in each direction.
        ({"highway": "trunk", "lanes": 4}, (2, 2)),
        ({"highway": "trunk", "lanes": 3}, (0, 0)),
        ({"highway": "trunk", "lanes": 5, "lanes_forward": 3}, (3, 2)),
        ({"highway": "trunk", "lanes": 3, "lanes_forward": 2, "lanes_backward": 1}, (2, 1)),
        ({"highway": "trunk"}, (0, 0)),
    ],
)
def test_lanes_forward_and_backward(tags: dict[str, object], lanes: tuple[int, int]) -> None:
    assert read(**tags) == (lanes, [])


@pytest.mark.parametrize("lanes", ["two", "3;4", "0", "40", "-1", "2.5"])
def test_an_impossible_number_of_lanes_is_unknown_and_reported(lanes: str) -> None:
    found, problems = read(lanes=lanes)
    assert found == (0, -1)
    assert problems == [f"lanes={lanes} is not a number from 1 to 30"]


@settings(max_examples=30)
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
    found, _ = read_lanes(("trunk", *values))
    assert all(-1 <= n_lanes <= 30 for n_lanes in found)
