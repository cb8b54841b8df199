"""The lane width from the gaps between lines: sure, unsure, or replaced by the fallback."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.drives import read_drives
from egolane_pgm.evidence.line_geometry.lane_width import gap_counts, width_of_gaps
from egolane_pgm.loading import load_experiment
from egolane_pgm.paper import paper_experiment
from egolane_pgm.types import FloatArray, LineLog
from tests.evidence.line_geometry.test_scale import MEDIAN, widths_of
from tests.evidence.line_geometry.test_scale import road as lines_of_road
from tests.kits.line_logs import line_log
from tests.kits.strangers import lane_width

FALLBACK = 3.5


def road(width: float, n_frames: int = 400, seed: int = 0, **given: Any) -> LineLog:
    """Four lanes' lines around a vehicle that wanders, some of them missed."""
    return line_log(lines_of_road(width, n_frames, seed, **{"n_lines": 5, **given}))


# --- from the whole recording and from the frames so far -----------------------------------------


def whole(offset: FloatArray) -> FloatArray:
    found = lane_width(line_log(offset), FALLBACK)
    return np.array([found.width_m])


def so_far(offset: FloatArray) -> FloatArray:
    """The median before each frame of the last quarter."""
    widths, _ = widths_of(offset)
    return widths[len(offset) * 3 // 4 :, MEDIAN]


def with_edge(share: float) -> FloatArray:
    """The edge of a hard shoulder that is always seen, a share of a lane beside the road, while
    each of three lane lines is missed half of the time."""
    lanes = lines_of_road(3.6, 8000, n_lines=3, missed=0.5)
    edge = lines_of_road(3.6, 8000, n_lines=3, missed=0)[:, -1:]
    return np.hstack([lanes, edge + share * 3.6])


def with_lines_anywhere(width: float) -> FloatArray:
    anywhere = np.random.default_rng(0).uniform(-10, 10, (2000, 2))
    return np.hstack([lines_of_road(width, 2000, n_lines=5), anywhere])


def with_doubles(apart: float) -> FloatArray:
    lanes = lines_of_road(3.6, 2000, missed=0.02)
    return np.hstack([lanes, lanes + apart])


@pytest.mark.parametrize("estimate", [whole, so_far])
@pytest.mark.parametrize(
    ("make", "width"),
    [
        *((partial(with_edge, share), 3.6) for share in (0.5, 0.6)),
        *((partial(with_lines_anywhere, width), width) for width in (2.0, 3.4, 4.1)),
        *((partial(with_doubles, apart), 3.6) for apart in (0.0, 0.05, 0.2)),
        # Every other line is often missed, which twice the width would explain as well.
        (partial(lines_of_road, 2.0, 2000, n_lines=5, missed=0.5), 2.0),
    ],
)
def test_odd_lines_do_not_hide_the_width(
    estimate: Callable[[FloatArray], FloatArray], make: Callable[[], FloatArray], width: float
) -> None:
    np.testing.assert_allclose(estimate(make()), width, rtol=0.06)


@pytest.mark.parametrize("seed", range(3))
def test_lines_anywhere_tell_no_width(seed: int) -> None:
    offset = np.random.default_rng(seed).uniform(-9, 9, (3000, 4))
    found = lane_width(line_log(offset), FALLBACK)
    assert not found.is_sure
    assert found.width_m == FALLBACK
    assert "unsure" in found.message
    assert "3.5 m is assumed" in found.message
    assert (np.abs(np.log(so_far(offset) / FALLBACK)) < 0.25).all()


# --- from the whole recording --------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(width=st.floats(1.8, 4.8), seed=st.integers(0, 1000), missed=st.floats(0, 0.4))
def test_the_width_of_a_road_is_found_whatever_it_is(
    width: float, seed: int, missed: float
) -> None:
    found = lane_width(road(width, seed=seed, missed=missed), FALLBACK)
    assert found.is_sure
    assert found.width_m == pytest.approx(width, abs=0.05)
    assert f"lane width {found.width_m:.2f} m" in found.message


@pytest.mark.parametrize("n_frames", [1, 49, 50, 330])
def test_the_width_of_gaps_added_up_is_that_of_all_the_frames(n_frames: int) -> None:
    # The road becomes another one; no line in the first frames.
    offsets = np.concatenate([road(3.0).offset_m[:200], 0.8 * road(3.0).offset_m[200:]])
    offsets[:60] = np.nan
    log = line_log(offsets[:n_frames])
    parts = [gap_counts(log.take(slice(k, k + 50))) for k in range(0, n_frames, 50)]
    added_up = width_of_gaps(np.sum(parts, axis=0), FALLBACK, log.source)
    assert str(added_up) == str(lane_width(log, FALLBACK))
    assert added_up.is_sure == (n_frames == 330)


@settings(max_examples=20, deadline=None)
@given(unit=st.floats(1e-2, 1e3), seed=st.integers(0, 1000))
def test_the_width_does_not_depend_on_the_unit(unit: float, seed: int) -> None:
    """Feet, centimetres, pixels: the expected width is in another unit, and hardly matters."""
    log = road(3.6, seed=seed)
    scaled = line_log(unit * log.offset_m)
    metres, other = lane_width(log, FALLBACK), lane_width(scaled, FALLBACK)
    assert other.is_sure
    assert other.width_m == pytest.approx(unit * metres.width_m, rel=0.01)
    half = lane_width(scaled.take(slice(0, 200)), FALLBACK)
    assert half.width_m == pytest.approx(unit * 3.6, rel=0.03)


def test_of_two_widths_that_explain_few_gaps_alike_the_expected_one_is_taken() -> None:
    """Gaps of 3 m in half of the frames, of 4.5 m in the others."""
    offsets = np.tile([-4.5, 0.01, 4.5, np.nan], (40, 1))
    offsets[::2] = [-3.0, 0.01, 3.0, np.nan]
    log = line_log(offsets)
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
def test_without_two_lines_in_a_frame_the_fallback_is_used_with_a_warning(
    offsets: FloatArray,
) -> None:
    found = lane_width(line_log(offsets), 3.2)
    assert (found.width_m, found.is_sure) == (3.2, False)
    assert np.isnan(found.found_m)
    assert "no two lines" in found.message
    assert "3.2 m is assumed" in found.message


def test_weak_lines_do_not_count_and_unknown_reliability_does() -> None:
    offsets = road(3.6).offset_m
    assert "no two lines" in lane_width(line_log(offsets, lri=5), FALLBACK).message
    assert lane_width(line_log(offsets, lri=np.nan), FALLBACK).is_sure


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
