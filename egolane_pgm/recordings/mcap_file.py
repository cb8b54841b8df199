"""MCAP files of JSON messages, with the same functions as `recordings.rosbag`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from egolane_pgm.recordings.decoding import Fields, fields_of_dicts
from egolane_pgm.recordings.rosbag import Message, Topics, time_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import reading
from egolane_pgm.types import InputError

with needed("an .mcap file outside ROS 2", "mcap"):
    from mcap.reader import McapReader, make_reader

CURE = "; if it was cut off or damaged, try `mcap recover`"


@contextmanager
def opened(path: Path) -> Iterator[McapReader]:
    """Open a file. Raises InputError for any error of mcap, also inside the block."""
    with reading(path, "MCAP", CURE), path.open("rb") as file:
        yield make_reader(file)


def topics_of(reader: McapReader) -> Topics:
    """The topics of a file, with type and encoding of their messages."""
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ValueError("no summary at its end")
    found: Topics = {}
    for key, count in summary.statistics.channel_message_counts.items():
        channel = summary.channels[key]
        schema = summary.schemas.get(channel.schema_id)
        kind = f"{schema.name if schema else 'no schema'}, {channel.message_encoding}"
        found[channel.topic] = (kind, count)
    return found


def messages(reader: McapReader, topic: str) -> Iterator[Message]:
    """The messages on a topic. Raises InputError for messages that are not JSON."""
    for _, channel, message in reader.iter_messages([topic]):
        if channel.message_encoding != "json":
            raise InputError(
                f"{topic}: the encoding '{channel.message_encoding}' cannot be read, only JSON"
                " and files with the profile ros2"
            )
        value = json.loads(message.data)
        yield time_of(value, message.log_time), value


def fields_of(reader: McapReader, topic: str) -> Fields:
    """The fields of all messages on a topic, and their times."""
    found = messages(reader, topic)
    return fields_of_dicts({"time_s": time_s, **value} for time_s, value in found)
