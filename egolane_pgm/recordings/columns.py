"""Columns of a table, or fields of messages, as lines: names, units, signs and cells.

`recording.columns` maps our names, `COLUMNS`, to other names; the default is our own name. A row of
the table is a line, or a frame with a column for each of its lines.
"""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

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

#: Columns of a line, without its offset.
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
    for text in [given] if isinstance(given, str) else given:
        if "=" not in text:
            raise InputError(
                f"columns: {text!r}: write it as ours=theirs, e.g. offset_m=lateral, or"
                " offset_m=[left,right]"
            )
        keys |= parse_yaml("{" + text.replace("=", ": ") + "}", f"columns: {text}")
    return keys


def lines_of_columns(
    data: pd.DataFrame,
    columns: Columns | None,
    path: Path,
    frame_rate: float = FRAME_RATE,
    *,
    first: int = 0,
    row: IntArray | None = None,
) -> LineLog:
    """The lines of a table, T frames of at most L lines.

    - data: N rows.
    - columns: names, units and signs of the columns; None for our own. Other names are covariates.
    - path: the file, for messages.
    - frame_rate: frames per second of a table without times.
    - first: first frame id, if frames are numbered by their times.
    - row (N,): the message of each row; None for a table.

    Raises InputError for an unknown column, a wrong cell (with its row), frames that decrease, a
    line that occurs twice in a frame, and a valid line without a finite offset.
    """
    if data.empty:
        raise InputError(f"{path}: the table has no rows")
    names: Any = {ours: ours for ours in COLUMNS if ours in data} | dict(columns or {})
    table = _Table(data, names, path, np.arange(len(data)) if row is None else row)
    covariates = {ours: names[ours] for ours in names if ours not in Columns.__annotations__}
    for ours in (*COLUMNS, *covariates):
        theirs = names.get(ours)
        for name in theirs if isinstance(theirs, tuple) else (theirs,):
            if name is not None and name not in data:
                meant = near_word(name, data) or f"; there are {', '.join(data)}"
                raise InputError(f"{path}: columns: {ours}: there is no column {name!r}{meant}")
    frame_id, time_s = _frames_of(table, first)
    starts = np.diff(frame_id, prepend=frame_id[0] - 1) != 0
    if time_s is not None:
        is_later = np.diff(time_s, prepend=-np.inf) > 0
        cure = "; `columns: {time_s: null}` uses frame id over frame rate"
        table.refuse(starts & ~is_later, f"time_s is not later than in the frame before{cure}")
    at = np.cumsum(starts) - 1
    lines = _columns_of_lines(table)
    row_frame, of_line = _lines_of(table, lines, at)
    log = LineLog.from_rows(frame_id[starts], frame_rate, row_frame, **of_line, source=str(path))
    if time_s is not None:
        log = replace(log, time_s=time_s[starts])
    values = {ours: table.of_frame(ours, theirs, starts) for ours, theirs in covariates.items()}
    log = replace(log, covariates=values) if values else log
    if row is None and (columns or {}).get("offset_m") is None:
        used = {names.get("frame_id"), names.get("time_s"), *(n for k in lines for n in k.values())}
        used |= {*covariates.values()}
        known = {*(COLUMNS if "offset_m" in names else ("frame_id", "time_s"))} - used
        unused = [name + near_word(name, known) for name in data if name not in used]
        if any(unused):
            ignored = f"{path}: ignored column(s) {', '.join(filter(None, unused))}"
            warnings.warn(ignored, UserWarning, stacklevel=4)
    return log


