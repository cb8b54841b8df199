"""openpilot's logs, rlog and qlog, by its own schema, the cereal/log.capnp of a checkout of it.
Each kind of event is a topic: modelV2, carState, ..."""

from __future__ import annotations

import bz2
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from egolane_pgm.recordings.containers import Topics, reading
from egolane_pgm.recordings.mapping import Message
from egolane_pgm.tools.extras import needed

with needed("a log of openpilot", "openpilot"):
    import capnp
    import zstandard


def topics_of(path: Path, definitions: Path) -> Topics:
    """See `recordings.containers`: the kinds of events of the schema, in the log or not."""
    return dict.fromkeys(_schema(definitions).Event.schema.union_fields, ("event", None))


def messages(path: Path, topics: Collection[str] | None, definitions: Path) -> Iterator[Message]:
    """See `recordings.containers`. Times are logMonoTime, since the device was started."""
    schema, raw = _schema(definitions), path.read_bytes()
    with reading(path, "a log of openpilot"):
        if raw.startswith(b"BZh"):
            raw = bz2.decompress(raw)
        elif raw.startswith(b"\x28\xb5\x2f\xfd"):
            raw = zstandard.ZstdDecompressor().decompressobj().decompress(raw)
        for event in schema.Event.read_multiple_bytes(raw):
            kind = str(event.which())
            if topics is None or kind in topics:
                value = getattr(event, kind)
                fields = value.to_dict() if hasattr(value, "to_dict") else {"value": value}
                yield Message(event.logMonoTime / 1e9, kind, fields)


def _schema(definitions: Path) -> Any:
    with reading(definitions, "a schema of Cap'n Proto"):
        # The parser of `capnp.load` ends the program at a second checkout with the same ids.
        return capnp.SchemaParser().load(str(definitions))
