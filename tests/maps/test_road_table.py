"""The number of lanes along a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from egolane_pgm.maps.road_table import lanes_along, lanes_at, unknown_lanes
from egolane_pgm.types import InputError, LineLog
from tests.kits.lane_maps import road_rows


def log_of(time_s: Sequence[float]) -> LineLog:
    """A log without lines."""
    nan = np.full((len(time_s), 1), np.nan)
    no = np.zeros((len(time_s), 1), dtype=bool)
    frame_id = np.arange(len(time_s))
    return LineLog(frame_id, np.array(time_s, dtype=float), nan, no, no, nan, no[:, 0])


@pytest.mark.parametrize(
    ("n_lanes", "time_s", "expected"),
    [
        # A row a second, from 10 s on: a frame has the lanes of the last row before it.
        ([3, 4, 3], [10, 10.9, 11, 11.9, 12, 15], [3, 3, 4, 4, 3, 3]),
        # A gap keeps the last known number, wherever the frames are in it.
        ([3, 0, 0, 4], [10, 11.5, 12.5, 13], [3, 3, 3, 4]),
        ([3, 0, 0, 4], [12.5, 13], [3, 4]),
        # Before the first known one it is that one.
        ([0, 2, 2], [5, 10, 11], [2, 2, 2]),
    ],
)
def test_frames_have_the_lanes_known_last(
    n_lanes: list[int], time_s: list[float], expected: list[int]
) -> None:
    assert lanes_along(road_rows(n_lanes, 10.0), log_of(time_s)).tolist() == expected
    assert lanes_at(road_rows(n_lanes, 10.0), np.array([99.0])).tolist() == n_lanes[-1:]


@pytest.mark.parametrize(
    ("n_lanes", "time_s", "message"),
    [
        ([3, 3], [100.0, 101.0], "has the times 10 to 11 s, and .* has 100 to 101 s: they do not"),
        ([3, 3], [1.0, 2.0], "has 1 to 2 s: they do not overlap"),
        ([0, 0], [10.0, 11.0], "no row has a number of lanes"),
        ([], [10.0, 11.0], "no row has a number of lanes"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_in_one_line(
    n_lanes: list[int], time_s: list[float], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        lanes_along(road_rows(n_lanes, 10.0), log_of(time_s))
    assert "\n" not in str(error.value)


def test_frames_without_a_number_of_lanes_in_the_map_are_reported() -> None:
    road = road_rows([3, 0, 0, 4], 0.0, off=[2], unknown_way={1: 7, 3: -9})
    reports = unknown_lanes(road, log_of([0, 1, 2, 3, 3.5]))
    assert [line.partition(": ")[2] for line in reports] == [
        "in 4 of 5 frames the number of lanes is not in the map (first such ways: 7, -9); it"
        " is assumed, or the number before is kept"
    ]
    assert unknown_lanes(road, log_of([0])) == []
