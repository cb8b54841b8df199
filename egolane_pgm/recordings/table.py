"""Recordings of lines as tables, CSV, Parquet or a DataFrame of pandas, in one of two forms.
`COLUMNS` says what the columns mean.

- One row per line, which is also how they are written: frame_id, line, offset_m and others. A frame
  without lines is one row with an empty line and offset.
- One row per frame: frame_id, offset_1, offset_2, ... and, where they are known, is_valid_1,
  is_continuous_1, lri_1, ... (also offset_m_1, valid_1, continuous_1). An empty offset is a line
  that is not there.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv

from egolane_pgm.recordings.select import rate_of
from egolane_pgm.tools.files import arrow_table, atomic, read_parquet, write_parquet
from egolane_pgm.types import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    LineLog,
    near_word,
    suggestion,
)

if TYPE_CHECKING:
    import pandas as pd

NEEDED = ("frame_id", "offset_m")

#: What each column means.
COLUMNS = {
    "frame_id": "number of the frame; increases, the rows of a frame stand together",
    "time_s": "when the frame was seen, seconds; left out, frame id over frame rate",
    "line": "1, 2, ... within the frame, in the detector's order; left out, the order of the rows",
    "offset_m": "where the line passes the car, metres, negative to the left",
    "is_valid": "whether the detector trusts the line; left out, it does",
    "is_continuous": "whether the line is not dashed; left out, none is",
    "lri": "line reliability index: in how many of the last frames it was seen; left out, unknown",
    "is_missing": "marks frames that `missing_frames: predict` put in",
}

#: What a cell of each column must be.
CELLS = dict.fromkeys(COLUMNS, "a number") | dict.fromkeys(
    ("is_valid", "is_continuous", "is_missing", "is_crossing"), "true, false, 1 or 0"
)

#: Frames per second of a table without times, where nothing else is said.
FRAME_RATE = 10.0

#: A line of a greater number is a mistake, and the padded arrays would fill the memory.
MAX_LINES = 1000

#: A column of a table with one row per frame: what it is, and of which line.
_OF_LINE = re.compile(r"(offset|is_valid|valid|is_continuous|continuous|lri|offset_m)_([1-9]\d?)")
_MEANT = {"offset": "offset_m", "valid": "is_valid", "continuous": "is_continuous"}

#: Columns that are the same in all rows of a frame.
_OF_FRAME = ("frame_id", "time_s", "is_missing")

#: The columns of a table as arrays of numbers (N,); an empty cell is NaN.
_Cells = dict[str, FloatArray]


def read_table(
    path: str | Path, *, frame_rate: float = FRAME_RATE, columns: Mapping[str, str] | None = None
) -> LineLog:
    """Read the lines of a CSV or Parquet table (by extension), T frames of at most L lines.

    Without a column is_valid every line is valid, without is_continuous none is continuous, without
    lri the LRI is unknown (NaN). Other columns are ignored with one warning.

    - frame_rate: frames per second; without a column time_s, time is frame id over frame rate.
    - columns: for a column of ours the name that it has in the table, `{"offset_m": "lateral"}`.

    Raises InputError for a file that is missing or no such table, a missing column (the ones that
    are there get listed), no rows, a cell that does not fit its column (with its place), frames
    that decrease, a line given twice in a frame, and a valid line without a finite offset.
    """
    path = Path(path)
    table = read_columns(path)
    cells = _cells(path, table.column_names, table.columns, columns or {})
    return _log_of(path, cells, frame_rate)


def own_rate(path: str | Path, columns: Mapping[str, str] | None = None) -> float | None:
    """Frames per second by the column time_s of a table; None where it says none.

    Raises InputError as `read_table`, as far as frame ids and times are wrong.
    """
    path = Path(path)
    table = read_columns(path)
    names = _renamed(path, table.column_names, columns or {})
    if not {"frame_id", "time_s"} <= {*names}:
        return None
    frame_id, time_s = (
        typed(path, name, table.column(names.index(name))) for name in ("frame_id", "time_s")
    )
    starts = np.diff(frame_id, prepend=np.nan) != 0
    return rate_of(frame_id[starts], time_s[starts])


def read_frame(
    frame: pd.DataFrame,
    *,
    frame_rate: float = FRAME_RATE,
    columns: Mapping[str, str] | None = None,
    source: str = "in memory",
) -> LineLog:
    """Read the lines of a DataFrame as `read_table` does those of a file. frame_id, or frame_id and
    line, may be its index.

    - source: how messages call it.
    """
    path = Path(source)
    frame = with_index(frame)
    parts = [frame.iloc[:, k] for k in range(frame.shape[1])]
    return _log_of(path, _cells(path, list(frame.columns), parts, columns or {}), frame_rate)


def with_index(frame: pd.DataFrame) -> pd.DataFrame:
    """A DataFrame with its index among its columns, whose names are text."""
    frame = frame.rename(columns=str)
    names = [name for name in frame.index.names if name is not None and name not in frame]
    return frame.reset_index(names)


def _log_of(path: Path, cells: _Cells, frame_rate: float) -> LineLog:
    row = np.arange(len(cells["frame_id"]))
    if not len(row):
        raise InputError(f"{path}: the table has no rows")
    check_whole(path, cells, "frame_id", row)
    if "offset_m" not in cells:
        cells, row = _per_line(cells)
    elif "line" not in cells:
        cells = {**cells, "line": _numbered(cells)}
    return _assemble(path, cells, row, frame_rate)


def write_table(path: str | Path, log: LineLog) -> None:
    """Write a log as CSV or Parquet (by extension); `read_table` gives it back as it was.

    Raises InputError for another extension, or where the file cannot be written.
    """
    path = Path(path)
    write = {".csv": _write_csv, ".parquet": write_parquet}.get(path.suffix.lower())
    if write is None:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
    write(path, rows_of(log))


# --- writing -----------------------------------------------------------------------------------


def rows_of(log: LineLog) -> Any:
    """The rows of a log, of pyarrow; with time_s where time is not what it is without the column,
    and with is_missing where a frame is."""
    is_there = (
        log.is_valid | log.is_continuous | ~np.isnan(log.offset_m) | ~np.isnan(log.lri)
    )  # all other cells are padding
    n_frames, n_lines = is_there.shape
    if n_frames and n_lines and not is_there[:, -1].any():
        is_there[0, -1] = True  # an empty line says how wide the padding is
    columns = log.rows(is_there)
    if np.array_equal(log.time_s, log.frame_id / FRAME_RATE):
        del columns["time_s"]
    no_line = np.ma.getmaskarray(columns["line"])
    columns["offset_m"] = np.ma.masked_array(columns["offset_m"], no_line)
    columns["lri"] = np.ma.masked_array(columns["lri"], np.isnan(columns["lri"]))
    if log.is_missing.any():
        columns["is_missing"] = log.is_missing[np.searchsorted(log.frame_id, columns["frame_id"])]
    return arrow_table(columns)


def _write_csv(path: Path, table: Any) -> None:
    with atomic(path) as temporary, temporary.open("wb") as file:
        file.write((",".join(table.column_names) + "\n").encode())
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))


# --- reading -----------------------------------------------------------------------------------


def _renamed(path: Path, names: list[str], columns: Mapping[str, str]) -> list[str]:
    """The table's columns by our names for them. Raises InputError for a name of ours that there
    is not, or a column that the table has not got."""
    ours: dict[str, str] = {}
    for name, given in columns.items():
        if name not in COLUMNS and _OF_LINE.fullmatch(name) is None:
            hint = suggestion(name, [*COLUMNS, "offset_1"])
            raise InputError(f"{path}: columns: there is no column '{name}'{hint}")
        if given not in names:
            hint = suggestion(str(given), names)
            raise InputError(f"{path}: columns: {name}: the table has no '{given}'{hint}")
        ours[given] = name
    found = []
    for name in names:
        name = ours.get(name, name)
        match = _OF_LINE.fullmatch(name)
        found.append(f"{_MEANT.get(match[1], match[1])}_{match[2]}" if match else name)
    return found


def _called(given: str, name: str) -> str:
    """What the table calls a column, and our name for it where that is another one."""
    return given if given == name else f"{given} ({name})"


def _check_columns(path: Path, names: list[str], given: list[str]) -> list[str]:
    """The columns to read. Raises InputError for a missing one, and warns once of all that are
    ignored.

    - names, given: of each column our name and the table's.
    """
    called = list(map(_called, given, names))
    known: set[str] = set(COLUMNS)
    needed: tuple[str, ...] = NEEDED
    numbers = [name.removeprefix("offset_m_") for name in names if name.startswith("offset_m_")]
    if "offset_m" not in names and numbers:
        kinds = ("offset_m", "is_valid", "is_continuous", "lri")
        known = {*_OF_FRAME, *(f"{kind}_{k}" for kind in kinds for k in numbers)}
        needed = NEEDED[:1]
    lacking = [name for name in needed if name not in names]
    if lacking:
        raise InputError(
            f"{path}: no column {', '.join(lacking)}{near_word(lacking[0], {*names} - known)}; the"
            f" table has {', '.join(called) or 'none'};"
            " it needs a row per line (frame_id, line, offset_m) or per frame (frame_id, offset_1,"
            " offset_2, ...); `columns: {offset_m: NAME}` says what yours are called"
        )
    twice = [each for each, name in zip(called, names, strict=True) if names.count(name) > 1]
    if twice:
        raise InputError(f"{path}: column {', '.join(dict.fromkeys(twice))} occurs more than once")
    unused = known - {*names, *NEEDED}
    others = [
        each + near_word(name, unused)
        for each, name in zip(called, names, strict=True)
        if name not in known
    ]
    if others:
        warnings.warn(f"{path}: ignored column(s) {', '.join(others)}", UserWarning, stacklevel=4)
    return [name for name in names if name in known]


def read_columns(path: Path) -> pa.Table:
    """A whole CSV or Parquet file. pyarrow finds the types of the columns of a CSV file."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    extension = path.suffix.lower()
    if extension == ".parquet":
        return read_parquet(path)
    if extension != ".csv":
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
    try:
        table = csv.read_csv(path)
    except (OSError, pa.ArrowInvalid) as error:
        said = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: cannot be read as CSV ({said})") from None
    return table.rename_columns([name.strip() for name in table.column_names])


