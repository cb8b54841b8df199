"""MCAP files of JSON messages."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from egolane_pgm.recordings.rosbag import Message, Topics, reading, time_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError

with needed("an .mcap file outside ROS 2", "mcap"):
    from mcap.reader import McapReader, make_reader

_CURE = "; if it was cut off or damaged, try `mcap recover`"


def topics_of(path: Path) -> Topics:
    """See `recordings.topics`."""
    found: Topics = {}
    with _open(path) as reader:
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise InputError(f"{path}: has no summary at its end{_CURE}")
        for key, count in summary.statistics.channel_message_counts.items():
            channel = summary.channels[key]
            schema = summary.schemas.get(channel.schema_id)
            kind = f"{schema.name if schema else 'no schema'}, {channel.message_encoding}"
            found[channel.topic] = (kind, found.get(channel.topic, (kind, 0))[1] + count)
    return found


def messages(path: Path, topics: Collection[str]) -> Iterator[Message]:
    """See `recordings.topics`. Raises InputError for messages that are not JSON."""
    with _open(path) as reader:
        for _, channel, message in reader.iter_messages(topics):
            if channel.message_encoding != "json":
                raise InputError(
                    f"{path}: messages encoded as {channel.message_encoding or 'nothing known'}"
                    " cannot be read; those of ROS 2 can, and JSON"
                )
            value = json.loads(message.data)
            yield Message(time_of(value, message.log_time), channel.topic, value)


@contextmanager
def _open(path: Path) -> Iterator[McapReader]:
    with reading(path, "MCAP", _CURE), path.open("rb") as file:
        yield make_reader(file)
