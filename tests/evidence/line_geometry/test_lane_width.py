"""The lane width from the gaps between lines: sure, unsure, or replaced by the fallback."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.drives import read_drives
from egolane_pgm.evidence.line_geometry.lane_width import gap_counts, width_of_gaps
from egolane_pgm.loading import load_experiment
from egolane_pgm.paper import paper_experiment
from egolane_pgm.types import FloatArray, LineLog
from tests.kits.strangers import lane_width

FALLBACK = 3.5


def log_of(offsets: FloatArray, lri: float = 10.0) -> LineLog:
    ids = np.arange(len(offsets))
    valid = np.isfinite(offsets)
    return LineLog(
        ids, ids / 10, offsets, valid, np.zeros(offsets.shape, bool), np.where(valid, lri, np.nan)
    )


def road(
    width: float, n_frames: int = 400, seed: int = 0, missed: float = 0.2, noise: float = 0.12
) -> LineLog:
    """Four lanes' lines around a vehicle that wanders, some of them missed."""
    rng = np.random.default_rng(seed)
    vehicle = np.cumsum(rng.normal(0, 0.1, n_frames)) % width
    offsets = (np.arange(5) - 2) * width - vehicle[:, None] + rng.normal(0, noise, (n_frames, 5))
    return log_of(np.where(rng.random(offsets.shape) < missed, np.nan, offsets))


@settings(max_examples=30, deadline=None)
@given(width=st.floats(1.8, 4.8), seed=st.integers(0, 1000), missed=st.floats(0, 0.4))
def test_the_width_of_a_road_is_found_whatever_it_is(
    width: float, seed: int, missed: float
) -> None:
    found = lane_width(road(width, seed=seed, missed=missed), FALLBACK)
    assert found.is_sure
    assert found.width_m == pytest.approx(width, abs=0.05)
    assert f"lane width {found.width_m:.2f} m" in found.message


