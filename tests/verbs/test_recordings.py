"""The commands `data`, `convert` and `show --frame`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.recordings import catalog, read_lines
from egolane_pgm.recordings.table import write_table
from tests.kits.box import BOX, box_log
from tests.kits.drives import (
    N_FRAMES,
    command,
    done,
    refused,
    short_drive,
    write_drive,
    write_experiment,
)


def test_the_topic_of_a_bag_is_a_name(tmp_path: Path) -> None:
    write_table(tmp_path / "a.csv", short_drive(30).log)
    done("convert", tmp_path / "a.csv", tmp_path / "a.bag")
    said = refused("convert", tmp_path / "a.bag", tmp_path / "b.csv", "--set", "topic=5")
    assert "topic 5" in said


def test_a_frame_of_an_experiment_is_printed_as_in_the_paper(tmp_path: Path) -> None:
    write_table(tmp_path / "box.parquet", box_log())
    recording = {"path": "box.parquet"}
    experiment = write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None)
    assert done("show", experiment, "--frame", 1234).stdout == BOX + "\n"
    said = refused("show", experiment, "--frame", 1235)
    assert said.endswith("has no frame 1235; the nearest is 1234 (frames 1234 to 1237)")
    assert refused("show", "lane_only", "--frame", 1) == "--frame: goes with an experiment"


def test_conversions_keep_every_line(tmp_path: Path, drive: Path) -> None:
    source = drive.parent / "lines.csv"
    shown = done("convert", source, tmp_path / "a.parquet").stdout
    assert shown == f"{tmp_path / 'a.parquet'}: {N_FRAMES} frames, ids 0 to {N_FRAMES - 1}\n"
    done("convert", tmp_path / "a.parquet", tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_bytes() == source.read_bytes()
    one, other = read_lines(tmp_path / "a.parquet"), short_drive().log
    np.testing.assert_array_equal(one.offset_m, other.offset_m)


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
    assert "cannot be written" in refused("convert", lines, tmp_path / "no" / "a.csv")
    assert "unknown extension '.txt'" in refused("convert", lines, tmp_path / "a.txt")
    assert "cannot be created" in refused("simulate", "--out", lines / "below")
    (tmp_path / "taken" / "experiment.yaml").mkdir(parents=True)
    assert "cannot be written" in refused("simulate", "--out", tmp_path / "taken")


def test_no_file_is_counted_as_good_where_there_is_no_network(tmp_path: Path) -> None:
    result = command("data", "fetch", "--base-url", "http://127.0.0.1:9", "--folder", tmp_path)
    assert result.exit_code == 2
    assert result.stderr.startswith("egolane: 0 of 12 files are there and good\n")
    assert len(result.stderr.splitlines()) == 2
    assert "no connection to 127.0.0.1:9; is the network up?" in result.stderr
