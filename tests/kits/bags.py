"""Small ROS 1 bags for the tests, of the published message type."""

from __future__ import annotations

import struct
from pathlib import Path

from egolane_pgm.recordings.rosbag import TOPIC

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
    topic: str = TOPIC,
    text: str | None = None,
    msgtype: str = "pkg/msg/msg_lines",
    stamps: list[int] | None = None,
    chunk_bytes: int | None = None,
) -> Path:
    from rosbags.rosbag1 import Writer

    with Writer(path) as bag:
        if chunk_bytes is not None:
            bag.chunk_threshold = chunk_bytes
        connection = bag.add_connection(
            topic, msgtype, msgdef=text or definition(), md5sum="0" * 32
        )
        for k, raw in enumerate(messages):
            bag.write(connection, stamps[k] if stamps else k, raw)
    return path


#: Six frames that nobody could complain about.
GOOD: list[list[Line]] = [[(True, True, 8, -5.0), (True, False, 9, 1.7)] for _ in range(6)]


def line_bag(path: Path, ids: list[int], lines: list[list[Line]] | None = None) -> Path:
    chosen = lines or [GOOD[0]] * len(ids)
    raw = [plain_message(i, ls, seq=k) for k, (i, ls) in enumerate(zip(ids, chosen, strict=True))]
    return write_bag(path, raw)


def truth_file(path: Path, rows: list[tuple[int, int, int]]) -> Path:
    path.write_text("".join(f"{f};{lane};{c}\n" for f, lane, c in rows))
    return path
