"""Columns with other names, units and signs: what is read, and what is refused with a cure."""

from __future__ import annotations

import re
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet as pq

import egolane_pgm as ego
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.columns import Column, checked, column_keys, to_numbers, to_seconds
from egolane_pgm.recordings.select import sign_warning
from egolane_pgm.recordings.table import lines_of
from egolane_pgm.types import InputError
from tests.kits.drives import done
from tests.kits.sensor_files import OFFSETS, foreign_table, per_line

FOREIGN = "time_s=timestamp,line=track,offset_m=lateral_cm,unit=cm,left_positive=true"


def test_a_table_with_foreign_names_keeps_its_lines_and_its_gap(tmp_path: Path) -> None:
    foreign_table(tmp_path / "a.csv")
    log = read_lines(tmp_path / "a.csv", columns=FOREIGN)
    seen = np.r_[0:50, 60:100]
    np.testing.assert_allclose(log.offset_m, OFFSETS[seen], atol=1e-9)
    np.testing.assert_array_equal(log.frame_id, seen)
    np.testing.assert_allclose(log.time_s, seen / 10)


@pytest.mark.parametrize(
    ("columns", "keys"),
    [
        (
            {"t": lambda t, k, y: t * 100, "id": lambda t, k, y: k - 1, "y": lambda t, k, y: y},
            {"time_s": "t", "time_unit": "ms", "line": "id", "offset_m": "y"},
        ),
        (
            {
                "stamp": lambda t, k, y: 1_700_000_000_000_000_000 + t * 10**8,
                "mm": lambda t, k, y: -1000 * y,
            },
            "time_s=stamp,time_unit=ns,offset_m=mm,unit=mm,left_positive=true",
        ),
        (
            {
                "when": lambda t, k, y: (
                    pd.Timestamp("2026-03-01 12:00") + pd.Timedelta(t / 10, "s")
                ),
                "offset_m": lambda t, k, y: y,
            },
            ["time_s=when"],
        ),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "memory"])
def test_given_units_times_and_names_are_used(
    tmp_path: Path, columns: dict[str, Any], keys: Any, kind: str
) -> None:
    table = per_line(**columns)
    file = tmp_path / f"a.{kind}"
    given: Any = str(file)
    if kind == "memory":
        given = table
    else:
        table.to_csv(file, index=False)
    run = ego.run(given, n_lanes=3, columns=keys)
    [log] = run.lines.values()
    np.testing.assert_allclose(log.offset_m, OFFSETS, atol=1e-9)
    assert run.run["frame_rate"] == 10.0
    assert set(np.diff(log.frame_id)) == {1}


def test_a_list_of_columns_is_a_line_each() -> None:
    table = pd.DataFrame({"frame_id": [7, 8], "l": [-1.8, None], "r": [1.7, 1.8], "ok": [1, 0]})
    keys = column_keys("offset_m=[l, r],is_valid=[ok, ok]")
    [log] = ego.run(table, n_lanes=3, columns=keys).lines.values()
    np.testing.assert_array_equal(log.offset_m, [[-1.8, 1.7], [np.nan, 1.8]])
    assert log.is_valid.tolist() == [[True, True], [False, False]]


