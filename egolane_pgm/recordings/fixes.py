"""The fixes of a GNSS receiver in ROS 1 bags: `sensor_msgs/NavSatFix`, read without ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from egolane_pgm.recordings.rosbag import message_types, one_line, read_messages, topics_of
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
    """Read the positions recorded in a ROS 1 bag.

    - topic: by default the only one whose type is NavSatFix

    Raises InputError for a file that is missing, no bag, truncated or empty; where no topic, or
    several, carry positions; a topic that is not there or carries something else; stamps that are
    all zero.
    """
    path = Path(path)
    topic = _only_topic(path) if topic is None else topic
    messages = read_messages(path, topic)
    rows = []
    stores: dict[tuple[str, str], Any] = {}
    for k, (kind, raw) in enumerate(messages):
        if kind not in stores:
            types = message_types(path, kind)
            stores[kind] = get_typestore(Stores.EMPTY)
            stores[kind].register(dict(types))
            fields = {name for name, _ in types[kind[0]][1]}
            lacking = [name for name in _FIELDS if name not in fields]
            if lacking:
                raise InputError(
                    f"{path}: topic {topic} has type {kind[0]}, which is not a position:"
                    f" it lacks {', '.join(lacking)}"
                )
        try:
            fix: Any = stores[kind].deserialize_ros1(raw, kind[0])
        except Exception as error:
            raise InputError(f"{path}: message {k + 1} is damaged ({one_line(error)})") from None
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
