"""The cells of a column of pyarrow or pandas as numbers, and where a bad one stands."""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from egolane_pgm.types import FloatArray, InputError, IntArray

#: Columns by our names as arrays of numbers (N,); an empty cell is NaN.
Cells = dict[str, FloatArray]

#: Cells that are a number are so by default; these are true or false.
FLAGS = ("is_valid", "is_continuous", "is_missing", "is_crossing")


def needs(name: str) -> str:
    """What a cell of one of our columns must be."""
    return "true, false, 1 or 0" if name in FLAGS else "a number"


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

    def refuse(row: int, cell: str, cure: str) -> InputError:
        where = place(path, row if rows is None else int(rows[row]))
        return InputError(f"{where}: {called} is {cell}, not {needs(name)}{cure}")

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
        said = f"{path}: column {called} has type {given}, which is not {needs(name)}"
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
