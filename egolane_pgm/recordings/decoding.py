"""Decode the messages of a ROS type into columns, a field of all messages at a time.

rosbags makes an object of each message and of each line in it, which takes most of the time of
reading a drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from egolane_pgm.types import BoolArray, IntArray

#: The types of fields that NumPy calls otherwise.
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
    """The list of messages in each of N messages.

    - counts (N,): how many there are.
    - fields: their fields, those in the first message first.
    """

    counts: IntArray
    fields: Fields


def stamp_parts(value: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """Seconds and nanoseconds of a time stamp, None for anything else."""
    parts = [[value[name] for name in names if name in value] for names in (_SECONDS, _NANOSECONDS)]
    return (parts[0][0], parts[1][0]) if all(parts) else None


class Decoder:
    """Decodes messages of one type.

    - fielddefs: the fields of each type, as a typestore of rosbags has them.
    - raw: the bytes of each message, little-endian.
    - is_cdr: whether they are of ROS 2, which aligns numbers to multiples of their size.
    """

    def __init__(self, fielddefs: Mapping[str, Any], raw: Sequence[bytes], is_cdr: bool) -> None:
        self.fielddefs = fielddefs
        self.is_cdr = is_cdr
        self.bytes = b"".join(raw)
        self.array = np.frombuffer(self.bytes, np.uint8)
        self.end = np.cumsum([len(each) for each in raw])
        # In CDR four bytes come first, of which the second is the byte order.
        self.start = np.concatenate([[0], self.end[:-1]]) + 4 * is_cdr
        #: Where each message is decoded next.
        self.at = self.start.copy()

    def decode(self, kind: str) -> Fields:
        """The fields of all messages. Raises ValueError for bytes that are not of that type."""
        every = np.arange(len(self.end))
        self._check(self.start > self.end, every, "is cut off")
        if self.is_cdr:
            self._check(self.array[self.start - 3] != 1, every, "is not little-endian")
        found = self._message(kind, every)
        # CDR may be padded.
        self._check(self.end - self.at > 3 * self.is_cdr, every, f"is longer than a {kind}")
        return found

    def _message(self, kind: str, of: IntArray) -> Fields:
        """The fields of a message that comes next in the messages `of` (N,)."""
        found: Fields = {}
        for name, (node, detail) in self.fielddefs[kind][1]:
            if node == Nodetype.BASE:
                found[name] = self._values(detail[0], of)
            elif node == Nodetype.ARRAY:
                found[name] = self._list(detail[0], np.full(len(of), detail[1]), of)
            elif node == Nodetype.SEQUENCE:
                counts = self._values("uint32", of).astype(np.int64)
                found[name] = self._list(detail[0], counts, of)
            else:
                inner = self._message(detail, of)
                if (parts := stamp_parts(inner)) is not None:
                    found[name] = parts[0] + parts[1] / 1e9
                else:
                    found |= {f"{name}.{each}": values for each, values in inner.items()}
        return found

    def _list(self, item: tuple[Any, Any], counts: IntArray, of: IntArray) -> Any:
        """The lists that come next, (N,): Items of messages, or an array of anything else."""
        self._check(counts > (self.end - self.at)[of], of, "is cut off")
        node, detail = item
        if node == Nodetype.BASE and detail[0] != "string":
            dtype = _dtype(detail[0])
            self._align(dtype.itemsize, of[counts > 0])
            begin = self._skip(counts * dtype.itemsize, of)
            each = zip(counts.tolist(), begin.tolist(), strict=True)
            return _objects(np.frombuffer(self.bytes, dtype, n, at) for n, at in each)
        # The first entry of all lists, then the second; without any, the names of the fields.
        row = [np.flatnonzero(counts > k) for k in range(max(1, counts.max()))]
        if node == Nodetype.BASE:
            parts = [{"": self._values("string", of[some])} for some in row]
        else:
            parts = [self._message(detail, of[some]) for some in row]
        order = np.argsort(np.concatenate(row), kind="stable")
        # Lists of messages in those of a list are left out.
        names = [name for name, values in parts[0].items() if not isinstance(values, Items)]
        fields = {name: np.concatenate([part[name] for part in parts])[order] for name in names}
        if node == Nodetype.BASE:
            return _objects(map(list, np.split(fields[""], np.cumsum(counts)[:-1])))
        return Items(counts, fields)

    def _values(self, kind: str, of: IntArray) -> NDArray[Any]:
        """The numbers or texts that come next, (N,)."""
        if kind == "string":
            length = self._values("uint32", of).astype(np.int64)
            begin = self._skip(length, of)
            # In CDR a zero ends them.
            each = zip(begin.tolist(), (begin + length - self.is_cdr).tolist(), strict=True)
            return _objects(self.bytes[at:end].decode() for at, end in each)
        dtype = _dtype(kind)
        self._align(dtype.itemsize, of)
        begin = self._skip(np.full(len(of), dtype.itemsize), of)
        values = self.array[begin[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
        found: NDArray[Any] = values.astype(bool if kind == "bool" else dtype)
        return found

    def _align(self, size: int, of: IntArray) -> None:
        if self.is_cdr:
            self.at[of] += -(self.at[of] - self.start[of]) % size

    def _skip(self, size: IntArray, of: IntArray) -> IntArray:
        """Go on by so many bytes, (N,); where they begin."""
        begin = self.at[of]
        self.at[of] = begin + size
        self._check(self.at[of] > self.end[of], of, "is cut off")
        return begin

    def _check(self, bad: BoolArray, of: IntArray, problem: str) -> None:
        if bad.any():
            raise ValueError(f"message {of[np.argmax(bad)] + 1} {problem}")


def _dtype(kind: str) -> np.dtype[Any]:
    return np.dtype(_DTYPES.get(kind, kind)).newbyteorder("<")


def _objects(values: Iterable[Any]) -> NDArray[Any]:
    return np.fromiter(values, dtype=object)
