"""The cells of a column of pyarrow or pandas as numbers, and where a bad one stands."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

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
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if not isinstance(column, pa.Array):
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
    called = called if called in ("", name) else f"{called} ({name})"
    called, is_flag = called or name, name in FLAGS
    given = getattr(column, "type", None) or column.dtype
    try:
        column = arrow_column(column)
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            column = _of_text(path, name, column, called, rows)
        elif pa.types.is_boolean(column.type) and not is_flag:
            raise pa.ArrowInvalid
        values = _numbers(column)
    except pa.ArrowException:
        said = f"{path}: column {called} has type {given}, which is not {needs(name)}"
        raise InputError(said) from None
    # To pyarrow every number but 0 is true; 7 is more likely another column.
    if is_flag and not (np.isnan(values) | np.isin(values, (0, 1))).all():
        k = int(np.argmax(~(np.isnan(values) | np.isin(values, (0, 1)))))
        where = place(path, k if rows is None else int(rows[k]))
        raise InputError(
            f"{where}: {called} is {values[k]:g}, not {needs(name)}; a condition says which"
            f" numbers mean true, `lines: {{{name}: {called.partition(' (')[0]} > 0.5}}`"
        )
    return values


def _of_text(path: Path, name: str, column: Any, called: str, rows: IntArray | None) -> Any:
    """The numbers that a column of text says. Raises InputError for the first cell without one."""
    text = trimmed = pc.utf8_trim_whitespace(column)
    if name in FLAGS:
        for word, digit in (("(?i)^true$", "1"), ("(?i)^false$", "0")):
            text = pc.replace_substring_regex(text, word, digit)
    text = pc.if_else(pc.equal(text, ""), None, text)
    try:
        return text.cast(pa.float64())
    except pa.ArrowInvalid:
        row = next(k for k, cell in enumerate(text) if not _is_number(cell))
        cell = str(trimmed[row])[:40]
        where = place(path, row if rows is None else int(rows[row]))
        raise InputError(f"{where}: {called} is {cell!r}, not {needs(name)}{_cure(cell)}") from None


def _cure(cell: str) -> str:
    """What may help with a cell that is no number: the end of a message."""
    if cell.count(",") == 1 and cell.replace(",", "").lstrip("+-").isdigit():
        return "; decimal commas: `lines: {decimal: ','}`"
    if 0 < len(cell) < 8 and not any(c.isdigit() for c in cell) and not cell.islower():
        return f"; if it stands for an empty cell: `lines: {{null_values: [{cell!r}]}}`"
    return ""


def _is_number(cell: Any) -> bool:
    try:
        cell.cast(pa.float64())
    except pa.ArrowInvalid:
        return False
    return True


def _numbers(column: Any) -> FloatArray:
    """A column of pyarrow as an array."""
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    values: FloatArray = (
        column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy(zero_copy_only=False)
    )
    return values


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
    if not bad.any():
        return
    k = int(np.argmax(bad))
    said = f"{name} is {number[k]:.17g}, not a whole number"
    if name == "frame_id":
        is_large = abs(number[k]) >= 2.0**53
        said = f"{name} is {number[k]:.17g}, " + (
            "too large for the number of a frame" if is_large else "not a whole number"
        )
        said += "; time stamps: `lines: {time: NAME, time_unit: s}` (or ms, us, ns)"
    raise InputError(f"{place(path, int(row[k]))}: {said}")
