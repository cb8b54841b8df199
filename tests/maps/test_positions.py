"""Positions of a GNSS receiver, from every format."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.maps.positions import Positions, read_positions
from egolane_pgm.types import InputError
from tests.kits.bags import line_bag, write_fixes

GPX = """<?xml version="1.0"?>
<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="49.9" lon="11.5"><time>2024-05-01T10:00:00Z</time></trkpt>
<trkpt lat="49.9002" lon="11.5"><time>2024-05-01T10:00:01.5Z</time><hdop>1.5</hdop></trkpt>
</trkseg></trk></gpx>
"""
#: 2024-05-01 10:00:00 UTC.
TEN = 1714557600.0


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_table_is_read_by_the_usual_names_of_its_columns(tmp_path: Path) -> None:
    table = write(tmp_path / "a.csv", "t,lat,lon,speed_mps\n0,52,4.4,30\n1,52.001,4.4,\n")
    found = read_positions(table)
    assert found.t_s.tolist() == [0, 1]
    assert found.latitude.tolist() == [52, 52.001]
    np.testing.assert_array_equal(found.speed_mps, [30, np.nan])
    assert np.isnan(found.heading_deg).all()


def test_columns_may_have_other_names_and_times_may_be_dates(tmp_path: Path) -> None:
    when = ["2024-05-01 10:00:00", "2024-05-01T10:00:01.5Z"]
    table = pd.DataFrame({"when": when, "lat_gps": [52, 52.1], "lon_gps": [4, 4.1]})
    table.to_parquet(tmp_path / "a.parquet")
    names = {"t_s": "when", "latitude": "lat_gps", "longitude": "lon_gps"}
    found = read_positions(tmp_path / "a.parquet", columns=names)
    assert found.t_s.tolist() == [TEN, TEN + 1.5]


@pytest.mark.parametrize("after", [None, "<trkseg>", "00Z</time></trkpt>", "</hdop></trkpt>"])
def test_gpx_is_read_and_a_point_without_a_time_is_left_out(
    tmp_path: Path, after: str | None
) -> None:
    pytest.importorskip("gpxpy")
    point = '<trkpt lat="49.8" lon="11.5"/>'
    text = GPX if after is None else GPX.replace(after, after + point)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read_positions(write(tmp_path / "a.gpx", text))
    notes = [str(w.message).partition(": ")[2] for w in caught]
    assert notes == ([] if after is None else ["left out 1 of 3 positions without a time"])
    assert found.t_s.tolist() == [TEN, TEN + 1.5]
    assert found.latitude.tolist() == [49.9, 49.9002]
    np.testing.assert_array_equal(found.sigma_m, [np.nan, 4.5])


@pytest.mark.parametrize("name", ["a.bag", "bag"])
def test_a_bag_is_read_and_fixes_without_status_are_left_out(tmp_path: Path, name: str) -> None:
    rows = [(10.5, 49.9, 11.5), (11.5, 0.0, 0.0), (12.5, 49.91, 11.5)]
    with pytest.warns(UserWarning, match="left out 1 of 3 positions without a fix"):
        found = read_positions(write_fixes(tmp_path / name, rows, no_fix=1))
    assert found.t_s.tolist() == [10.5, 12.5]
    assert found.latitude.tolist() == [49.9, 49.91]
    assert found.sigma_m.tolist() == [2.0, 2.0]


def test_a_bag_without_positions_is_refused(tmp_path: Path) -> None:
    bag = line_bag(tmp_path / "a.bag", [1, 2])
    with pytest.raises(InputError, match="0 topics of type NavSatFix"):
        read_positions(bag)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,lat\n0,52\n", "no column longitude; the table has t, lat"),
        ("t,lat,lon\n0,52,4\n1,x,4\n", r"row 2: lat \(latitude\) is 'x', not a number"),
        ("t,lat,lon\n,52,4\n", "has no position with a time and a fix"),
        ("t,lat,lon\n1,52,4\n,52,4\n0,52,4\n", "position 3 is earlier than the position before"),
        ("t,lat,lon\n1,52,4\n0,52,4\n", "position 2 is earlier than the position before"),
        ("t,lat,lon\n1,92,4\n", "position 1 has a latitude beyond 90"),
        ("t,lat,lon\n1,52,184\n", "position 1 has a longitude beyond 180"),
        ("t,lat,lon,sigma_m\n1,52,4,0\n", "position 1 has a sigma_m that is not greater than 0"),
        ("t,lat,lon\n", "has no position with a time and a fix"),
    ],
)
def test_bad_tables_are_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        read_positions(write(tmp_path / "a.csv", text))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "columns", "message"),
    [
        ("b.kml", {}, r"unknown extension '\.kml' of positions"),
        ("a.csv", {}, "no such file"),
        ("b.csv", {"topic": "/fix"}, "unknown column 'topic'"),
        ("b.bag", {"latitude": "x"}, r"unknown column 'latitude' \(known: topic"),
        (
            "b.csv",
            {"latitude": "lta"},
            r"no column lta .*; the table has t, lat, lon",
        ),
    ],
)
def test_other_files_and_options_are_refused(
    tmp_path: Path, name: str, columns: dict[str, str], message: str
) -> None:
    for kind in ("csv", "kml", "bag"):
        write(tmp_path / f"b.{kind}", "t,lat,lon\n0,52,4\n")
    with pytest.raises(InputError, match=message):
        read_positions(tmp_path / name, columns=columns)


def test_times_that_repeat_are_left_out() -> None:
    at = np.array([0.0, 1.0, 1.0, 2.0])
    with pytest.warns(UserWarning, match="left out 1 of 4 positions with the time of the position"):
        found = Positions.make(at, 52 + at, 4 + at)
    assert found.latitude.tolist() == [52, 53, 54]


@pytest.mark.parametrize(
    ("step", "unit"), [(0.1, ""), (30, ""), (1000, "ms"), (10**6, "us"), (0.001, "another unit")]
)
def test_an_implausible_clock_is_warned_of(tmp_path: Path, step: float, unit: str) -> None:
    rows = [f"{k * step},52.{k},4\n" for k in range(4)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_positions(write(tmp_path / "a.csv", f"t,lat,lon\n{''.join(rows)}"))
    cures = [str(w.message).partition("if the times are in ")[2] for w in caught]
    assert cures == ([f"{unit}, convert them to seconds"] if unit else [])
