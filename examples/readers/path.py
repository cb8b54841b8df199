"""Lines that are a nav_msgs/Path each, in the frame of the car (base_link), in a bag of ROS 1 or 2.

    egolane run drive.bag --n-lanes 3 --set recording.format=examples/readers/path.py

TOPICS has the topic of each line, from left to right. y is positive to the left (REP 103).
"""

import numpy as np
import pandas as pd
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

TOPICS = ["/lane/left", "/lane/right"]


def read(path, *, frame_rate):
    """Each line beside the car: y where x is 0. Lines of one frame have the same stamp."""
    rows = []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        chosen = [each for each in bag.connections if each.topic in TOPICS]
        for connection, _, raw in bag.messages(chosen):
            message = bag.deserialize(raw, connection.msgtype)
            stamp, points = message.header.stamp, [pose.pose.position for pose in message.poses]
            y = np.interp(0, [p.x for p in points], [p.y for p in points]) if points else np.nan
            number = TOPICS.index(connection.topic) + 1
            rows.append((stamp.sec + stamp.nanosec / 1e9, number, -y))
    table = pd.DataFrame(rows, columns=["time_s", "line", "offset_m"])
    return table.sort_values(["time_s", "line"])
