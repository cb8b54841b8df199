"""ROS 1 bags of line messages, written without ROS: the way back from a table."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from egolane_pgm.files import atomic
from egolane_pgm.recordings.rosbag import TOPIC
from egolane_pgm.types import InputError, LineLog

MESSAGE_TYPE = "road_layout_estimation/msg/msg_lines"

_RULE = "=" * 80
_DEFINITION = f"""\
Header header
float64 number_of_lines
float64 goodLines
float64 width
float64 naive_width
int64 way_id
msg_lineInfo[] lines

{_RULE}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id

{_RULE}
MSG: road_layout_estimation/msg_lineInfo
bool isValid
bool continuous
int32 counter
float32 offset
"""


def write_rosbag(path: str | Path, log: LineLog, *, topic: str = TOPIC) -> None:
    """Write a log as a bag of the published message type, stamped with the log's times.

    Offsets are stored in single precision, as the type has them. Frames put in by
    `missing_frames: predict` are left out.

    Raises InputError for what the type cannot hold, naming the frame: a line whose LRI is unknown
    or no whole number; and for a file that cannot be written.
    """
    from rosbags.rosbag1 import Writer

    path = Path(path)
    listed = ~(np.isnan(log.offset_m) & np.isnan(log.lri))
    bad = listed & ~(np.isfinite(log.lri) & (np.abs(log.lri) < 2**31) & (log.lri % 1 == 0))
    if bad.any():
        frame, line = np.argwhere(bad)[0]
        raise InputError(
            f"{path}: frame {int(log.frame_id[frame])}: line {int(line) + 1} has the LRI"
            f" {log.lri[frame, line]}, a bag holds whole numbers; write a .csv or .parquet"
        )
    with atomic(path) as temporary, Writer(temporary) as bag:
        connection = bag.add_connection(topic, MESSAGE_TYPE, msgdef=_DEFINITION, md5sum="0" * 32)
        for t in np.flatnonzero(~log.is_missing):
            # A bag's own stamps may not be zero or negative.
            stamp = max(1, round(float(log.time_s[t]) * 1e9))
            bag.write(connection, stamp, _message(log, int(t), listed[t]))


def _message(log: LineLog, t: int, listed: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> bytes:
    seconds = max(0.0, float(log.time_s[t]))
    stamp = (int(seconds) % 2**32, int(seconds % 1 * 1e9))
    lines = np.flatnonzero(listed)
    raw = struct.pack("<IIII", t % 2**32, *stamp, 0)
    good = float(log.is_valid[t].sum())
    raw += struct.pack("<ddddqI", len(lines), good, 0.0, 0.0, int(log.frame_id[t]), len(lines))
    for k in lines:
        raw += struct.pack(
            "<??i", bool(log.is_valid[t, k]), bool(log.is_continuous[t, k]), int(log.lri[t, k])
        )
        raw += np.float32(log.offset_m[t, k]).tobytes()
    return raw