def test_twice_the_width_is_not_taken_where_every_other_line_is_often_missed() -> None:
    """The multi-lane detector on the Italian motorway: a third of its gaps skip a line."""
    found = lane_width(road(2.0, n_frames=2000, missed=0.5), FALLBACK)
    assert found.is_sure
    assert found.width_m == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_lines_anywhere_tell_no_width(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = lane_width(log_of(rng.uniform(-9, 9, (2000, 4))), FALLBACK)
    assert not found.is_sure
    assert found.width_m == FALLBACK
    assert "unsure" in found.message
    assert "3.5 m is assumed" in found.message


@pytest.mark.parametrize("n_frames", [1, 49, 50, 330])
def test_the_width_of_gaps_added_up_is_that_of_all_the_frames(n_frames: int) -> None:
    # The road becomes another one; no line in the first frames.
    offsets = np.concatenate([road(3.0).offset_m[:200], 0.8 * road(3.0).offset_m[200:]])
    offsets[:60] = np.nan
    log = log_of(offsets[:n_frames])
    parts = [gap_counts(log.take(slice(k, k + 50))) for k in range(0, n_frames, 50)]
    added_up = width_of_gaps(np.sum(parts, axis=0), FALLBACK, log.source)
    assert str(added_up) == str(lane_width(log, FALLBACK))
    assert added_up.is_sure == (n_frames == 330)


@settings(max_examples=20, deadline=None)
@given(unit=st.floats(1e-2, 1e3), seed=st.integers(0, 1000))
def test_the_width_does_not_depend_on_the_unit(unit: float, seed: int) -> None:
    """Feet, centimetres, pixels: the expected width is in another unit, and hardly matters."""
    log = road(3.6, seed=seed)
    scaled = log_of(unit * log.offset_m)
    metres, other = lane_width(log, FALLBACK), lane_width(scaled, FALLBACK)
    assert other.is_sure
    assert other.width_m == pytest.approx(unit * metres.width_m, rel=0.01)
    half = lane_width(scaled.take(slice(0, 200)), FALLBACK)
    assert half.width_m == pytest.approx(unit * 3.6, rel=0.03)


@pytest.mark.parametrize("share", [0.4, 0.5, 0.6])
@pytest.mark.parametrize("seed", range(3))
def test_a_line_half_a_lane_beside_the_road_does_not_halve_the_width(
    share: float, seed: int
) -> None:
    """The edge of a hard shoulder that is always seen, while each of three lane lines is missed
    half of the time."""
    rng = np.random.default_rng(seed)
    lanes = road(3.6, n_frames=8000, seed=seed, missed=0.5).offset_m[:, 2:]
    edge = road(3.6, n_frames=8000, seed=seed, missed=0, noise=0).offset_m[:, -1:]
    beside = edge + share * 3.6 + rng.normal(0, 0.12, (8000, 1))
    found = lane_width(log_of(np.hstack([lanes, beside])), FALLBACK)
    assert found.width_m == pytest.approx(3.6, abs=0.1)


@pytest.mark.parametrize("width", [2.0, 3.4, 4.1])
def test_lines_that_are_none_among_the_others_do_not_hide_the_width(width: float) -> None:
    rng = np.random.default_rng(0)
    lanes = road(width, n_frames=2000).offset_m
    found = lane_width(log_of(np.hstack([lanes, rng.uniform(-10, 10, (2000, 2))])), FALLBACK)
    assert found.is_sure
    assert found.width_m == pytest.approx(width, abs=0.06)


@pytest.mark.parametrize("apart", [0.0, 0.05, 0.2])
def test_lines_that_are_reported_twice_do_not_change_the_width(apart: float) -> None:
    lanes = road(3.6, n_frames=2000, missed=0.02).offset_m
    found = lane_width(log_of(np.hstack([lanes, lanes + apart])), FALLBACK)
    assert found.is_sure
    assert found.width_m == pytest.approx(3.6, abs=0.05)


def test_of_two_widths_that_explain_few_gaps_alike_the_expected_one_is_taken() -> None:
    """Gaps of 3 m in half of the frames, of 4.5 m in the others."""
    offsets = np.tile([-4.5, 0.01, 4.5, np.nan], (40, 1))
    offsets[::2] = [-3.0, 0.01, 3.0, np.nan]
    log = log_of(offsets)
    assert lane_width(log, 3.0).found_m == pytest.approx(3.0, abs=0.05)
    assert lane_width(log, 4.5).found_m == pytest.approx(4.5, abs=0.05)


def test_too_few_gaps_tell_no_width() -> None:
    few, many = road(3.0, n_frames=5), road(3.0, n_frames=100)
    assert not lane_width(few, FALLBACK).is_sure
    assert lane_width(few, FALLBACK).width_m == FALLBACK
    assert lane_width(many, FALLBACK).is_sure


@pytest.mark.parametrize(
    "offsets",
    [
        np.empty((0, 0)),
        np.empty((5, 0)),
        np.full((5, 3), np.nan),
        np.full((5, 1), 1.75),
        np.zeros((500, 3)),
    ],
    ids=["no frames", "no slots", "no lines", "one line", "placeholders at zero"],
)
def test_without_two_lines_in_a_frame_the_fallback_is_used_and_it_says_so(
    offsets: FloatArray,
) -> None:
    found = lane_width(log_of(offsets), 3.2)
    assert (found.width_m, found.is_sure) == (3.2, False)
    assert np.isnan(found.found_m)
    assert "no two lines" in found.message
    assert "3.2 m is assumed" in found.message


def test_weak_lines_do_not_count_and_unknown_reliability_does() -> None:
    offsets = road(3.6).offset_m
    assert "no two lines" in lane_width(log_of(offsets, lri=5), FALLBACK).message
    assert lane_width(log_of(offsets, lri=np.nan), FALLBACK).is_sure


@pytest.mark.parametrize(
    ("run", "width"), [(1, 3.9), (4, 3.9), (5, 2.02), (7, 3.4), (10, 4.06)], ids=str
)
def test_the_papers_recordings(recordings: object, run: int, width: float) -> None:
    [drive] = read_drives(load_experiment(paper_experiment(run)))
    log = drive.log
    found = lane_width(log, FALLBACK)
    assert found.is_sure
    assert found.width_m == pytest.approx(width, abs=0.06)
    # From any fifth of the drive, too.
    for part in np.array_split(np.arange(len(log)), 5):
        piece = lane_width(log.take(part), FALLBACK)
        assert piece.found_m == pytest.approx(width, abs=0.15)
