"""The lane from the offset to the middle of the road, alone and beside the lines."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

from egolane_pgm.experiment import Gnss
from egolane_pgm.maps.lanes_from_gnss import Across, _drifts, _wander, across, beside_lines
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import FloatArray
from tests.kits.gnss_alone import AloneNoise, lanes_from_offsets
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
    found = lanes_from_offsets(np.full(3, np.nan), 3, AloneNoise(count_wrong=0, count_stays=1))
    np.testing.assert_allclose(found.lane[0], [1 / 3, 1 / 3, 1 / 3, 0])
    assert found.more[-1] == found.fewer[-1] == 0


def test_the_past_tells_the_lane_better_than_the_last_offset() -> None:
    rng = np.random.default_rng(5)
    better = []
    for _ in range(15):
        lane = wander(3, 300, rng)
        seen = offsets(lane, 3, rng)
        belief = lanes_from_offsets(seen, 3, AloneNoise(count_wrong=0, count_stays=1)).lane
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


# --- beside the lines --------------------------------------------------------------------------

NOISE = Gnss(lane_width_m=3.5, sigma_m=1.0, drift_sigma_m=1.0, drift_s=20.0)


def seen(metres: list[float], sigma: float = np.nan) -> Across:
    return Across(np.array(metres), np.full(len(metres), sigma))


def enumerated(metres: FloatArray, lanes: list[int], noise: Gnss) -> FloatArray:
    """P(position at t | lane at t, positions and lanes before) by every path of the drift."""
    drift, (first, rates) = _drifts(noise), _wander(noise)
    moves = expm(rates)
    found = np.empty((len(metres), 3))

    def density(t: int, lane: int, cell: int) -> float:
        off = metres[t] - (lane + 0.5) * noise.lane_width_m - drift[cell]
        said = np.exp(-0.5 * (off / noise.sigma_m) ** 2) / np.sqrt(2 * np.pi) / noise.sigma_m
        return float((1 - noise.off_share) * said + noise.off_share / 50.0)

    for t in range(len(metres)):
        for lane in range(3):
            total = 0.0
            for path in product(range(len(drift)), repeat=t + 1):
                chance = first[path[0]]
                for k in range(t):
                    chance *= density(k, lanes[k], path[k]) * moves[path[k], path[k + 1]]
                total += chance * density(t, lane, path[t])
            found[t, lane] = total
    return found / found.max(axis=1, keepdims=True)


def test_where_the_lines_are_sure_the_likelihood_is_that_of_all_paths_of_the_drift() -> None:
    noise = Gnss(lane_width_m=3.5, sigma_m=1.5, drift_sigma_m=1.5, drift_s=4.0)
    metres, lanes = np.array([6.5, 9.9, 8.8]), [1, 2, 2]
    said = beside_lines(seen(list(metres)), np.arange(3.0), np.eye(3)[lanes], noise)
    np.testing.assert_allclose(said, enumerated(metres, lanes, noise), rtol=1e-9)


def test_without_drift_a_position_is_worth_its_noise() -> None:
    noise = Gnss(lane_width_m=3.5, sigma_m=1.0, drift_sigma_m=0.0)
    said = beside_lines(seen([5.0]), np.zeros(1), np.full((1, 3), 1 / 3), noise)
    off = 5.0 - np.array([1.75, 5.25, 8.75])
    normal = 0.95 * np.exp(-0.5 * off**2) / np.sqrt(2 * np.pi) + 0.05 / 50
    np.testing.assert_allclose(said[0], normal / normal.max())


def test_in_a_mirror_the_lanes_are_mirrored() -> None:
    rng = np.random.default_rng(3)
    metres, believed = rng.uniform(0, 10.5, 20), rng.dirichlet(np.ones(3), 20)
    metres[[4, 11]] = np.nan
    time_s = np.arange(20.0)
    said = beside_lines(Across(metres, np.full(20, np.nan)), time_s, believed, NOISE)
    other = Across(10.5 - metres, np.full(20, np.nan))
    np.testing.assert_allclose(
        beside_lines(other, time_s, believed[:, ::-1], NOISE), said[:, ::-1], rtol=1e-6
    )
    assert (said[[4, 11]] == 1).all()


def test_no_position_is_told_of_before_it_is_there() -> None:
    rng = np.random.default_rng(4)
    metres, believed = rng.uniform(0, 10.5, 20), rng.dirichlet(np.ones(3), 20)
    whole = beside_lines(seen(list(metres)), np.arange(20.0), believed, NOISE)
    half = beside_lines(seen(list(metres[:10])), np.arange(10.0), believed[:10], NOISE)
    np.testing.assert_array_equal(whole[:10], half)


def test_the_drift_that_the_lines_tell_is_taken_off_where_they_are_missing() -> None:
    """The receiver errs by a lane; by itself it would be believed."""
    known, unknown = np.tile([0, 1.0, 0], (10, 1)), np.full((5, 3), 1 / 3)
    metres = [5.25 + 3.5] * 15
    said = beside_lines(seen(metres), np.arange(15.0), np.concatenate([known, unknown]), NOISE)
    assert said[0].argmax() == 2
    assert (said[10:].argmax(axis=1) == 1).all()


def test_a_receiver_that_says_it_is_unsure_says_little() -> None:
    usual = beside_lines(seen([1.75]), np.zeros(1), np.full((1, 3), 1 / 3), NOISE)
    unsure = beside_lines(seen([1.75], 20.0), np.zeros(1), np.full((1, 3), 1 / 3), NOISE)
    assert usual[0, 2] < 0.1
    assert unsure[0, 2] > 0.9


def test_a_position_far_off_the_road_says_nothing() -> None:
    said = beside_lines(seen([400.0]), np.zeros(1), np.full((1, 3), 1 / 3), NOISE)
    np.testing.assert_allclose(said, 1.0)


def table(t_s: list[float], offset_m: list[float], n: int, way_line: float) -> RoadTable:
    rows = len(t_s)
    nothing, whole = np.full(rows, np.nan), np.zeros(rows, dtype=np.int64)
    return RoadTable(
        t_s=np.array(t_s), segment=whole, along_m=np.arange(rows) * 30.0,
        offset_m=np.array(offset_m), sigma_m=nothing, way_line=np.full(rows, way_line),
        sure=np.ones(rows), n_lanes=whole + n, next_n_lanes=whole, next_in_m=nothing,
        next_shift=nothing, next_join=np.full(rows, ""), next_side=whole,
        next_optional=np.full(rows, ""),
    )  # fmt: skip


def test_a_position_counts_once_in_the_first_frame_behind_it() -> None:
    time_s = np.arange(0, 3, 0.1)
    said = across(
        table([0.0, 1.05, 2.0, 9.0], [0, 1, np.nan, 5], 3, 1.0), time_s, np.full(30, 3), 3.5
    )
    assert np.flatnonzero(np.isfinite(said.metres)).tolist() == [0, 11]
    np.testing.assert_allclose(said.metres[[0, 11]], [3.5, 4.5])


def test_where_the_map_has_another_number_of_lanes_its_line_is_the_middle() -> None:
    time_s = np.arange(0, 1, 0.1)
    for lanes, way_line, left in ((3, 1.0, 3.5), (4, 1.0, 7.0), (3, np.nan, 5.25)):
        said = across(table([0.0], [0.0], 3, way_line), time_s, np.full(10, lanes), 3.5)
        assert said.metres[0] == pytest.approx(left)