def test_the_given_keys_are_in_the_yaml_of_the_result(tmp_path: Path) -> None:
    foreign_table(tmp_path / "a.csv")
    words = ("--n-lanes", 3, "--columns", FOREIGN, "--no-figures", "--out", tmp_path / "out")
    done("run", tmp_path / "a.csv", *words)
    result = ego.load_result(tmp_path / "out")
    assert result.experiment.recording.columns == column_keys(FOREIGN)
    assert np.mean(result.frames["assigned_lane"][20:] == 2) > 0.9
    again = ego.run(tmp_path / "out" / "experiment.yaml")
    np.testing.assert_array_equal(again.node("Lane"), result.node("Lane"))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("ofset_m=y", "columns: unknown key 'ofset_m' (did you mean 'offset_m'?)"),
        ("offset_m=z", "columns: offset_m: there is no column 'z'; there are frame_id, y, quality"),
        ("offset_m=y,unit=feet", "columns: unit: input should be 'm', 'cm' or 'mm' (got 'feet')"),
        (
            "offset_m=[y, y],is_valid=quality",
            "columns: is_valid: needs as many columns as offset_m",
        ),
        ("offset_m", "columns: 'offset_m': write it as ours=theirs, e.g. offset_m=lateral"),
        ("offset_m=y,is_valid=quality", "quality (is_valid) is 3, not true, false, 1 or 0"),
    ],
)
def test_a_refusal_names_the_key_and_the_cure(tmp_path: Path, keys: str, message: str) -> None:
    (tmp_path / "a.csv").write_text("frame_id,y,quality\n1,2,3\n")
    with pytest.raises(InputError) as info:
        read_lines(tmp_path / "a.csv", columns=keys)
    assert message in str(info.value)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stamp,offset_m\n1.7e18,2\n", "`columns: {frame_id: NAME}` or `{time_s: NAME"),
        (
            "time_s,offset_m\n1700000000000000000,2\n",
            "in s; set `columns: {time_unit: ns}`",
        ),
        ("time_s,offset_m\n1790000000000,2\n", "in s; set `columns: {time_unit: ms}`"),
        ("frame,offset_m\n1,2\n", "no column frame_id (did you mean 'frame'?)"),
        ("time_s,offset_m\n2,1\n1,1\n", "row 2: time_s goes back; sort by time"),
    ],
)
def test_a_table_without_frames_is_refused_with_a_cure(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=re.escape(message)):
        read_lines(tmp_path / "a.csv")


def test_lines_that_move_against_the_annotated_changes_are_warned_of() -> None:
    drive = ego.simulate("quickstart", frames=3000)
    assert drive.truth is not None
    lane = drive.truth["true_lane"].to_numpy()
    assert sign_warning(drive.log, lane) == []
    mirrored = replace(drive.log, offset_m=-drive.log.offset_m)
    (message,) = sign_warning(mirrored, lane)
    assert "`columns: {left_positive: true}`" in message
    assert "or do the lane numbers count from the right?" in message
    assert sign_warning(mirrored, np.ones_like(lane)) == []


# --- tables that come in -------------------------------------------------------------------------

NAT = pd.NaT
DAY = 1_577_836_800.0


@pytest.mark.parametrize(
    ("cells", "time_s"),
    [
        (pd.to_timedelta([0, 1500], unit="ms"), [0, 1.5]),
        (pd.to_timedelta([0, 1500], unit="ms").astype("timedelta64[s]"), [0, 1]),
        ([pd.Timedelta("1.5s").to_pytimedelta(), None], [1.5, np.nan]),
        (["0 days 00:00:01.5", "0 days 00:00:02"], [1.5, 2]),
        (pd.to_datetime(["2020-01-01", NAT]), [DAY, np.nan]),
        (pd.to_datetime(["2020-01-01 01:00+01:00"]), [DAY]),
        (["2020-01-01T00:00:00.25Z", "2020-01-01 00:00:01+00:00"], [DAY + 0.25, DAY + 1]),
        ([pd.Timestamp("2020-01-01").date()], [DAY]),
        # Years in text are numbers.
        ([" 2020", "2021"], [2020, 2021]),
        (pd.array([1, None], dtype="Int64"), [1, np.nan]),
        ([1_790_000_000_123_456_789], "; it is in ns: convert it to seconds"),
        ([1.79e15], "; it is in us: convert it to seconds"),
        ([5e9], [5e9]),
        ([2e11], "x is 2e+11, which is not a time in s"),
        (["2020-01-01", "x"], "row 1: x is '2020-01-01', not a number"),
        ([True], "row 1: x is True, not a number"),
    ],
)
def test_times_are_seconds_or_refused(cells: Any, time_s: Any) -> None:
    if isinstance(time_s, str):
        with pytest.raises(InputError, match=re.escape(time_s) + "$"):
            to_seconds("a.csv", "x", cells)
    else:
        np.testing.assert_array_equal(to_seconds("a.csv", "x", cells), time_s)


CELLS: dict[str, Any] = {
    "flags": [True, None],
    "dates": pd.to_datetime(["2020-01-01"]),
    "durations": pd.to_timedelta([1], unit="s"),
    "complex": [1 + 2j],
    "lists": [np.array([1.0])],
    "dicts": [{"a": 1}],
    "too large": [10**400],
    "text": ["x"],
    "nullable": pd.array([1, None], dtype="Int64"),
    "categories": pd.Categorical(["1", None]),
    "decimals": [Decimal(1), None],
    "mixed": ["1", " NaN "],
    "blank": [1, " "],
    "bytes": [b"1", b""],
    "2**53": [2**53],
    "below": [2**53 - 1],
    "infinite": [np.inf],
    "half": [0.5],
    "words": ["True", "false "],
    "two": [2],
}


@pytest.mark.parametrize(
    ("kind", "read", "empty"),
    [
        (
            "number",
            ["2**53", "below", "infinite", "half", "two"],
            ["nullable", "categories", "decimals", "mixed", "blank", "bytes"],
        ),
        (
            "whole",
            ["below", "two"],
            ["nullable", "categories", "decimals", "mixed", "blank", "bytes"],
        ),
        (
            "flag",
            ["words"],
            ["flags", "nullable", "categories", "decimals", "mixed", "blank", "bytes"],
        ),
    ],
)
def test_cells_have_the_declared_type_or_are_refused(
    kind: str, read: list[str], empty: list[str]
) -> None:
    for name, cells in CELLS.items():
        if name in (*read, *empty):
            values = to_numbers("a.csv", "x", cells, kind=kind)
            assert values.dtype == np.float64
            assert np.isnan(values).tolist() == (
                [False, True] if name in empty else [False] * len(cells)
            )
        else:
            with pytest.raises(InputError, match=r"a\.csv: row 1: x is .*, (not|larger)"):
                to_numbers("a.csv", "x", cells, kind=kind)


TABLE = pd.DataFrame({"frame_id": [3, 3, 4], "line": [1, 2, 1], "offset_m": [-1.5, 2.0, 1.0]})


@pytest.mark.parametrize("kind", ["memory", "parquet"])
@pytest.mark.parametrize(
    "table",
    [
        TABLE.set_index("frame_id"),
        TABLE.set_index(["frame_id", "line"]),
        TABLE.set_index(["frame_id", "line"]).set_index("offset_m", append=True).reset_index(2),
        TABLE.set_index(TABLE["frame_id"].rename(None)),
        TABLE.convert_dtypes(),
        TABLE.astype({"frame_id": "category", "line": "str"}).astype({"line": "category"}),
        TABLE.rename(columns={"line": " line "}),
        TABLE.iloc[:, ::-1],
        TABLE.set_index(pd.Index([5, 5, 5])),
    ],
)
def test_a_table_is_read_alike_whatever_its_index_and_types(
    tmp_path: Path, table: pd.DataFrame, kind: str
) -> None:
    if kind == "memory":
        log = lines_of(table)
    else:
        table.to_parquet(tmp_path / "a.parquet")
        log = read_lines(tmp_path / "a.parquet")
    assert log.frame_id.tolist() == [3, 4]
    np.testing.assert_array_equal(log.offset_m, [[-1.5, 2.0], [1.0, np.nan]])


@pytest.mark.parametrize("kind", ["memory", "parquet"])
@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            TABLE.pivot_table(index="frame_id", columns="line", values=["offset_m"]),
            "the columns have names of 2 levels, such as offset_m, 1; give each a single name",
        ),
        (TABLE.assign(line=True), "row 1: line is True, not a whole number"),
        (TABLE.assign(offset_m=[True, None, None]), "row 1: offset_m is True, not a number"),
        (TABLE.assign(frame_id=2**53), "row 1: frame_id is 9007199254740992, larger than 2**53"),
        (
            TABLE.assign(line=1),
            "row 2: its frame has this line twice; remove it, or give the lines different numbers",
        ),
        (
            TABLE.assign(line=1, time_s=[0.1, 0.1, 0.2]),
            "row 2: its frame has this line twice; `columns: {frame_id: null}` numbers frames by",
        ),
    ],
)
def test_a_table_that_does_not_fit_is_refused_alike(
    tmp_path: Path, table: pd.DataFrame, message: str, kind: str
) -> None:
    place = Path("in memory")
    if kind == "parquet":
        place = tmp_path / "a.parquet"
        table.to_parquet(place)
    with pytest.raises(InputError) as info:
        lines_of(table) if kind == "memory" else read_lines(place)
    assert str(info.value).startswith(f"{place}: {message}")


def test_a_parquet_file_whose_notes_on_types_are_wrong_is_read_by_its_columns(
    tmp_path: Path,
) -> None:
    rows = pa.Table.from_pandas(TABLE.convert_dtypes())
    words = pa.array(["1", "2", "1"]).dictionary_encode()
    pq.write_table(rows.set_column(1, "line", words), tmp_path / "a.parquet")
    assert read_lines(tmp_path / "a.parquet").offset_m.tolist()[0] == [-1.5, 2.0]
    pq.write_table(rows.set_column(1, "line", pa.array([True] * 3)), tmp_path / "a.parquet")
    with pytest.raises(InputError, match="row 1: line is True, not a whole number"):
        read_lines(tmp_path / "a.parquet")


DECLARED = {
    "id": Column("whole", is_needed=True, is_full=True, others=("number", "nr")),
    "lane": Column("whole"),
    "sure": Column("flag"),
    "is_on": Column("flag", is_full=True),
    "at": Column("time"),
    "speed": Column(),
}


def test_declared_columns_get_our_name_and_their_type() -> None:
    given = pd.DataFrame({
        "nr": ["1", "2"], "sure": ["true", ""], "lane": [2.0, None], "is_on": [1, 0],
        "when": pd.to_datetime(["2020-01-01", None]), "other": ["a", "b"],
    })  # fmt: skip
    table = checked(given, DECLARED, "a.csv", {"at": "when"})
    types = {name: str(table[name].dtype) for name in ("id", "lane", "sure", "is_on", "at")}
    assert types == {
        "id": "int64", "lane": "Int64", "sure": "boolean", "is_on": "bool", "at": "float64",
    }  # fmt: skip
    assert table["at"].tolist()[0] == DAY
    assert table["other"].tolist() == ["a", "b"]
    assert "speed" not in table


@pytest.mark.parametrize(
    ("given", "names", "message"),
    [
        ({"idd": [1]}, {}, "a.csv: no column id (did you mean 'idd'?); the table has idd"),
        ({"id": [1]}, {"speed": "v"}, "a.csv: no column v; the table has id"),
        ({"id": [1, None]}, {}, "a.csv: row 2: id is empty"),
        ({"nr": [1, 2.5]}, {}, "a.csv: row 2: nr (id) is 2.5, not a whole number"),
        ({"id": [1], "is_on": [None]}, {}, "a.csv: row 1: is_on is empty"),
    ],
)
def test_a_table_without_its_declared_columns_is_refused(
    given: Any, names: dict[str, str], message: str
) -> None:
    with pytest.raises(InputError) as info:
        checked(pd.DataFrame(given), DECLARED, "a.csv", names)
    assert str(info.value) == message
