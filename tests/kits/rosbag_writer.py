"""Bags of line messages, written without ROS, of the published type: ROS can read them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.recordings.table import write_table
from egolane_pgm.recordings.topics import TOPICS
from egolane_pgm.tools.files import atomic
from egolane_pgm.types import BoolArray, LineLog

#: The published definitions. ROS tells types apart by a checksum of these.
LINES_TYPE, LINE_TYPE = (
    "road_layout_estimation/msg/msg_lines",
    "road_layout_estimation/msg/msg_lineInfo",
)
DEFINITIONS = {
    LINES_TYPE: """\
Header header
float64 number_of_lines
float64 goodLines
float64 width
float64 naive_width
int64 way_id
msg_lineInfo[] lines
""",
    LINE_TYPE: """\
bool isValid
bool continuous
int32 counter
float32 offset
""",
}

#: The same, with names that ROS 2 allows.
LINES_TYPE_2 = "road_layout_estimation/msg/MsgLines"
LINE_TYPE_2 = "road_layout_estimation/msg/MsgLineInfo"
DEFINITIONS_2 = {
    LINES_TYPE_2: DEFINITIONS[LINES_TYPE]
    .replace("Header", "std_msgs/Header")
    .replace("goodLines", "good_lines")
    .replace("msg_lineInfo", "MsgLineInfo"),
    LINE_TYPE_2: DEFINITIONS[LINE_TYPE].replace("isValid", "is_valid"),
}


def write_lines(path: str | Path, log: LineLog) -> None:
    """Write a log as a table or a bag, by the ending of the file."""
    is_bag = Path(path).suffix in (".bag", ".mcap")
    (write_rosbag if is_bag else write_table)(path, log)


def write_rosbag(path: str | Path, log: LineLog, topics: Sequence[str] = TOPICS[:1]) -> None:
    """Write a log as a ROS 1 bag of the published message type, or (.mcap) as an MCAP file of the
    same type in ROS 2, stamped with the log's times, once for each topic.

    Offsets are stored in single precision, the LRI as a whole number. Frames put in by
    `missing_frames: predict` are left out.
    """
    path = Path(path)
    listed = ~(np.isnan(log.offset_m) & np.isnan(log.lri))
    is_ros2 = path.suffix.lower() == ".mcap"
    store = get_typestore(Stores.ROS2_HUMBLE if is_ros2 else Stores.ROS1_NOETIC)
    for name, definition in (DEFINITIONS_2 if is_ros2 else DEFINITIONS).items():
        store.register(get_types_from_msg(definition, name))
    lines_type, serialised = LINES_TYPE, store.serialize_ros1
    if is_ros2:
        lines_type, serialised = LINES_TYPE_2, store.serialize_cdr
    with atomic(path) as temporary, (_mcap if is_ros2 else Writer)(temporary) as bag:
        connections = [bag.add_connection(name, lines_type, typestore=store) for name in topics]
        for t in np.flatnonzero(~log.is_missing):
            # Nanoseconds since 1970 have more digits than a float.
            seconds = np.floor(max(0.0, log.time_s[t]))
            stamp_ns = int(seconds) * 10**9 + round(max(0.0, log.time_s[t] - seconds) * 1e9)
            message = _message(store.types, log, int(t), listed[t], stamp_ns, is_ros2)
            # The stamp of a message in a bag must be greater than zero.
            for connection in connections:
                bag.write(connection, max(1, stamp_ns), bytes(serialised(message, lines_type)))


@contextlib.contextmanager
def _mcap(file: Path) -> Iterator[Any]:
    """A writer of an MCAP file alone, which rosbags writes into the folder of a bag."""
    # Databases and YAML are loaded only where there is such a bag.
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    bag = file.with_name("bag")
    with Writer2(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        yield writer
    (bag / "bag.mcap").replace(file)


def _message(
    types: Any, log: LineLog, t: int, listed: BoolArray, stamp_ns: int, is_ros2: bool
) -> Any:
    seconds, ns = divmod(stamp_ns, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](seconds % 2**31, ns)
    header = types["std_msgs/msg/Header"](*([] if is_ros2 else [t]), stamp, "")
    lines = [
        types[LINE_TYPE_2 if is_ros2 else LINE_TYPE](
            bool(log.is_valid[t, k]),
            bool(log.is_continuous[t, k]),
            int(log.lri[t, k]),
            float(np.float32(log.offset_m[t, k])),
        )
        for k in np.flatnonzero(listed)
    ]
    n_valid, unknown = float(log.is_valid[t].sum()), 0.0
    return types[LINES_TYPE_2 if is_ros2 else LINES_TYPE](
        header, float(len(lines)), n_valid, unknown, unknown, int(log.frame_id[t]), lines
    )
