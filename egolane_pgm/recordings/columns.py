"""Columns of a table, or fields of messages, as lines: names, units, signs and cells.

`recording.columns` maps our names, `COLUMNS`, to other names; the default is our own name. A row of
the table is a line, or a frame with a column for each of its lines.
"""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from egolane_pgm.experiment import Columns
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog, near_word

#: The columns of a table and the fields of messages.
COLUMNS = {
    "frame_id": "number of the frame; increases, rows of a frame are adjacent",
    "time_s": "time of the frame, seconds; default: frame id over frame rate",
    "line": "1, 2, ... within the frame, in the detector's order; default: the order of the rows",
    "offset_m": "lateral offset of the line from the car, metres, negative to the left",
    "is_valid": "whether the detector trusts the line; default: true",
    "is_continuous": "true for a solid line; default: false",
    "lri": "line reliability index: number of the last frames with the line; default: unknown",
}

#: Frames per second of a table without times, unless given.
FRAME_RATE = 10.0

#: A greater number of a line is a mistake, and would fill the memory with padding.
MAX_LINES = 1000

#: Columns as callers give them: a section, a dict, or `ours=theirs,ours=theirs`.
ColumnsGiven = Columns | Mapping[str, Any] | str | Sequence[str]

#: Columns of true or false, and of whole numbers; all others are numbers.
_FLAGS = ("is_valid", "is_continuous", "is_crossing")
_WHOLE = ("frame_id", "line", "lane")

#: Columns of a line besides its offset.
OF_LINE = ("is_valid", "is_continuous", "lri")

#: The offset of a line in a table with a row per frame; `is_valid_1` and so on go with it.
_WIDE = re.compile(r"offset_(\d+)")

_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


