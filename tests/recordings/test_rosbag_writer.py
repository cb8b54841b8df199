"""Bags written from logs: what is read back is what was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.recordings import read_lines, write_lines
from egolane_pgm.recordings.rosbag_writer import write_rosbag
from egolane_pgm.recordings.topics import read_topic
from egolane_pgm.simulation import simulate
from egolane_pgm.types import InputError, LineLog

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


def connection(bag: Path) -> Any:
    with Reader(bag) as reader:
        (found,) = reader.connections
        return found


def test_a_bag_has_the_checksum_that_ros_asks_for_and_the_definition_it_is_of(
    tmp_path: Path,
) -> None:
    write_rosbag(tmp_path / "x.bag", simulate("quickstart", frames=20).log)
    found = connection(tmp_path / "x.bag")
    assert found.digest == "fb0fde59be0f1a54cd7c266cd726d126"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(found.msgdef.data, found.msgtype))
    assert store.generate_msgdef(found.msgtype, ros_version=1)[1] == found.digest


def test_an_unknown_lri_is_refused_naming_the_frame_and_nothing_is_written(tmp_path: Path) -> None:
    log = simulate("quickstart", frames=50).log
    lri = log.lri.copy()
    frame, line = np.argwhere(log.is_valid)[0]
    lri[frame, line] = np.nan
    with pytest.raises(InputError, match=f"frame {log.frame_id[frame]}: line {line + 1}"):
        write_rosbag(tmp_path / "x.bag", replace(log, lri=lri))
    assert not list(tmp_path.iterdir())