@dataclass(frozen=True)
class _Table:
    """A table of N rows.

    - names: columns of the table by our names, units and signs.
    - row (N,): row of the file, or message, of each row.
    """

    data: pd.DataFrame
    names: Mapping[str, Any]
    path: Path
    row: IntArray

    def numbers(self, ours: str, theirs: str) -> FloatArray:
        """A column as numbers, (N,)."""
        return to_numbers(self.path, ours, self.data[theirs], theirs, self.row)

    def of_frame(self, ours: str, theirs: str, starts: BoolArray) -> FloatArray:
        """A covariate of each frame, (T,); flags are 0 and 1. starts (N,): first rows of frames."""
        cells = self.data[theirs]
        cells = cells.astype("Float64") if pd.api.types.is_bool_dtype(cells) else cells
        values = to_numbers(self.path, ours, cells, theirs, self.row)
        first = values[starts][np.cumsum(starts) - 1]
        same = (values == first) | (np.isnan(values) & np.isnan(first))
        self.refuse(~same, f"{theirs} differs from the row before, of the same frame")
        return values[starts]

    def refuse(self, bad: BoolArray, problem: str, at: IntArray | None = None) -> None:
        """Raise InputError for the first bad row. at: the rows of `bad`, by default all."""
        if bad.any():
            k = int(np.argmax(bad))
            k = k if at is None else int(at[k])
            raise InputError(f"{self.path}: row {self.row[k] + 1}: {problem}")


# --- lines and frames ----------------------------------------------------------------------------


def _columns_of_lines(table: _Table) -> list[dict[str, str]]:
    """For each line of a row, the names of its columns by ours."""
    theirs = {ours: table.names.get(ours) for ours in ("offset_m", *OF_LINE, "line")}
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


def _lines_of(
    table: _Table, lines: list[dict[str, str]], at: IntArray
) -> tuple[IntArray, dict[str, Any]]:
    """The frame of each line, and the other arguments of `LineLog.from_rows`.

    - lines: the columns of each line of a row.
    - at (N,): the frame of each row, from 0.
    """
    blank = np.full(len(at), np.nan)

    def cells(ours: str) -> FloatArray:
        return np.concatenate([
            table.numbers(ours, names[ours]) if ours in names else blank for names in lines
        ])  # fmt: skip

    row = np.tile(np.arange(len(at)), len(lines))
    offset = cells("offset_m") / _PER_METRE[table.names.get("unit", "m")]
    is_empty = np.isnan(offset)
    found: dict[str, Any] = {
        "offset_m": -offset if table.names.get("left_positive", False) else offset,
        "lri": cells("lri"),
    }
    for name, default in (("is_valid", ~is_empty), ("is_continuous", False)):
        flag = cells(name)
        has_column = np.repeat([name in names for names in lines], len(at))
        table.refuse(np.isnan(flag) & has_column & ~is_empty, f"{name} is empty", row)
        found[name] = np.where(has_column, flag == 1, default)
    if "line" in lines[0]:
        line: Any = cells("line")
        is_there = ~np.isnan(line)
        table.refuse(~is_there & ~is_empty, "line is empty, but there is an offset")
        # Lines may be numbered from 0.
        line += np.nanmin(line, initial=1) == 0
    elif isinstance(table.names.get("offset_m"), str):
        line = row - np.searchsorted(at, at) + 1.0
        # A single row without an offset is a frame without lines.
        is_there = ~is_empty | (np.bincount(at)[at] > 1)
    else:
        line = np.repeat(np.arange(len(lines)) + 1.0, len(at))
        # A valid line without an offset is kept, and refused later.
        is_there = ~is_empty | found["is_valid"]
    row, line = row[is_there], line[is_there]
    table.refuse((line < 1) | (line > MAX_LINES), f"line is not in 1..{MAX_LINES}", row)
    is_twice = pd.Series(at[row] * MAX_LINES + line).duplicated().to_numpy()
    cure = "; `columns: {frame_id: null}` numbers frames by their times"
    table.refuse(is_twice, f"its frame has this line twice{cure}", row)
    kept = {name: values[is_there] for name, values in found.items()}
    return at[row], {**kept, "row_line": line.astype(np.int64) - 1}


