"""Bags and MCAP files: messages on topics, read as the lines that they are.

A message is a line, a frame with a field for each line, or a frame with a list of lines. Its fields
are columns (`recordings.columns`): those of a section have its name before theirs, `header.seq`,
those of the lines in the list only their own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import rosbag
from egolane_pgm.recordings.columns import (
    FRAME_RATE,
    OF_LINE,
    arrow_column,
    lines_of_columns,
)
from egolane_pgm.recordings.decoding import Fields, Items, stamp_parts
from egolane_pgm.recordings.rosbag import Message, Topics
from egolane_pgm.types import InputError, IntArray, LineLog, near_word

#: The topics of the lines in the published recordings and in MCAP files of a result.
TOPICS = ("/isis_line_detector/lines", "/lines")

#: The columns of the published messages of lines, in ROS 1 and in ROS 2.
_PUBLISHED = {
    "frame_id": "way_id",
    "offset_m": "offset",
    "is_continuous": "continuous",
    "lri": "counter",
}
_VALID = {True: "isValid", False: "is_valid"}


def topics_of(path: str | Path) -> Topics:
    """The topics of a file of messages: for each the type of its messages, and how many there are.

    Raises InputError for a file that is missing or cannot be read.
    """
    topics: Topics = _reader(Path(path)).topics_of(Path(path))
    return topics


def messages(path: str | Path, topics: Collection[str]) -> Iterator[Message]:
    """The messages of a file in the order of their recording. The time of one is the stamp in its
    header, or else when it was recorded, seconds.

    Raises InputError as `topics_of`, for a topic that is not there, with those that are, and for a
    file that holds no message on them.
    """
    file = Path(path)
    topics = [_topic_of(file, topic) for topic in topics]
    is_empty = True
    for message in _reader(file).messages(file, topics):
        is_empty = False
        yield message
    if is_empty:
        raise InputError(f"{file}: holds no messages on {', '.join(topics)}")


def _topic_of(path: Path, topic: str | None = None) -> str:
    """A topic of a file, by default the one of the lines. Raises InputError for one that is not
    there, and if several may be meant."""
    there = topics_of(path)
    if topic is None:
        found = [name for name in TOPICS if name in there][:1] or [*there]
        if len(found) == 1:
            return found[0]
        problem = "topic: is missing" if found else "holds no messages"
    elif topic in there:
        return topic
    else:
        problem = f"no topic {topic}{near_word(topic, there)}"
    listed = ", ".join(f"{name} ({kind})" for name, (kind, _) in sorted(there.items()))
    raise InputError(f"{path}: {problem}; the file has {listed or 'none'} (`egolane show {path}`)")


def read_topic(
    path: str | Path,
    *,
    topic: str | None = None,
    frame_rate: float = FRAME_RATE,
    columns: Columns | None = None,
) -> LineLog:
    """Read the lines of a bag or an MCAP file, T frames of at most L lines.

    - topic: of the lines; by default one of TOPICS, or the only one.
    - frame_rate: frames per second of messages with frame ids but without times.
    - columns: which fields are what; by default those of the published recordings, or our own
      names.

    Raises InputError as `messages` and `recordings.columns.lines_of_columns`.
    """
    path = Path(path)
    table, row = table_of(fields_of(path, topic))
    said = columns or Columns()
    if said.get("offset_m") is None and {"line", "way_id"} <= table.keys():
        is_ros1 = path.suffix == ".bag"
        published: Any = {**_PUBLISHED, "is_valid": _VALID[is_ros1], **said}
        said = published
        begins = np.flatnonzero(np.diff(row, prepend=-1))
        frame_id = said.get("frame_id")
        if frame_id in table:
            if (np.diff(np.asarray(table[frame_id])[begins]) == 0).any():
                raise InputError(
                    f"{path}: {frame_id} stays the same from message to message; `columns:"
                    " {frame_id: null}` numbers frames by their times"
                )
            if is_ros1 and said.get("time_s") is None:
                # The stamps of the published ROS 1 bags say when they were processed, jump by
                # minutes or are all zero: time is frame id over frame rate there.
                table = {name: each for name, each in table.items() if name != "time_s"}
    return _lines_of(table, row, said, path, frame_rate)


def fields_of(path: Path, topic: str | None) -> Fields:
    """The fields of all messages on a topic, by default that of the lines, and `time_s`, when each
    was made, if none of them is called so. Raises InputError as `messages`."""
    topic = _topic_of(path, topic)
    reader = _reader(path)
    if reader is rosbag:
        fields = rosbag.fields_of(path, topic)
    else:
        found = [{"time_s": m.time_s, **m.value} for m in reader.messages(path, [topic])]
        fields = _fields(found, str(path)) if found else {}
    if not fields:
        raise InputError(f"{path}: holds no messages on {topic}")
    return fields


def lines_of_messages(
    messages: Sequence[Mapping[str, Any]],
    said: Columns | None,
    where: str,
    frame_rate: float = FRAME_RATE,
    first: int = 0,
) -> LineLog:
    """The lines of messages, T frames of at most L lines.

    - said: which fields are what; None for our own names.
    - where: names the file in what is said of it.
    - frame_rate: frames per second where the messages have frame ids but no times.
    - first: the first frame id, where time gives them.

    Raises InputError as `recordings.columns.lines_of_columns`.

    >>> from egolane_pgm.recordings.topics import lines_of_messages
    >>> from egolane_pgm.experiment import Columns
    >>> message = {"t": 12.0, "lanes": [{"c0": 1.8}, {"c0": -1.7}]}
    >>> said = Columns(time_s="t", offset_m="c0", left_positive=True)
    >>> lines_of_messages([message], said, "drive.mcap").offset_m.tolist()
    [[-1.8, 1.7]]
    """
    columns, row = table_of(_fields(messages, where))
    return _lines_of(columns, row, said, Path(where), frame_rate, first)


def _lines_of(
    columns: Mapping[str, Any],
    row: IntArray,
    said: Columns | None,
    path: Path,
    frame_rate: float,
    first: int = 0,
) -> LineLog:
    if "line" in columns and columns["line"].null_count == len(row):
        # Of lists that are always empty the fields may not be known.
        given: Mapping[str, Any] = said or {}
        names = [given.get(name) or name for name in ("offset_m", *OF_LINE)]
        columns = {**dict.fromkeys(names, pa.nulls(len(row))), **columns}
    return lines_of_columns(columns, said, path, frame_rate, first=first, row=row)


def _fields(messages: Sequence[Mapping[str, Any]], where: str) -> Fields:
    """The fields of messages that are dicts."""
    try:
        return _fields_in(pa.array(messages))
    except pa.ArrowException as error:
        raise InputError(f"{where}: a field has values of several types ({error})") from None


def _fields_in(values: pa.StructArray) -> Fields:
    """The columns of sections, those of sections in them by their path; a stamp is in seconds."""
    inner = dict(zip([field.name for field in values.type], values.flatten(), strict=True))
    if (parts := stamp_parts(inner)) is not None:
        seconds, nanoseconds = (np.asarray(part.cast(pa.int64())) for part in parts)
        return {"": seconds + nanoseconds / 1e9}
    found: Fields = {}
    for name, each in inner.items():
        if pa.types.is_struct(each.type):
            fields = _fields_in(each)
            found |= {f"{name}.{key}" if key else name: values for key, values in fields.items()}
        elif pa.types.is_list(each.type) and pa.types.is_struct(each.type.value_type):
            found[name] = Items(_counts(each), _fields_in(each.flatten()))
        elif pa.types.is_list(each.type) and pa.types.is_null(each.type.value_type):
            found[name] = Items(_counts(each), {})
        else:
            found[name] = each
    return found


def _counts(lists: pa.ListArray) -> IntArray:
    return np.asarray(lists.value_lengths().fill_null(0)).astype(np.int64)


def table_of(fields: Fields) -> tuple[dict[str, Any], IntArray]:
    """The columns of messages, a row for each line of those that have a list of lines (`lines`, or
    their only list), and the message of each row, (N,)."""
    lists = [name for name, values in fields.items() if isinstance(values, Items)]
    of_lines = "lines" if "lines" in lists else lists[0] if len(lists) == 1 else None
    table = {name: arrow_column(each) for name, each in fields.items() if name not in lists}
    if of_lines is None:
        # The lists are named in messages.
        table |= {name: pa.array([[None] * n for n in fields[name].counts]) for name in lists}
        return table, np.arange(len(next(iter(table.values()), ())))
    counts, of_line = fields[of_lines]
    # A message without lines has a row with an empty one.
    rows = np.maximum(counts, 1)
    row = np.repeat(np.arange(len(counts)), rows)
    is_empty = (counts == 0)[row]
    number = np.arange(len(row)) - (np.cumsum(rows) - rows)[row] + 1
    line = pa.array(np.cumsum(~is_empty) - 1, mask=is_empty)
    table = {name: values.take(pa.array(row)) for name, values in table.items()}
    table["line"] = pa.array(number, mask=is_empty)
    return table | {name: arrow_column(each).take(line) for name, each in of_line.items()}, row


def _reader(path: Path) -> Any:
    """What reads a file of messages. Raises InputError where it is not there."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() == ".mcap" and path.is_file():
        with path.open("rb") as opened:
            head = opened.read(25)
        # rosbags reads MCAP files of ROS 2, and says what is wrong with what is no MCAP.
        if head.startswith(b"\x89MCAP") and head[17:] != b"\x04\0\0\0ros2":
            from egolane_pgm.recordings import mcap_file

            return mcap_file
    return rosbag
