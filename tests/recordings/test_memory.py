"""Recordings and ground truth in a DataFrame: what a file of them gives, refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.recordings.memory import lines_of, truth_of
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.table import read_table
from egolane_pgm.types import InputError
from tests.kits.drives import short_drive
from tests.recordings.test_table import assert_same

LONG = pd.DataFrame(
    {
        "frame_id": [3, 3, 4, 6],
        "time_s": [0.12, 0.12, 0.16, 0.24],
        "offset_m": [-1.5, 2.0, np.nan, 1.0],
        "is_valid": [True, False, False, True],
        "lri": [4, 5, np.nan, 6],
    }
)


def test_the_table_of_a_log_is_a_recording() -> None:
    log = short_drive().log
    table = log.to_pandas()
    seen = log.take(np.flatnonzero(np.isfinite(log.offset_m).any(axis=1)))
    assert_same(lines_of(table), seen)
    assert_same(lines_of(table.reset_index().drop(columns="line")), seen)
    assert lines_of(log) is log


@pytest.mark.parametrize("extension", ["csv", "parquet"])
def test_a_frame_is_read_as_the_file_of_it(tmp_path: Path, extension: str) -> None:
    wide = pd.DataFrame({"frame_id": [3, 4], "offset_1": [-1.5, None], "offset_m_2": [2.0, 1.9]})
    for k, frame in enumerate((LONG, wide)):
        file = tmp_path / f"{k}.{extension}"
        frame.to_csv(file, index=False) if extension == "csv" else frame.to_parquet(file)
        assert_same(
            lines_of(frame.set_index("frame_id"), frame_rate=5), read_table(file, frame_rate=5)
        )


def test_times_are_the_column_and_say_the_rate() -> None:
    log = lines_of(LONG)
    np.testing.assert_array_equal(log.time_s, [0.12, 0.16, 0.24])
    assert rate_of(log.frame_id, log.time_s) == 25.0
    np.testing.assert_array_equal(lines_of(LONG.drop(columns="time_s")).time_s, [0.3, 0.4, 0.6])


def test_lanes_that_are_missing_are_not_annotated() -> None:
    frame = pd.DataFrame({"lane": [2, None, 1], "crossing": [0, 1, 1]}, index=[7, 8, 9])
    truth = truth_of(frame.rename_axis("frame_id"))
    assert truth.index.tolist() == [7, 9]
    assert truth["true_lane"].tolist() == [2, 1]
    assert truth["is_crossing"].tolist() == [False, True]
    pd.testing.assert_frame_equal(truth_of(truth), truth)
    result = {"frame_id": [1], "lane": [2], "is_crossing": [True], "lri": ["x"]}
    assert truth_of(pd.DataFrame(result))["is_crossing"].all()


@pytest.mark.parametrize(
    ("read", "columns", "said"),
    [
        (
            lines_of,
            {"frame": [1], "offset_m": [1.0]},
            "in memory: no column frame_id (did you",
        ),
        (lines_of, {"frame_id": [1]}, "in memory: no column offset_m; the table has frame_id"),
        (lines_of, {"frame_id": [1, 2], "offset_m": ["x", 1]}, "in memory: column offset_m has"),
        (lines_of, {"frame_id": [], "offset_m": []}, "in memory: the table has no rows"),
        (truth_of, {"frame_id": [1], "lanes": [1]}, "ground truth in memory: no column lane (did"),
        (truth_of, [1, 2], "ground_truth: [1, 2] is neither a file nor a DataFrame of lanes"),
        (
            lines_of,
            "drive.csv",
            "recording: 'drive.csv' is neither a file nor a DataFrame of lines",
        ),
    ],
)
def test_what_does_not_fit_is_refused(read: Any, columns: Any, said: str) -> None:
    given = pd.DataFrame(columns) if isinstance(columns, dict) else columns
    with pytest.raises(InputError) as info:
        read(given)
    assert str(info.value).startswith(said)
    assert "\n" not in str(info.value)
