"""The columns of a table, or the fields of messages, as lines: names, units, signs and cells.

`recording.columns` says which column is what; one that it leaves out has our own name, `COLUMNS`,
where it is there. A row is a line, or a frame with a column for each of its lines.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from egolane_pgm.experiment import CheckedColumns, Columns, validated
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog, near_word

#: What each column of a table means; messages have the same names.
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

#: Frames per second of a table without times, where nothing else is said.
FRAME_RATE = 10.0

#: A line of a greater number is a mistake, and the padded arrays would fill the memory.
MAX_LINES = 1000

#: Columns by our names as arrays of numbers (N,); an empty cell is NaN.
Cells = dict[str, FloatArray]

#: Columns as callers give them: a section, keys and values, or `ours=theirs,ours=theirs`.
ColumnsGiven = Columns | Mapping[str, Any] | str | Sequence[str]

#: Cells that are a number are so by default; these are true or false.
_FLAGS = ("is_valid", "is_continuous", "is_missing", "is_crossing")

#: Cells that are whole numbers.
_WHOLE = ("frame_id", "line", "lane")

#: Columns that are the same in all rows of a frame, and those of a line beside its offset.
_OF_FRAME = ("frame_id", "time_s", "is_missing")
OF_LINE = ("is_valid", "is_continuous", "lri")

#: The offset of a line in a table with one row per frame; its flags and LRI have its number, too.
_WIDE = re.compile(r"offset_(\d+)")

_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


def column_keys(given: ColumnsGiven) -> dict[str, Any]:
    """The keys of `recording.columns` that a caller gives. Raises InputError for what is none.

    >>> from egolane_pgm.recordings.columns import column_keys
    >>> column_keys("offset_m=[left, right],left_positive=true")
    {'offset_m': ['left', 'right'], 'left_positive': True}
    """
    if isinstance(given, Mapping):
        return dict(given)
    keys: dict[str, Any] = {}
    for each in [given] if isinstance(given, str) else given:
        for part in re.split(r",(?![^\[]*\])", each):
            name, equals, value = part.partition("=")
            if not equals:
                raise InputError(
                    f"columns: {part!r}: write it as ours=theirs, e.g. offset_m=lateral, or"
                    " offset_m=[left,right]"
                )
            # A lone bar or the like is something else to YAML.
            keys[name.strip()] = value if len(value) == 1 else parse_yaml(value, f"columns: {name}")
    return keys


def columns_of(given: ColumnsGiven, where: str) -> Columns:
    """What a caller gives as a section. Raises InputError for keys that do not fit."""
    return validated(CheckedColumns, column_keys(given), f"{where}: columns")


def lines_of_columns(
    columns: Mapping[str, Any],
    said: Columns | None,
    path: Path,
    frame_rate: float = FRAME_RATE,
    *,
    first: int = 0,
    row: IntArray | None = None,
) -> LineLog:
    """The lines of a table, T frames of at most L lines.

    - columns: of pyarrow or pandas, or lists, by name, N values each.
    - said: which of them are what.
    - path: the file, for messages. frame_rate: frames per second of a table without times.
    - first: the first frame id, where time gives them.
    - row (N,): the message of each row; None for a table.

    Raises InputError for a column that is not there, a cell that does not fit (with its place),
    frames that decrease, a line given twice in a frame, and a valid line without a finite offset.
    """
    n_rows = len(next(iter(columns.values()), ()))
    if not n_rows:
        raise InputError(f"{path}: the table has no rows")
    table = _Table(columns, said or Columns(), path, np.arange(n_rows) if row is None else row)
    frames = _frames_of(table, first)
    frame_id = frames["frame_id"].astype(np.int64)
    step = np.diff(frame_id, prepend=frame_id[0] - 1)
    table.refuse(step < 0, "its frame comes after a later one; sort the table by frame_id")
    starts = step > 0
    if "time_s" in frames:
        is_later = np.diff(frames["time_s"], prepend=-np.inf) > 0
        cure = "; `columns: {time_s: null}` takes frame id over frame rate"
        table.refuse(starts & ~is_later, f"time_s is not later than that of the frame before{cure}")
    at = np.cumsum(starts) - 1
    lines = _lines_of(table, at)
    log = LineLog.from_rows(
        frame_id[starts],
        frame_rate,
        at[lines["row"]],
        lines["offset_m"],
        lines["is_valid"] == 1,
        lines["is_continuous"] == 1,
        lines["lri"],
        row_line=lines["line"].astype(np.int64) - 1,
        is_missing=frames["is_missing"][starts] == 1 if "is_missing" in frames else None,
        source=str(path),
    )
    if "time_s" in frames:
        log = replace(log, time_s=frames["time_s"][starts])
    if row is None and table.said.get("offset_m") is None:
        known = {*(COLUMNS if table.named("offset_m") else _OF_FRAME)} - table.used
        unused = [name + near_word(name, known) for name in columns if name not in table.used]
        if any(unused):
            ignored = f"{path}: ignored column(s) {', '.join(filter(None, unused))}"
            warnings.warn(ignored, UserWarning, stacklevel=4)
    return log


@dataclass(frozen=True)
class _Table:
    """A table whose columns are found by our names.

    - row (N,): the row of the file, or the message, of each row.
    - used: the columns that were looked at.
    """

    columns: Mapping[str, Any]
    said: Columns
    path: Path
    row: IntArray
    used: set[str] = field(default_factory=set)

    def named(self, ours: str) -> Any:
        """What the table calls a column of ours: a name, several, or None where it has none."""
        return self.said.get(ours, ours if ours in self.columns else None)

    def column(self, ours: str, theirs: str) -> Any:
        """A column. Raises InputError where it is not there."""
        if theirs not in self.columns:
            raise InputError(
                f"{self.path}: columns: {ours}: there is no column"
                f" '{theirs}'{near_word(theirs, self.columns)}; there are {', '.join(self.columns)}"
            )
        self.used.add(theirs)
        return self.columns[theirs]

    def cells(self, ours: str, theirs: str) -> FloatArray:
        """A column as numbers, (N,)."""
        return typed(self.path, ours, self.column(ours, theirs), theirs, self.row)

    def refuse(self, bad: BoolArray, why: str, at: IntArray | None = None) -> None:
        """Raise InputError for the first row that is bad.

        - at: the row of each value of `bad`, by default one after the other.
        """
        if bad.any():
            k = int(np.argmax(bad))
            k = k if at is None else int(at[k])
            raise InputError(f"{self.path}: row {self.row[k] + 1}: {why}")


# --- lines and frames ----------------------------------------------------------------------------


def _slots(table: _Table) -> list[dict[str, str]]:
    """The columns of each line of a row, by our names."""
    theirs = {name: table.named(name) for name in ("offset_m", *OF_LINE, "line")}
    offset = theirs["offset_m"]
    if isinstance(offset, str):
        return [{ours: name for ours, name in theirs.items() if name is not None}]
    if offset is not None:
        several = {ours: names for ours, names in theirs.items() if isinstance(names, tuple)}
        return [{ours: names[k] for ours, names in several.items()} for k in range(len(offset))]
    found = []
    for match in filter(None, map(_WIDE.fullmatch, table.columns)):
        names = {ours: f"{ours}_{match[1]}" for ours in OF_LINE}
        there = {ours: name for ours, name in names.items() if name in table.columns}
        found.append({"offset_m": match[0], **there})
    if not found:
        raise InputError(
            f"{table.path}: no column offset_m{near_word('offset_m', table.columns)}; the table"
            f" has {', '.join(table.columns)}; it needs a row per line (frame_id, line, offset_m)"
            " or per frame (frame_id, offset_1, offset_2, ...); `columns: {offset_m: NAME}` says"
            " what yours is called, and `egolane show` what is in it"
        )
    return found


def _lines_of(table: _Table, at: IntArray) -> dict[str, NDArray[Any]]:
    """The lines of a table by our names, and the `row` of each.

    - at (N,): the frame of each row, from 0.
    """
    found: list[dict[str, NDArray[Any]]] = []
    rows = np.arange(len(at))
    is_long = isinstance(table.named("offset_m"), str)
    for number, names in enumerate(_slots(table), start=1):
        cells = {ours: table.cells(ours, theirs) for ours, theirs in names.items()}
        offset = cells["offset_m"] / _PER_METRE[table.said.get("unit", "m")]
        is_empty = np.isnan(offset)
        cells = {
            "is_valid": np.where(is_empty, 0.0, 1.0),
            "is_continuous": np.zeros(len(rows)),
            "lri": np.full(len(rows), np.nan),
            **cells,
            "offset_m": -offset if table.said.get("left_positive", False) else offset,
        }
        if not is_long:
            # A line that is said to be valid is there, and without an offset it is a mistake.
            is_there = ~is_empty | (cells["is_valid"] == 1)
            cells["line"] = np.full(len(rows), float(number))
        elif "line" in cells:
            is_there = ~np.isnan(cells["line"])
            table.refuse(~is_there & ~is_empty, "line is empty, but there is an offset")
            # Lines may be numbered from 0.
            cells["line"] = cells["line"] + (np.nanmin(cells["line"], initial=1) == 0)
        else:
            # The rows of a frame are its lines; a single one without an offset says that it has
            # none.
            is_there = ~is_empty | (np.bincount(at)[at] > 1)
            cells["line"] = (rows - np.searchsorted(at, at) + 1).astype(np.float64)
        for name in ("is_valid", "is_continuous"):
            # A line that is not there needs no flags.
            table.refuse(np.isnan(cells[name]) & is_there & ~is_empty, f"{name} is empty")
        found.append({name: each[is_there] for name, each in {**cells, "row": rows}.items()})
    lines = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    is_odd = (lines["line"] < 1) | (lines["line"] > MAX_LINES)
    table.refuse(is_odd, f"line is not in 1..{MAX_LINES}", lines["row"])
    first = np.unique(at[lines["row"]] * MAX_LINES + lines["line"], return_index=True)[1]
    is_first = np.isin(np.arange(len(is_odd)), first)
    table.refuse(~is_first, "its frame has this line twice", lines["row"])
    return lines


def _frames_of(table: _Table, first: int) -> Cells:
    """Of each row (N,) the frame id and, where they are known, time and is_missing.

    - first: the first frame id, where time gives them.
    """
    ids, time, missing = map(table.named, _OF_FRAME)
    cells: Cells = {}
    if time is not None:
        cells["time_s"] = _seconds(table, time)
    if ids is not None:
        cells["frame_id"] = table.cells("frame_id", ids)
    elif time is not None:
        cells["frame_id"] = first + _ids_of(table, cells["time_s"])
    else:
        raise InputError(
            f"{table.path}: no column frame_id{near_word('frame_id', table.columns)}, nor time_s;"
            f" the table has {', '.join(table.columns)}; `columns: {{frame_id: NAME}}` or"
            " `{time_s: NAME, time_unit: s}` says what yours is called"
        )
    if missing is not None:
        cells["is_missing"] = table.cells("is_missing", missing)
    for name, values in cells.items():
        table.refuse(np.isnan(values), f"{name} is empty")
    return cells


def _seconds(table: _Table, theirs: str) -> FloatArray:
    """A column as times in seconds, (N,): numbers of a unit, or dates."""
    values, unit = arrow_column(table.column("time_s", theirs)), table.said.get("time_unit", "s")
    per = _PER_SECOND[unit]
    if pa.types.is_timestamp(values.type):
        values, per = values.cast(pa.timestamp("ns", values.type.tz)).cast(pa.int64()), 10**9
    if pa.types.is_integer(values.type) and not values.null_count:
        # Nanoseconds since 1970 have more digits than a float.
        ticks = values.to_numpy(zero_copy_only=False)
        time_s: FloatArray = ticks // per + ticks % per / per
    else:
        time_s = typed(table.path, "time_s", values, theirs, table.row) / per
    longest = float(np.nanmax(np.abs(time_s), initial=0))
    if longest > 1e11:
        raise InputError(
            f"{table.path}: {theirs} is {longest * per:.4g}, which is no time in {unit}; set"
            " `columns: {time_unit: ns}` (or ms, us)"
        )
    return time_s


def _ids_of(table: _Table, time_s: FloatArray) -> FloatArray:
    """Frame ids by the time stamps (N,) of rows; they begin with 0. A step of the median counts as
    one frame, and a longer one as the whole multiple that is nearest to it: gaps stay gaps."""
    step = np.diff(time_s, prepend=-np.inf)
    table.refuse(~(step >= 0), "time is empty or goes back; sort by time")
    step = step[1:]
    if not (step > 0).any():
        return np.zeros(len(time_s))
    usual = np.median(step[step > 0])
    frames = np.where(step > 0, np.maximum(1, np.rint(step / usual)), 0)
    return np.concatenate([[0.0], np.cumsum(frames)])


# --- cells ---------------------------------------------------------------------------------------


def arrow_column(column: Any) -> Any:
    """A column as an array of pyarrow. Raises `pyarrow.ArrowException` for one of mixed types."""
    if not isinstance(column, (pa.Array, pa.ChunkedArray)):
        column = pa.array(column, from_pandas=True)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def typed(
    path: Path, name: str, column: Any, called: str = "", rows: IntArray | None = None
) -> FloatArray:
    """The cells of a column, which may hold text or other numbers; NaN where they are empty.

    - column: of pyarrow or pandas, or a list.
    - called: what the table calls it, where that is another name.
    - rows: the row of the file in which each cell stands; by default one after the other.

    Raises InputError for what does not fit the column: a flag is true or false, some are whole.
    """
    called = name if called in ("", name) else f"{called} ({name})"
    is_flag = name in _FLAGS
    needed = "a whole number" if name in _WHOLE else "a number"
    needed = "true, false, 1 or 0" if is_flag else needed
    try:
        column = arrow_column(column)
        is_text = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
        if is_text:
            values, bad = _numbers_of(column.to_pylist(), is_flag)
        elif pa.types.is_boolean(column.type) and not is_flag:
            raise pa.ArrowInvalid
        else:
            numbers = column.cast(pa.float64(), safe=False).fill_null(np.nan)
            values, bad = numbers.to_numpy(zero_copy_only=False), np.zeros(len(column), dtype=bool)
    except (pa.ArrowException, OverflowError):
        kind = getattr(column, "type", "mixed")
        raise InputError(f"{path}: column {called} has type {kind}, not {needed}") from None
    if is_flag:
        # To pyarrow every number but 0 is true; 7 is more likely another column.
        bad = bad | ~(np.isnan(values) | np.isin(values, (0, 1)))
    elif name in _WHOLE:
        # pandas writes whole numbers beside empty cells as 12.0.
        is_whole = (np.floor(values) == values) & (np.abs(values) < 2.0**53)
        bad = bad | ~(np.isnan(values) | is_whole)
    if bad.any():
        k = int(np.argmax(bad))
        row = 1 + int(k if rows is None else rows[k])
        raise InputError(f"{path}: row {row}: {called} is {column[k].as_py()!r:.40}, not {needed}")
    return values


def _numbers_of(cells: Sequence[str | None], is_flag: bool) -> tuple[FloatArray, BoolArray]:
    """Texts as numbers, and which of them are none, (N,) both."""
    words = {"": "nan", **({"true": "1", "false": "0"} if is_flag else {})}
    values, bad = np.full(len(cells), np.nan), np.zeros(len(cells), dtype=bool)
    for k, cell in enumerate(cells):
        text = (cell or "").strip().lower()
        try:
            values[k] = float(words.get(text, text))
        except ValueError:
            bad[k] = True
    return values, bad
