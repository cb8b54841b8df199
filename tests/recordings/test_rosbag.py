"""Bags of ROS 1 and ROS 2 and MCAP files: what is read, and what is refused."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import files_of, format_of, read_lines
from egolane_pgm.recordings.topics import messages
from egolane_pgm.simulation import simulate
from egolane_pgm.types import InputError, LineLog
from tests.kits.bags import (
    Line,
    definition,
    plain_message,
    write_bag,
    write_bag2,
)
from tests.kits.rosbag_writer import write_lines
from tests.kits.sensor_files import json_mcap

#: Kinds of records in an MCAP file; readers skip unknown ones.
CHUNK_INDEX = 0x08
UNKNOWN_RECORD = 0x7F

LINES: list[list[Line]] = [
    [(True, False, 7, -1.75), (False, True, -1, 3e32)],
    [],
    [(True, True, 10, 1.5), (False, False, -2147483648, float("nan")), (True, False, 3, 5.25)],
]


def refused(path: Path, **options: object) -> str:
    with pytest.raises(InputError) as info:
        read_lines(path, **options)
    text = str(info.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


GOOD_MESSAGE = plain_message(0, LINES[0])


def of_ids(*ids: int) -> Callable[[Path], object]:
    return lambda path: write_bag(path, [plain_message(k, LINES[0]) for k in ids])


def of_type(body: str) -> Callable[[Path], object]:
    return lambda path: write_bag(path, [b"\0" * 80], text=definition(body))


def of_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def killed(path: Path) -> None:
    """A bag whose recording was killed, before it wrote its index."""
    whole = bytearray(write_bag(path, [GOOD_MESSAGE]).read_bytes())
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    whole[at : at + 8] = bytes(8)
    path.write_bytes(whole)


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (lambda path: None, {}, ": no such file"),
        (of_bytes(b"frame_id,line\n"), {}, "cannot be read as a bag (File magic is invalid)"),
        (killed, {}, "is not indexed, reindex before reading); if it was cut off"),
        (lambda path: write_bag(path, []), {}, "holds no messages on /isis_line"),
        (
            lambda path: write_bag(path, [GOOD_MESSAGE], topic="/my/lines"),
            {"topic": "/x"},
            "no topic /x; the file has /my/lines (pkg/msg/msg_lines)",
        ),
        (
            of_type("int64 way\nuint8[72] rest\n"),
            {},
            "no column offset_m; the table has time_s, way, rest",
        ),
        (lambda path: write_bag(path, [GOOD_MESSAGE, b""]), {}, "cannot be read as a bag ("),
        (of_ids(0), {"topik": "/x"}, "no option 'topik' (did you mean 'topic'?)"),
    ],
)
def test_a_bag_that_cannot_be_read_is_refused(
    tmp_path: Path, make: Callable[[Path], object], options: dict[str, Any], message: str
) -> None:
    make(tmp_path / "a.bag")
    assert message in refused(tmp_path / "a.bag", **options)


# --- ROS 2 ---------------------------------------------------------------------------------------

ARRAYS = ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri")

#: When the drive began, seconds since 1970; between two multiples of 2^-22 as few are.
START_S = 1_515_801_391.25


@pytest.fixture(scope="module")
def log() -> LineLog:
    made = simulate("quickstart", frames=60).log
    return replace(
        made,
        offset_m=made.offset_m.astype(np.float32).astype(np.float64),
        time_s=START_S + made.frame_id / 10,
    )


def assert_same(one: LineLog, other: LineLog) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_ros2_bag_is_read_as_folder_and_as_file(
    log: LineLog, tmp_path: Path, storage: str
) -> None:
    bag = write_bag2(tmp_path / "bag", log, storage=storage)
    assert format_of(bag) == "rosbag"
    assert_same(read_lines(bag), log)
    (file,) = files_of(bag)
    assert file.suffix == {"SQLITE3": ".db3", "MCAP": ".mcap"}[storage]
    assert_same(read_lines(file), log)


def test_ros1_keeps_frame_id_over_frame_rate_and_its_stamps_where_they_are_asked_for(
    log: LineLog, tmp_path: Path
) -> None:
    write_lines(tmp_path / "a.bag", log)
    np.testing.assert_array_equal(read_lines(tmp_path / "a.bag").time_s, log.frame_id / 10)
    stamped = read_lines(tmp_path / "a.bag", columns=Columns(time_s="header.stamp"))
    assert_same(stamped, log)


def test_without_a_stamp_in_the_header_the_time_of_recording_is_used(
    log: LineLog, tmp_path: Path
) -> None:
    stamps = [10**18 + k * 10**8 for k in range(len(log))]
    blank = replace(log, time_s=np.zeros(len(log)))
    found = read_lines(write_bag2(tmp_path / "bag", blank, stamps=stamps))
    np.testing.assert_array_equal(found.time_s, np.array(stamps) / 1e9)


def test_stamps_that_do_not_increase_are_refused_or_left_out(log: LineLog, tmp_path: Path) -> None:
    time_s = log.time_s.copy()
    time_s[7] = time_s[6]
    write_lines(tmp_path / "a.mcap", replace(log, time_s=time_s))
    assert "time_s is not later than in the frame before" in refused(tmp_path / "a.mcap")
    found = read_lines(tmp_path / "a.mcap", columns="time_s=null")
    np.testing.assert_array_equal(found.time_s, log.frame_id / 10)


def test_a_bag_without_the_definition_of_its_type_is_refused(log: LineLog, tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", log, msgtype="my_msgs/msg/Lanes")
    with sqlite3.connect(files_of(bag)[0]) as base:
        base.execute("DELETE FROM message_definitions")
    assert "has no definition of my_msgs/msg/Lanes; convert it to MCAP" in refused(bag)


def test_a_file_without_the_definition_of_its_type_is_refused(log: LineLog, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    write_lines(file, log)
    with file.open("rb") as opened:
        [schema] = make_reader(opened).get_summary().schemas.values()
    with file.open("wb") as opened:
        writer = McapWriter(opened)
        writer.start(profile="ros2")
        blank = writer.register_schema(schema.name, schema.encoding, b"")
        channel = writer.register_channel("/lines", "cdr", blank)
        writer.add_message(channel, 0, b"\0" * 80, 0)
        writer.finish()
    assert refused(file).startswith(f": has no definition of {schema.name}; convert it to MCAP")


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_folder_without_metadata_is_read_in_order(
    log: LineLog, tmp_path: Path, storage: str
) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    for k, frames in enumerate((slice(30, None), slice(0, 30))):
        bag = write_bag2(tmp_path / f"bag{k}", log.take(frames), storage=storage)
        [file] = files_of(bag)
        file.rename(folder / file.name)
    assert_same(read_lines(folder), log)


def test_messages_that_the_index_lacks_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    with file.open("wb") as opened:
        writer = McapWriter(opened, chunk_size=200)
        writer.start()
        schema = writer.register_schema("lines", "jsonschema", b"{}")
        channel = writer.register_channel("/lines", "json", schema)
        for k in range(40):
            message = json.dumps({"time_s": k / 10, "offset_1": -1.8})
            writer.add_message(channel, k * 10**8, message.encode(), k * 10**8)
        writer.finish()
    whole = bytearray(file.read_bytes())
    # The footer has the place of the summary; a record is a kind, a length and its content.
    at = int.from_bytes(whole[-28:-20], "little")
    while whole[at] != CHUNK_INDEX:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    assert len(read_lines(file)) == 40
    whole[at] = UNKNOWN_RECORD
    file.write_bytes(whole)
    with pytest.warns(UserWarning, match=r"a\.mcap: only 3\d of 40 messages on /lines can be read"):
        assert len(read_lines(file)) < 40
    with pytest.warns(UserWarning, match=r"only 3\d of 40 messages"):
        assert len(list(messages(file, "/lines"))) < 40


def test_json_files_of_a_folder_are_given_one_by_one(tmp_path: Path) -> None:
    for name in ("a", "b"):
        json_mcap(tmp_path / f"{name}.mcap")
    assert refused(tmp_path).startswith(f": has 2 MCAP files; give one, {tmp_path / 'a.mcap'}")
    (tmp_path / "b.mcap").unlink()
    assert len(list(messages(tmp_path, "/lanes"))) == 100
    (tmp_path / "a.mcap").unlink()
    assert refused(tmp_path, format="rosbag") == ": the folder is empty"


def test_messages_are_numbered_by_their_times_where_they_have_no_frame_id(
    log: LineLog, tmp_path: Path
) -> None:
    bag = write_bag2(tmp_path / "bag", replace(log, frame_id=np.arange(60) - 30))
    found = read_lines(bag, columns={"frame_id": None}).frame_id
    np.testing.assert_array_equal(found, np.arange(60))
    message = refused(bag, columns=Columns(frame_id="header.seq"))
    assert "columns: frame_id: there is no column 'header.seq' (did you mean 'header" in message


def test_a_time_stamp_of_foxglove_is_the_time(tmp_path: Path) -> None:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("builtin_interfaces/Time timestamp\nfloat64 y\n", "a/msg/A"))
    time, message = store.types["builtin_interfaces/msg/Time"], store.types["a/msg/A"]
    with Writer(tmp_path / "bag", version=9) as bag:
        connection = bag.add_connection("/a", "a/msg/A", typestore=store)
        for k in range(3):
            raw = store.serialize_cdr(message(time(7 + k, 500_000_000), -1.8), "a/msg/A")
            bag.write(connection, k, raw)
    found = read_lines(tmp_path / "bag", columns="offset_m=y")
    np.testing.assert_array_equal(found.time_s, [7.5, 8.5, 9.5])