def _cells(path: Path, given: list[str], parts: list[Any], columns: Mapping[str, str]) -> _Cells:
    """The columns of a table as numbers, by our names.

    - given, parts: what the table calls its columns, and these, of pyarrow or pandas.
    """
    names = _renamed(path, given, columns)
    places = {name: names.index(name) for name in _check_columns(path, names, given)}
    return {name: typed(path, name, parts[k], given[k]) for name, k in places.items()}


def typed(path: Path, name: str, column: Any, called: str = "") -> FloatArray:
    """The cells of a column of pyarrow or pandas, which may hold text or other numbers. Raises
    InputError for what does not fit the column.

    - called: what the table calls it, where that is another name.
    """
    called = _called(called or name, name)
    is_arrow = isinstance(column, pa.ChunkedArray)
    given = column.type if is_arrow else column.dtype
    try:
        column = column if is_arrow else pa.array(column, from_pandas=True)
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            column = _of_text(path, name, column, called)
        elif pa.types.is_boolean(column.type) and not _is_flag(name):
            raise pa.ArrowInvalid
        values = _numbers(column)
        # To pyarrow every number but 0 is true; 7 is more likely another column.
        if _is_flag(name) and not (np.isnan(values) | np.isin(values, (0, 1))).all():
            raise pa.ArrowInvalid
    except pa.ArrowException:
        said = f"{path}: column {called} has type {given}, which is not {_needs(name)}"
        raise InputError(said) from None
    return values


