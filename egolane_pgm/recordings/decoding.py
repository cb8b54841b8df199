"""Decode messages into columns, one field of all messages at a time.

rosbags makes an object of each message and of each line in it, which takes most of the time of
reading a drive; the decoder here is some ten times as fast.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from egolane_pgm.types import BoolArray, InputError, IntArray

#: Types of fields that have another name in NumPy.
_DTYPES = {
    **dict.fromkeys(("bool", "byte", "char", "octet"), "u1"),
    "float32": "f4",
    "float64": "f8",
}

#: The parts of a time stamp in ROS 1, in ROS 2 and in Foxglove's schemas.
_SECONDS, _NANOSECONDS = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanos")

#: Columns by the path of their field, such as `header.seq`: N values each.
Fields = dict[str, Any]


class Items(NamedTuple):
    """A list of messages inside each of N messages.

    - counts (N,): lengths of the lists.
    - fields: columns of all entries, in the order of the messages.
    """

    counts: IntArray
    fields: Fields


def stamp_parts(value: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """Seconds and nanoseconds of a time stamp, None for anything else."""
    parts = [[value[name] for name in names if name in value] for names in (_SECONDS, _NANOSECONDS)]
    return (parts[0][0], parts[1][0]) if all(parts) else None


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
        self._check(self.start > self.end, every, "is cut off")
        if self.is_cdr:
            self._check(self.array[self.start - 3] != 1, every, "is not little-endian")
        found = self._message(kind, every)
        # CDR may be padded.
        self._check(self.end - self.at > 3 * self.is_cdr, every, f"is longer than a {kind}")
        return found

    def _message(self, kind: str, of: IntArray) -> Fields:
        """Read a message of some type at the current position of the messages `of` (N,)."""
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
        """Read a list of counts (N,) entries: Items of messages, or an array of anything else."""
        self._check(counts > (self.end - self.at)[of], of, "is cut off")
        node, detail = item
        if node == Nodetype.BASE and detail[0] != "string":
            dtype = _dtype(detail[0])
            begin = self._skip(counts * dtype.itemsize, of, dtype.itemsize)
            each = zip(counts.tolist(), begin.tolist(), strict=True)
            return _objects(np.frombuffer(self.bytes, dtype, n, at) for n, at in each)
        # Read the first entry of all lists, then the second. One round without any entry gives the
        # names of the fields if all lists are empty.
        row = [np.flatnonzero(counts > k) for k in range(max(1, counts.max()))]
        is_text = node == Nodetype.BASE
        parts = [
            {"": self._values("string", of[some])} if is_text else self._message(detail, of[some])
            for some in row
        ]
        order = np.argsort(np.concatenate(row), kind="stable")
        # Lists inside the entries of a list are left out.
        names = [name for name, values in parts[0].items() if not isinstance(values, Items)]
        fields = {name: np.concatenate([part[name] for part in parts])[order] for name in names}
        if is_text:
            return _objects(map(list, np.split(fields[""], np.cumsum(counts)[:-1])))
        return Items(counts, fields)

    def _values(self, kind: str, of: IntArray) -> NDArray[Any]:
        """Read a number or a text from each message, (N,)."""
        if kind == "string":
            length = self._values("uint32", of).astype(np.int64)
            begin = self._skip(length, of)
            # CDR ends texts with a zero.
            each = zip(begin.tolist(), (begin + length - self.is_cdr).tolist(), strict=True)
            return _objects(self.bytes[at:end].decode() for at, end in each)
        dtype = _dtype(kind)
        begin = self._skip(np.full(len(of), dtype.itemsize), of, dtype.itemsize)
        values = self.array[begin[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
        found: NDArray[Any] = values.astype(bool if kind == "bool" else dtype)
        return found

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


def _objects(values: Iterable[Any]) -> NDArray[Any]:
    return np.fromiter(values, dtype=object)


# --- JSON ----------------------------------------------------------------------------------------


def fields_of_dicts(messages: Sequence[Mapping[str, Any]], where: str) -> Fields:
    """The fields of messages that are dicts. Raises InputError for fields of mixed types."""
    try:
        return _fields_in(pa.array(messages))
    except pa.ArrowException as error:
        raise InputError(f"{where}: a field has values of several types ({error})") from None


def _fields_in(values: pa.StructArray) -> Fields:
    inner = dict(zip([field.name for field in values.type], values.flatten(), strict=True))
    if (parts := stamp_parts(inner)) is not None:
        seconds, nanoseconds = (np.asarray(part.cast(pa.int64())) for part in parts)
        return {"": seconds + nanoseconds / 1e9}
    found: Fields = {}
    for name, each in inner.items():
        kind = each.type.value_type if pa.types.is_list(each.type) else None
        if pa.types.is_struct(each.type):
            fields = _fields_in(each)
            found |= {f"{name}.{key}" if key else name: values for key, values in fields.items()}
        elif kind is not None and (pa.types.is_struct(kind) or pa.types.is_null(kind)):
            counts = np.asarray(each.value_lengths().fill_null(0)).astype(np.int64)
            # A list that is empty in every message has no field names.
            found[name] = Items(
                counts, {} if pa.types.is_null(kind) else _fields_in(each.flatten())
            )
        else:
            found[name] = each
    return found
