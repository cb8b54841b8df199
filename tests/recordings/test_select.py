"""Ranges of frames, missing frames, the join with the ground truth, warnings about a log."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.recordings.select import (
    fill_missing,
    recording_warnings,
    select_frames,
)
from egolane_pgm.types import InputError, LineLog


def make_log(frames: list[int], n_lines: int = 3, seed: int = 0) -> LineLog:
    rng = np.random.default_rng(seed)
    shape = (len(frames), n_lines)
    frame_id = np.array(frames, dtype=np.int64)
    return LineLog(
        frame_id=frame_id,
        time_s=frame_id / 10.0,
        offset_m=rng.normal(0, 5, shape),
        is_valid=rng.random(shape) < 0.5,
        is_continuous=rng.random(shape) < 0.5,
        lri=rng.integers(0, 11, shape).astype(float),
        source="drive.bag",
    )


frame_lists = st.lists(st.integers(-20, 60), min_size=1, max_size=30, unique=True).map(sorted)


@pytest.mark.parametrize(
    ("first", "stop", "kept"),
    [
        (None, None, [3, 4, 7, 9]),
        (4, None, [4, 7, 9]),
        (None, 9, [3, 4, 7]),
        (4, 9, [4, 7]),
        (5, 100, [7, 9]),
    ],
)
def test_the_first_frame_is_included_and_the_stop_is_not(
    first: int | None, stop: int | None, kept: list[int]
) -> None:
    log = make_log([3, 4, 7, 9])
    chosen = select_frames(log, first, stop)
    np.testing.assert_array_equal(chosen.frame_id, kept)
    rows = [list(log.frame_id).index(k) for k in kept]
    np.testing.assert_array_equal(chosen.offset_m, log.offset_m[rows])
    with pytest.raises(InputError, match=r"^drive\.bag: no frame .*frames 3 to 9$"):
        select_frames(log, 5, 7)


@given(frame_lists, st.integers(0, 3), st.sampled_from(["skip", "hold", "predict"]))
def test_filled_frames_have_the_lines_of_the_frame_before_or_none(
    frames: list[int], n_lines: int, policy: str
) -> None:
    log = make_log(frames, n_lines)
    filled = fill_missing(log, policy, frame_rate=10.0)
    expected = frames if policy == "skip" else list(range(frames[0], frames[-1] + 1))
    np.testing.assert_array_equal(filled.frame_id, expected)
    np.testing.assert_allclose(filled.time_s, filled.frame_id / 10.0)
    rows = np.searchsorted(filled.frame_id, log.frame_id)
    added = np.setdiff1d(np.arange(len(filled)), rows)
    is_predicted = np.isin(np.arange(len(filled)), added) & (policy == "predict")
    np.testing.assert_array_equal(filled.is_missing, is_predicted)
    for name in ("offset_m", "is_valid", "is_continuous", "lri"):
        values = getattr(filled, name)
        assert values.dtype == getattr(log, name).dtype
        np.testing.assert_array_equal(values[rows], getattr(log, name))
        if policy == "predict":
            assert (np.isnan(values[added]) | (values[added] == 0)).all()
        else:
            np.testing.assert_array_equal(values[added], values[added - 1])


def test_ids_that_cannot_be_frame_numbers_are_not_filled() -> None:
    log = make_log([0, 10**12])
    assert fill_missing(log, "skip", 10.0) is log
    with pytest.raises(InputError, match=r"drive\.bag.*are these ids frame numbers"):
        fill_missing(log, "hold", 10.0)


def test_each_oddity_is_one_line_with_its_count_and_first_frame() -> None:
    nan = np.nan
    log = LineLog(
        frame_id=np.array([3, 4, 5]),
        time_s=np.array([0.3, 0.4, 0.5]),
        offset_m=np.array([[0.0, 1, 2, 3], [1e30, nan, 1, nan], [-5, -300, nan, nan]]),
        is_valid=np.array([[1, 1, 1, 1], [0, 0, 1, 0], [1, 1, 0, 0]], dtype=bool),
        is_continuous=np.zeros((3, 4), dtype=bool),
        lri=np.array([[1.0, 2, 3, 4], [0, 7, 99, nan], [-7, 11, nan, nan]]),
        source="odd.bag",
    )
    message = recording_warnings(log, n_lanes=2)
    assert message == [
        "odd.bag: 3 valid line(s) have an LRI outside 0..10, first in frame 4",
        "odd.bag: 1 valid line(s) have an offset beyond 100 m, first in frame 5",
        "odd.bag: 1 frame(s) have more valid lines than the 3 of 2 lane(s), first in frame 3",
    ]
    assert not any("LRI" in line for line in recording_warnings(log, n_lanes=3, max_lri=99)[1:])
