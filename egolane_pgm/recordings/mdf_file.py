"""Measurement files, MDF 4 and 3, whose channels are signals; each channel group is a topic.

One that holds raw CAN frames is read with the .dbc that defines them: see `recordings.can_log`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from heapq import merge
from operator import attrgetter
from pathlib import Path
from typing import Any

from egolane_pgm.recordings.containers import Topics, reading
from egolane_pgm.recordings.mapping import Message
from egolane_pgm.tools.extras import needed

with needed("a measurement file (MDF)", "can"):
    from asammdf import MDF


def topics_of(path: Path, definitions: Path | None) -> Topics:
    """See `recordings.containers`."""
    with _open(path) as file:
        return {
            name: ("channel group", file.groups[k].channel_group.cycles_nr)
            for name, k in _groups(file).items()
        }


def messages(
    path: Path, topics: Collection[str] | None, definitions: Path | None
) -> Iterator[Message]:
    """See `recordings.containers`: a message for each row of a group, its channels by name; codes
    with a text stay codes. Times are since 1970, where the file says when it began."""
    with _open(path) as file:
        began = file.header.start_time.timestamp()

        def rows(topic: str, group: int) -> Iterator[Message]:
            frame = file.get_group(group, time_from_zero=False, ignore_value2text_conversions=True)
            for time_s, cells in zip(frame.index, frame.to_dict("records"), strict=True):
                yield Message(began + time_s, topic, cells)

        chosen = [each for each in _groups(file).items() if topics is None or each[0] in topics]
        yield from merge(*(rows(*each) for each in chosen), key=attrgetter("time_s"))


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    with reading(path, "MDF"), MDF(path) as file:
        yield file


def _groups(file: Any) -> dict[str, int]:
    """The channel groups that have rows, by name: their own, or else what stands with them."""
    found: dict[str, int] = {}
    for k in file.virtual_groups:
        group = file.groups[k].channel_group
        if not group.cycles_nr:
            continue
        name = getattr(group, "acq_name", "") or getattr(group, "comment", "") or f"group {k}"
        found[f"{name} {k}" if name in found else name] = k
    return found
