"""Files of messages on topics: bags, MCAP, MDF4, CAN logs, openpilot's logs.

Each kind is read by one file of this folder through the kind's own library. It has two functions,
`topics_of` and `messages`, which take the arguments of those here.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import LinesMapping
from egolane_pgm.recordings import format_of, mapping
from egolane_pgm.recordings.fields import Table
from egolane_pgm.recordings.mapping import Message
from egolane_pgm.types import InputError, LineLog, near_word

#: The topics of the lines in the published recordings and in what `egolane plot` writes.
TOPICS = ("/isis_line_detector/lines", "/lines")

#: What a file has on its topics: the type of the messages, and how many there are.
Topics = dict[str, tuple[str, int | None]]

#: The file of this folder that reads a format.
_READERS = {"mdf": "mdf_file", "can": "can_log", "openpilot": "openpilot_log"}

#: What `definitions` names, for the kinds that do not define their messages themselves.
_NEEDED = {
    "can_log": "is a log of CAN frames: name the .dbc that defines their signals",
    "openpilot_log": "is a log of openpilot: name the cereal/log.capnp of a checkout of openpilot",
}


def topics_of(path: str | Path, *, definitions: str | Path | None = None) -> Topics:
    """The topics of a file of messages: for each the type of its messages, and how many there are,
    or None where only reading them tells.

    - definitions: what says how the bytes of a message are to be read, where the file does not: the
      .dbc of a CAN log, openpilot's cereal/log.capnp, the folder of the .msg files of a ROS 2 bag
      from before Iron.

    Raises InputError for a file that is missing or cannot be read, or needs definitions.
    """
    reader, *files = _opened(path, definitions)
    topics: Topics = reader.topics_of(*files)
    return topics


def messages(
    path: str | Path,
    topics: Collection[str] | None = None,
    *,
    definitions: str | Path | None = None,
) -> Iterator[Message]:
    """The messages of a file in the order of their recording. The time of one is the stamp in its
    header, or else when it was recorded, seconds.

    - topics: those that are read; None for all.
    - definitions: as for `topics_of`.

    Raises InputError as `topics_of`, for a topic that is not there, with those that are, and for a
    file that holds no message on them.
    """
    reader, file, defined = _opened(path, definitions)
    if topics is not None:
        topics = _known(file, topics, reader.topics_of(file, defined))
    is_empty = True
    for message in reader.messages(file, topics, defined):
        is_empty = False
        yield message
    if is_empty:
        raise InputError(
            f"{file}: holds no messages{' on ' if topics else ''}{', '.join(topics or ())}"
        )


def read_messages(
    path: str | Path,
    *,
    topic: str | None = None,
    frame_rate: float = mapping.FRAME_RATE,
    lines: LinesMapping | None = None,
    definitions: str | Path | None = None,
) -> LineLog:
    """Read the lines of a file of messages, T frames of at most L lines.

    - topic: of the lines; by default one of TOPICS, or the only one.
    - frame_rate: frames per second of messages with frame ids but without times.
    - lines: which fields are what; by default those of the published recordings, or our own names.
    - definitions: as for `topics_of`.

    Raises InputError as `messages` and `recordings.mapping.lines_of`.
    """
    whole = mapping.whole_mapping(lines, str(path))
    if topic is not None and not mapping.topics_of(whole):
        whole = whole.model_copy(update={"topic": topic})
    wanted = mapping.topics_of(whole)
    if not wanted:
        there = topics_of(path, definitions=definitions)
        wanted = tuple(name for name in (*TOPICS, *there) if name in there)[:1]
        if len(there) > 1 and wanted[0] not in TOPICS:
            raise InputError(
                f"{path}: topic: is missing; the file has {_listed(there)} (`egolane inspect`)"
            )
    found = list(messages(path, wanted, definitions=definitions))
    if whole.offset is None and {"lines", "way_id"} <= found[0].value.keys():
        whole, found = _published(Path(path), whole, found, frame_rate)
    return mapping.lines_of(found, whole, str(path), frame_rate=frame_rate)


def _published(
    path: Path, keys: LinesMapping, found: list[Message], frame_rate: float
) -> tuple[LinesMapping, list[Message]]:
    """The mapping of the published recordings, and their messages with times that increase.

    The stamps of the published ROS 1 bags say when they were processed, jump by minutes or are all
    zero: time is frame id over frame rate there.
    """
    is_ros1 = path.suffix == ".bag"
    preset = "rle" if is_ros1 else "rle_ros2"
    keys = mapping.whole_mapping(keys.model_copy(update={"preset": preset}), str(path))
    columns = mapping.columns_of([message.value for message in found], str(path))
    if keys.time is not None or keys.frame_id is None:
        return keys, found
    ids = Table(columns, len(found), path).numbers("frame_id", keys.frame_id)[0].astype(np.int64)
    for one, other in pairwise(ids):
        if other <= one:
            raise InputError(
                f"{path}: frame ids must increase, but {one} is followed by {other}; split the file"
                " there, or, where it does not fill in way_id, take `lines: {frame_id: header.seq}`"
                " (ROS 1) or `{frame_id: null}`, which numbers frames by their times"
            )
    backwards = np.diff([message.time_s for message in found]) <= 0
    if backwards.any() and not is_ros1:
        one, other = ids[np.argmax(backwards) :][:2]
        said = f"{path}: the stamps of frames {one} and {other} do not increase"
        warnings.warn(f"{said}; time is frame id over frame rate", UserWarning, stacklevel=4)
    if is_ros1 or backwards.any():
        pairs = zip(ids.tolist(), found, strict=True)
        found = [message._replace(time_s=k / frame_rate) for k, message in pairs]
    return keys, found


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
    second = nano = 0
    if isinstance(stamp, dict):
        second, nano = (
            next((int(stamp[name]) for name in names if name in stamp), 0)
            for names in (mapping.SECONDS, mapping.NANOSECONDS)
        )
    # Nanoseconds since 1970 have more digits than a float.
    return second + nano / 1e9 if second or nano else logged_ns // 10**9 + logged_ns % 10**9 / 1e9


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


def _known(path: Path, topics: Collection[str], there: Topics) -> list[str]:
    """Some topics as the file calls them. Raises InputError for one that is not there."""
    names = {name.strip("/"): name for name in there}
    for topic in topics:
        if topic.strip("/") not in names:
            meant = near_word(topic, there)
            raise InputError(f"{path}: no topic {topic}{meant}; the file has {_listed(there)}")
    return [names[topic.strip("/")] for topic in topics]


def _listed(topics: Topics) -> str:
    return ", ".join(f"{name} ({kind})" for name, (kind, _) in sorted(topics.items())) or "none"


def _opened(path: str | Path, definitions: str | Path | None) -> tuple[Any, Path, Path | None]:
    """What reads a file, the file, and what defines its messages."""
    path, found = Path(path), None if definitions is None else Path(definitions)
    for file in (path, found):
        if file is not None and not file.exists():
            raise InputError(f"{file}: no such file")
    name = "rosbag" if path.is_dir() else _READERS.get(format_of(path), "rosbag")
    if name == "mdf_file" and found is not None:
        name = "can_log"
    if path.suffix.lower() == ".mcap" and path.is_file():
        with path.open("rb") as opened:
            head = opened.read(25)
        # rosbags reads MCAP files of ROS 2, and says what is wrong with what is no MCAP.
        if head.startswith(b"\x89MCAP") and head[17:] != b"\x04\0\0\0ros2":
            name = "mcap_file"
    if name in _NEEDED and found is None:
        raise InputError(f"{path}: {_NEEDED[name]} (recording.definitions)")
    return import_module(f"egolane_pgm.recordings.{name}"), path, found