def column_keys(given: ColumnsGiven) -> dict[str, Any]:
    """The keys of `recording.columns`. Raises InputError for a text that is not ours=theirs.

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
            # A single letter may be syntax of YAML.
            keys[name.strip()] = value if len(value) == 1 else parse_yaml(value, f"columns: {name}")
    return keys


def lines_of_columns(
    data: Mapping[str, Any],
    columns: Columns | None,
    path: Path,
    frame_rate: float = FRAME_RATE,
    *,
    first: int = 0,
    row: IntArray | None = None,
) -> LineLog:
    """The lines of a table, T frames of at most L lines.

    - data: columns of pyarrow or pandas, or lists, by name, N values each.
    - columns: their names, units and signs; None for our own.
    - path: the file, for messages.
    - frame_rate: frames per second of a table without times.
    - first: first frame id, if frames are numbered by their times.
    - row (N,): the message of each row; None for a table.

    Raises InputError for an unknown column, a wrong cell (with its row), frames that decrease, a
    line that occurs twice in a frame, and a valid line without a finite offset.
    """
    n_rows = len(next(iter(data.values()), ()))
    if not n_rows:
        raise InputError(f"{path}: the table has no rows")
    table = _Table(data, columns or Columns(), path, np.arange(n_rows) if row is None else row)
    frames = _frames_of(table, first)
    frame_id = frames["frame_id"].astype(np.int64)
    step = np.diff(frame_id, prepend=frame_id[0] - 1)
    table.refuse(step < 0, "its frame comes after a later one; sort the table by frame_id")
    starts = step > 0
    if "time_s" in frames:
        is_later = np.diff(frames["time_s"], prepend=-np.inf) > 0
        cure = "; `columns: {time_s: null}` uses frame id over frame rate"
        table.refuse(starts & ~is_later, f"time_s is not later than in the frame before{cure}")
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
        source=str(path),
    )
    if "time_s" in frames:
        log = replace(log, time_s=frames["time_s"][starts])
    if row is None and table.columns.get("offset_m") is None:
        known = {*(COLUMNS if table.name_of("offset_m") else ("frame_id", "time_s"))} - table.used
        unused = [name + near_word(name, known) for name in data if name not in table.used]
        if any(unused):
            ignored = f"{path}: ignored column(s) {', '.join(filter(None, unused))}"
            warnings.warn(ignored, UserWarning, stacklevel=4)
    return log


@dataclass(frozen=True)
class _Table:
    """A table whose columns are found by our names.

    - row (N,): row of the file, or message, of each value.
    - used: names of the columns that were read.
    """

    data: Mapping[str, Any]
    columns: Columns
    path: Path
    row: IntArray
    used: set[str] = field(default_factory=set)

    def name_of(self, ours: str) -> Any:
        """The name of a column in the table, several names, or None."""
        return self.columns.get(ours, ours if ours in self.data else None)

    def column(self, ours: str, theirs: str) -> Any:
        """A column. Raises InputError for an unknown name."""
        if theirs not in self.data:
            raise InputError(
                f"{self.path}: columns: {ours}: there is no column"
                f" '{theirs}'{near_word(theirs, self.data)}; there are {', '.join(self.data)}"
            )
        self.used.add(theirs)
        return self.data[theirs]

    def numbers(self, ours: str, theirs: str) -> FloatArray:
        """A column as numbers, (N,)."""
        return to_numbers(self.path, ours, self.column(ours, theirs), theirs, self.row)

    def refuse(self, bad: BoolArray, problem: str, at: IntArray | None = None) -> None:
        """Raise InputError for the first bad row. at: the rows of `bad`, by default all."""
        if bad.any():
            k = int(np.argmax(bad))
            k = k if at is None else int(at[k])
            raise InputError(f"{self.path}: row {self.row[k] + 1}: {problem}")


# --- lines and frames ----------------------------------------------------------------------------


def _columns_of_lines(table: _Table) -> list[dict[str, str]]:
    """For each line of a row, the names of its columns by ours."""
    theirs = {name: table.name_of(name) for name in ("offset_m", *OF_LINE, "line")}
    offset = theirs["offset_m"]
    if isinstance(offset, str):
        return [{ours: name for ours, name in theirs.items() if name is not None}]
    if offset is not None:
        several = {ours: names for ours, names in theirs.items() if isinstance(names, tuple)}
        return [{ours: names[k] for ours, names in several.items()} for k in range(len(offset))]
    found = []
    for match in filter(None, map(_WIDE.fullmatch, table.data)):
        names = {ours: f"{ours}_{match[1]}" for ours in OF_LINE}
        there = {ours: name for ours, name in names.items() if name in table.data}
        found.append({"offset_m": match[0], **there})
    if not found:
        raise InputError(
            f"{table.path}: no column offset_m{near_word('offset_m', table.data)}; the table"
            f" has {', '.join(table.data)}; it needs a row per line (frame_id, line, offset_m)"
            " or per frame (frame_id, offset_1, offset_2, ...); name yours with `columns:"
            " {offset_m: NAME}`, see `egolane show FILE`"
        )
    return found


def _lines_of(table: _Table, at: IntArray) -> dict[str, NDArray[Any]]:
    """The columns of all lines by our names, and the `row` of each line.

    - at (N,): the frame of each row, from 0.
    """
    found: list[dict[str, NDArray[Any]]] = []
    rows = np.arange(len(at))
    is_long = isinstance(table.name_of("offset_m"), str)
    for number, names in enumerate(_columns_of_lines(table), start=1):
        cells = {ours: table.numbers(ours, theirs) for ours, theirs in names.items()}
        offset = cells["offset_m"] / _PER_METRE[table.columns.get("unit", "m")]
        is_empty = np.isnan(offset)
        cells = {
            "is_valid": np.where(is_empty, 0.0, 1.0),
            "is_continuous": np.zeros(len(rows)),
            "lri": np.full(len(rows), np.nan),
            **cells,
            "offset_m": -offset if table.columns.get("left_positive", False) else offset,
        }
        if not is_long:
            # A valid line without an offset is kept, and refused later.
            is_there = ~is_empty | (cells["is_valid"] == 1)
            cells["line"] = np.full(len(rows), float(number))
        elif "line" in cells:
            is_there = ~np.isnan(cells["line"])
            table.refuse(~is_there & ~is_empty, "line is empty, but there is an offset")
            # Lines may be numbered from 0.
            cells["line"] = cells["line"] + (np.nanmin(cells["line"], initial=1) == 0)
        else:
            # A single row without an offset is a frame without lines.
            is_there = ~is_empty | (np.bincount(at)[at] > 1)
            cells["line"] = (rows - np.searchsorted(at, at) + 1).astype(np.float64)
        for name in ("is_valid", "is_continuous"):
            table.refuse(np.isnan(cells[name]) & is_there & ~is_empty, f"{name} is empty")
        found.append({name: each[is_there] for name, each in {**cells, "row": rows}.items()})
    lines = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    is_odd = (lines["line"] < 1) | (lines["line"] > MAX_LINES)
    table.refuse(is_odd, f"line is not in 1..{MAX_LINES}", lines["row"])
    first = np.unique(at[lines["row"]] * MAX_LINES + lines["line"], return_index=True)[1]
    is_first = np.isin(np.arange(len(is_odd)), first)
    table.refuse(~is_first, "its frame has this line twice", lines["row"])
    return lines


def _frames_of(table: _Table, first: int) -> dict[str, FloatArray]:
    """The frame id of each row (N,), and its time if there is such a column.

    - first: first frame id, if frames are numbered by their times.
    """
    ids, time = table.name_of("frame_id"), table.name_of("time_s")
    cells: dict[str, FloatArray] = {}
    if time is not None:
        column, unit = table.column("time_s", time), table.columns.get("time_unit", "s")
        cells["time_s"] = to_seconds(table.path, "time_s", column, time, table.row, unit)
    if ids is not None:
        cells["frame_id"] = table.numbers("frame_id", ids)
    elif time is not None:
        # One frame per median time step; a longer step is the nearest whole multiple.
        step = np.diff(cells["time_s"], prepend=-np.inf)
        table.refuse(~(step >= 0), "time is empty or goes back; sort by time")
        step = step[1:]
        usual = np.median(step[step > 0]) if (step > 0).any() else 1.0
        n_frames = np.where(step > 0, np.maximum(1, np.rint(step / usual)), 0)
        cells["frame_id"] = first + np.concatenate([[0.0], np.cumsum(n_frames)])
    else:
        raise InputError(
            f"{table.path}: no column frame_id{near_word('frame_id', table.data)}, nor time_s; the"
            f" table has {', '.join(table.data)}; name yours with `columns: {{frame_id: NAME}}` or"
            " `{time_s: NAME, time_unit: s}`"
        )
    for name, values in cells.items():
        table.refuse(np.isnan(values), f"{name} is empty")
    return cells


# --- cells ---------------------------------------------------------------------------------------


def arrow_column(column: Any) -> Any:
    """A column as an array of pyarrow. Raises `pyarrow.ArrowException` for mixed types."""
    if not isinstance(column, (pa.Array, pa.ChunkedArray)):
        column = pa.array(column, from_pandas=True)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def _is_text(column: Any) -> bool:
    return bool(pa.types.is_string(column.type) or pa.types.is_large_string(column.type))


def to_seconds(
    path: Path,
    name: str,
    column: Any,
    theirs: str = "",
    rows: IntArray | None = None,
    unit: str = "s",
) -> FloatArray:
    """A column as times in seconds, (N,): numbers of some unit, or dates (UTC without a zone).

    Parameters and errors: see `to_numbers`.
    """
    values, per = arrow_column(column), _PER_SECOND[unit]
    if _is_text(values):
        # Other texts are refused as numbers.
        with contextlib.suppress(ValueError):
            values = pa.array(pd.to_datetime(values.to_pandas(), utc=True, format="ISO8601"))
    if pa.types.is_timestamp(values.type):
        values, per = values.cast(pa.timestamp("ns", values.type.tz)).cast(pa.int64()), 10**9
    if pa.types.is_integer(values.type) and not values.null_count:
        # Nanoseconds since 1970 have more digits than a float.
        ticks = values.to_numpy(zero_copy_only=False)
        time_s: FloatArray = ticks // per + ticks % per / per
    else:
        time_s = to_numbers(path, name, values, theirs, rows) / per
    longest = float(np.nanmax(np.abs(time_s), initial=0))
    if longest > 1e11:
        raise InputError(
            f"{path}: {theirs or name} is {longest * per:.4g}, which is no time in {unit}; set"
            " `columns: {time_unit: ns}` (or ms, us)"
        )
    return time_s


def to_numbers(
    path: Path, name: str, column: Any, theirs: str = "", rows: IntArray | None = None
) -> FloatArray:
    """The cells of a column as numbers, (N,); NaN if empty. Text is parsed.

    - name: our name of the column, which decides what is allowed.
    - column: of pyarrow or pandas, or a list.
    - theirs: the name in the table, if it is another one.
    - rows (N,): the row of the file of each cell, for messages.

    Raises InputError for a cell that is not a number, not whole, or not a flag.
    """
    theirs = name if theirs in ("", name) else f"{theirs} ({name})"
    is_flag = name in _FLAGS
    needed = "a whole number" if name in _WHOLE else "a number"
    needed = "true, false, 1 or 0" if is_flag else needed
    try:
        column = arrow_column(column)
        if _is_text(column):
            text = column.to_pandas().str.strip().str.lower().replace("", None)
            text = text.replace({"true": "1", "false": "0"}) if is_flag else text
            values = np.asarray(pd.to_numeric(text, errors="coerce"), dtype=np.float64)
            bad = np.isnan(values) & text.notna().to_numpy() & (text != "nan").to_numpy()
        elif pa.types.is_boolean(column.type) and not is_flag:
            raise pa.ArrowInvalid
        else:
            numbers = column.cast(pa.float64(), safe=False).fill_null(np.nan)
            values, bad = np.asarray(numbers), np.zeros(len(column), dtype=bool)
    except (pa.ArrowException, OverflowError):
        kind = getattr(column, "type", "mixed")
        raise InputError(f"{path}: column {theirs} has type {kind}, not {needed}") from None
    if is_flag:
        bad = bad | ~(np.isnan(values) | np.isin(values, (0, 1)))
    elif name in _WHOLE:
        # pandas writes whole numbers as 12.0 if other cells of the column are empty.
        is_whole = (np.floor(values) == values) & (np.abs(values) < 2.0**53)
        bad = bad | ~(np.isnan(values) | is_whole)
    if bad.any():
        k = int(np.argmax(bad))
        row = 1 + int(k if rows is None else rows[k])
        raise InputError(f"{path}: row {row}: {theirs} is {column[k].as_py()!r:.40}, not {needed}")
    return values
