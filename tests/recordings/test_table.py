"""Recordings as CSV and Parquet: nothing is lost, and what does not fit is refused by place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.table import lines_of, read_table, write_table
from egolane_pgm.runs import open_input
from egolane_pgm.types import InputError, LineLog
from tests.kits.drives import short_drive, simulated

ARRAYS = ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri", "is_missing")
HEADING = "frame_id,line,offset_m,is_valid,is_continuous,lri\n"
FORMATS = ("csv", "parquet")


def assert_same(one: LineLog, other: LineLog) -> None:
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)


@st.composite
def logs(draw: st.DrawFn) -> LineLog:
    frames = sorted(draw(st.lists(st.integers(-(2**40), 2**40), min_size=1, unique=True)))
    shape = (len(frames), draw(st.integers(0, 4)))
    offset = draw(
        hnp.arrays(np.float32, shape, elements=st.floats(width=32))
        | hnp.arrays(np.float64, shape, elements=st.floats())
    ).astype(np.float64)
    lri = draw(
        hnp.arrays(
            np.float64, shape, elements=st.integers(-(2**31), 2**31 - 1) | st.just(float("nan"))
        )
    )
    booleans = hnp.arrays(np.bool_, shape)
    frame_id = np.array(frames, dtype=np.int64)
    return LineLog(
        frame_id=frame_id,
        time_s=frame_id / 10.0,
        offset_m=offset,
        is_valid=draw(booleans) & np.isfinite(offset),
        is_continuous=draw(booleans),
        lri=lri,
    )


@settings(deadline=None)  # the first example imports pyarrow
@given(log=logs(), extension=st.sampled_from(FORMATS))
def test_any_log_comes_back_as_it_was(
    tmp_path_factory: pytest.TempPathFactory, log: LineLog, extension: str
) -> None:
    path = tmp_path_factory.getbasetemp() / f"round_trip.{extension}"
    write_table(path, log)
    # Columns of padding at the end are no lines.
    is_line = log.is_valid | log.is_continuous | ~np.isnan(log.offset_m) | ~np.isnan(log.lri)
    width = int(np.flatnonzero(is_line.any(axis=0)).max(initial=-1)) + 1
    of_lines = ("offset_m", "is_valid", "is_continuous", "lri")
    kept = replace(log, **{name: getattr(log, name)[:, :width] for name in of_lines})
    assert_same(kept, read_table(path))


@pytest.mark.parametrize("extension", FORMATS)
def test_a_table_keeps_times_and_its_rate(tmp_path: Path, extension: str) -> None:
    log = short_drive().log
    file = tmp_path / f"a.{extension}"

    def rate(**recording: Any) -> float:
        options = {"experiment": simulated(), "n_lanes": 3, "recording": recording}
        [drive] = open_input(file, **options).drives()
        return float(drive.experiment.recording.frame_rate)

    write_table(file, log)
    assert rate() == 10
    stamped = replace(log, time_s=1.5e9 + log.frame_id / 29.97)
    write_table(file, stamped)
    assert_same(read_table(file), stamped)
    assert rate() == 29.97
    assert rate(frame_rate=5) == 5


def test_the_csv_is_as_documented(tmp_path: Path) -> None:
    nan = np.nan
    log = LineLog(
        frame_id=np.array([7, 8, 9]),
        time_s=np.array([0.7, 0.8, 0.9]),
        offset_m=np.array([[-1.75, 1.5], [nan, nan], [nan, nan]]),
        is_valid=np.array([[True, False], [False, False], [False, False]]),
        is_continuous=np.array([[False, True], [False, False], [False, False]]),
        lri=np.array([[10, nan], [nan, nan], [3, nan]]),
    )
    write_table(tmp_path / "a.csv", log)
    assert (tmp_path / "a.csv").read_text() == HEADING + (
        "7,1,-1.75,true,false,10\n"
        "7,2,1.5,false,true,\n"
        "8,,,false,false,\n"
        "9,1,,false,false,3\n"
    )  # fmt: skip
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv"]


def refused(path: Path) -> str:
    with pytest.raises(InputError) as info:
        read_table(path)
    text = str(info.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def csv(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path


def test_a_file_of_pandas_is_read(tmp_path: Path) -> None:
    rows = "1.0,3,-1.5,True\r\n,4,,\r\n 2.0,5,1e1,False\r\n"
    log = read_table(csv(tmp_path, '\ufeff"line","frame_id","offset_m","is_valid"\r\n' + rows))
    np.testing.assert_array_equal(log.frame_id, [3, 4, 5])
    np.testing.assert_array_equal(log.is_valid, [[True, False], [False, False], [False, False]])
    np.testing.assert_array_equal(log.offset_m[2], [np.nan, 10.0])


def test_other_columns_are_ignored_with_one_warning_that_names_near_misses(tmp_path: Path) -> None:
    path = csv(tmp_path, "frame_id,line,offset_m,isvalid,speed\n1,1,2.0,false,30\n")
    with pytest.warns(UserWarning, match="ignored column") as caught:
        log = read_table(path)
    assert len(caught) == 1
    assert "isvalid (did you mean 'is_valid'?), speed" in str(caught[0].message)
    assert log.is_valid.all()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("2,-1,2.0,true,false,3", "line is not in 1..1000"),
        ("2,,2.0,true,false,3", "line is empty, but there is an offset"),
        ("1,1,2.0,true,false,3", "its frame has this line twice"),
    ],
)
def test_a_bad_row_is_refused_with_its_number(tmp_path: Path, row: str, message: str) -> None:
    text = HEADING + f"1,1,2.0,true,false,3\n1,2,4.0,true,true,3\n{row}\n"
    assert refused(csv(tmp_path, text)).startswith(f"row 3: {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADING, "the table has no rows"),
        (
            HEADING + "1,1,\udcff\udcfe,true,false,3\n",
            "row 1: offset_m is b'\\xff\\xfe', not a number",
        ),
        (HEADING + "1,1,2,1,0,3\n0,1,2,1,0,3\n", "frame ids must increase, 1 is followed by 0"),
        ("frame_id,line,offset_m,line\n", "column line occurs more than once"),
        (
            "frame_id,offset\n1,2.0\n",
            "no column offset_m (did you mean 'offset'?); the table has frame_id, offset; it needs"
            " a row per line (frame_id, line, offset_m) or per frame (frame_id, offset_1, offset_2,"
            " ...); name yours with `columns: {offset_m: NAME}`, see `egolane show FILE`",
        ),
        (
            "frame_id,line,offset_m,is_valid\n3,1,-1.5,1\n3,2,,1\n",
            "frame 3: line 2 is valid but its offset is nan; drop it or mark it not valid",
        ),
        (
            "frame_id,time_s,offset_m\n3,0.3,2\n3,0.3,4\n4,0.3,2\n",
            "row 3: time_s is not later than in the frame before",
        ),
        ("frame_id,time_s,offset_m\n3,,2\n", "row 1: time_s is empty"),
    ],
)
def test_a_csv_that_does_not_fit_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode(errors="surrogateescape"))
    assert refused(tmp_path / "a.csv").startswith(message)


def test_a_file_that_is_not_a_table_is_refused(tmp_path: Path) -> None:
    assert refused(tmp_path / "absent.csv") == "no such file"
    (tmp_path / "b.parquet").write_bytes(b"PAR1 this is not one")
    assert "cannot be read as Parquet" in refused(tmp_path / "b.parquet")
    with pytest.raises(InputError, match="greater than 0"):
        read_lines(csv(tmp_path, HEADING), frame_rate=-1)


WIDE = "frame_id,offset_1,offset_2,offset_3,lri_1,is_valid_1\n7,-1.8,1.9,,3,true\n9,,,,,\n"


def test_a_row_per_frame_is_the_same_as_a_row_per_line(tmp_path: Path) -> None:
    wide = read_table(csv(tmp_path, WIDE))
    text = "frame_id,line,offset_m,lri\n7,1,-1.8,3\n7,2,1.9,\n9,,,\n"
    long = read_table(csv(tmp_path, text))
    for name in ("frame_id", "offset_m", "is_valid", "is_continuous", "lri"):
        np.testing.assert_array_equal(getattr(wide, name), getattr(long, name))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("7,1,2,x,,true", "row 1: offset_3 (offset_m) is 'x', not a number"),
        ("7,1,2,3,,", "row 1: is_valid is empty"),
    ],
)
def test_a_bad_row_of_a_frame_is_named_by_its_line(tmp_path: Path, rows: str, message: str) -> None:
    assert message in refused(csv(tmp_path, WIDE.splitlines()[0] + "\n" + rows + "\n"))


# --- DataFrames ----------------------------------------------------------------------------------

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


@pytest.mark.parametrize("extension", FORMATS)
def test_a_frame_is_read_as_its_file(tmp_path: Path, extension: str) -> None:
    wide = pd.DataFrame({"frame_id": [3, 4], "offset_1": [-1.5, None], "offset_m_2": [2.0, 1.9]})
    for k, frame in enumerate((LONG, wide)):
        file = tmp_path / f"{k}.{extension}"
        frame.to_csv(file, index=False) if extension == "csv" else frame.to_parquet(file)
        in_memory = lines_of(frame.set_index("frame_id"), frame_rate=5)
        assert_same(in_memory, read_table(file, frame_rate=5))


def test_what_is_no_table_is_refused() -> None:
    given: Any = "drive.csv"
    with pytest.raises(InputError, match=r"^in memory: 'drive.csv' is neither a file nor a Data"):
        lines_of(given)
