"""Decode messages into columns, one field of all messages at a time.

rosbags makes an object of each message and of each line in it, which takes most of the time of
reading a drive; the decoder here is some ten times as fast.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from rosbags.interfaces import Nodetype

from egolane_pgm.types import BoolArray, IntArray

#: Types of fields that have another name in NumPy.
_DTYPES = {
    **dict.fromkeys(("bool", "byte", "char", "octet"), "u1"),
    "float32": "f4",
    "float64": "f8",
}

#: The parts of a time stamp in ROS 1, in ROS 2 and in Foxglove's schemas.
_SECONDS, _NANOSECONDS = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanos")

#: The fields of N messages by their paths, such as `header.seq`: N values each. A field that is a
#: list of messages is a DataFrame with a row per entry; its index is the number of the message.
Fields = dict[str, Any]


def stamp_of(value: Any) -> Any:
    """The seconds of a time stamp, a dict with its parts; None for anything else."""
    if not isinstance(value, Mapping):
        return None
    seconds, nanoseconds = (
        next((value[name] for name in names if name in value), None)
        for names in (_SECONDS, _NANOSECONDS)
    )
    return None if seconds is None or nanoseconds is None else seconds + nanoseconds / 1e9


# --- ROS 1 and ROS 2 -----------------------------------------------------------------------------


class Decoder:
    """Decodes messages of one type.

    - fielddefs: fields of each type, from a typestore of rosbags.
    - raw: the bytes of each message, little-endian.
    - is_cdr: ROS 2 encoding, which aligns numbers to multiples of their size.
    """

    def __init__(self, fielddefs: Mapping[str, Any], raw: Sequence[bytes], is_cdr: bool) -> None:
        self.fielddefs = fielddefs
        self.is_cdr = is_cdr
        self.bytes = b"".join(raw)
        self.array = np.frombuffer(self.bytes, np.uint8)
        self.end = np.cumsum([len(each) for each in raw])
        # CDR starts with four bytes; the second one is the byte order.
        self.start = np.concatenate([[0], self.end[:-1]]) + 4 * is_cdr
        #: Current position in each message.
        self.at = self.start.copy()

    def decode(self, kind: str) -> Fields:
        """Decode the fields of all messages. Raises ValueError for bytes of another type."""
        every = np.arange(len(self.end))
        if self.is_cdr:
            self._check(self.array[self.start - 3] != 1, every, "is not little-endian")
        found = self._message(kind, every)
        # CDR may be padded.
        self._check(self.end - self.at > 3 * self.is_cdr, every, f"is longer than a {kind}")
        return found

    def _message(self, kind: str, of: IntArray) -> Fields:
        """Read a message of some type at the current position of the messages `of` (N,).

        Texts, and lists inside the entries of a list, are left out.
        """
        found: Fields = {}
        for name, (node, detail) in self.fielddefs[kind][1]:
            if node == Nodetype.BASE:
                found[name] = self._values(detail[0], of)
            elif node == Nodetype.ARRAY:
                found[name] = self._list(detail[0], np.full(len(of), detail[1]), of)
            elif node == Nodetype.SEQUENCE:
                found[name] = self._list(detail[0], self._values("uint32", of).astype(int), of)
            else:
                inner = self._message(detail, of)
                stamp = stamp_of(inner)
                fields = {f"{name}.{each}": values for each, values in inner.items()}
                found |= fields if stamp is None else {name: stamp}
        return {name: values for name, values in found.items() if values is not None}

    def _list(self, item: tuple[Any, Any], counts: IntArray, of: IntArray) -> Any:
        """Read a list of counts (N,) entries: an array of numbers, or a DataFrame of messages."""
        node, detail = item
        is_text = node == Nodetype.BASE and detail[0] == "string"
        if node == Nodetype.BASE and not is_text:
            dtype = _dtype(detail[0])
            begin = self._skip(counts * dtype.itemsize, of, dtype.itemsize)
            each = zip(counts.tolist(), begin.tolist(), strict=True)
            arrays = (np.frombuffer(self.bytes, dtype, n, at) for n, at in each)
            return np.fromiter(arrays, dtype=object)
        # Read the first entry of all lists, then the second. One round without any entry gives the
        # names of the fields if all lists are empty.
        rows, parts = [], []
        for k in range(counts.max(initial=1)):
            rows.append(np.flatnonzero(counts > k))
            some = of[rows[-1]]
            parts.append(self._values("string", some) if is_text else self._message(detail, some))
        if is_text:
            return None
        names = [name for name, values in parts[0].items() if not isinstance(values, pd.DataFrame)]
        fields = {name: np.concatenate([part[name] for part in parts]) for name in names}
        return pd.DataFrame(fields, index=np.concatenate(rows)).sort_index(kind="stable")

    def _values(self, kind: str, of: IntArray) -> Any:
        """Read a number from each message, (N,), 0 or 1 for a flag. Skip texts; return None."""
        if kind == "string":
            self._skip(self._values("uint32", of).astype(int), of)
            return None
        dtype = _dtype(kind)
        begin = self._skip(np.full(len(of), dtype.itemsize), of, dtype.itemsize)
        return self.array[begin[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]

    def _skip(self, size: IntArray, of: IntArray, align: int = 1) -> IntArray:
        """Advance by some bytes, (N,), to the end of a value; return its begin."""
        begin = self.at[of]
        if self.is_cdr:
            begin = begin + np.where(size > 0, (self.start[of] - begin) % align, 0)
        self.at[of] = begin + size
        self._check(self.at[of] > self.end[of], of, "is cut off")
        return begin

    def _check(self, bad: BoolArray, of: IntArray, problem: str) -> None:
        if bad.any():
            raise ValueError(f"message {of[np.argmax(bad)] + 1} {problem}")


def _dtype(kind: str) -> np.dtype[Any]:
    return np.dtype(_DTYPES.get(kind, kind)).newbyteorder("<")


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
