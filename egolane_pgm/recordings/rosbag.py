"""Bags of ROS 1 and ROS 2, and MCAP files of ROS 2, read without ROS.

The definitions of the messages are taken from the file.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_typestore

from egolane_pgm.recordings import files_of
from egolane_pgm.recordings.decoding import Fields, fields_of_objects, stamp_of
from egolane_pgm.tools.files import reading
from egolane_pgm.types import InputError

#: The topics of a file: message type and number of messages.
Topics = dict[str, tuple[str, int]]


#: The time of a message, seconds, and its fields: nested dicts and lists, or NumPy arrays.
Message = tuple[float, Mapping[str, Any]]

#: Advice for a damaged file.
CURE = (
    "; if it was cut off or damaged, record or copy it again, or try `rosbag reindex` (.bag),"
    " `mcap recover` (.mcap) or `ros2 bag reindex`"
)


@contextmanager
def opened(path: Path) -> Iterator[AnyReader]:
    """Open a bag. Raises InputError for any error of rosbags, also inside the block.

    - path: a file, or a folder. Without metadata.yaml, all bags in the folder are read.
    """
    is_bag = path.is_file() or (path / "metadata.yaml").is_file()
    paths = [path] if is_bag else files_of(path)
    # ROS 1 bags have all definitions; ROS 2 databases may lack the standard ones.
    typestore = None if paths[0].suffix == ".bag" else get_typestore(Stores.LATEST)
    with reading(path, "a bag", CURE), AnyReader(paths, default_typestore=typestore) as bag:
        yield bag


def topics_of(bag: AnyReader) -> Topics:
    """The topics of a bag."""
    return {
        name: (info.msgtype or "of several types", info.msgcount)
        for name, info in bag.topics.items()
    }


def messages(bag: AnyReader, topic: str) -> Iterator[Message]:
    """The messages on a topic."""
    for connection, logged_ns, raw in bag.messages(_connections(bag, topic)):
        message: Any = bag.deserialize(raw, connection.msgtype)
        value = dataclasses.asdict(message)
        yield time_of(value, logged_ns), value


def fields_of(bag: AnyReader, topic: str) -> Fields:
    """The fields of all messages on a topic, and their times `time_s` (N,) unless there is a field
    of that name."""
    chosen = _connections(bag, topic)
    found = list(bag.messages(chosen))
    types = bag.typestore.fielddefs
    kind = chosen[0].msgtype
    read = [bag.deserialize(raw, kind) for _, _, raw in found]
    fields = fields_of_objects(read, kind, types)
    is_stamp = ("timestamp", (Nodetype.NAME, "builtin_interfaces/msg/Time")) in types[kind][1]
    stamp = fields.get("header.stamp", fields["timestamp"] if is_stamp else np.zeros(len(found)))
    logged_s = _seconds(np.array([ns for _, ns, _ in found]))
    return {"time_s": np.where(stamp != 0, stamp, logged_s), **fields}


def _connections(bag: AnyReader, topic: str) -> list[Connection]:
    chosen = [each for each in bag.connections if each.topic == topic]
    for each in chosen:
        kind = each.msgtype
        has_text = each.msgdef.format == MessageDefinitionFormat.NONE or each.msgdef.data.strip()
        # A trigger has no fields.
        is_known = has_text or kind == "std_msgs/msg/Empty"
        if not is_known or kind not in bag.typestore.fielddefs:
            raise InputError(
                f"has no definition of {kind}; convert it to MCAP where that type is known:"
                " `ros2 bag convert`"
            )
    return chosen


def time_of(value: Mapping[str, Any], logged_ns: int) -> float:
    """The time of a message, seconds: the stamp of its header, or its `timestamp` in Foxglove's
    schemas; the time of recording if there is no stamp or it is zero.

    >>> time_of({"header": {"stamp": {"sec": 12, "nanosec": 500_000_000}}}, 13_000_000_000)
    12.5
    >>> time_of({"c0": -1.8}, 13_000_000_000)
    13.0
    """
    header = value.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else value.get("timestamp")
    return float(stamp_of(stamp) or _seconds(logged_ns))


def _seconds(ns: Any) -> Any:
    # Nanoseconds since 1970 have more digits than a float.
    return ns // 10**9 + ns % 10**9 / 1e9
