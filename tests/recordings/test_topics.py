"""Messages of somebody's own, from the bag to the lane, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.recordings.topics import lines_of_messages, messages, topics_of
from egolane_pgm.types import InputError
from tests.kits.drives import done
from tests.kits.sensor_files import N_FRAMES, OFFSETS, START_S, json_mcap, own_bag


@pytest.mark.parametrize(
    ("name", "make"), [("own.bag", own_bag), ("own", own_bag), ("json.mcap", json_mcap)]
)
def test_each_kind_of_file_goes_from_the_file_to_the_lane(
    tmp_path: Path, name: str, make: Callable[[Path], None]
) -> None:
    make(tmp_path / name)
    words = ("--set", "recording.topic=/lanes", "--columns", "offset_m=c0,is_continuous=is_solid")
    words = (*words, "--columns", "left_positive=true", "--no-figures", "--out", tmp_path / "out")
    done("run", tmp_path / name, "--n-lanes", 3, *words)
    result = ego.load_result(tmp_path / "out")
    assert np.mean(result.frames["assigned_lane"].iloc[20:] == 2) > 0.9
    assert result.frame_rate == 10
    [log] = result.lines.values()
    np.testing.assert_allclose(log.offset_m, OFFSETS, atol=1e-6)
    np.testing.assert_array_equal(log.frame_id, np.arange(N_FRAMES))
    # The stamps in the messages, and not half a second later.
    np.testing.assert_allclose(log.time_s, START_S + np.arange(N_FRAMES) / 10, atol=1e-6)
    np.testing.assert_array_equal(log.is_continuous[0], [True, False, False, True])
    assert "/lanes" in topics_of(tmp_path / name)


def test_flat_messages_are_a_line_or_a_frame() -> None:
    wide = [{"time_s": t / 10, "offset_1": -1.8, "offset_2": 1.7} for t in range(3)]
    long = [{"time_s": t / 10, "offset_m": y} for t in range(3) for y in (-1.8, 1.7)]
    for rows in (wide, long):
        log = lines_of_messages(rows, None, "x.mcap")
        np.testing.assert_array_equal(log.frame_id, [0, 1, 2])
        np.testing.assert_array_equal(log.offset_m, [[-1.8, 1.7]] * 3)


def test_a_file_that_cannot_be_read_is_refused_with_advice(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    json_mcap(file)
    with pytest.raises(InputError, match=r"no topic /lane \(did you mean '/lanes'\?\); the file"):
        list(messages(file, "/lane"))
    file.write_bytes(file.read_bytes()[:600])
    with pytest.raises(InputError, match="if it was cut off or damaged, try `mcap recover`"):
        list(messages(file, "/lanes"))


def test_one_of_several_topics_has_to_be_named(tmp_path: Path) -> None:
    own_bag(tmp_path / "a.bag")
    with pytest.raises(InputError, match=r"topic: is missing; the file has /lanes \(my_msgs/msg/L"):
        ego.read_lines(tmp_path / "a.bag")
    with pytest.raises(InputError, match=r"no column offset_m; the table has time_s, header.seq, "):
        ego.read_lines(tmp_path / "a.bag", topic="/lanes")
