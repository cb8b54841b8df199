"""Messages as columns, one field of all messages at a time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from rosbags.interfaces import Nodetype

#: The fields of N messages by their paths, such as `header.seq`: N values each. A field that is a
#: list of messages is a DataFrame with a row per entry; its index is the number of the message.
Fields = dict[str, Any]


def stamp_of(value: Any) -> Any:
    """The seconds of a time stamp of ROS or Foxglove, a dict with its parts; else None."""
    if not isinstance(value, Mapping) or "sec" not in value:
        return None
    nanoseconds = value.get("nanosec", value.get("nsec"))
    return None if nanoseconds is None else value["sec"] + nanoseconds / 1e9


# --- ROS 1 and ROS 2 -----------------------------------------------------------------------------


def fields_of_objects(messages: Sequence[Any], kind: str, fielddefs: Mapping[str, Any]) -> Fields:
    """The fields of messages of one type that rosbags has read, without texts.

    - fielddefs: fields of each type, from a typestore of rosbags.
    """
    found: Fields = {}
    for name, (node, detail) in fielddefs[kind][1]:
        values = [getattr(message, name) for message in messages]
        if node == Nodetype.NAME:
            inner = fields_of_objects(values, detail, fielddefs)
            stamp = stamp_of(inner)
            fields = {f"{name}.{each}": column for each, column in inner.items()}
            found |= fields if stamp is None else {name: stamp}
        elif node == Nodetype.BASE:
            found |= {} if detail[0] == "string" else {name: np.array(values)}
        elif detail[0][0] == Nodetype.NAME:
            entries = [entry for each in values for entry in each]
            of = np.repeat(np.arange(len(values)), [len(each) for each in values])
            inner = fields_of_objects(entries, detail[0][1], fielddefs)
            # Lists of messages inside of an entry are left out.
            flat = {n: each for n, each in inner.items() if not isinstance(each, pd.DataFrame)}
            found[name] = pd.DataFrame(flat, index=of)
        elif detail[0][1][0] != "string":
            found[name] = np.fromiter(values, dtype=object)
    return found


# --- JSON ----------------------------------------------------------------------------------------


def fields_of_dicts(messages: Iterable[Mapping[str, Any]]) -> Fields:
    """The fields of messages that are dicts."""
    found: Fields = {}
    for name, cells in pd.DataFrame([_flat(message) for message in messages]).items():
        is_list = cells.map(lambda cell: isinstance(cell, list))
        entries = cells[is_list].explode().dropna()
        is_dict = entries.map(lambda entry: isinstance(entry, Mapping))
        if is_list.any() and is_dict.all():
            found[str(name)] = pd.DataFrame([_flat(each) for each in entries], index=entries.index)
        else:
            found[str(name)] = cells
    return found


def _flat(message: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a message by their paths."""
    found: dict[str, Any] = {}
    for name, value in message.items():
        if (stamp := stamp_of(value)) is not None:
            found[name] = stamp
        elif isinstance(value, Mapping):
            found |= {f"{name}.{key}": each for key, each in _flat(value).items()}
        else:
            found[name] = value
    return found
