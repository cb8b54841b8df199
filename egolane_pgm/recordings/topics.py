"""Lines from bags and MCAP files: messages on topics.

A message is a line, a frame with a field for each line, or a frame with a list of lines. Its fields
are columns (`recordings.columns`). A nested field has the path as name, `header.seq`; the fields of
a list of lines keep their own names.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import files_of, rosbag
from egolane_pgm.recordings.columns import FRAME_RATE, OF_LINE
from egolane_pgm.recordings.decoding import Fields, fields_of_dicts
from egolane_pgm.recordings.lines import lines_of_columns
from egolane_pgm.recordings.rosbag import Message, Topics
from egolane_pgm.types import InputError, LineLog, near_word

#: The topics of lines in the published recordings and in MCAP files of a result.
TOPICS = ("/isis_line_detector/lines", "/lines")

#: The columns of the published messages of lines, in ROS 1 and in ROS 2.
_PUBLISHED = {
    "frame_id": "way_id",
    "offset_m": "offset",
    "is_continuous": "continuous",
    "lri": "counter",
}


def topics_of(path: str | Path) -> Topics:
    """The topics of a file: message type and number of messages.

    Raises InputError for a file that is missing or cannot be read.
    """
    with _opened(Path(path)) as (library, file):
        topics: Topics = library.topics_of(file)
    return topics


def messages(path: str | Path, topic: str) -> Iterator[Message]:
    """The messages on a topic, in the order of recording.

    Raises InputError as `topics_of`, for an unknown topic, and for one without messages.
    """
    with _opened(Path(path)) as (library, file):
        there = library.topics_of(file)
        n_read = 0
        for message in library.messages(file, _find_topic(there, topic)):
            n_read += 1
            yield message
        _check_count(path, topic, n_read, there[topic][1], library.CURE)


def fields_of(path: Path, topic: str | None = None) -> Fields:
    """The fields of all messages on a topic (by default the one with lines), and their times
    `time_s` in seconds. Raises InputError as `messages`."""
    with _opened(path) as (library, file):
        there = library.topics_of(file)
        topic = _find_topic(there, topic)
        fields: Fields = library.fields_of(file, topic)
        _check_count(path, topic, len(fields["time_s"]), there[topic][1], library.CURE)
    return fields


def _check_count(path: str | Path, topic: str, n_read: int, n_counted: int, cure: str) -> None:
    """Warn of messages that the file counts but its index lacks."""
    if n_read < n_counted:
        missing = f"{path}: only {n_read} of {n_counted} messages on {topic} can be read{cure}"
        warnings.warn(missing, UserWarning, stacklevel=4)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The module that reads a file, and the open file. Raises InputError for a missing one."""
    library: Any = rosbag
    if not os.path.exists(path):
        raise InputError(f"{path}: no such file")
    files = files_of(path) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: the folder is empty")
    if files[0].suffix.lower() == ".mcap":
        with files[0].open("rb") as opened:
            head = opened.read(25)
        # rosbags reads MCAP files of ROS 2, and refuses other files.
        if head.startswith(b"\x89MCAP") and head[17:] != b"\x04\0\0\0ros2":
            from egolane_pgm.recordings import mcap_file as library

            if len(files) > 1:
                raise InputError(f"{path}: has {len(files)} MCAP files; give one, {files[0]}")
            [path] = files
    with library.opened(path) as file:
        yield library, file


def _find_topic(there: Topics, topic: str | None) -> str:
    """Check a topic; by default find the one with lines."""
    if topic is None:
        topic = next((name for name in TOPICS if name in there), None)
        topic = next(iter(there)) if topic is None and len(there) == 1 else topic
    if topic in there and there[topic][1]:
        return topic
    if topic in there:
        raise InputError(f"holds no messages on {topic}")
    problem = f"no topic {topic}{near_word(topic, there)}" if topic else "topic: is missing"
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

    Raises InputError as `messages` and `recordings.lines.lines_of_columns`.
    """
    path = Path(path)
    names: Any = columns or Columns()
    table = table_of(fields_of(path, topic), names)
    if names.get("offset_m") is None and {"line", "way_id"} <= {*table}:
        is_valid = "isValid" if "isValid" in table else "is_valid"
        names = {**_PUBLISHED, "is_valid": is_valid, **names}
        if path.suffix == ".bag" and names["frame_id"] in table and names.get("time_s") is None:
            # The stamps of the published ROS 1 bags are times of processing: they jump by minutes
            # or are zero. Time is frame id over frame rate there.
            names["time_s"] = None
    return lines_of_columns(table, names, path, frame_rate, row=table.index.to_numpy())


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

    Raises InputError as `recordings.lines.lines_of_columns`.

    >>> from egolane_pgm.recordings.topics import lines_of_messages
    >>> from egolane_pgm.experiment import Columns
    >>> message = {"t": 12.0, "lanes": [{"c0": 1.8}, {"c0": -1.7}]}
    >>> columns = Columns(time_s="t", offset_m="c0", left_positive=True)
    >>> lines_of_messages([message], columns, "drive.mcap").offset_m.tolist()
    [[-1.8, 1.7]]
    """
    table = table_of(fields_of_dicts(messages), columns or Columns())
    row = table.index.to_numpy()
    return lines_of_columns(table, columns, Path(where), frame_rate, first=first, row=row)


def table_of(fields: Fields, columns: Columns | None = None) -> pd.DataFrame:
    """The columns of messages; the index is the number of the message.

    Messages with a list of lines (`lines`, or their only list) have a row per line, or an empty
    one; other messages have one row.

    - columns: names of the fields of a line, for lists that are empty in every message.
    """
    lists = [name for name, values in fields.items() if isinstance(values, pd.DataFrame)]
    table = pd.DataFrame({name: each for name, each in fields.items() if name not in lists})
    if "lines" not in lists and len(lists) != 1:
        # For messages that name what there is.
        return table.assign(**dict.fromkeys(lists))
    lines = fields["lines" if "lines" in lists else lists[0]]
    if not len(lines.columns) and columns is not None:
        given: Mapping[str, Any] = columns
        lines = lines.reindex(columns=[given.get(n) or n for n in ("offset_m", *OF_LINE)])
    # The number of the line; NaN in messages without lines.
    lines = lines.assign(line=lines.groupby(level=0).cumcount() + 1)
    return table.drop(columns=lines.columns, errors="ignore").join(lines)