def _frames_of(table: _Table, first: int) -> tuple[IntArray, FloatArray | None]:
    """The frame id of each row (N,), and its time if there is such a column.

    - first: first frame id, if frames are numbered by their times.
    """
    path, ids, time = table.path, table.names.get("frame_id"), table.names.get("time_s")
    time_s = None
    frame_id: FloatArray
    if time is not None:
        unit = table.names.get("time_unit", "s")
        time_s = to_seconds(path, "time_s", table.data[time], time, table.row, unit)
        table.refuse(np.isnan(time_s), "time_s is empty")
    if ids is not None:
        frame_id = table.numbers("frame_id", ids)
        table.refuse(np.isnan(frame_id), "frame_id is empty")
    elif time_s is not None:
        # One frame per median time step; a longer step is the nearest whole multiple.
        step = np.diff(time_s, prepend=time_s[0])
        table.refuse(step < 0, "time_s goes back; sort by time")
        usual = np.median(step[step > 0]) if (step > 0).any() else 1.0
        n_frames = np.where(step > 0, np.maximum(1, np.rint(step / usual)), 0)
        frame_id = first + np.cumsum(n_frames)
    else:
        raise InputError(
            f"{path}: no column frame_id{near_word('frame_id', table.data)}, nor time_s; the"
            f" table has {', '.join(table.data)}; name yours with `columns: {{frame_id: NAME}}` or"
            " `{time_s: NAME, time_unit: s}`"
        )
    return frame_id.astype(np.int64), time_s


# --- cells ---------------------------------------------------------------------------------------


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
    values, per = pd.Series(column), _PER_SECOND[unit]
    if pd.api.types.infer_dtype(values) == "string":
        # Other texts are refused as numbers.
        with contextlib.suppress(ValueError):
            values = pd.to_datetime(values, utc=True, format="ISO8601")
    if pd.api.types.is_datetime64_any_dtype(values) and not values.hasnans:
        values, per = values.dt.as_unit("ns").astype(np.int64), 10**9
    if pd.api.types.is_integer_dtype(values):
        # Nanoseconds since 1970 have more digits than a float.
        ticks = values.to_numpy()
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
    - column: of pandas, or an array.
    - theirs: the name in the table, if it is another one.
    - rows (N,): the row of the file of each cell, for messages.

    Raises InputError, with its row, for a cell that is not a number, not whole, or not a flag.
    """
    cells = pd.Series(column)
    is_flag = name in _FLAGS
    if pd.api.types.is_bool_dtype(cells) and not is_flag:
        bad, values = np.ones(len(cells), dtype=bool), np.full(len(cells), np.nan)
    else:
        try:
            values = cells.to_numpy(np.float64, na_value=np.nan)
            bad = np.zeros(len(cells), dtype=bool)
        except (TypeError, ValueError):
            text = cells.map(str).str.strip().str.lower()
            text = text.replace({"true": "1", "false": "0"}) if is_flag else text
            values = pd.to_numeric(text, errors="coerce").to_numpy(np.float64, na_value=np.nan)
            is_empty = cells.isna() | text.isin(["", "nan"])
            bad = np.isnan(values) & ~is_empty.to_numpy(dtype=bool)
    needed = "a number"
    if is_flag:
        needed = "true, false, 1 or 0"
        bad = bad | ~(np.isnan(values) | np.isin(values, (0, 1)))
    elif name in _WHOLE:
        needed = "a whole number"
        # pandas writes whole numbers as 12.0 if other cells of the column are empty.
        is_whole = (np.floor(values) == values) & (np.abs(values) < 2.0**53)
        bad = bad | ~(np.isnan(values) | is_whole)
    if bad.any():
        k = int(np.argmax(bad))
        row = 1 + int(k if rows is None else rows[k])
        theirs = name if theirs in ("", name) else f"{theirs} ({name})"
        cell = cells.tolist()[k]
        raise InputError(f"{path}: row {row}: {theirs} is {cell!r:.40}, not {needed}")
    return values
