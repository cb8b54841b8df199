"""The place in the lane by the lines alone: it is that of simulated cars, frame by frame."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import egolane_pgm as ego
from egolane_pgm.evidence.line_geometry.scale import place_finder
from egolane_pgm.scoring.events import Reported, score_events
from egolane_pgm.simulation import simulate
from egolane_pgm.types import FloatArray, LineLog
from tests.kits.line_logs import line_log


def places_of(log: LineLog, **parameters: float) -> FloatArray:
    return place_finder(parameters)(log)


def apart(one: FloatArray, other: FloatArray) -> FloatArray:
    """How far places are from each other: a lane's right border is the next one's left border."""
    return np.asarray(np.abs((one - other + 0.5) % 1 - 0.5))


@pytest.mark.parametrize(("preset", "width_m"), [("a4", 3.75), ("a2", 3.5)])
@pytest.mark.parametrize("scale", [1.0, 0.55])
def test_the_place_is_that_of_the_car_whatever_the_detectors_unit(
    preset: str, width_m: float, scale: float
) -> None:
    drive = simulate(preset, seed=1, frames=3000)
    place = places_of(replace(drive.log, offset_m=scale * drive.log.offset_m))
    # From when the lane width is known.
    is_sure = (np.arange(3000) >= 600) & ~drive.is_failing
    wrong = apart(place, drive.position_m / width_m - 0.5)[is_sure]
    assert np.isnan(wrong).mean() < 0.02
    assert np.nanmedian(wrong) < 0.05


@given(st.sets(st.integers(1, 199), max_size=8), st.integers(0, 10))
def test_however_a_drive_is_cut_the_places_are_the_same(cuts: set[int], seed: int) -> None:
    log = simulate("quickstart", seed=seed, frames=200).log
    place_of = place_finder({})
    parts = [place_of(log.take(slice(a, b))) for a, b in pairwise([0, *sorted(cuts), 200])]
    np.testing.assert_array_equal(np.concatenate(parts), places_of(log))


@given(st.integers(0, 2**32 - 1))
def test_mirrored_lines_have_mirrored_places(seed: int) -> None:
    rng = np.random.default_rng(seed)
    car = rng.normal(0, 0.03, 200).cumsum()
    # No two are so near that they count as one, of which the left one tells the lane width.
    lattice = 3.5 * (np.arange(-2, 2) - car[:, None] % 1) + rng.normal(0, 0.1, (200, 4))
    is_seen = rng.random((200, 4)) < rng.choice([0.1, 0.8])
    log = line_log(np.where(is_seen, lattice, np.nan), lri=np.nan)
    place, mirrored = places_of(log), places_of(replace(log, offset_m=-log.offset_m))
    np.testing.assert_array_equal(np.isnan(mirrored), np.isnan(place))
    known = ~np.isnan(place)
    np.testing.assert_allclose(apart(mirrored[known], -place[known]), 0, atol=1e-9)


def steady(n_seen: int, n_blind: int, lri: float = np.nan) -> LineLog:
    """A car in the middle of its lane, which sees its two lines and then none."""
    offset_m = np.tile([-1.75, 1.75], (n_seen + n_blind, 1))
    offset_m[n_seen:] = np.nan
    return line_log(offset_m, lri=lri)


def test_a_place_is_kept_for_about_a_second_without_lines() -> None:
    place = places_of(steady(30, 30))
    np.testing.assert_allclose(place[:40], 0, atol=1e-9)
    assert np.isnan(place[45:]).all()


def test_lines_that_are_not_reliable_do_not_count() -> None:
    assert np.isnan(places_of(steady(20, 0, lri=3.0))).all()
    assert not np.isnan(places_of(steady(20, 0, lri=3.0), max_lri=4)).any()
    log = steady(20, 0)
    assert np.isnan(places_of(replace(log, is_valid=np.zeros((20, 2), dtype=bool)))).all()
    assert np.isnan(places_of(replace(log, offset_m=np.zeros((20, 2))))).all()


def test_times_that_stand_still_or_run_back_are_no_error() -> None:
    log = steady(20, 0)
    np.testing.assert_allclose(places_of(replace(log, time_s=log.time_s[::-1])), 0, atol=1e-9)
    np.testing.assert_allclose(places_of(replace(log, time_s=np.zeros(20))), 0, atol=1e-9)
    assert places_of(log.take(slice(0, 0))).shape == (0,)


@pytest.mark.parametrize("preset", ["a4", "a2"])
def test_the_papers_graph_finds_lane_changes_by_the_lines(preset: str) -> None:
    drive = simulate(preset, seed=2, n_lanes=4)
    paper = {"graph": "sensor_failure", "evidence": "counting"}
    run = ego.run(drive.log, n_lanes=4, ground_truth=drive.truth, overrides=paper)
    assert "line_crossing_probability" not in run.frames
    assert run.truth is not None
    right = places_of(drive.log, lane_width_m=3.5)
    np.testing.assert_array_equal(run.frames["lateral_offset"], right)
    # The belief alone has a precision of .6 to .72 and a recall of .81 to .91.
    within = score_events([Reported(run.events, run.truth)], 10.0)["within"]["2"]
    assert within["precision"] > 0.9
    assert within["recall"] > 0.95
