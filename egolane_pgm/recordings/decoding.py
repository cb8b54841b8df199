"""Decodes the messages of a ROS type into columns, a field of all messages at a time.

A message of rosbags is an object with an object for each of its lines: of a drive of 12,000 frames
those are 80,000, and to make and walk them takes ten times as long as to read the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from egolane_pgm.types import IntArray

#: The types of a message's fields that NumPy calls otherwise.
_DTYPES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "float32": "f4",
    "float64": "f8",
}

#: The parts of a stamp as ROS 1, ROS 2 and Foxglove's schemas call them.
_SECONDS, _NANOSECONDS = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanos")

#: Columns by the path of their field, `header.seq`: N values each.
Fields = dict[str, Any]


class Items(NamedTuple):
    """A list of messages in each of N messages: how many there are, (N,), and their fields, those
    of the first message first."""

    counts: IntArray
    fields: Fields


def stamp_parts(value: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """Seconds and nanoseconds of a time stamp, None for anything else."""
    parts = [[value[name] for name in names if name in value] for names in (_SECONDS, _NANOSECONDS)]
    return (parts[0][0], parts[1][0]) if all(parts) else None


class Decoder:
    """Decodes messages of one type.

    - fielddefs: the fields of each type, see `rosbags.typesys.store.Typestore`.
    - raw: the bytes of each message, as in a bag.
    - is_cdr: whether they are of ROS 2, which aligns numbers to multiples of their size.
    """

    def __init__(self, fielddefs: Mapping[str, Any], raw: Sequence[bytes], is_cdr: bool) -> None:
        self.fielddefs = fielddefs
        self.is_cdr = is_cdr
        self.bytes = b"".join(raw)
        self.array = np.frombuffer(self.bytes, np.uint8)
        self.end = np.cumsum([len(each) for each in raw])
        #: Where each message is decoded next.
        self.at = np.concatenate([[0], self.end[:-1]])
        self.order: Literal["<", ">"] = "<"
        if is_cdr:
            self.order = "<" if self.bytes[1] else ">"
            self.at += 4
        self.start = self.at.copy()

    def decode(self, kind: str) -> Fields:
        """The fields of all messages. Raises ValueError for bytes that are not of that type."""
        found = self._message(kind, np.arange(len(self.end)))
        # CDR may be padded.
        left = self.end - self.at
        self._check(left > 3 * self.is_cdr, np.arange(len(left)), f"is longer than a {kind}")
        return found

    def _message(self, kind: str, of: IntArray) -> Fields:
        """The fields of a message that comes next in the messages `of` (N,)."""
        found: Fields = {}
        for name, (node, detail) in self.fielddefs[kind][1]:
            if node == Nodetype.BASE:
                found[name] = self._values(detail[0], of)
            elif node != Nodetype.NAME:
                found[name] = self._list(
                    detail[0], detail[1] if node == Nodetype.ARRAY else None, of
                )
            else:
                inner = self._message(detail, of)
                if (parts := stamp_parts(inner)) is not None:
                    found[name] = parts[0] + parts[1] / 1e9
                else:
                    found |= {f"{name}.{each}": values for each, values in inner.items()}
        return found

    def _list(self, item: tuple[Any, Any], length: int | None, of: IntArray) -> Any:
        """The lists that come next: Items of messages, an array (N,) of lists of anything else.

        length: of each, None where the messages say it.
        """
        count = np.full(len(of), length) if length else self._values("uint32", of).astype(np.int64)
        self._check(count > (self.end - self.at)[of], of, "is cut off")
        node, detail = item
        if node == Nodetype.BASE and detail[0] != "string":
            dtype = self._dtype(detail[0])
            self._align(dtype.itemsize, of[count > 0])
            begin = self._skip(count * dtype.itemsize, of)
            each = zip(count.tolist(), begin.tolist(), strict=True)
            return _objects([np.frombuffer(self.bytes, dtype, n, at) for n, at in each])
        parts, row = [], []
        for k in range(int(count.max(initial=0))):
            row.append(np.flatnonzero(count > k))
            some = of[row[-1]]
            is_text = node == Nodetype.BASE
            parts.append(
                {"": self._values("string", some)} if is_text else self._message(detail, some)
            )
        if not parts:
            # Their names are known, even if all lists are empty.
            parts = (
                [self._message(detail, of[:0])] if node == Nodetype.NAME else [{"": np.array([])}]
            )
            row = [of[:0]]
        order = np.argsort(np.concatenate(row), kind="stable")
        # Lists of messages in those of a list are left out.
        names = [name for name, values in parts[0].items() if not isinstance(values, Items)]
        fields = {name: np.concatenate([part[name] for part in parts])[order] for name in names}
        if node == Nodetype.NAME:
            return Items(count, fields)
        return _objects(map(list, np.split(fields[""], np.cumsum(count)[:-1])))

    def _values(self, kind: str, of: IntArray) -> NDArray[Any]:
        """The numbers or texts that come next, (N,)."""
        if kind == "string":
            length = self._values("uint32", of).astype(np.int64)
            begin = self._skip(length, of)
            # In CDR a zero ends them.
            ends = (begin + length - self.is_cdr).tolist()
            each = zip(begin.tolist(), ends, strict=True)
            return _objects([self.bytes[at:end].decode() for at, end in each])
        dtype = self._dtype(kind)
        self._align(dtype.itemsize, of)
        begin = self._skip(np.full(len(of), dtype.itemsize), of)
        values = self.array[begin[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
        found: NDArray[Any] = values.astype(bool if kind == "bool" else dtype.newbyteorder("="))
        return found

    def _dtype(self, kind: str) -> np.dtype[Any]:
        return np.dtype(_DTYPES.get(kind, kind)).newbyteorder(self.order)

    def _align(self, size: int, of: IntArray) -> None:
        if self.is_cdr:
            self.at[of] += -(self.at[of] - self.start[of]) % size

    def _skip(self, size: IntArray, of: IntArray) -> IntArray:
        """Go on by so many bytes, (N,); where they begin."""
        begin = self.at[of]
        self.at[of] = begin + size
        self._check(self.at[of] > self.end[of], of, "is cut off")
        return begin

    def _check(self, bad: NDArray[np.bool_], of: IntArray, said: str) -> None:
        if bad.any():
            raise ValueError(f"message {of[np.argmax(bad)] + 1} {said}")


def _objects(values: Iterable[Any]) -> NDArray[Any]:
    """An array of texts or lists."""
    return np.fromiter(values, dtype=object)
