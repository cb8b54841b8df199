"""Bags written from logs: what is read back is what was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.topics import read_topic
from egolane_pgm.simulation import simulate
from egolane_pgm.types import LineLog
from tests.kits.rosbag_writer import write_lines, write_rosbag

ARRAYS = ("frame_id", "offset_m", "is_valid", "is_continuous", "lri")


def single_precision(log: LineLog) -> LineLog:
    return replace(log, offset_m=log.offset_m.astype(np.float32).astype(np.float64))


def test_a_simulated_log_comes_back_from_a_bag_as_it_was(tmp_path: Path) -> None:
    log = single_precision(simulate("quickstart", frames=200).log)
    write_rosbag(tmp_path / "x.bag", log)
    back = read_topic(tmp_path / "x.bag")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(back, name), getattr(log, name), err_msg=name)


def test_a_published_bag_survives_the_way_to_a_table_and_back(
    recordings: Path, tmp_path: Path
) -> None:
    name = "special.issue.spain.mono.yesClothoid.noLines.left._2018-01-14-11-59-09.bag"
    log = read_lines(recordings / "rle" / name)
    write_lines(tmp_path / "x.parquet", log)
    write_lines(tmp_path / "x.bag", read_lines(tmp_path / "x.parquet"))
    back = read_lines(tmp_path / "x.bag")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(back, name), getattr(log, name), err_msg=name)
