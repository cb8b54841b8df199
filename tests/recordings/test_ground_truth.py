"""The ground-truth format: read, written, refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.recordings.ground_truth import read_ground_truth, truth_of, write_ground_truth
from egolane_pgm.types import InputError, LineLog, lane_truth


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def refused(path: Path, **options: object) -> str:
    with pytest.raises(InputError) as info:
        read_ground_truth(path, **options)  # type: ignore[arg-type]
    text = str(info.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    "text",
    [
        "238;4;0\n239;4;1\n245;3;0\n",
        "238,4,0\n239,4,1\n245,3,0",
        "frame;lane;crossing\n238;4;0\n239;4;1\n\n245;3;0\n\n",
        "\ufeff238; 4; 0\r\n 239;4;1\r\n245;3;0\r\n",
    ],
)
def test_separators_headings_and_blank_lines_do_not_matter(tmp_path: Path, text: str) -> None:
    (tmp_path / "gt.txt").write_bytes(text.encode())
    truth = read_ground_truth(tmp_path / "gt.txt")
    np.testing.assert_array_equal(truth.index, [238, 239, 245])
    np.testing.assert_array_equal(truth["true_lane"], [4, 4, 3])
    np.testing.assert_array_equal(truth["is_crossing"], [False, True, False])
    assert truth.attrs["source"] == str(tmp_path / "gt.txt")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        *((x, f"line 3: {x!r} is not") for x in ("3;1", "3;1;0;0", "3;x;0", "3;1;2", "lane")),
        ("1;2;0", "frame ids must increase, 1 is followed by 1"),
        ("0;2;0", "frame ids must increase, 1 is followed by 0"),
    ],
)
def test_a_bad_line_is_refused_with_its_number(tmp_path: Path, line: str, message: str) -> None:
    path = write(tmp_path / "gt.txt", f"1;1;0\n\n{line}\n4;1;0\n")
    assert refused(path).startswith(message)


def test_files_without_rows_or_text_are_refused(tmp_path: Path) -> None:
    assert "has no annotated row, 'frame;lane;crossing'" in refused(
        write(tmp_path / "gt.txt", "frame;lane;crossing\n")
    )
    assert refused(tmp_path / "absent.txt") == "cannot be read: No such file or directory"
    (tmp_path / "b.txt").write_bytes(b"\xff\xfe\x00\x80")
    assert refused(tmp_path / "b.txt") == "cannot be read: is not text in UTF-8"


def test_extra_rows_are_put_in_where_they_belong(tmp_path: Path) -> None:
    path = write(tmp_path / "gt.txt", "1;1;0\n2;1;0\n9;2;0\n")
    truth = read_ground_truth(path, extra_rows=[(5, 2, 1), (0, 1, 0)])
    np.testing.assert_array_equal(truth.index, [0, 1, 2, 5, 9])
    np.testing.assert_array_equal(truth["true_lane"], [1, 1, 1, 2, 2])
    np.testing.assert_array_equal(truth["is_crossing"], [False, False, False, True, False])
    assert "2 is followed by 2" in refused(path, extra_rows=[(2, 1, 0)])
    assert "7 is followed by 7" in refused(path, extra_rows=[(7, 1, 0), (7, 1, 0)])


@given(
    st.dictionaries(
        st.integers(-5, 10**12), st.tuples(st.integers(1, 9), st.booleans()), min_size=1
    )
)
def test_written_rows_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, rows: dict[int, tuple[int, bool]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "truth.txt"
    frames = np.array(sorted(rows), dtype=np.int64)
    truth = lane_truth(frames, [rows[f][0] for f in frames], [rows[f][1] for f in frames])
    write_ground_truth(path, truth)
    pd.testing.assert_frame_equal(read_ground_truth(path), truth)


# --- DataFrames ----------------------------------------------------------------------------------


def test_lanes_that_are_missing_are_not_annotated() -> None:
    frame = pd.DataFrame({"lane": [2, None, 1], "crossing": [0, 1, 1]}, index=[7, 8, 9])
    truth = truth_of(frame.rename_axis("frame_id"))
    assert truth.index.tolist() == [7, 9]
    assert truth["true_lane"].tolist() == [2, 1]
    assert truth["is_crossing"].tolist() == [False, True]
    pd.testing.assert_frame_equal(truth_of(truth), truth)


def test_what_is_no_table_is_refused() -> None:
    given: Any = [1, 2]
    with pytest.raises(InputError, match=r"^ground truth in memory: \[1, 2\] is neither a file"):
        truth_of(given)


TIMED = LineLog.from_rows(
    np.arange(5, 9), 10.0, np.zeros(0, int), np.zeros(0), *np.zeros((2, 0), bool), np.zeros(0)
)


@pytest.mark.parametrize(
    ("rows", "frames"),
    [
        ("time_s,lane\n0.5,1\n0.62,2\n0.8,3\n", {5: 1, 6: 2, 8: 3}),
        ("time_s;lane;crossing\n0.54;1;1\n", {5: 1}),
        # The nearest of several.
        ("time_s,lane\n0.56,1\n0.59,2\n0.64,3\n", {6: 2}),
        ("frame_id,lane,true_lane\n6,2,9\n7,,9\n8,1,9\n", {6: 2, 8: 1}),
    ],
)
def test_rows_of_a_table_belong_to_a_frame_or_the_nearest_one(
    tmp_path: Path, rows: str, frames: dict[int, int]
) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(rows)
    truth = read_ground_truth(path, log=TIMED)
    assert truth["true_lane"].to_dict() == frames
    assert truth["is_crossing"].any() == ("crossing" in rows)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            "time_s,lane\n7,1\n8,1\n",
            "no row has the time of a frame; the frames are from 0.5 to",
        ),
        ("time_s,lane\n0.6,1\n0.5,1\n", "row 2: time_s must increase, 0.6 is followed by 0.5"),
        ("time_s,lan\n0.5,1\n", "no column lane (did you mean 'lan'?); the table has time_s, lan"),
        ("time_s,lane\n", "has no rows"),
        ("time_s,lane\n,1\n", "row 1: time_s is empty"),
        ("time_s,lane\n1790000000000,1\n", "time_s is 1.79e+12, which is not a time in s; it is"),
        ("frame_id,lane\n5,\n", "has no annotated row"),
        ("frame_id,lane\n5,true\n", "row 1: lane is True, not a whole number"),
    ],
)
def test_rows_of_a_table_that_fit_no_frame_are_refused(
    tmp_path: Path, rows: str, message: str
) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(rows)
    with pytest.raises(InputError) as info:
        read_ground_truth(path, log=TIMED)
    assert str(info.value).startswith(f"{path}: {message}")


def test_a_log_whose_times_go_back_has_no_truth_by_time() -> None:
    back = replace(TIMED, time_s=TIMED.time_s[::-1])
    with pytest.raises(InputError, match=r"row 2: time_s must increase, 0.8 is followed by 0.7"):
        truth_of(pd.DataFrame({"time_s": [0.5], "lane": [1]}), back)


def test_extra_rows_are_added_to_a_table(tmp_path: Path) -> None:
    path = write(tmp_path / "truth.csv", "frame_id,lane\n5,1\n7,2\n")
    truth = read_ground_truth(path, extra_rows=[(6, 2, 1)])
    assert truth["true_lane"].to_dict() == {5: 1, 6: 2, 7: 2}
