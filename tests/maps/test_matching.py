"""The road of a car: matching, the baseline, and the road table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.maps import matching
from egolane_pgm.maps.lane_graph import LaneGraph, assumed_lanes, near
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.matching import match
from egolane_pgm.maps.positions import Positions
from egolane_pgm.types import FloatArray, InputError
from tests.kits.lane_maps import PLANE, interchange, lane_map, random_trip
from tests.reference.matching import enumerated, nearest_by_hand


@pytest.fixture(scope="module")
def graph() -> LaneGraph:
    return interchange()


def drive(x: FloatArray, y: FloatArray | float) -> Positions:
    """Positions at places in metres, one a second."""
    place = np.stack([x, np.broadcast_to(y, len(x))], axis=1)
    latitude, longitude = PLANE.degrees(place).T
    return Positions.make(np.arange(len(x)) * 1.0, latitude, longitude)


EASTWARD = np.arange(10.0, 5990, 30)


def by_ramp(x: FloatArray) -> FloatArray:
    return np.interp(x, [3000, 3200, 3500, 4500, 4800, 5000], [0, -20, -60, -60, -20, 0])


# --- the index and the recursions, against plain ones ----------------------------------------


def test_near_segments_equal_a_search_of_all_segments(graph: LaneGraph) -> None:
    rng = np.random.default_rng(1)
    place = graph.point.mean(axis=0) + rng.uniform(-1500, 1500, (60, 2))
    place[:, 1] /= 20
    found = near(graph, place, 50.0)
    for t in range(len(place)):
        rows = slice(found.start[t], found.start[t + 1])
        expected = nearest_by_hand(graph, place[t], 50.0)
        assert sorted(found.segment[rows]) == sorted(expected)
        for k in range(*rows.indices(len(found.segment))):
            along, distance = expected[int(found.segment[k])]
            assert found.along_m[k] == pytest.approx(along, abs=1e-6)
            assert abs(found.offset_m[k]) == pytest.approx(distance, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_filter_smoother_and_best_path_equal_an_enumeration_of_all_paths(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 4, rng.integers(1, 6))
    first = np.concatenate([[0], np.cumsum(size)])
    block = np.concatenate([[0, 0], np.cumsum(size[:-1] * size[1:])])
    emission, transition = rng.normal(size=first[-1]) * 3, rng.normal(size=block[-1]) * 3
    filtered, smoothed, best = enumerated(size, emission, transition)
    belief, path = np.empty(first[-1]), np.empty(len(size), dtype=np.int64)
    matching.filter_states(first, emission, block, transition, belief)
    np.testing.assert_allclose(belief, filtered, atol=1e-12)
    matching.smooth_states(first, block, transition, belief)
    np.testing.assert_allclose(belief, smoothed, atol=1e-12)
    matching.best_path(first, emission, block, transition, path)
    assert path.tolist() == best


# --- drives ----------------------------------------------------------------------------------


@pytest.mark.parametrize("online", [False, True])
def test_the_direction_decides_between_carriageways_that_are_near(
    graph: LaneGraph, online: bool
) -> None:
    # Half way between them.
    there = match(graph, drive(EASTWARD[:60], 7.5), online=online)
    back = match(graph, drive(EASTWARD[:60][::-1], 7.5), online=online)
    assert (there.segment[2:] == 0).all()
    assert (back.segment[2:] == 5).all()


def test_the_branch_that_the_car_took_is_known_afterwards_from_where_it_splits(
    graph: LaneGraph,
) -> None:
    table = locate(graph, drive(EASTWARD, by_ramp(EASTWARD)))
    expected = np.select([EASTWARD < 2000, EASTWARD < 3000, EASTWARD < 5010], [0, 1, 4], 3)
    # The ramp is a little longer than the road beside it.
    assert (table.segment == expected).mean() > 0.98
    assert set(table.segment) == {0, 1, 4, 3}


@pytest.mark.parametrize("online", [False, True])
def test_positions_that_jump_5_km_are_outliers_and_the_car_stays_on_its_road(
    graph: LaneGraph, online: bool
) -> None:
    x, y = EASTWARD.copy(), np.zeros(len(EASTWARD))
    y[50] = 5000
    x[90:93] += 5000
    drove = drive(x, y)
    found = match(graph, drove, online=online)
    assert np.flatnonzero(found.is_outlier).tolist() == [50, 90, 91, 92]
    table = locate(graph, drove, online=online)
    assert (table.segment[[49, 50, 51]] == 0).all()
    assert (table.segment[90:94] == table.segment[89]).all()
    # The last place is kept.
    np.testing.assert_allclose(table.along_m[50], EASTWARD[49], atol=3)
    assert np.isnan(table.offset_m[50])


def test_a_car_that_is_elsewhere_after_a_jump_is_found_there(graph: LaneGraph) -> None:
    x = np.concatenate([EASTWARD[:30], EASTWARD[:30][::-1] + 4000])
    y = np.repeat([0.0, 15.0], 30)
    found = match(graph, drive(x, y))
    assert (found.segment[:30] == 0).all()
    assert found.is_outlier[30:34].all()
    assert (found.segment[34:] == 5).all()


def test_a_track_far_from_any_road_is_refused_with_both_places(graph: LaneGraph) -> None:
    message = r"no position of 200 is .*latitude 50\.4.*; the map: latitude 49\.999"
    with pytest.raises(InputError, match=message):
        locate(graph, drive(EASTWARD, 50_000.0))


@pytest.mark.parametrize("online", [False, True])
def test_a_car_that_leaves_the_map_is_off_it(graph: LaneGraph, online: bool) -> None:
    y = np.interp(EASTWARD, [0, 1000, 1300, 1700, 2000, 6000], [0, 0, 400, 400, 0, 0])
    table = locate(graph, drive(EASTWARD, y), online=online)
    assert (table.segment[(EASTWARD > 1100) & (EASTWARD < 1900)] == -1).all()
    assert (table.segment[EASTWARD < 990] == 0).all()
    assert (table.segment[(EASTWARD > 2100) & (EASTWARD < 2990)] == 1).all()
    assert np.isnan(table.along_m[table.segment < 0]).all()
    assert (table.n_lanes[table.segment < 0] == 0).all()


def test_a_cut_road_is_followed_and_a_wrong_direction_is_off_the_map() -> None:
    cut = lane_map([[(0, 0), (3000, 0)], [(3000, 0), (6000, 0)]], [2, 2])
    found = locate(cut, drive(EASTWARD, 0.0))
    assert (found.segment == np.where(EASTWARD < 3000, 0, 1)).all()
    wrong = lane_map([[(6000, 0), (0, 0)]], [2])
    assert (match(wrong, drive(EASTWARD[::-1], 0.0)).segment == 0).all()
    assert (match(wrong, drive(EASTWARD, 0.0)).segment == -1).mean() > 0.9


def test_online_knows_the_past_only(graph: LaneGraph) -> None:
    rng = np.random.default_rng(3)
    positions, _ = random_trip(graph, rng)
    whole = locate(graph, positions, online=True)
    n = 2 * len(positions) // 3
    columns = ("t_s", "latitude", "longitude", "speed_mps", "heading_deg", "sigma_m")
    part = replace(positions, **{c: getattr(positions, c)[:n] for c in columns})
    shorter = locate(graph, part, online=True)
    for name in ("segment", "along_m", "offset_m", "sure", "n_lanes"):
        np.testing.assert_array_equal(getattr(shorter, name), getattr(whole, name)[:n])


@pytest.mark.parametrize(
    ("n_lanes", "assumed"),
    [
        # The road before, over two segments; the road after; none of the kind has a number.
        ([3, 0, 0, 2], [3, 3, 3, 2]),
        ([0, 0, 2, 3], [2, 2, 2, 3]),
        ([0, 0, 0, 0], [0, 0, 0, 0]),
    ],
)
def test_missing_lanes_are_taken_from_the_road(n_lanes: list[int], assumed: list[int]) -> None:
    lines = [[(1000.0 * k, 0.0), (1000.0 * (k + 1), 0.0)] for k in range(4)]
    road = lane_map(lines, n_lanes, [(k, k + 1) for k in range(3)])
    assert assumed_lanes(road).tolist() == assumed
    places = drive(np.arange(10.0, 3990, 30), 0.0)
    table = locate(road, places)
    np.testing.assert_array_equal(table.n_lanes, np.array(assumed)[table.segment])
    unknown_way = np.where(np.array(n_lanes) == 0, road.way, 0)
    np.testing.assert_array_equal(table.unknown_way, unknown_way[table.segment])


def test_a_number_is_not_taken_from_a_link() -> None:
    lines = [[(1000.0 * k, 0.0), (1000.0 * (k + 1), 0.0)] for k in range(3)]
    road = lane_map([*lines, [(3000.0, 0.0), (5000.0, 0.0)]], [1, 0, 4, 3], [(0, 1)])
    road = replace(road, kind=np.array(["motorway_link", *["motorway"] * 3]))
    assert assumed_lanes(road).tolist() == [1, 3, 4, 3]
