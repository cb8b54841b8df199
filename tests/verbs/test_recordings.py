"""The commands `data` and `show --frame`."""

from __future__ import annotations

from pathlib import Path

import pytest

from egolane_pgm.recordings import catalog
from egolane_pgm.recordings.table import write_table
from tests.kits.box import BOX, box_log
from tests.kits.drives import (
    command,
    done,
    refused,
    write_drive,
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


def test_data_verify_looks_where_a_run_would_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("EGOLANE_DATA", str(tmp_path / "data"))
    name = catalog.list_files()[0].target
    for folder in (tmp_path / "data", catalog.download_folder()):
        (folder / "rle").mkdir(parents=True)
        (folder / name).write_text("something else")
    assert f"{tmp_path / 'data' / name}: wrong checksum" in command("data", "verify").stderr
    # A file that is not in the first folder is looked for in the second.
    (tmp_path / "data" / name).unlink()
    said = command("data", "verify").stderr
    assert f"{catalog.download_folder() / name}: wrong checksum" in said
    assert said.count("no such file") == 11
    said = command("data", "verify", "--folder", tmp_path / "data").stderr
    assert said.count("no such file") == 12


def test_other_commands_name_what_they_cannot_write(tmp_path: Path) -> None:
    write_drive(tmp_path, 20)
    lines = tmp_path / "lines.csv"
    assert "cannot be created" in refused("simulate", "--out", lines / "below")
    (tmp_path / "taken" / "experiment.yaml").mkdir(parents=True)
    assert "cannot be written" in refused("simulate", "--out", tmp_path / "taken")


def test_no_file_is_counted_as_good_where_there_is_no_network(tmp_path: Path) -> None:
    result = command("data", "fetch", "--base-url", "http://127.0.0.1:9", "--folder", tmp_path)
    assert result.exit_code == 2
    assert result.stderr.endswith("egolane: 0 of 12 files are there and good\n")
    assert len(result.stderr.splitlines()) == 2
    assert "no connection to 127.0.0.1:9; is the network up?" in result.stderr
