"""Bags, ROS 1 and ROS 2, and MCAP files of ROS 2, read without ROS; and what a message is.

The definitions of the messages are taken from the file.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, Nodetype
from rosbags.typesys import Stores, get_typestore

from egolane_pgm.recordings.decoding import Decoder, Fields, stamp_parts
from egolane_pgm.types import InputError

#: What a file has on its topics: the type of the messages, and how many there are.
Topics = dict[str, tuple[str, int]]


class Message(NamedTuple):
    """A message of a recording.

    - time_s: when it was made, seconds.
    - value: its fields: nested dicts and lists of numbers and texts, or arrays of NumPy.
    """

    time_s: float
    topic: str
    value: Mapping[str, Any]


#: What may help with a file that is cut off.
_CURE = (
    "; if it was cut off or damaged, record or copy it again, or try `rosbag reindex` (.bag),"
    " `mcap recover` (.mcap) or `ros2 bag reindex`"
)


def topics_of(path: Path) -> Topics:
    """See `recordings.topics`."""
    with open_bag(path) as bag:
        return {
            name: (info.msgtype or "of several types", info.msgcount)
            for name, info in bag.topics.items()
        }


def messages(path: Path, topics: Collection[str]) -> Iterator[Message]:
    """See `recordings.topics`."""
    with open_bag(path) as bag:
        for connection, logged_ns, raw in bag.messages(_connections(bag, path, topics)):
            value = plain(bag.deserialize(raw, connection.msgtype))
            yield Message(time_of(value, logged_ns), connection.topic, value)


def fields_of(path: Path, topic: str) -> Fields:
    """The fields of all messages on a topic, and their times, `time_s` (N,), if they have none;
    empty without messages."""
    with open_bag(path) as bag:
        chosen = _connections(bag, path, [topic])
        found = list(bag.messages(chosen))
        if not found:
            return {}
        types, kind = bag.typestore.fielddefs, chosen[0].msgtype
        fields = Decoder(types, [raw for _, _, raw in found], bag.is2).decode(kind)
    logged_ns = np.array([ns for _, ns, _ in found])
    stamp = fields.get("header.stamp")
    if stamp is None:
        is_stamp = ("timestamp", (Nodetype.NAME, "builtin_interfaces/msg/Time")) in types[kind][1]
        stamp = fields["timestamp"] if is_stamp else np.zeros(len(found))
    return {"time_s": np.where(stamp != 0, stamp, _seconds(logged_ns)), **fields}


@contextmanager
def open_bag(path: Path) -> Iterator[AnyReader]:
    """An open bag. Raises InputError for whatever rosbags raises here or in the block, where the
    file is read."""
    # ROS 1 bags have their definitions; ROS 2 bags of databases may lack those of ROS itself.
    typestore = None if path.suffix == ".bag" else get_typestore(Stores.LATEST)
    with reading(path, "a bag", _CURE), AnyReader([path], default_typestore=typestore) as bag:
        yield bag


def _connections(bag: AnyReader, path: Path, topics: Collection[str]) -> list[Connection]:
    """The connections on some topics. Raises InputError for a type that is not defined."""
    chosen = [each for each in bag.connections if each.topic in topics]
    for kind in {each.msgtype for each in chosen} - bag.typestore.fielddefs.keys():
        raise InputError(
            f"{path}: has no definition of {kind}; convert it to MCAP where that type is known:"
            " `ros2 bag convert`"
        )
    return chosen


def plain(value: Any) -> Any:
    """A message of rosbags as a dict of its fields, those in it likewise. Arrays of numbers stay
    arrays."""
    if isinstance(value, list):
        return [plain(each) for each in value]
    if not hasattr(value, "__msgtype__"):
        return value
    # Constants of a type are no fields.
    names = (field.name for field in dataclasses.fields(value) if field.name != "__msgtype__")
    return {name: plain(getattr(value, name)) for name in names}


def time_of(value: Any, logged_ns: int) -> float:
    """When a message was made, seconds: the stamp of its header, or its `timestamp` in Foxglove's
    schemas; where it has none, or zero, when it was recorded.

    >>> time_of({"header": {"stamp": {"sec": 12, "nanosec": 500_000_000}}}, 13_000_000_000)
    12.5
    >>> time_of({"c0": -1.8}, 13_000_000_000)
    13.0
    """
    header = value.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else value.get("timestamp")
    return stamp_s(stamp) or _seconds(logged_ns)


def _seconds(ns: Any) -> Any:
    # Nanoseconds since 1970 have more digits than a float.
    return ns // 10**9 + ns % 10**9 / 1e9


def stamp_s(value: Any) -> float | None:
    """A time stamp as seconds, None for anything else."""
    parts = stamp_parts(value) if isinstance(value, dict) else None
    return None if parts is None else int(parts[0]) + int(parts[1]) / 1e9


@contextmanager
def reading(path: Path, what: str, cure: str = "") -> Iterator[None]:
    """Around the reading of a file. The libraries raise whatever damaged bytes lead to, which this
    turns into InputError: `what` it should be, and what may help."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())[:120].rstrip(".") or type(error).__name__
        raise InputError(f"{path}: cannot be read as {what} ({said}){cure}") from None
