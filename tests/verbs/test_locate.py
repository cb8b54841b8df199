"""`egolane locate`: from a map and positions to a road table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("osmium")

from egolane_pgm.maps import road_table
from tests.kits.drives import done, refused
from tests.kits.osm_files import EAST_M, LATITUDE, LONGITUDE, write_osm


def write_map(path: Path, middle: dict[str, int]) -> Path:
    """A motorway to the east: 2 km of two lanes, 1 km with the tags of `middle`, 3 km of two."""
    nodes = {0: (0.0, 0.0), 1: (2000.0, 0.0), 2: (3000.0, 0.0), 3: (6000.0, 0.0)}
    tags = ({"lanes": 2}, middle, {"lanes": 2})
    ways = [(100 + k, [k, k + 1], {"highway": "motorway"} | tags[k]) for k in range(3)]
    return write_osm(path, nodes, ways)


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str, str]:
    """A map, positions with columns of their own names, and the path of the table."""
    write_map(tmp_path / "roads.osm", {"lanes": 3})
    east = LONGITUDE + np.arange(10.0, 5990, 30) / EAST_M
    rows = [f"{t},{LATITUDE},{longitude:.8f}" for t, longitude in enumerate(east)]
    (tmp_path / "drive.csv").write_text("when,lat_gps,lon\n" + "\n".join(rows) + "\n")
    return tuple(str(tmp_path / name) for name in ("roads.osm", "drive.csv", "road.parquet"))


NAMED = ("--columns", "t_s=when,latitude=lat_gps")


@pytest.mark.parametrize("more", [(), ("--online",)])
def test_a_road_table_is_written(files: tuple[str, str, str], more: tuple[str, ...]) -> None:
    a_map, drive, out = files
    output = done("locate", a_map, drive, "-o", out, *NAMED, "--shift", "100", *more).output
    assert "200 rows, 100 to 299 s, 100.0% on the map" in output
    assert "lanes: 2, 3" in output
    table = road_table.load(out)
    assert set(table.n_lanes) == {2, 3}


def test_an_assumed_number_of_lanes_is_reported(files: tuple[str, str, str]) -> None:
    write_map(Path(files[0]), {})
    assert "lanes: 2 (assumed in " in done("locate", *files[:2], "-o", files[2], *NAMED).output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({2: "road.csv"}, "a road table is a .parquet file"),
        ({0: "drive.csv"}, "cannot be read as a map"),
        ({1: "roads.osm"}, "unknown extension '.osm' of positions"),
        ({1: "nowhere.csv"}, "no such file"),
    ],
)
def test_bad_files_are_refused_in_one_line(
    files: tuple[str, str, str], change: dict[int, str], message: str
) -> None:
    folder = Path(files[0]).parent
    words = [str(folder / change[k]) if k in change else file for k, file in enumerate(files)]
    named = NAMED if 1 not in change else ()
    assert message in refused("locate", words[0], words[1], "-o", words[2], *named)
