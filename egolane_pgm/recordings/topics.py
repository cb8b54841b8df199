"""Lines from bags and MCAP files: messages on topics.

A message is a line, a frame with a field for each line, or a frame with a list of lines. Its fields
are columns (`recordings.columns`). A nested field has the path as name, `header.seq`; the fields of
a list of lines keep their own names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import rosbag
from egolane_pgm.recordings.columns import FRAME_RATE, OF_LINE, arrow_column, lines_of_columns
from egolane_pgm.recordings.decoding import Fields, Items, fields_of_dicts
from egolane_pgm.recordings.rosbag import Message, Topics
from egolane_pgm.types import InputError, IntArray, LineLog, near_word

#: The topics of lines in the published recordings and in MCAP files of a result.
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
    """The topics of a file: message type and number of messages.

    Raises InputError for a file that is missing or cannot be read.
    """
    library = _library(Path(path))
    with library.opened(Path(path)) as file:
        topics: Topics = library.topics_of(file)
    return topics


def messages(path: str | Path, topic: str) -> Iterator[Message]:
    """The messages on a topic, in the order of recording.

    Raises InputError as `topics_of`, for an unknown topic, and for one without messages.
    """
    library, is_empty = _library(Path(path)), True
    with library.opened(Path(path)) as file:
        _find_topic(library.topics_of(file), topic)
        for message in library.messages(file, topic):
            is_empty = False
            yield message
        if is_empty:
            raise InputError(f"holds no messages on {topic}")


def fields_of(path: Path, topic: str | None = None) -> Fields:
    """The fields of all messages on a topic (by default the one with lines), and their times
    `time_s` in seconds. Raises InputError as `messages`."""
    library = _library(path)
    with library.opened(path) as file:
        topic = _find_topic(library.topics_of(file), topic)
        fields: Fields = library.fields_of(file, topic)
        if not fields:
            raise InputError(f"holds no messages on {topic}")
    return fields


def _library(path: Path) -> Any:
    """The module that reads a file. Raises InputError if there is no such file."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() == ".mcap" and path.is_file():
        with path.open("rb") as opened:
            head = opened.read(25)
        # rosbags reads MCAP files of ROS 2, and refuses what is no MCAP file.
        if head.startswith(b"\x89MCAP") and head[17:] != b"\x04\0\0\0ros2":
            from egolane_pgm.recordings import mcap_file

            return mcap_file
    return rosbag


def _find_topic(there: Topics, topic: str | None) -> str:
    """Check a topic; by default find the one with lines."""
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
    raise InputError(f"{problem}; the file has {listed or 'none'} (see `egolane show FILE`)")


# --- lines ---------------------------------------------------------------------------------------


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
    - columns: names of the fields; by default the published ones, or our own.

    Raises InputError as `messages` and `recordings.columns.lines_of_columns`.
    """
    path = Path(path)
    names = columns or Columns()
    table, row = table_of(fields_of(path, topic), names)
    if names.get("offset_m") is None and {"line", "way_id"} <= table.keys():
        is_ros1 = path.suffix == ".bag"
        published: Any = {**_PUBLISHED, "is_valid": _VALID[is_ros1], **names}
        names = published
        begins = np.flatnonzero(np.diff(row, prepend=-1))
        frame_id = names.get("frame_id")
        if frame_id in table:
            if (np.diff(np.asarray(table[frame_id])[begins]) == 0).any():
                raise InputError(
                    f"{path}: {frame_id} stays the same from message to message; `columns:"
                    " {frame_id: null}` numbers frames by their times"
                )
            if is_ros1 and names.get("time_s") is None:
                # The stamps of the published ROS 1 bags are times of processing: they jump by
                # minutes or are zero. Time is frame id over frame rate there.
                del table["time_s"]
    return lines_of_columns(table, names, path, frame_rate, row=row)


def lines_of_messages(
    messages: Sequence[Mapping[str, Any]],
    columns: Columns | None,
    where: str,
    frame_rate: float = FRAME_RATE,
    first: int = 0,
) -> LineLog:
    """The lines of messages that are dicts, T frames of at most L lines.

    - columns: names of the fields; None for our own.
    - where: the source, for messages.
    - frame_rate: frames per second of messages with frame ids but without times.
    - first: first frame id, if frames are numbered by their times.

    Raises InputError as `recordings.columns.lines_of_columns`.

    >>> from egolane_pgm.recordings.topics import lines_of_messages
    >>> from egolane_pgm.experiment import Columns
    >>> message = {"t": 12.0, "lanes": [{"c0": 1.8}, {"c0": -1.7}]}
    >>> columns = Columns(time_s="t", offset_m="c0", left_positive=True)
    >>> lines_of_messages([message], columns, "drive.mcap").offset_m.tolist()
    [[-1.8, 1.7]]
    """
    table, row = table_of(fields_of_dicts(messages, where), columns or Columns())
    return lines_of_columns(table, columns, Path(where), frame_rate, first=first, row=row)


def table_of(fields: Fields, columns: Columns | None = None) -> tuple[dict[str, Any], IntArray]:
    """The columns of messages, and the message of each row, (N,).

    Messages with a list of lines (`lines`, or their only list) have a row per line, or an empty
    one; other messages have one row.

    - columns: names of the fields of a line, for lists that are empty in every message.
    """
    lists = [name for name, values in fields.items() if isinstance(values, Items)]
    of_lines = "lines" if "lines" in lists else lists[0] if len(lists) == 1 else None
    table = {name: arrow_column(each) for name, each in fields.items() if name not in lists}
    if of_lines is None:
        # Columns of the lists, for messages that name what there is.
        table |= {name: pa.array([[None] * n for n in fields[name].counts]) for name in lists}
        return table, np.arange(len(next(iter(table.values()), ())))
    counts, of_line = fields[of_lines]
    if not of_line and columns is not None:
        given: Mapping[str, Any] = columns
        names = [given.get(name) or name for name in ("offset_m", *OF_LINE)]
        of_line = dict.fromkeys(names, pa.nulls(0))
    rows = np.maximum(counts, 1)
    row = np.repeat(np.arange(len(counts)), rows)
    is_empty = (counts == 0)[row]
    number = np.arange(len(row)) - (np.cumsum(rows) - rows)[row] + 1
    line = pa.array(np.cumsum(~is_empty) - 1, mask=is_empty)
    table = {name: values.take(pa.array(row)) for name, values in table.items()}
    table["line"] = pa.array(number, mask=is_empty)
    return table | {name: arrow_column(each).take(line) for name, each in of_line.items()}, row
