"""The fixes of a GNSS receiver in bags of ROS 1 and ROS 2: `sensor_msgs/NavSatFix`, read without
ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from egolane_pgm.recordings.rosbag import messages_of, open_bag, topic_of
from egolane_pgm.types import FloatArray, InputError

#: The name of the message type, whatever its package.
TYPE = "NavSatFix"

_FIELDS = ("header.stamp", "status.status", "latitude", "longitude", "position_covariance")


@dataclass(frozen=True)
class Fixes:
    """T fixes, in the order of recording.

    - t_s (T,): seconds since 1970, of the header's stamp
    - latitude, longitude (T,): degrees; NaN where the receiver had no fix
    - sigma_m (T,): horizontal standard deviation along one axis, metres; NaN where unknown
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
    rows = []
    with open_bag(path) as bag:
        if topic is None:
            names = {c.topic for c in bag.connections if c.msgtype.split("/")[-1] == TYPE}
            if len(names) != 1:
                several = f"; name one of {', '.join(sorted(names))}" if names else ""
                raise InputError(f"{path}: {len(names)} topics of type {TYPE} in the bag{several}")
            (topic,) = names
        chosen, _ = topic_of(bag, path, topic, _FIELDS, "a position")
        for fix, _ in messages_of(bag, path, chosen):
            place = (fix.latitude, fix.longitude) if fix.status.status >= 0 else (np.nan, np.nan)
            # East and north; a covariance of zeros says that it is not known.
            variance = (fix.position_covariance[0] + fix.position_covariance[4]) / 2
            sigma = np.sqrt(variance) if variance > 0 else np.nan
            rows.append((fix.header.stamp.sec + fix.header.stamp.nanosec * 1e-9, *place, sigma))
    values = np.array(rows, dtype=np.float64).T
    if not values[0].any():
        raise InputError(f"{path}: the positions have no time, all stamps are zero")
    return Fixes(*values)
