"""ROS 1 bags of line messages, written without ROS, of the published type: ROS can read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.files import atomic
from egolane_pgm.recordings.rosbag import TOPIC
from egolane_pgm.types import BoolArray, InputError, LineLog

MESSAGE_TYPE = "road_layout_estimation/msg/msg_lines"
_LINE_TYPE = "road_layout_estimation/msg/msg_lineInfo"

#: The published definitions. ROS tells types apart by a checksum of these.
_DEFINITIONS = {
    MESSAGE_TYPE: """\
Header header
float64 number_of_lines
float64 goodLines
float64 width
float64 naive_width
int64 way_id
msg_lineInfo[] lines
""",
    _LINE_TYPE: """\
bool isValid
bool continuous
int32 counter
float32 offset
""",
}


def write_rosbag(path: str | Path, log: LineLog, *, topic: str = TOPIC) -> None:
    """Write a log as a bag of the published message type, stamped with the log's times.

    Offsets are stored in single precision, as the type has them. Frames put in by
    `missing_frames: predict` are left out.

    Raises InputError for what the type cannot hold, naming the frame: a line whose LRI is unknown
    or no whole number; and for a file that cannot be written.
    """
    path = Path(path)
    listed = ~(np.isnan(log.offset_m) & np.isnan(log.lri))
    bad = listed & ~(np.isfinite(log.lri) & (np.abs(log.lri) < 2**31) & (log.lri % 1 == 0))
    if bad.any():
        frame, line = np.argwhere(bad)[0]
        raise InputError(
            f"{path}: frame {int(log.frame_id[frame])}: line {int(line) + 1} has the LRI"
            f" {log.lri[frame, line]}, a bag holds whole numbers; write a .csv or .parquet"
        )
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in _DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    with atomic(path) as temporary, Writer(temporary) as bag:
        connection = bag.add_connection(topic, MESSAGE_TYPE, typestore=store)
        for t in np.flatnonzero(~log.is_missing):
            # The stamp of a message in a bag must be greater than zero.
            stamp = max(1, round(float(log.time_s[t]) * 1e9))
            message = _message(store.types, log, int(t), listed[t])
            bag.write(connection, stamp, bytes(store.serialize_ros1(message, MESSAGE_TYPE)))


def _message(types: Any, log: LineLog, t: int, listed: BoolArray) -> Any:
    seconds = max(0.0, float(log.time_s[t]))
    time = types["builtin_interfaces/msg/Time"](int(seconds) % 2**31, int(seconds % 1 * 1e9))
    lines = [
        types[_LINE_TYPE](
            bool(log.is_valid[t, k]),
            bool(log.is_continuous[t, k]),
            int(log.lri[t, k]),
            float(np.float32(log.offset_m[t, k])),
        )
        for k in np.flatnonzero(listed)
    ]
    return types[MESSAGE_TYPE](
        header=types["std_msgs/msg/Header"](seq=t, stamp=time, frame_id=""),
        number_of_lines=float(len(lines)),
        goodLines=float(log.is_valid[t].sum()),
        width=0.0,
        naive_width=0.0,
        way_id=int(log.frame_id[t]),
        lines=lines,
    )
