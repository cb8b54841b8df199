"""A node of ROS 2: it takes the messages of a lane detector and publishes the lane.

    python3 lane_node.py --ros-args -p topic:=/lanes -p type:=my_msgs/msg/Lanes -p n_lanes:=3 \
        -p columns:="offset_m=c0,left_positive=true"

`columns` is that of `egolane run --columns`; `egolane show` on a bag prints its topics and fields.
It publishes

    ~/lane         std_msgs/Int32    1 is the leftmost lane, 0: unassigned
    ~/probability  std_msgs/Float32  of that lane
    ~/events       std_msgs/String   a lane change as JSON, when it is detected

`experiment` is a name that `egolane show` prints, or a YAML file.
"""

from __future__ import annotations

import json
import queue
import threading
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rosidl_runtime_py import message_to_ordereddict
from rosidl_runtime_py.utilities import get_message
from std_msgs.msg import Float32, Int32, String

from egolane_pgm.loading import load_experiment
from egolane_pgm.online import online, read_messages
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.recordings.rosbag import time_of
from egolane_pgm.types import InputError

PARAMETERS = {
    "experiment": "zero_label",
    "n_lanes": 3,
    "topic": "/lanes",
    "type": "my_msgs/msg/Lanes",
    "columns": "offset_m=c0,left_positive=true",
}


class LaneNode(Node):
    """Filters in a thread."""

    def __init__(self) -> None:
        super().__init__("egolane")
        given = {name: self.declare_parameter(name, v).value for name, v in PARAMETERS.items()}
        changes = {
            "n_lanes": given["n_lanes"],
            "recording": {"columns": column_keys(given["columns"])},
        }
        self.experiment = load_experiment(given["experiment"], changes)
        self.waiting: queue.Queue[str] = queue.Queue()
        self.lane = self.create_publisher(Int32, "~/lane", 10)
        self.probability = self.create_publisher(Float32, "~/probability", 10)
        self.events = self.create_publisher(String, "~/events", 10)
        self.create_subscription(get_message(given["type"]), given["topic"], self.on_lines, 10)
        threading.Thread(target=self.answer, daemon=True).start()

    def on_lines(self, message: Any) -> None:
        """Queue a message of the detector; one without a stamp gets the time of now."""
        fields = message_to_ordereddict(message)
        self.waiting.put(json.dumps({"time_s": time_of(fields, time.time_ns()), **fields}))

    def answer(self) -> None:
        """Publish the answers, one after the other."""
        try:
            frames = read_messages(self.experiment, iter(self.waiting.get, None))
            for answer in online(self.experiment, frames):
                self.lane.publish(Int32(data=answer["lane"]))
                self.probability.publish(Float32(data=answer["probability"]))
                for event in answer["events"]:
                    self.events.publish(String(data=json.dumps(event)))
        except InputError as error:
            self.get_logger().fatal(str(error))
            rclpy.shutdown()


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(LaneNode())
