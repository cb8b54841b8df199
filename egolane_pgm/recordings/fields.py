"""The fields of a table or of messages by their paths, conditions on them, `confidence > 0.5`, and
their cells as numbers. A path is `header.seq`, `lanes[].c0` (each of a list) or `y[0]` (its first).

A table's rows and a topic's messages are the same here: columns of pyarrow, nested ones where the
fields are.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import FloatArray, InputError, IntArray, near_word

#: Columns by our names as arrays of numbers (N,); an empty cell is NaN.
Cells = dict[str, FloatArray]

#: Cells that are a number are so by default; these are true or false.
FLAGS = ("is_valid", "is_continuous", "is_missing", "is_crossing")

#: For each `[]` of a path, the outer first, the list that each element is of.
Up = tuple[IntArray, ...]

#: A field of a section, an element of a list, or each.
_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d*)\]")

_CONDITION = re.compile(r"(.+?)\s*(>=|<=|==|!=|>|<|\s(?:not )?in\s)\s*(.+)")
_COMPARED = {
    ">": np.greater,
    ">=": np.greater_equal,
    "<": np.less,
    "<=": np.less_equal,
}


class _NoField(LookupError):
    """A path that leads nowhere; its arguments are the part that is not there, and what is."""


@dataclass(frozen=True)
class Table:
    """The columns of a table, or the fields of the messages of a topic.

    - columns: of pyarrow or pandas, T rows each, by name.
    - path: names the file in messages.
    - used: the columns that were looked at.
    """

    columns: Mapping[str, Any]
    n_rows: int
    path: Path
    used: set[str] = field(default_factory=set)

    def has(self, path: str) -> bool:
        """Whether there is such a field."""
        try:
            return path in self.columns or bool(_follow(self.columns, path))
        except _NoField:
            return False

    def own(self, name: str, beside: str = "") -> str | None:
        """The path of a field that has our name, in capitals or not; None where none has."""
        if self.has(beside + name):
            return beside + name
        same = [each for each in self.columns if each.casefold() == name]
        return same[0] if same and not beside else None

    def values(self, key: str, path: str, beside: str = "") -> tuple[str, Any, Up]:
        """The whole path of a field, its values, of pyarrow, and the lists that they are of.

        - key: of the mapping, for messages.
        - beside: the list or section in which the field is looked for first, `lanes[].`.

        Raises InputError for a field that is not there.
        """
        # Of lists that are always empty nobody knows the fields: what says the list is whole.
        ways = [path] if path.startswith(beside) else [beside + path, path]
        whole = next(filter(self.has, ways), ways[0])
        try:
            name, found, up = _follow(self.columns, whole)
        except _NoField as wrong:
            part, known = wrong.args
            what = f"there is no '{part}'" + (f" in {path}" if part != path else "")
            hint = near_word(part, known) + (f"; there are {', '.join(known)}" if known else "")
            raise InputError(f"{self.path}: lines: {key}: {what}{hint}") from None
        except pa.ArrowException as error:
            said = " ".join(str(error).split())[:120]
            raise InputError(f"{self.path}: column {whole} has mixed types ({said})") from None
        self.used.add(name)
        return whole, found, up

    def numbers(
        self, name: str, path: str, beside: str = "", key: str = ""
    ) -> tuple[FloatArray, Up]:
        """The values of a field as numbers, (N,), and the lists that they are of.

        - name: ours, by which cells are checked. key: of the mapping, where it is another one.
        """
        path, found, up = self.values(key or name, path, beside)
        return typed(self.path, name, found, path, self.rows(up)), up

    def rows(self, up: Up) -> IntArray:
        """The row of each value of a field, (N,)."""
        rows = np.arange(self.n_rows)
        for each in up:
            rows = rows[each]
        return rows

    def aligned(self, key: str, values: FloatArray, of: Up, up: Up) -> FloatArray:
        """Values of some lists, or of what these are in, for each element of the lists `up`."""
        if len(of) > len(up) or not all(map(np.array_equal, of, up)):
            raise InputError(f"{self.path}: lines: {key}: has not a value for each offset")
        index = np.arange(len(up[-1]) if up else self.n_rows)
        for each in reversed(up[len(of) :]):
            index = each[index]
        return values[index]

    def is_so(self, name: str, said: str, beside: str) -> tuple[FloatArray, Up]:
        """1 where a condition holds, 0 where it does not or a value is missing; of a bare field its
        own values, NaN where one is missing. And the lists that they are of."""
        if self.has(beside + said) or self.has(said) or not _CONDITION.fullmatch(said):
            return self.numbers(name, said, beside)
        parts = [self._holds(name, part, beside) for part in re.split(r"\s+and\s+", said)]
        if len({len(is_so) for is_so, _ in parts}) > 1:
            raise InputError(f"{self.path}: lines: {name}: {said!r} compares different lists")
        return np.all([is_so for is_so, _ in parts], axis=0).astype(np.float64), parts[0][1]

    def _holds(self, name: str, said: str, beside: str) -> tuple[Any, Up]:
        where, match = f"{self.path}: lines: {name}", _CONDITION.fullmatch(said.strip())
        if match is None:
            raise InputError(f"{where}: {said!r} is no condition, e.g. confidence > 0.5")
        operator, meant = match[2].strip(), parse_yaml(match[3], where)
        path, found, up = self.values(name, match[1], beside)
        among = meant if isinstance(meant, list) else [meant]
        if operator in _COMPARED and not isinstance(meant, (int, float)):
            raise InputError(f"{where}: {match[3]!r} is not a number")
        if any(isinstance(each, str) for each in among):
            values = np.array(found.cast(pa.string()).to_pylist(), dtype=object)
            is_there, among = values != None, [*map(str, among)]  # noqa: E711
        else:
            kind = "is_valid" if pa.types.is_boolean(found.type) else "number"
            values = typed(self.path, kind, found, path, self.rows(up))
            is_there = ~np.isnan(values)
        if operator in _COMPARED:
            return _COMPARED[operator](values, meant) & is_there, up
        return is_there & (np.isin(values, among) == (operator in ("==", "in"))), up


def _follow(columns: Mapping[str, Any], path: str) -> tuple[str, Any, Up]:
    """The column in which a field is, its values, and the lists that these are of. Raises _NoField
    where the path leads nowhere."""
    # A table's columns may have dots and brackets in their names.
    ends = [len(path), *(m.start() for m in reversed(list(re.finditer(r"[.\[]", path))))]
    end = next((end for end in ends if path[:end] in columns), None)
    if end is None:
        raise _NoField(path[: ends[-1]], [*columns])
    name, values = path[:end], arrow_column(columns[path[:end]])
    up: Up = ()
    while end < len(path):
        step = _STEP.match(path, end)
        if step is None:
            raise _NoField(path[end:], ())
        inner, index = step[1], step[2]
        if pa.types.is_null(values.type):
            # Of a list that is always empty nobody knows what is in it.
            if index == "" and len(values):
                values, up = values[:0], (*up, np.zeros(0, dtype=np.int64))
        elif inner is None:
            values, up = _listed(values, up, index)
        else:
            known = [f.name for f in values.type] if pa.types.is_struct(values.type) else []
            if inner not in known:
                raise _NoField(inner, known)
            values = pc.struct_field(values, inner)
        end = step.end()
    return name, values, up


def _listed(values: Any, up: Up, index: str) -> tuple[Any, Up]:
    """Each element of lists, or the one of an index; null where a list is too short."""
    if not pa.types.is_nested(values.type) or pa.types.is_struct(values.type):
        raise _NoField(f"[{index}]", ())
    if index == "":
        parent = pc.list_parent_indices(values).to_numpy(zero_copy_only=False)
        return pc.list_flatten(values), (*up, parent.astype(np.int64))
    one = pc.list_slice(values, int(index), int(index) + 1, return_fixed_size_list=True)
    return pc.list_element(one, 0), up


# --- cells ----------------------------------------------------------------------------------------


def arrow_column(column: Any) -> Any:
    """A column of pyarrow or pandas as an array of pyarrow. Raises `pyarrow.ArrowException` for one
    of mixed types."""
    if not isinstance(column, (pa.Array, pa.ChunkedArray)):
        column = pa.array(column, from_pandas=True)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def typed(
    path: Path, name: str, column: Any, called: str = "", rows: IntArray | None = None
) -> FloatArray:
    """The cells of a column of pyarrow or pandas, which may hold text or other numbers. Raises
    InputError for what does not fit the column.

    - called: what the table calls it, where that is another name.
    - rows: the row of the file in which each cell stands; by default one after the other.
    """
    called, bare = (name if called in ("", name) else f"{called} ({name})"), called or name
    given = getattr(column, "type", None) or column.dtype
    needed = "true, false, 1 or 0" if name in FLAGS else "a number"

    def refuse(row: int, cell: str, cure: str) -> InputError:
        where = place(path, row if rows is None else int(rows[row]))
        return InputError(f"{where}: {called} is {cell}, not {needed}{cure}")

    try:
        column = arrow_column(column)
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            values = np.full(len(column), np.nan)
            words = {"": np.nan, **({"true": 1, "false": 0} if name in FLAGS else {})}
            for row, cell in enumerate(column.to_pylist()):
                text = (cell or "").strip()
                try:
                    values[row] = float(words.get(text.lower(), text))
                except ValueError:
                    raise refuse(row, repr(text[:40]), _cure(text)) from None
        elif pa.types.is_boolean(column.type) and name not in FLAGS:
            raise pa.ArrowInvalid
        else:
            if pa.types.is_boolean(column.type):
                column = column.cast(pa.int8())
            column = column.cast(pa.float64(), safe=False).fill_null(np.nan)
            values = column.to_numpy(zero_copy_only=False)
    except pa.ArrowException:
        said = f"{path}: column {called} has type {given}, which is not {needed}"
        raise InputError(said) from None
    # To pyarrow every number but 0 is true; 7 is more likely another column.
    if name in FLAGS and (wrong := ~(np.isnan(values) | np.isin(values, (0, 1)))).any():
        cure = f"; a condition says which numbers mean true, `lines: {{{name}: {bare} > 0.5}}`"
        raise refuse(int(np.argmax(wrong)), f"{values[np.argmax(wrong)]:g}", cure)
    return values


def _cure(cell: str) -> str:
    """What may help with a cell that is no number: the end of a message."""
    if re.fullmatch(r"[-+]?\d+,\d+", cell):
        return "; decimal commas: `lines: {decimal: ','}`"
    if re.fullmatch(r"[^\da-z]{1,7}", cell):
        return f"; if it stands for an empty cell: `lines: {{null_values: [{cell!r}]}}`"
    return ""


def place(path: Path, row: int) -> str:
    """Where a row is, as an editor would say it (text), or counted from 1."""
    if path.suffix.lower() not in (".csv", ".tsv", ".jsonl", ".json"):
        return f"{path}: row {row + 1}"
    first = 1 if path.suffix.lower() in (".csv", ".tsv") else 0
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        filled = (number for number, line in enumerate(file, start=1) if line.strip())
        return f"{path}: line {next(islice(filled, row + first, None), row + 1 + first)}"


def check_whole(path: Path, cells: Cells, name: str, row: IntArray) -> None:
    """Raise InputError for a cell that is neither empty nor a whole number."""
    number = cells[name]
    # pandas writes whole numbers beside empty cells as 12.0.
    bad = ~np.isnan(number) & ~((np.floor(number) == number) & (np.abs(number) < 2.0**53))
    if bad.any():
        k = int(np.argmax(bad))
        said = "not a whole number" if abs(number[k]) < 2.0**53 else "too large for a number here"
        if name == "frame_id":
            said += "; time stamps: `lines: {time: NAME, time_unit: s}` (or ms, us, ns)"
        raise InputError(f"{place(path, int(row[k]))}: {name} is {number[k]:.17g}, {said}")
