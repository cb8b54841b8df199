"""What `egolane show` says of a recording, and that its command runs."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from tests.kits.drives import done, refused, short_drive
from tests.kits.rosbag_writer import write_lines
from tests.kits.sensor_files import N_FRAMES, OFFSETS, foreign_table, json_mcap, own_bag, per_line


def command_of(path: Path) -> list[str]:
    """The words of the command that is printed."""
    (command,) = (
        line for line in done("show", path).stdout.splitlines() if line.startswith("  egolane run")
    )
    return shlex.split(command.replace("--n-lanes N", "--n-lanes 3"))[1:]


@pytest.mark.parametrize(
    ("name", "make", "which"),
    [
        ("foreign.csv", foreign_table, slice(4)),
        ("own.parquet", lambda path: per_line(
            frame_id=lambda t, k, y: t, offset_m=lambda t, k, y: y).to_parquet(path), slice(4)),
    ],
)  # fmt: skip
def test_the_command_of_a_table_runs_and_has_its_lines(
    tmp_path: Path, name: str, make: Callable[[Path], Any], which: slice
) -> None:
    make(tmp_path / name)
    done(*command_of(tmp_path / name), "--no-figures", "--out", tmp_path / "out")
    [log] = ego.load_result(tmp_path / "out").lines.values()
    np.testing.assert_allclose(log.offset_m, OFFSETS[log.frame_id][:, which], atol=1e-9)


def test_every_guess_is_marked_and_rate_gaps_and_spans_are_said(tmp_path: Path) -> None:
    foreign_table(tmp_path / "a.csv")
    shown = done("show", tmp_path / "a.csv").stdout
    assert re.search(r"  lateral_cm +-55\d[.\d]* to 55\d", shown)
    assert "90 frames, 10.0 per second, gaps: 1; lines from -5.55 to 5.55 m" in shown
    guesses = [line for line in shown.splitlines() if line.startswith("  guess: ")]
    assert len(guesses) == 6
    assert "  guess: positive offsets are to the left: then lines go from left to right" in guesses


@pytest.mark.parametrize(
    ("columns", "why"),
    [
        (
            {"dist_l": OFFSETS[:, 2], "dist_r": OFFSETS[:, 2]},
            "no name is plainly that of an offset",
        ),
        ({"offset": OFFSETS[:, 2]}, "the unit of offset_m is not plain"),
        (
            {"offset_1": OFFSETS[:, 2], "offset_2": OFFSETS[:, 3]},
            "not those of lines on both sides",
        ),
        ({"x": OFFSETS[:, 2], "y": OFFSETS[:, 1]}, "no name is plainly that of an offset"),
        ({"lateral": OFFSETS[:, 2], "offset": OFFSETS[:, 2]}, "offset_m may be lateral or offset"),
    ],
)
def test_what_is_not_plain_has_no_command(
    tmp_path: Path, columns: dict[str, Any], why: str
) -> None:
    table = pd.DataFrame({"frame_id": np.arange(N_FRAMES), **columns})
    table.to_csv(tmp_path / "a.csv", index=False)
    shown = done("show", tmp_path / "a.csv").stdout
    assert "egolane run" not in shown
    assert "  no command, since what is a line here is not plain: " in shown
    assert why in shown


def test_topics_are_listed_and_that_of_the_lines_has_a_command(tmp_path: Path) -> None:
    log = short_drive(60).log
    for name in ("a.bag", "a.mcap"):
        write_lines(tmp_path / name, log)
        done(*command_of(tmp_path / name), "--no-figures", "--out", tmp_path / "out")
        [seen] = ego.load_result(tmp_path / "out").lines.values()
        np.testing.assert_allclose(seen.offset_m, log.offset_m, atol=1e-5)


@pytest.mark.parametrize(("name", "make"), [("a.bag", own_bag), ("a.mcap", json_mcap)])
def test_messages_of_ones_own_are_described_and_not_guessed(
    tmp_path: Path, name: str, make: Callable[[Path], None]
) -> None:
    make(tmp_path / name)
    shown = done("show", tmp_path / name).stdout
    assert "): 100 messages; 10 per second, gaps: 0" in shown
    assert "  c0                       -5.55 to 5.55" in shown
    assert "egolane run" not in shown


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    assert "a.csv: no such file" in refused("show", tmp_path / "a.csv")
