"""Small recordings of own kinds, with the same lines: 100 frames, ten a second, of a car in the
middle one of three lanes, which swings by 30 cm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

N_FRAMES, START_S = 100, 1_700_000_000

#: The lines of each frame from left to right, (N_FRAMES, 4), metres, negative to the left.
OFFSETS = np.round([-5.25, -1.75, 1.75, 5.25] + 0.3 * np.sin(np.arange(N_FRAMES) / 8)[:, None], 3)

LANES_MSG = "std_msgs/Header header\nLane[] lanes\nuint32 sequence\n"
LANE_MSG = "float64 c0\nfloat32 confidence\nbool is_solid\n"


def per_line(**columns: Any) -> pd.DataFrame:
    """A table with a row for each line. columns: a function of the frame (from 0), the line (from
    1) and the offset each."""
    rows = [(t, k + 1, float(OFFSETS[t, k])) for t in range(N_FRAMES) for k in range(4)]
    return pd.DataFrame({name: [of(*row) for row in rows] for name, of in columns.items()})


def foreign_table(path: Path) -> None:
    """Semicolons, decimal commas, seconds, lines numbered from 1, centimetres, positive to the
    left; a second is lost."""
    table = per_line(
        timestamp=lambda t, k, y: t / 10,
        track=lambda t, k, y: k,
        lateral_cm=lambda t, k, y: -100 * y,
    )
    kept = table[(table["timestamp"] < 5) | (table["timestamp"] >= 6)]
    kept.to_csv(path, sep=";", decimal=",", index=False)


def polynomials_table(path: Path) -> None:
    """c0 to c3 and a quality of the left and the right line."""
    table: dict[str, Any] = {"time": np.arange(N_FRAMES) / 10}
    for side, k in (("left", 1), ("right", 2)):
        table |= {f"{side}_c0": OFFSETS[:, k], f"{side}_quality": 3}
        table |= {f"{side}_c{power}": 0.0 for power in (1, 2, 3)}
    pd.DataFrame(table).to_csv(path, index=False)


def messages() -> list[tuple[float, list[dict[str, Any]]]]:
    """The time and the lines of each frame as messages of somebody's own, positive to the left."""
    return [
        (
            START_S + t / 10,
            [
                {"c0": -float(y), "confidence": 0.9, "is_solid": k in (0, 3)}
                for k, y in enumerate(OFFSETS[t])
            ],
        )
        for t in range(N_FRAMES)
    ]


def own_bag(path: Path) -> None:
    """A bag of own messages, of ROS 1 or 2, recorded half a second after their stamps; with another
    topic."""
    is_ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(LANES_MSG, "my_msgs/msg/Lanes"))
    store.register(get_types_from_msg(LANE_MSG, "my_msgs/msg/Lane"))
    types = store.types
    serialised = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    with Writer1(path) if is_ros1 else Writer2(path, version=9) as bag:
        lanes = bag.add_connection("/lanes", "my_msgs/msg/Lanes", typestore=store)
        other = bag.add_connection("/said", "std_msgs/msg/String", typestore=store)
        for k, (time_s, lines) in enumerate(messages()):
            stamp = types["builtin_interfaces/msg/Time"](int(time_s), round(time_s % 1 * 1e9))
            seq = {"seq": k} if is_ros1 else {}
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="car", **seq)
            each = [types["my_msgs/msg/Lane"](**line) for line in lines]
            message = types["my_msgs/msg/Lanes"](header, each, k)
            ns = round((time_s + 0.5) * 1e9)
            bag.write(lanes, ns, bytes(serialised(message, "my_msgs/msg/Lanes")))
            said = types["std_msgs/msg/String"]("hello")
            bag.write(other, ns, bytes(serialised(said, "std_msgs/msg/String")))


def json_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="", library="test")
        schema = writer.register_schema("lanes", "jsonschema", b"{}")
        channel = writer.register_channel("/lanes", "json", schema)
        for time_s, lines in messages():
            stamp = {"nsec": round(time_s % 1 * 1e9), "sec": int(time_s)}
            data = json.dumps({"timestamp": stamp, "lanes": lines}).encode()
            writer.add_message(channel, round((time_s + 0.5) * 1e9), data, 0)
        writer.finish()
