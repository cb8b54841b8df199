"""Bags of line messages, ROS 1 and ROS 2, and MCAP files, read without ROS.

A message carries a frame id, and per line whether it is valid, whether it is continuous, its
counter (the LRI) and its lateral offset: `road_layout_estimation/msg_lines`, and any other type
with those fields, whatever its package. The definition is taken from the file. ROS 2 allows no
capitals in the name of a field: there `isValid` is `is_valid`.
"""

from __future__ import annotations

import warnings
from array import array
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.types import InputError, IntArray, LineLog, not_one_of

#: The topic of the line detectors in the published recordings.
TOPIC = "/isis_line_detector/lines"

#: The numbers that may be the frame id: of the message, of its header (ROS 1), or its place in the
#: recording.
FRAME_IDS = ("way_id", "seq", "count")

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


def read_rosbag(
    path: str | Path,
    *,
    topic: str = TOPIC,
    frame_id: str = "way_id",
    frame_rate: float = 10.0,
    stamps: bool | None = None,
) -> LineLog:
    """Read the lines recorded in a ROS 1 bag (.bag), a ROS 2 bag (the folder, or one .db3 of it) or
    an MCAP file of ROS 2, T messages of at most L lines.

    - frame_id: "way_id" (the field of the message), "seq" (header.seq, for ROS 1 recordings that
      leave way_id empty) or "count" (0, 1, ... in the order of recording).
    - frame_rate: frames per second.
    - stamps: whether the time is that of the messages (of their header, or else when they were
      recorded; seconds since 1970) instead of frame id over frame rate. By default it is in ROS 2
      where it increases.

    Messages are taken in the order in which they were recorded. The header stamps of the published
    ROS 1 bags say when they were processed, jump by minutes or are all zero, so they give no time.

    Warns of a bag that has fewer messages than it says. Raises InputError for a file that is
    missing, no bag, truncated or empty; a topic that is not there (the ones that are get listed) or
    whose type lacks a field; frame ids that repeat or decrease; stamps that are asked for and do
    not increase; an offset of a valid line that is NaN or infinite.
    """
    path = Path(path)
    if frame_id not in FRAME_IDS:
        raise InputError(f"{path}: frame_id {not_one_of(frame_id, FRAME_IDS)}")
    needed = ["lines.isValid or lines.is_valid"]
    needed += ["lines.continuous", "lines.counter", "lines.offset"]
    id_of = {"way_id": "way_id", "seq": "header.seq", "count": None}[frame_id]
    # Of numbers, not of Python objects: an hour has a million lines.
    ids, header_ns, logged_ns, n_lines = array("q"), array("q"), array("q"), array("q")
    cells = array("d")
    with open_bag(path) as bag:
        needed = needed if id_of is None else [id_of, *needed]
        chosen, fields = topic_of(bag, path, str(topic), needed, "a message of lines")
        is_valid = "isValid" if "lines.isValid" in fields else "is_valid"
        of_line = attrgetter(is_valid, "continuous", "counter", "offset")
        for message, ns in messages_of(bag, path, chosen):
            ids.append(len(ids) if id_of is None else attrgetter(id_of)(message))
            stamp = message.header.stamp if "header.stamp" in fields else None
            header_ns.append(0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec)
            logged_ns.append(ns)
            n_lines.append(len(message.lines))
            for line in message.lines:
                cells.extend(of_line(line))
        is_ros2 = bag.is2
    frames = np.array(ids, dtype=np.int64)
    _check_ids(path, frames, frame_id)
    valid, continuous, lri, offset_m = np.array(cells).reshape(-1, 4).T
    log = LineLog.from_rows(
        frames,
        frame_rate,
        np.repeat(np.arange(len(frames)), np.array(n_lines)),
        offset_m,
        valid != 0,
        continuous != 0,
        lri,
        source=str(path),
    )
    if not (is_ros2 if stamps is None else stamps):
        return log
    stamp = np.array(header_ns if any(header_ns) else logged_ns, dtype=np.int64)
    return _stamped(log, stamp, must=bool(stamps))


