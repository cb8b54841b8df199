"""`egolane locate`: from a map and positions to a road table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.command import egolane
from egolane_pgm.maps import lane_graph, road_table
from tests.kits.lane_maps import PLANE, interchange


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str, str]:
    """A map, positions with columns of their own names, and where the table goes."""
    lane_graph.save(interchange(), tmp_path / "lanes.parquet")
    x = np.arange(10.0, 5990, 30)
    places = PLANE.degrees(np.stack([x, np.zeros(len(x))], axis=1))
    rows = [f"{t},{north:.8f},{east:.8f}" for t, (north, east) in enumerate(places)]
    (tmp_path / "drive.csv").write_text("when,lat_gps,lon\n" + "\n".join(rows) + "\n")
    return tuple(str(tmp_path / name) for name in ("lanes.parquet", "drive.csv", "road.parquet"))


def run(*words: str) -> Result:
    return CliRunner().invoke(egolane, ["locate", *words])


NAMED = ("--column", "t_s=when", "--column", "latitude=lat_gps")


@pytest.mark.parametrize("more", [(), ("--online",), ("--method", "lock-on-road")])
def test_a_road_table_is_written(files: tuple[str, str, str], more: tuple[str, ...]) -> None:
    a_map, drive, out = files
    done = run(a_map, drive, "-o", out, *NAMED, "--shift", "100", *more)
    assert done.exit_code == 0, done.output
    assert "200 rows, 100 to 299 s, 100.0% on the map" in done.output
    assert "lanes: 2, 3" in done.output
    table = road_table.load(out)
    assert set(table.n_lanes) == {2, 3}


def test_a_number_of_lanes_that_the_map_does_not_tell_is_said(files: tuple[str, str, str]) -> None:
    graph = interchange()
    untold = replace(graph, n_lanes=graph.n_lanes * (graph.way != 101))
    lane_graph.save(untold, files[0])
    assert "lanes: 2 (a guess in " in run(*files[:2], "-o", files[2], *NAMED).output


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({2: "road.csv"}, "a road table is a .parquet file"),
        ({2: "lanes.parquet"}, "is read here; name another file"),
        ({0: "drive.csv"}, "cannot be read as a map"),
        ({1: "lanes.parquet"}, "no column t_s"),
        ({1: "nowhere.csv"}, "no such file"),
    ],
)
def test_bad_files_are_refused_in_one_line(
    files: tuple[str, str, str], change: dict[int, str], said: str
) -> None:
    folder = Path(files[0]).parent
    words = [str(folder / change[k]) if k in change else file for k, file in enumerate(files)]
    done = run(words[0], words[1], "-o", words[2], *(NAMED if 1 not in change else ()))
    assert done.exit_code == 2
    assert said in done.output
    assert done.output.count("\n") == 1
