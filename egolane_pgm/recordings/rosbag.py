"""Bags, ROS 1 and ROS 2, and MCAP files of ROS 2, read without ROS; and what a message is.

The definitions of the messages are taken from the file. ROS 2 allows no capitals in the name of a
field: there `isValid` of the published recordings is `is_valid`.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

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


#: The published definitions. ROS tells types apart by a checksum of these.
LINES_TYPE, LINE_TYPE = (
    "road_layout_estimation/msg/msg_lines",
    "road_layout_estimation/msg/msg_lineInfo",
)
DEFINITIONS = {
    LINES_TYPE: """\
Header header
float64 number_of_lines
float64 goodLines
float64 width
float64 naive_width
int64 way_id
msg_lineInfo[] lines
""",
    LINE_TYPE: """\
bool isValid
bool continuous
int32 counter
float32 offset
""",
}

#: The same, with names that ROS 2 allows.
LINES_TYPE_2 = "road_layout_estimation/msg/MsgLines"
LINE_TYPE_2 = "road_layout_estimation/msg/MsgLineInfo"
DEFINITIONS_2 = {
    LINES_TYPE_2: DEFINITIONS[LINES_TYPE]
    .replace("Header", "std_msgs/Header")
    .replace("goodLines", "good_lines")
    .replace("msg_lineInfo", "MsgLineInfo"),
    LINE_TYPE_2: DEFINITIONS[LINE_TYPE].replace("isValid", "is_valid"),
}

#: What may help with a file that is cut off, by its ending; the last is of a ROS 2 folder.
_REPAIRS = {
    ".bag": "`rosbag reindex`",
    ".mcap": "`mcap recover`",
    ".db3": "`ros2 bag reindex`",
    "": "`ros2 bag reindex`, or name the .mcap or .db3 in it",
}


def topics_of(path: Path) -> Topics:
    """See `recordings.topics`."""
    with open_bag(path) as bag:
        return {
            name: (info.msgtype or "of several types", info.msgcount)
            for name, info in bag.topics.items()
        }


def messages(path: Path, topics: Collection[str] | None) -> Iterator[Message]:
    """See `recordings.topics`. Warns of a bag that has fewer messages than its index."""
    found = 0
    with open_bag(path) as bag:
        chosen = _connections(bag, path, topics)
        for connection, logged_ns, raw in bag.messages(chosen):
            found += 1
            value = plain(bag.deserialize(raw, connection.msgtype))
            yield Message(time_of(value, logged_ns), connection.topic, value)
        _check_count(bag, path, chosen, found)


def fields_of(path: Path, topic: str) -> Fields:
    """The fields of all messages on a topic, and their times, `time_s` (N,), if they have none;
    empty without messages. Warns as `messages`."""
    with open_bag(path) as bag:
        chosen = _connections(bag, path, [topic])
        if len({connection.msgtype for connection in chosen}) > 1:
            raise InputError(f"{path}: {topic} has messages of several types; split the bag")
        found = list(bag.messages(chosen))
        _check_count(bag, path, chosen, len(found))
        if not found:
            return {}
        decoder = Decoder(bag.typestore.fielddefs, [raw for _, _, raw in found], bag.is2)
        fields = decoder.decode(chosen[0].msgtype)
    logged_ns = np.array([ns for _, ns, _ in found])
    stamp = fields.get("header.stamp", np.zeros(len(found)))
    return {"time_s": np.where(stamp != 0, stamp, _seconds(logged_ns)), **fields}


def _check_count(bag: AnyReader, path: Path, chosen: Sequence[Connection], found: int) -> None:
    counted = sum(bag.topics[name].msgcount for name in {c.topic for c in chosen})
    if counted > found:
        said = f"{path}: {found} messages were read of the {counted} that it says are on"
        names = ", ".join(sorted({c.topic for c in chosen}))
        warnings.warn(f"{said} {names}; it is damaged", UserWarning, stacklevel=4)


@contextmanager
def open_bag(path: Path) -> Iterator[AnyReader]:
    """An open bag. Raises InputError for whatever rosbags raises here or in the block, where the
    file is read."""
    typestore = None
    # ROS 1 bags have their definitions.
    if path.suffix != ".bag":
        typestore = get_typestore(Stores.LATEST)
        for name, text in DEFINITIONS_2.items():
            typestore.register(get_types_from_msg(text, name))
    repair = _REPAIRS.get(path.suffix, _REPAIRS[""])
    cure = f"; if it was cut off or damaged, record or copy it again, or try {repair}"
    with reading(path, "a bag", cure), AnyReader([path], default_typestore=typestore) as bag:
        yield bag


def _connections(bag: AnyReader, path: Path, topics: Collection[str] | None) -> list[Connection]:
    """The connections on some topics, None for all. Raises InputError for a type that is not
    defined, or is in several ways."""
    chosen = [each for each in bag.connections if topics is None or each.topic in topics]
    of_type: dict[str, Connection] = {}
    for connection in chosen:
        kind = connection.msgtype
        if of_type.setdefault(kind, connection).msgdef != connection.msgdef:
            raise InputError(
                f"{path}: the messages on {connection.topic} have several definitions (its node was"
                " rebuilt while it recorded); split the bag"
            )
        if kind not in bag.typestore.fielddefs:
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
    values = ((name, getattr(value, name)) for name in _names(value.__class__))
    # Most values are numbers, and a call for each of them takes longest of all.
    return {name: each if isinstance(each, int | float) else plain(each) for name, each in values}


@functools.cache
def _names(kind: type) -> tuple[str, ...]:
    """The fields of a type of message. Its constants are no fields."""
    return tuple(f.name for f in dataclasses.fields(kind) if f.name != "__msgtype__")


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
