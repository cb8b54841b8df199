"""Columns with other names, units and signs: what is read, and what is refused with a cure."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.recordings.select import sign_warning
from egolane_pgm.types import InputError
from tests.kits.drives import done, refused
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
    given = ("--n-lanes", 3, "--columns", keys)
    assert message.removeprefix("columns: ") in refused("run", tmp_path / "a.csv", *given)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stamp,offset_m\n1.7e18,2\n", "`columns: {frame_id: NAME}` or `{time_s: NAME"),
        (
            "time_s,offset_m\n1700000000000000000,2\n",
            "in s; set `columns: {time_unit: ns}`",
        ),
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
