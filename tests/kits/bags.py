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


def definition(body: str = PLAIN_BODY) -> str:
    return f"{body}\n{HEADER}\n{SEPARATOR}\nMSG: pkg/msg_lineInfo\n{PLAIN_LINE}"


def plain_message(way_id: int, lines: list[Line], seq: int = 0) -> bytes:
    raw = struct.pack("<IIII", seq, 0, 0, 3) + b"rig"
    raw += struct.pack("<ddddqI", 0.0, 1.0, -1.0, 2.0, way_id, len(lines))
    return raw + b"".join(struct.pack("<??if", *line) for line in lines)


def write_bag(
    path: Path,
    messages: list[bytes],
    *,
    topic: str = TOPICS[0],
    text: str | None = None,
    msgtype: str = "pkg/msg/msg_lines",
) -> Path:
    """A ROS 1 bag."""
    from rosbags.rosbag1 import Writer

    text = text or definition()
    with Writer(path) as bag:
        known = _store(text, msgtype).generate_msgdef(msgtype)[1]
        connection = bag.add_connection(topic, msgtype, msgdef=text, md5sum=known)
        for k, raw in enumerate(messages):
            bag.write(connection, k, raw)
    return path


def _store(text: str, msgtype: str) -> Any:
    """The message types that a definition has."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, msgtype))
    return store


#: A frame that nobody could complain about.
GOOD: list[Line] = [(True, True, 8, -5.0), (True, False, 9, 1.7)]


def line_bag(path: Path, ids: list[int], lines: list[list[Line]] | None = None) -> Path:
    chosen = lines or [GOOD] * len(ids)
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
    stamps: list[int] | None = None,
    msgtype: str = LINES_TYPE_2,
) -> Path:
    """A ROS 2 bag of lines, of the messages of an MCAP file that `write_rosbag` made; stamps: when
    they were recorded, ns."""
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer

    file = folder.with_name(f"{folder.name}-first.mcap")
    write_rosbag(file, log)
    with Reader(file) as made:
        messages = [(ns, raw) for _, ns, raw in made.messages(made.connections)]
        definition = made.connections[0].msgdef.data
    file.unlink()
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        known = _store(definition, msgtype).hash_rihs01(msgtype)
        connection = bag.add_connection(TOPICS[0], msgtype, msgdef=definition, rihs01=known)
        for k, (ns, raw) in enumerate(messages):
            bag.write(connection, ns if stamps is None else stamps[k], raw)
    return folder


def write_fixes(path: Path, rows: list[tuple[float, float, float]], no_fix: int = -1) -> Path:
    """A bag (.bag: of ROS 1) of sensor_msgs/NavSatFix.

    - rows: seconds, latitude, longitude
    - no_fix: the row whose status is that of no fix, if any
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    serialised = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    types, name = store.types, "sensor_msgs/msg/NavSatFix"
    with rosbag1.Writer(path) if is_ros1 else rosbag2.Writer(path, version=9) as bag:
        connection = bag.add_connection("/gps/fix", name, typestore=store)
        for k, (seconds, latitude, longitude) in enumerate(rows):
            stamp = types["builtin_interfaces/msg/Time"](int(seconds), int(seconds % 1 * 1e9))
            fix = types[name](
                types["std_msgs/msg/Header"](*([k] if is_ros1 else []), stamp, "gps"),
                types["sensor_msgs/msg/NavSatStatus"](-1 if k == no_fix else 0, 1),
                latitude,
                longitude,
                0.0,
                np.array([4.0, 0, 0, 0, 4.0, 0, 0, 0, 9.0]),
                2,
            )
            bag.write(connection, k + 1, bytes(serialised(fix, name)))
    return path
