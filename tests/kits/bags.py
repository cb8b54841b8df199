"""Small bags for the tests, of the published message type."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.recordings.topics import TOPICS
from egolane_pgm.types import LineLog
from tests.kits.rosbag_writer import LINES_TYPE_2, write_rosbag

SEPARATOR = "=" * 80
HEADER = f"{SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
PLAIN_BODY = (
    "Header header\nfloat64 number_of_lines\nfloat64 goodLines\nfloat64 width\n"
    "float64 naive_width # full road width\n#int32 oneway\nint64 way_id\nmsg_lineInfo[] lines\n"
)
PLAIN_LINE = "bool isValid\nbool continuous\nint32 counter\nfloat32 offset\n"

#: One line of a message: valid, continuous, counter, offset.
Line = tuple[bool, bool, int, float]


def definition(body: str = PLAIN_BODY, line: str = PLAIN_LINE, package: str = "pkg") -> str:
    return f"{body}\n{HEADER}\n{SEPARATOR}\nMSG: {package}/msg_lineInfo\n{line}"


def plain_message(way_id: int, lines: list[Line], seq: int = 0, frame: bytes = b"rig") -> bytes:
    raw = struct.pack("<IIII", seq, 0, 0, len(frame)) + frame
    raw += struct.pack("<ddddqI", 0.0, 1.0, -1.0, 2.0, way_id, len(lines))
    return raw + b"".join(struct.pack("<??if", *line) for line in lines)


def write_bag(
    path: Path,
    messages: list[bytes],
    *,
    topic: str = TOPICS[0],
    text: str | None = None,
    msgtype: str = "pkg/msg/msg_lines",
    stamps: list[int] | None = None,
    chunk_bytes: int | None = None,
    compression: str | None = None,
    md5sum: str | None = None,
) -> Path:
    """A ROS 1 bag. md5sum: of the definition, by default as ROS has it."""
    from rosbags.rosbag1 import Writer

    text = text or definition()
    writer = Writer(path)
    if compression is not None:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer as bag:
        if chunk_bytes is not None:
            bag.chunk_threshold = chunk_bytes
        known = md5sum or _store(text, msgtype).generate_msgdef(msgtype)[1]
        connection = bag.add_connection(topic, msgtype, msgdef=text, md5sum=known)
        for k, raw in enumerate(messages):
            bag.write(connection, stamps[k] if stamps else k, raw)
    return path


def _store(text: str, msgtype: str) -> Any:
    """The message types that a definition has, in .msg or in IDL."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    if text.startswith(f"{SEPARATOR}\nIDL: "):
        parts = [part.partition("\n")[2] for part in text.split(f"{SEPARATOR}\n")[1:]]
        store.register({k: v for part in parts for k, v in get_types_from_idl(part).items()})
    else:
        store.register(get_types_from_msg(text, msgtype))
    return store


#: Six frames that nobody could complain about.
GOOD: list[list[Line]] = [[(True, True, 8, -5.0), (True, False, 9, 1.7)] for _ in range(6)]


def line_bag(path: Path, ids: list[int], lines: list[list[Line]] | None = None) -> Path:
    chosen = lines or [GOOD[0]] * len(ids)
    raw = [plain_message(i, ls, seq=k) for k, (i, ls) in enumerate(zip(ids, chosen, strict=True))]
    return write_bag(path, raw)


def truth_file(path: Path, rows: list[tuple[int, int, int]]) -> Path:
    path.write_text("".join(f"{f};{lane};{c}\n" for f, lane, c in rows))
    return path


def write_bag2(
    folder: Path,
    log: LineLog,
    *,
    storage: str = "SQLITE3",
    topic: str = TOPICS[0],
    stamps: list[int] | None = None,
    text: str | None = None,
    msgtype: str = LINES_TYPE_2,
) -> Path:
    """A ROS 2 bag of lines, of the messages of an MCAP file that `write_rosbag` made; stamps: when
    they were recorded, ns; text: another definition, which the messages need not fit."""
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer

    file = folder.with_name(f"{folder.name}-first.mcap")
    write_rosbag(file, log)
    with Reader(file) as made:
        messages = [(ns, raw) for _, ns, raw in made.messages(made.connections)]
        definition = made.connections[0].msgdef.data if text is None else text
    file.unlink()
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        known = _store(definition, msgtype).hash_rihs01(msgtype)
        connection = bag.add_connection(topic, msgtype, msgdef=definition, rihs01=known)
        for k, (ns, raw) in enumerate(messages):
            bag.write(connection, ns if stamps is None else stamps[k], raw)
    return folder


def write_fixes2(folder: Path, rows: list[tuple[float, float, float]], status: int = 0) -> Path:
    """A ROS 2 bag of sensor_msgs/NavSatFix. rows: seconds, latitude, longitude."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, name = store.types, "sensor_msgs/msg/NavSatFix"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/gps/fix", name, typestore=store)
        for seconds, latitude, longitude in rows:
            stamp = types["builtin_interfaces/msg/Time"](int(seconds), int(seconds % 1 * 1e9))
            fix = types[name](
                types["std_msgs/msg/Header"](stamp, "gps"),
                types["sensor_msgs/msg/NavSatStatus"](status, 1),
                latitude,
                longitude,
                0.0,
                np.array([4.0, 0, 0, 0, 4.0, 0, 0, 0, 9.0]),
                2,
            )
            bag.write(connection, 1, store.serialize_cdr(fix, name))
    return folder
