"""MCAP files of JSON, of protobuf (Foxglove's SDKs) and of CDR outside ROS 2's own profile."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from egolane_pgm.recordings.containers import Topics, reading, time_of
from egolane_pgm.recordings.mapping import Message
from egolane_pgm.recordings.rosbag import plain
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError

with needed("an .mcap file outside ROS 2", "mcap"):
    from mcap.reader import McapReader, make_reader
    from mcap.records import Schema

#: What makes a dict of the bytes of a message.
_Decode = Callable[[bytes], Any]


def topics_of(path: Path, definitions: Path | None) -> Topics:
    """See `recordings.containers`. Without a summary at its end the whole file is read."""
    found: Topics = {}
    with _open(path) as reader:
        summary = reader.get_summary()
        if summary is not None and summary.statistics is not None:
            counts = summary.statistics.channel_message_counts
            channels = [(summary.channels[k], count) for k, count in counts.items() if count]
            each = [(summary.schemas.get(c.schema_id), c, count) for c, count in channels]
        else:
            each = [(schema, channel, 1) for schema, channel, _ in reader.iter_messages()]
        for schema, channel, count in each:
            kind = f"{schema.name if schema else 'no schema'}, {channel.message_encoding}"
            number = found.get(channel.topic, (kind, 0))[1] or 0
            found[channel.topic] = (kind, number + count)
    return found


def messages(
    path: Path, topics: Collection[str] | None, definitions: Path | None
) -> Iterator[Message]:
    """See `recordings.containers`. Raises InputError for an encoding that is not known here."""
    decoders: dict[int, _Decode] = {}
    with _open(path) as reader:
        for schema, channel, message in reader.iter_messages(topics):
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(path, channel.message_encoding, schema)
            value = decoders[channel.id](message.data)
            yield Message(time_of(value, message.log_time), channel.topic, value)


@contextmanager
def _open(path: Path) -> Iterator[McapReader]:
    cure = "; if it was cut off or damaged, try `mcap recover`"
    with reading(path, "MCAP", cure), path.open("rb") as file:
        yield make_reader(file)


def _decoder(path: Path, encoding: str, schema: Schema | None) -> _Decode:
    if encoding == "json":
        return json.loads
    if encoding == "protobuf":
        with needed("an .mcap file of protobuf", "mcap"):
            from mcap_protobuf.decoder import DecoderFactory
        decode: Any = DecoderFactory().decoder_for(encoding, schema)
        return lambda data: _plain(decode(data))
    if encoding in ("cdr", "ros1") and schema is not None:
        store, text = get_typestore(Stores.EMPTY), schema.data.decode()
        is_idl = schema.encoding == "ros2idl"
        types = get_types_from_idl(text) if is_idl else get_types_from_msg(text, schema.name)
        store.register(types)
        read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        return lambda data: plain(read(data, schema.name))
    raise InputError(f"{path}: messages encoded as {encoding or 'nothing known'} cannot be read")


def _plain(value: Any) -> Any:
    """A message of protobuf as a dict of its fields, those in it likewise; what is not set has its
    default, and a message that is not set is None."""
    if isinstance(value, (str, bytes)):
        return value
    if hasattr(value, "items"):
        return {key: _plain(each) for key, each in value.items()}
    if hasattr(value, "__len__"):
        return [_plain(each) for each in value]
    if not hasattr(value, "DESCRIPTOR"):
        return value
    return {
        field.name: _plain(getattr(value, field.name))
        if field.is_repeated or field.message_type is None or value.HasField(field.name)
        else None
        for field in value.DESCRIPTOR.fields
    }
