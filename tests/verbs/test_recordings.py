"""The commands `data` and `show --frame`."""

from __future__ import annotations

from pathlib import Path

import pytest

from egolane_pgm.recordings import catalog
from egolane_pgm.recordings.table import write_table
from tests.kits.box import BOX, box_log
from tests.kits.drives import (
    done,
    refused,
    write_experiment,
)


def test_a_frame_of_an_experiment_is_printed_as_in_the_paper(tmp_path: Path) -> None:
    write_table(tmp_path / "box.parquet", box_log())
    recording = {"path": "box.parquet"}
    experiment = write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None)
    assert done("show", experiment, "--frame", 1234).stdout == BOX + "\n"
    said = refused("show", experiment, "--frame", 1235)
    assert said.endswith("has no frame 1235; the nearest is 1234 (frames 1234 to 1237)")
    assert refused("show", "lane_only", "--frame", 1) == "--frame: goes with an experiment"


def test_data_list_shows_the_files_where_a_run_would_find_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("EGOLANE_DATA", str(tmp_path / "data"))
    (tmp_path / "data" / "rle").mkdir(parents=True)
    (tmp_path / "data" / "rle" / "ISIS_01.txt").write_text("1;1;0\n")
    lines = done("data", "list").stdout.splitlines()
    assert lines[0] == f"looked in: {tmp_path / 'data'}"
    assert lines[1] == f"looked in: {catalog.download_folder()}"
    assert len(lines) == 2 + 12
    state = {line.rpartition("/")[2]: line.split()[0] for line in lines[2:]}
    assert state.pop("ISIS_01.txt") == "bad"
    assert set(state.values()) == {"missing"}