def _stamped(log: LineLog, stamp: IntArray, *, must: bool) -> LineLog:
    """The log with the times of its messages, (T,) ns, or as it is, with a warning, where these do
    not increase; must: raise InputError there."""
    step = np.diff(stamp)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        one, other = log.frame_id[k], log.frame_id[k + 1]
        said = f"{log.source}: the stamps of frames {one} and {other} do not increase"
        if must:
            raise InputError(f"{said}; leave out stamps=true")
        warnings.warn(f"{said}; time is frame id over frame rate", UserWarning, stacklevel=3)
        return log
    # Nanoseconds since 1970 have more digits than a float.
    return replace(log, time_s=stamp // 10**9 + stamp % 10**9 / 1e9)


def _check_ids(path: Path, ids: IntArray, field: str) -> None:
    """Raise InputError for ids that repeat or decrease. LineLog refuses them too, but does not know
    which option may help."""
    other = "seq (ROS 1) or count" if field == "way_id" else "way_id or count"
    step = np.diff(ids)
    if len(ids) > 1 and (step == 0).all():
        raise InputError(
            f"{path}: all {len(ids)} messages have frame id {int(ids[0])}, this recording does not"
            f" fill in {field}; use frame_id {other}"
        )
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        raise InputError(
            f"{path}: frame ids must increase, but {ids[k]} is followed by {ids[k + 1]} (messages"
            f" {k + 1} and {k + 2} of the file); split the bag there, or use frame_id {other}"
        )


# --- bags of any kind ----------------------------------------------------------------------------


@contextmanager
def open_bag(path: Path) -> Iterator[AnyReader]:
    """An open bag. Raises InputError for a file that is missing, and for whatever rosbags raises
    here or in the block, where the file is read."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    # ROS 1 bags have their definitions.
    typestore = None if path.suffix == ".bag" else get_typestore(Stores.LATEST)
    try:
        with AnyReader([path], default_typestore=typestore) as bag:
            yield bag
    except InputError:
        raise
    # Of a damaged file rosbags raises struct, assertion, database and unpacking errors alike.
    except Exception as error:
        said = " ".join(str(error).split())[:120].rstrip(".") or type(error).__name__
        repair = _REPAIRS.get(path.suffix, _REPAIRS[""])
        raise InputError(
            f"{path}: cannot be read as a bag ({said}); if it was cut off or damaged, record or"
            f" copy it again, or try {repair}"
        ) from None


def topic_of(
    bag: AnyReader, path: Path, topic: str, needed: Iterable[str], what: str
) -> tuple[list[Connection], list[str]]:
    """The connections of a topic, which have one message type, and the fields of that: `header`,
    `header.stamp`, `lines`, `lines.offset`, ...

    - needed: the fields that it must have; `a or b` for one of two.

    Where the file has no definition of the type, as ROS 2 bags before Iron, the published ones and
    those of ROS stand in for it, and a warning says so. Raises InputError for a topic that is not
    there, with those that are, and for a type that is not known or lacks a field.
    """
    if not bag.connections:
        raise InputError(f"{path}: the bag is empty, it holds no messages")
    chosen = [c for c in bag.connections if c.topic.strip("/") == topic.strip("/")]
    if not chosen:
        there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections}))
        raise InputError(f"{path}: no topic {topic}; the bag has {there}")
    if len({(c.msgtype, c.msgdef) for c in chosen}) > 1:
        raise InputError(
            f"{path}: the messages on {topic} have several definitions (its node was rebuilt while"
            " it recorded); split the bag"
        )
    kind = chosen[0].msgtype
    types: dict[str, Any] = bag.typestore.fielddefs
    if chosen[0].msgdef.format == MessageDefinitionFormat.NONE:
        for name, text in (DEFINITIONS | DEFINITIONS_2).items():
            name = f"{kind.rpartition('/')[0]}/{name.rpartition('/')[2]}"
            bag.typestore.register(get_types_from_msg(text, name))
        if kind not in types:
            raise InputError(
                f"{path}: has no definition of {kind}; convert it where that type is known:"
                " `ros2 bag convert` to MCAP"
            )
        said = f"{path}: has no definition of {kind}; taken for the usual one"
        warnings.warn(said, UserWarning, stacklevel=3)
    fields = []
    for name, (node, inner) in types[kind][1]:
        is_list = node in (Nodetype.SEQUENCE, Nodetype.ARRAY)
        node, inner = inner[0] if is_list else (node, inner)
        below = types[inner][1] if node == Nodetype.NAME else []
        fields += [name, *(f"{name}.{each}" for each, _ in below)]
    lacking = [names for names in needed if not any(n in fields for n in names.split(" or "))]
    if lacking:
        raise InputError(
            f"{path}: topic {topic} has type {kind}, which is not {what}: it lacks"
            f" {', '.join(lacking)}; it has {', '.join(fields)}"
        )
    return chosen, fields


def messages_of(bag: AnyReader, path: Path, chosen: list[Connection]) -> Iterator[tuple[Any, int]]:
    """Each message of some connections, an object that has its fields, and when it was recorded, ns
    since 1970. Warns where the bag says that it has more; raises InputError where it has none."""
    found = 0
    for connection, logged_ns, raw in bag.messages(chosen):
        found += 1
        yield bag.deserialize(raw, connection.msgtype), logged_ns
    counted = sum(bag.topics[name].msgcount for name in {c.topic for c in chosen})
    if counted > found:
        said = f"{path}: {found} messages were read of the {counted} that it says are on"
        warnings.warn(f"{said} {chosen[0].topic}; it is damaged", UserWarning, stacklevel=3)
    if not found:
        raise InputError(f"{path}: the bag holds no messages on {chosen[0].topic}")