def _of_text(path: Path, name: str, column: Any, called: str) -> Any:
    """The numbers that a column of text says. Raises InputError for the first cell without one."""
    text = trimmed = pc.utf8_trim_whitespace(column)
    if _is_flag(name):
        for word, digit in (("(?i)^true$", "1"), ("(?i)^false$", "0")):
            text = pc.replace_substring_regex(text, word, digit)
    text = pc.if_else(pc.equal(text, ""), None, text)
    try:
        return text.cast(pa.float64())
    except pa.ArrowInvalid:
        row = next(k for k, cell in enumerate(text) if not _is_number(cell))
        said = f"{called} is {str(trimmed[row])[:40]!r}, not {_needs(name)}"
        raise InputError(f"{_place(path, row)}: {said}") from None


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
    values: FloatArray = column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy()
    return values


def _needs(name: str) -> str:
    """What a cell of a column must be."""
    return CELLS.get(re.sub(r"_\d+$", "", name), "a number")


def _is_flag(name: str) -> bool:
    return _needs(name) != "a number"


def _place(path: Path, row: int) -> str:
    """Where a row is, as an editor would say it (CSV), or counted from 1 (Parquet)."""
    if path.suffix.lower() != ".csv":
        return f"{path}: row {row + 1}"
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        filled = (number for number, line in enumerate(file, start=1) if line.strip())
        return f"{path}: line {next(islice(filled, row + 1, None), row + 2)}"


def check_whole(path: Path, cells: _Cells, name: str, row: IntArray) -> None:
    """Raise InputError for a cell that is neither empty nor a whole number."""
    number = cells[name]
    # pandas writes whole numbers beside empty cells as 12.0.
    bad = ~np.isnan(number) & ~((np.floor(number) == number) & (np.abs(number) < 2.0**53))
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(f"{_place(path, int(row[k]))}: {name} is {number[k]}, not a whole number")


