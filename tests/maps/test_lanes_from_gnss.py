"""The lane from the offset to the middle of the road alone."""

from __future__ import annotations

import numpy as np
import pytest

from egolane_pgm.maps.lanes_from_gnss import GnssNoise, lanes_from_offsets
from egolane_pgm.types import FloatArray, InputError
from tests.kits.lane_maps import slow

W = 3.5


def offsets(lane: FloatArray, n: int, rng: np.random.Generator, drift_m: float = 2.0) -> FloatArray:
    """What a receiver measures of a car in these lanes, second by second."""
    drift = drift_m * slow(rng, len(lane), 300)
    return (lane - (n + 1) / 2) * W + drift + rng.normal(size=len(lane)) * 0.7


def wander(n: int, seconds: int, rng: np.random.Generator) -> FloatArray:
    lane = [int(rng.integers(1, n + 1))]
    while len(lane) < seconds:
        step = rng.choice([-1, 1]) if rng.random() < 0.04 else 0
        lane.append(int(np.clip(lane[-1] + step, 1, n)))
    return np.array(lane, dtype=float)


def test_without_noise_the_lane_is_the_one_whose_middle_the_car_is_in() -> None:
    for n in (1, 2, 3, 4):
        for lane in range(1, n + 1):
            found = lanes_from_offsets(np.full(5, (lane - (n + 1) / 2) * W), n)
            assert found.lane[-1].argmax() + 1 == lane
            assert found.lane.shape == (5, n + 1)
            np.testing.assert_allclose(found.lane.sum(axis=1), 1)


def test_unknown_offsets_say_nothing() -> None:
    found = lanes_from_offsets(np.full(3, np.nan), 3, GnssNoise(count_wrong=0, count_stays=1))
    np.testing.assert_allclose(found.lane[0], [1 / 3, 1 / 3, 1 / 3, 0])
    assert found.more[-1] == found.fewer[-1] == 0


def test_the_past_tells_the_lane_better_than_the_last_offset() -> None:
    rng = np.random.default_rng(5)
    better = []
    for _ in range(15):
        lane = wander(3, 300, rng)
        seen = offsets(lane, 3, rng)
        belief = lanes_from_offsets(seen, 3, GnssNoise(count_wrong=0, count_stays=1)).lane
        nearest = np.clip(np.rint(seen / W + 2), 1, 3)
        later = slice(60, None)
        right = (belief.argmax(axis=1) + 1 == lane)[later].mean()
        better.append(right - (nearest == lane)[later].mean())
    assert np.mean(better) > 0.1


def test_a_lane_more_than_the_map_has_is_found_once_the_car_used_them_all() -> None:
    rng = np.random.default_rng(2)
    lane = np.repeat([1.0, 2, 3, 2, 1, 2, 3], 30)
    more = [lanes_from_offsets(offsets(lane, 3, rng, 1.0), 2).more[-1] for _ in range(5)]
    right = [lanes_from_offsets(offsets(lane, 3, rng, 1.0), 3).more[-1] for _ in range(5)]
    assert np.mean(more) > 0.9
    assert np.mean(right) < 0.3


def test_the_smoothed_answer_of_the_last_second_is_the_filtered_one() -> None:
    seen = offsets(wander(3, 60, np.random.default_rng(1)), 3, np.random.default_rng(1))
    one, other = lanes_from_offsets(seen, 3), lanes_from_offsets(seen, 3, smooth=True)
    np.testing.assert_allclose(one.lane[-1], other.lane[-1], atol=1e-9)


def test_a_road_without_lanes_is_refused() -> None:
    with pytest.raises(InputError, match="n_lanes: 0 is less than 1"):
        lanes_from_offsets(np.zeros(3), 0)
