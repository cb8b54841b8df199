"""Simulated drives have the properties that their settings and their truth state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence import counting
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.simulation import PRESETS, simulate
from egolane_pgm.simulation.detector import (
    DetectorModel,
    detect_lines,
    line_reliability,
    sensor_failures,
)
from egolane_pgm.simulation.world import World, simulate_road
from egolane_pgm.types import InputError

#: Sees every line, always, without error.
PERFECT = DetectorModel(
    noise_m=0,
    seen_left=1,
    seen_inner=1,
    seen_right=1,
    seen_shoulder=1,
    range_m=1000,
    miss=0,
    clutter=0,
    bad_s=0,
    continuous_left=1,
    continuous_inner=0,
    continuous_right=1,
)


def stretches(flag: np.ndarray) -> np.ndarray:
    """Lengths of the stretches of True."""
    edges = np.flatnonzero(np.diff(np.r_[0, flag.astype(int), 0]))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_the_same_seed_gives_the_same_drive_and_another_seed_another(preset: str) -> None:
    first, again, other = (simulate(preset, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.log.offset_m, again.log.offset_m)
    assert not np.array_equal(first.position_m, other.position_m)
    assert not np.array_equal(first.is_failing, other.is_failing)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n_lanes=st.integers(1, 6),
    change_s=st.floats(2, 8),
    crossing_share=st.floats(0.5, 1),
    label_flips_at=st.floats(0, 1),
    width=st.floats(3, 4.5),
)
def test_the_annotated_lane_is_where_the_vehicle_is_outside_crossings(
    seed: int,
    n_lanes: int,
    change_s: float,
    crossing_share: float,
    label_flips_at: float,
    width: float,
) -> None:
    world = World(
        n_lanes=n_lanes,
        lane_width_m=width,
        n_frames=900,
        change_s=change_s,
        crossing_share=crossing_share,
        label_flips_at=label_flips_at,
        changes_per_minute=4,
        wander_m=0.12,
    )
    road = simulate_road(world, seed)
    lane = np.floor(road.position_m / width).astype(int) + 1
    assert road.lane.min() >= 1
    assert road.lane.max() <= n_lanes
    assert set(np.abs(np.diff(road.lane))) <= {0, 1}
    np.testing.assert_array_equal(road.lane[~road.is_crossing], lane[~road.is_crossing])
    changes = 0 if n_lanes == 1 else 6
    assert np.count_nonzero(np.diff(road.lane)) == changes == len(stretches(road.is_crossing))
    assert np.abs(np.diff(road.position_m)).max() < width / 2


def test_lane_changes_take_0_6_to_1_7_times_the_median_duration() -> None:
    world = World(n_frames=20_000, change_s=5, change_spread=3, crossing_share=1, min_stay_s=1)
    lengths = stretches(simulate_road(world, 0).is_crossing)
    assert (min(lengths), max(lengths)) == (30, 85)


@pytest.mark.parametrize("flips_at", [1.0, 0.65, 0.0])
def test_the_label_flips_at_the_configured_part_of_the_crossing(flips_at: float) -> None:
    road = simulate_road(World(n_frames=3000, change_s=6, label_flips_at=flips_at), 5)
    begins = np.flatnonzero(np.diff(road.is_crossing.astype(int), prepend=0) == 1)
    lengths = stretches(road.is_crossing)
    flips = np.flatnonzero(np.diff(road.lane)) + 1
    np.testing.assert_array_equal(flips, begins + np.round(flips_at * lengths))


def test_a_perfect_detector_reports_every_line_where_it_is() -> None:
    road = simulate_road(World(n_lanes=4, shoulder_m=3), 2)
    log = detect_lines(road, np.zeros(len(road), dtype=bool), PERFECT, 2)
    expected = np.column_stack([road.line_offset_m, road.shoulder_offset_m])
    np.testing.assert_array_equal(log.offset_m, expected)
    assert log.is_valid.all()
    assert (log.lri == 10).all()
    assert log.is_continuous[:, [0, 4]].all()
    assert not log.is_continuous[:, 1:4].any()
    np.testing.assert_allclose(np.diff(log.offset_m[:, :5], axis=1), 3.75)
    np.testing.assert_allclose(log.offset_m[:, 5] - log.offset_m[:, 4], 3.0)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_valid_lines_lie_on_the_lattice_of_road_lines_within_the_noise(preset: str) -> None:
    drive = simulate(preset, 0, bad_s=0, clutter=0)
    chosen = PRESETS[preset]
    width, shoulder_m = chosen.world.lane_width_m, chosen.world.shoulder_m
    lines = [k * width for k in range(drive.n_lanes + 1)]
    lines += [lines[-1] + shoulder_m] if shoulder_m else []
    seen = (np.array(lines) - drive.position_m[:, None]) * chosen.detector.offset_scale
    frame, slot = np.nonzero(drive.log.is_valid & (drive.log.lri == 10))
    error = drive.log.offset_m[frame, slot][:, None] - seen[frame]
    nearest = error[np.arange(len(error)), np.abs(error).argmin(axis=1)]
    assert np.std(nearest) == pytest.approx(chosen.detector.noise_m, rel=0.12)
    assert np.abs(nearest).max() < 6 * chosen.detector.noise_m


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), rate=st.floats(0, 1))
def test_lri_and_validity_equal_counting_frame_by_frame(seed: int, rate: float) -> None:
    detected = np.random.default_rng(seed).random((60, 3)) < rate
    lri, is_valid = line_reliability(detected)
    for k in range(3):
        past = [detected[0, k]] * 10
        valid = False
        for t in range(60):
            past = [*past[1:], detected[t, k]]
            count = sum(past)
            valid = count == 10 or (valid and count > 0)
            assert lri[t, k] == count
            assert is_valid[t, k] == valid


def test_failures_last_as_long_and_come_as_often_as_configured() -> None:
    road = simulate_road(World(n_frames=400_000, n_lanes=1, wander_m=0), 0)
    failing = sensor_failures(DetectorModel(ok_s=12, bad_s=3), road, 0)
    # About 2,600 stretches: the means of geometric lengths are known to 2 % (one sigma).
    assert stretches(failing).mean() == pytest.approx(30, rel=0.08)
    assert stretches(~failing).mean() == pytest.approx(120, rel=0.08)
    assert stretches(failing).std() == pytest.approx(30, rel=0.12)


def test_a_failure_takes_lines_away_and_puts_lines_in_wrong_places() -> None:
    road = simulate_road(World(n_frames=3000, n_lanes=3), 0)
    failing = np.zeros(3000, dtype=bool)
    failing[500:600] = failing[1500:1600] = failing[2500:2600] = True
    blind = replace(PERFECT, bad_missed=1, bad_clutter=0)
    log = detect_lines(road, failing, blind, 0)
    late = np.zeros_like(failing)
    late[510:600] = late[1510:1600] = late[2510:2600] = True  # the LRI takes 10 frames to fall
    assert not log.is_valid[late].any()
    assert log.is_valid[:500].sum(axis=1).min() == 4

    slipped = replace(PERFECT, bad_missed=0, bad_shifted=1, bad_clutter=0)
    error = detect_lines(road, failing, slipped, 0).offset_m - road.line_offset_m
    np.testing.assert_allclose(error[~failing], 0, atol=1e-12)
    shift = [error[a : a + 100] for a in (500, 1500, 2500)]
    for one in shift:
        np.testing.assert_allclose(one, one[0, 0])
    assert len({round(float(one[0, 0]), 6) for one in shift}) == 3

    ghosts = replace(PERFECT, bad_missed=1, bad_clutter=1)
    log = detect_lines(road, failing, ghosts, 0)
    assert (log.is_valid[late].sum(axis=1) == 2).all()
    assert np.abs(log.offset_m[late][log.is_valid[late]]).max() <= 10


@pytest.mark.parametrize(
    ("preset", "lowest", "highest"),
    [("a4", 0.50, 0.70), ("a2", 0.6, 0.78), ("quickstart", 0.55, 0.70)],
)
def test_the_counting_rule_is_right_as_often_as_on_the_road_and_less_in_failures(
    preset: str, lowest: float, highest: float
) -> None:
    drive = simulate(preset, 0)
    values = resolve_parameters(counting.PARAMETERS, {"bonus_value": 7}, drive.n_lanes)
    tentative = counting.evidence(drive.log, drive.n_lanes, values)
    lane = assigned_lane(tentative.likelihoods["DetectorOutput"])
    scored = ~drive.truth["is_crossing"].to_numpy()
    is_right = lane == drive.truth["true_lane"].to_numpy()
    assert lowest < is_right[scored].mean() < highest
    ok, bad = (is_right[scored & f].mean() for f in (~drive.is_failing, drive.is_failing))
    assert bad < ok - 0.15


@pytest.mark.parametrize(
    ("preset", "n_lanes", "frames", "changes", "crossing"),
    [("a4", 4, 9952, 109, 19), ("a2", 3, 9777, 34, 56), ("quickstart", 3, 1200, 10, 20)],
)
def test_presets_have_the_length_and_the_lane_changes_they_promise(
    preset: str, n_lanes: int, frames: int, changes: int, crossing: int
) -> None:
    drive = simulate(preset)
    assert (drive.n_lanes, len(drive)) == (n_lanes, frames)
    assert np.count_nonzero(np.diff(drive.truth["true_lane"].to_numpy())) == changes
    assert np.median(stretches(drive.truth["is_crossing"].to_numpy())) == pytest.approx(
        crossing, rel=0.06
    )
    np.testing.assert_array_equal(drive.log.frame_id, drive.truth.index)
    np.testing.assert_allclose(drive.log.time_s, drive.log.frame_id / 10)


def test_frames_and_lanes_and_any_field_can_be_overridden() -> None:
    drive = simulate("a4", 0, frames=600, n_lanes=2, label_flips_at=0.65)
    assert (len(drive), drive.n_lanes) == (600, 2)
    assert set(drive.truth["true_lane"].to_numpy()) == {1, 2}
    assert len(simulate("a4", 0, frames=1)) == 1
    assert len(simulate("a2", 0, n_frames=300.0)) == 300
    assert set(simulate("quickstart", 0, n_lanes=1).truth["true_lane"]) == {1}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preset": "quickstrat"}, r"unknown preset 'quickstrat' \(did you mean 'quickstart'\?\)"),
        ({"noise": 1}, r"simulation: unknown key 'noise' \(did you mean 'noise_[ms]'\?\)"),
        ({"seed": -1}, r"simulation\.seed: -1 must not be negative"),
        ({"frames": 0}, r"simulation\.n_frames: 0: input should be greater than or equal to 1"),
        ({"miss": 1.3}, r"simulation\.miss: 1\.3: input should be less than or equal to 1"),
        ({"noise_m": float("nan")}, r"simulation\.noise_m: nan: input should be less"),
        ({"range_m": "far"}, r"simulation\.range_m: far: input should be a valid number"),
        ({"changes_per_minute": 40}, r"changes_per_minute: 80 lane changes do not fit into 1200"),
    ],
)
def test_impossible_keys_are_refused_by_name(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulate(**arguments)  # type: ignore[arg-type]
