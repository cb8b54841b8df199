"""Lane changes on a road that a ramp joins."""

from __future__ import annotations

import pytest

from makers.beyond.ramps import STARTS, events_of, is_right, ramp_drive


@pytest.mark.parametrize("lanes", STARTS.values(), ids=[*STARTS])
def test_a_ramp_that_joins_is_no_lane_change_and_hides_none(lanes: tuple[int, int]) -> None:
    for seed in (0, 2, 4):
        for mirrored in (False, True):
            drive = ramp_drive(seed, lanes, "a4", 10.0, 4.0, mirrored=mirrored)
            events = events_of(drive, 10.0, "zero labels")
            assert is_right(drive, events), (seed, mirrored, events)
