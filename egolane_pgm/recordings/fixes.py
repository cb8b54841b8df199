"""The fixes of a GNSS receiver in bags of ROS 1 and ROS 2: `sensor_msgs/NavSatFix`, read without
ROS."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from egolane_pgm.recordings.rosbag import (
    contents,
    lacking,
    message_types,
    read_messages,
    topics_of,
)
from egolane_pgm.types import FloatArray, InputError

#: The name of the message type, whatever its package.
TYPE = "NavSatFix"

_FIELDS = ("header", "status", "latitude", "longitude", "position_covariance")


@dataclass(frozen=True)
class Fixes:
    """T fixes, in the order of the file.

    - t_s (T,): seconds since 1970, of the header's stamp
    - latitude, longitude (T,): degrees; NaN where the receiver had no fix
    - sigma_m (T,): horizontal standard deviation along one axis, metres; NaN where it is not told
    """

    t_s: FloatArray
    latitude: FloatArray
    longitude: FloatArray
    sigma_m: FloatArray


def read_fixes(path: str | Path, *, topic: str | None = None) -> Fixes:
    """Read the positions recorded in a bag of ROS 1 or ROS 2, or an MCAP file.

    - topic: by default the only one whose type is NavSatFix

    Raises InputError for a file that is missing, no bag, truncated or empty; where no topic, or
    several, carry positions; a topic that is not there or carries something else; stamps that are
    all zero.
    """
    path = Path(path)
    topic = _only_topic(path) if topic is None else topic
    messages = read_messages(path, topic)
    rows = []
    for kind, run in groupby(messages, key=lambda message: message.kind):
        types = message_types(path, kind)
        fields = {name for name, _ in types[kind.type][1]}
        missing = [name for name in _FIELDS if name not in fields]
        if missing:
            raise lacking(path, topic, kind, "a position", missing)
        for fix in contents(path, kind, types, run):
            stamp = fix.header.stamp
            place = (fix.latitude, fix.longitude) if fix.status.status >= 0 else (np.nan, np.nan)
            # East and north; a covariance of zeros says that it is not known.
            variance = (fix.position_covariance[0] + fix.position_covariance[4]) / 2
            sigma = np.sqrt(variance) if variance > 0 else np.nan
            rows.append((stamp.sec + stamp.nanosec * 1e-9, *place, sigma))
    values = np.array(rows, dtype=np.float64).T
    if not values[0].any():
        raise InputError(f"{path}: the positions have no time, all stamps are zero")
    return Fixes(*values)


def _only_topic(path: Path) -> str:
    found = topics_of(path, TYPE)
    if len(found) != 1:
        several = f"; name one of {', '.join(found)}" if found else ""
        raise InputError(f"{path}: {len(found)} topics of type {TYPE} in the bag{several}")
    return found[0]
