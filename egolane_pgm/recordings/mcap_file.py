"""MCAP files of JSON, and of CDR outside ROS 2's own profile."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from egolane_pgm.recordings.rosbag import Message, Topics, plain, reading, time_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError

with needed("an .mcap file outside ROS 2", "mcap"):
    from mcap.reader import McapReader, make_reader
    from mcap.records import Schema

_CURE = "; if it was cut off or damaged, try `mcap recover`"

#: What makes a dict of the bytes of a message.
_Decode = Callable[[bytes], Any]


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


def messages(path: Path, topics: Collection[str] | None) -> Iterator[Message]:
    """See `recordings.topics`. Raises InputError for an encoding that is not known here."""
    decoders: dict[int, _Decode] = {}
    with _open(path) as reader:
        for schema, channel, message in reader.iter_messages(topics):
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(path, channel.message_encoding, schema)
            value = decoders[channel.id](message.data)
            yield Message(time_of(value, message.log_time), channel.topic, value)


@contextmanager
def _open(path: Path) -> Iterator[McapReader]:
    with reading(path, "MCAP", _CURE), path.open("rb") as file:
        yield make_reader(file)


def _decoder(path: Path, encoding: str, schema: Schema | None) -> _Decode:
    if encoding == "json":
        return json.loads
    if encoding in ("cdr", "ros1") and schema is not None:
        store, text = get_typestore(Stores.EMPTY), schema.data.decode()
        is_idl = schema.encoding == "ros2idl"
        types = get_types_from_idl(text) if is_idl else get_types_from_msg(text, schema.name)
        store.register(types)
        read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        return lambda data: plain(read(data, schema.name))
    raise InputError(f"{path}: messages encoded as {encoding or 'nothing known'} cannot be read")
