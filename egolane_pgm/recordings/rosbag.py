"""Bags, ROS 1 and ROS 2, and MCAP files of ROS 2, read without ROS.

The definitions of the messages are taken from the file. ROS 2 allows no capitals in the name of a
field: there `isValid` of the published recordings is `is_valid`.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.recordings.containers import Topics, reading, time_of
from egolane_pgm.recordings.mapping import Message
from egolane_pgm.types import InputError

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


def topics_of(path: Path, definitions: Path | None) -> Topics:
    """See `recordings.containers`."""
    with open_bag(path, definitions) as bag:
        return {
            name: (info.msgtype or "of several types", info.msgcount)
            for name, info in bag.topics.items()
        }


def messages(
    path: Path, topics: Collection[str] | None, definitions: Path | None
) -> Iterator[Message]:
    """See `recordings.containers`. Warns of a bag that says it has more messages than it has."""
    found = 0
    with open_bag(path, definitions) as bag:
        chosen = [c for c in bag.connections if topics is None or c.topic in topics]
        _check_definitions(bag, path, chosen)
        for connection, logged_ns, raw in bag.messages(chosen):
            found += 1
            value = plain(bag.deserialize(raw, connection.msgtype))
            yield Message(time_of(value, logged_ns), connection.topic, value)
        counted = sum(bag.topics[name].msgcount for name in {c.topic for c in chosen})
    if counted > found:
        said = f"{path}: {found} messages were read of the {counted} that it says are on"
        names = ", ".join(sorted({c.topic for c in chosen}))
        warnings.warn(f"{said} {names}; it is damaged", UserWarning, stacklevel=3)


@contextmanager
def open_bag(path: Path, definitions: Path | None) -> Iterator[AnyReader]:
    """An open bag. Raises InputError for whatever rosbags raises here or in the block, where the
    file is read.

    - definitions: the folder of .msg files, for a bag of ROS 2 that has none.
    """
    typestore = get_typestore(Stores.LATEST)
    texts = dict(DEFINITIONS_2)
    for file in sorted(definitions.rglob("*.msg")) if definitions else ():
        package = next(name for name in reversed(file.parts[:-1]) if name != "msg")
        texts[f"{package}/msg/{file.stem}"] = file.read_text()
    for name, text in texts.items():
        typestore.register(get_types_from_msg(text, name))
    repair = _REPAIRS.get(path.suffix, _REPAIRS[""])
    cure = f"; if it was cut off or damaged, record or copy it again, or try {repair}"
    # ROS 1 bags have their definitions.
    default = None if path.suffix == ".bag" else typestore
    with reading(path, "a bag", cure), AnyReader([path], default_typestore=default) as bag:
        yield bag


def _check_definitions(bag: AnyReader, path: Path, chosen: Sequence[Connection]) -> None:
    """Raise InputError for a type that is not defined, or is in several ways."""
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
                f"{path}: has no definition of {kind}: name the folder of its .msg files"
                " (recording.definitions), or convert it where that type is known: `ros2 bag"
                " convert` to MCAP"
            )


def plain(value: Any) -> Any:
    """A message of rosbags as a dict of its fields, those in it likewise. Arrays of numbers stay
    arrays."""
    if isinstance(value, list):
        return [plain(each) for each in value]
    if not hasattr(value, "__msgtype__"):
        return value
    names = (name for name in value.__dataclass_fields__ if name != "__msgtype__")
    return {name: plain(getattr(value, name)) for name in names}
