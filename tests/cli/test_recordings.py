"""The commands `data`, `convert` and `lines`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import LineLog
from tests.kits.drives import done, refused, short_drive, write_experiment


def test_the_topic_of_a_bag_is_a_name(tmp_path: Path) -> None:
    write_table(tmp_path / "a.csv", short_drive(30).log)
    done("convert", tmp_path / "a.csv", tmp_path / "a.bag")
    said = refused("convert", tmp_path / "a.bag", tmp_path / "b.csv", "--set", "topic=5")
    assert said == f"{tmp_path / 'a.bag'}: topic: 5 is not the name of a topic"


#: The paper's Box 1.
BOX = """\
Line1: isValid = 1; continuous=1; LRI: 10; offset: -9.15m
Line2: isValid = 0; continuous=0; LRI: 09; offset: -6.47m
Line3: isValid = 1; continuous=0; LRI: 07; offset: -2.15m
Line4: isValid = 0; continuous=1; LRI: 00; offset: +0.99m"""


def box_log() -> LineLog:
    """Frame 1234 is the paper's; 1236 has no line, 1237 has two of which little is known."""
    nan = np.nan
    offset = np.array([[-9.15, -6.47, -2.15, 0.99, nan], [nan] * 5, [nan, 1.5, nan, nan, nan]])
    valid = np.array([[1, 0, 1, 0, 0], [0] * 5, [0, 1, 0, 0, 0]], dtype=bool)
    continuous = np.array([[1, 0, 0, 1, 0], [0] * 5, [0] * 5], dtype=bool)
    lri = np.array([[10, 9, 7, 0, nan], [nan] * 5, [3, nan, nan, nan, nan]])
    frame_id = np.array([1234, 1236, 1237])
    return LineLog(frame_id, frame_id / 10, offset, valid, continuous, lri, source="box.csv")


def test_the_command_prints_it_from_a_recording_and_from_an_experiment(tmp_path: Path) -> None:
    write_table(tmp_path / "box.parquet", box_log())
    assert done("lines", tmp_path / "box.parquet", "--frame", 1234).stdout == BOX + "\n"
    recording = {"path": "box.parquet"}
    experiment = write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None)
    assert done("lines", experiment, "--frame", 1234).stdout == BOX + "\n"
    said = refused("lines", tmp_path / "box.parquet", "--frame", 1235)
    assert said.endswith("has no frame 1235; the nearest is 1234 (frames 1234 to 1237)")
    said = refused("lines", tmp_path / "box.parquet", "--frame", 1234, "--set", "n_lanes=3")
    assert said == "--set: goes with an experiment"
    assert "no such file" in refused("lines", tmp_path / "none.csv", "--frame", 1)
