"""Logs of raw CAN frames (.blf, .asc, .trc, candump's .log, .mf4) with the .dbc that defines their
messages; each message of the .dbc is a topic, its signals are the fields."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from egolane_pgm.recordings.containers import Topics, reading
from egolane_pgm.recordings.mapping import Message
from egolane_pgm.tools.extras import needed

with needed("a log of CAN frames", "can"):
    import can
    import cantools


def topics_of(path: Path, definitions: Path) -> Topics:
    """See `recordings.containers`: the messages of the .dbc, in the log or not."""
    return {each.name: (f"CAN {each.frame_id:#x}", None) for each in _defined(definitions)}


def messages(path: Path, topics: Collection[str] | None, definitions: Path) -> Iterator[Message]:
    """See `recordings.containers`. Signals are physical values; codes with a name stay codes, and
    signals of a frame that is shorter than it should be are left out."""
    known = {
        (each.frame_id, each.is_extended_frame): each
        for each in _defined(definitions)
        if topics is None or each.name in topics
    }
    with reading(path, "a log of CAN frames"), can.LogReader(path) as log:
        for frame in log:
            found = known.get((frame.arbitration_id, frame.is_extended_id))
            if found is not None and not frame.is_error_frame and not frame.is_remote_frame:
                value = found.decode(frame.data, decode_choices=False, allow_truncated=True)
                yield Message(frame.timestamp, found.name, value)


def _defined(definitions: Path) -> Any:
    with reading(definitions, "a .dbc"):
        database: Any = cantools.database.load_file(definitions)
        return database.messages
