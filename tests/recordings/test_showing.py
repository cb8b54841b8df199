"""The description of a recording by `egolane show`, and its command."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.showing import show_recording
from egolane_pgm.types import InputError
from tests.kits.drives import done, short_drive
from tests.kits.image_line_files import entry, tusimple
from tests.kits.rosbag_writer import write_lines
from tests.kits.sensor_files import foreign_table, json_mcap, own_bag


@pytest.mark.parametrize("name", ["a.csv", "a.bag", "a.mcap"])
def test_lines_under_our_names_have_a_command_that_runs(tmp_path: Path, name: str) -> None:
    log = short_drive(60).log
    write_lines(tmp_path / name, log)
    shown = done("show", tmp_path / name).stdout
    assert "60 frames, 10 per second, gaps: 0" in shown
    (command,) = (line for line in shown.splitlines() if line.startswith("  egolane run"))
    words = shlex.split(command.replace("--n-lanes N", "--n-lanes 3"))[1:]
    done(*words, "--no-figures", "--out", tmp_path / "out")
    [seen] = ego.load_result(tmp_path / "out").lines.values()
    np.testing.assert_allclose(seen.offset_m, log.offset_m, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("a.csv", foreign_table, ["a.csv: 360 rows", "  lateral_cm               -555"]),
        ("a.bag", own_bag, ["): 100 messages; 10 per second, gaps: 0", "  c0    "]),
        (
            "a.mcap",
            json_mcap,
            [
                "): 100 messages; 10 per second, gaps: 0",
                "  is_solid                 true in 200 of 400",
            ],
        ),
    ],
)
def test_foreign_lines_are_described_with_the_missing_column(
    tmp_path: Path, name: str, make: Callable[[Path], None], message: list[str]
) -> None:
    make(tmp_path / name)
    shown = done("show", tmp_path / name).stdout
    assert all(each in shown for each in message)
    assert "egolane run" not in shown
    assert "  to run it: no column " in shown


def test_lanes_in_pictures_are_a_recording_that_needs_a_camera(tmp_path: Path) -> None:
    file = tusimple(tmp_path / "labels.json", [entry(0)])
    shown = show_recording(file)
    assert shown.startswith(f"{file}: format tusimple\n  to run it: its lines are in pixels: name")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.mp4", "unknown extension '.mp4' of a recording"),
        ("a.xlsx", "save a spreadsheet as CSV"),
        ("folders", "a folder without files"),
        ("pictures", "a folder without a bag"),
    ],
)
def test_another_kind_of_file_is_refused_as_a_recording(
    tmp_path: Path, name: str, message: str
) -> None:
    (tmp_path / "folders" / "deeper").mkdir(parents=True)
    (tmp_path / "pictures").mkdir()
    for file in ("a.mp4", "a.xlsx", "pictures/a.jpg"):
        (tmp_path / file).touch()
    for read in (show_recording, read_lines):
        with pytest.raises(InputError, match=re.escape(message)):
            read(tmp_path / name)