def _assemble(path: Path, cells: _Cells, row: IntArray, frame_rate: float) -> LineLog:
    """The frames of a table that has a row for each line; row (N,): where each is in the file."""

    def refuse(bad: BoolArray, why: str) -> None:
        """Raise InputError for the first row that is bad; `{}` in `why` becomes its frame id."""
        if bad.any():
            k = int(np.argmax(bad))
            place = _place(path, int(row[k]))
            raise InputError(f"{place}: " + why.format(int(cells["frame_id"][k])))

    for name in _OF_FRAME:
        if name in cells and np.isnan(cells[name]).any():
            k = int(np.argmax(np.isnan(cells[name])))
            raise InputError(f"{_place(path, int(row[k]))}: {name} is empty")
    check_whole(path, cells, "line", row)
    frame, offset = cells["frame_id"].astype(np.int64), cells["offset_m"]
    has_line = ~np.isnan(cells["line"])
    line = np.where(has_line, cells["line"], 0).astype(np.int64) - 1
    step = np.diff(frame, prepend=frame[0])
    refuse(step < 0, "frame {} comes after a later one; sort the table by frame_id")
    refuse(has_line & ((line < 0) | (line >= MAX_LINES)), f"line is not in 1..{MAX_LINES}")
    starts = step != 0
    starts[0] = True
    if "time_s" in cells:
        is_later = np.diff(cells["time_s"], prepend=-np.inf) > 0
        refuse(starts & ~is_later, "time_s of frame {} is not later than that before")
    at = np.cumsum(starts) - 1
    alone = np.bincount(at)[at] == 1
    refuse(
        ~has_line & ~(alone & np.isnan(offset)),
        "frame {} has a row with an empty line, but with an offset or next to other rows",
    )
    key, again = at * MAX_LINES + line, has_line.copy()
    again[np.flatnonzero(has_line)[np.unique(key[has_line], return_index=True)[1]]] = False
    refuse(again, "frame {} has this line twice")
    for name in ("is_valid", "is_continuous"):
        if name in cells:
            refuse(np.isnan(cells[name]) & has_line, f"frame {{}} has a line with empty {name}")
    valid = cells["is_valid"] == 1 if "is_valid" in cells else has_line
    zeros = np.zeros(len(frame))
    log = LineLog.from_rows(
        frame[starts],
        frame_rate,
        at[has_line],
        offset[has_line],
        valid[has_line],
        cells.get("is_continuous", zeros)[has_line] == 1,
        cells.get("lri", zeros + np.nan)[has_line],
        row_line=line[has_line],
        is_missing=cells.get("is_missing", zeros)[starts] == 1,
        source=str(path),
    )
    return replace(log, time_s=cells["time_s"][starts]) if "time_s" in cells else log


def _numbered(cells: _Cells) -> FloatArray:
    """The numbers of the lines of each frame, in the order of the rows; NaN for a row that stands
    for a frame without lines."""
    frame = cells["frame_id"]
    first = np.flatnonzero(np.diff(frame, prepend=np.nan) != 0)
    of_frame = np.diff(first, append=len(frame))
    number = (np.arange(len(frame)) - np.repeat(first, of_frame) + 1).astype(np.float64)
    number[np.isnan(cells["offset_m"]) & (np.repeat(of_frame, of_frame) == 1)] = np.nan
    return number


def _per_line(cells: _Cells) -> tuple[_Cells, IntArray]:
    """The cells of a table that has a row for each frame, as those of one that has a row for each
    line, and which row of the table each is from."""
    numbers = [name.removeprefix("offset_m_") for name in cells if name.startswith("offset_m_")]

    def side_by_side(kind: str, blank: float = np.nan) -> FloatArray:
        """The cells of all lines, and of none; blank: where there is no column."""
        absent = np.full(len(cells["frame_id"]), blank)
        return np.stack([*(cells.get(f"{kind}_{k}", absent) for k in numbers), absent], axis=1)

    # A line that is said to be valid is there, and without an offset it is a mistake.
    there = ~np.isnan(side_by_side("offset_m")) | (side_by_side("is_valid") == 1)
    there[:, -1] = ~there.any(axis=1)
    row, slot = np.nonzero(there)
    found: _Cells = {name: cells[name][row] for name in _OF_FRAME if name in cells}
    found["line"] = np.array([*map(float, numbers), np.nan])[slot]
    blanks = {"offset_m": np.nan, "is_valid": 1, "is_continuous": 0, "lri": np.nan}
    for kind, blank in blanks.items():
        if any(f"{kind}_{k}" in cells for k in numbers):
            found[kind] = side_by_side(kind, blank)[row, slot]
    return found, row
