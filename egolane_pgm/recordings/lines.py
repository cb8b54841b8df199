"""Rows of a table, or of messages, as lines.

A row is a line, or a frame with a column for each of its lines.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings.columns import COLUMNS, FRAME_RATE, OF_LINE, to_numbers, to_seconds
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog, near_word

#: A greater number of a line is a mistake, and would fill the memory with padding.
MAX_LINES = 1000

#: The kinds of our columns; the others are numbers.
_KINDS = {
    "frame_id": "whole",
    "line": "whole",
    "is_valid": "flag",
    "is_continuous": "flag",
}

#: The offset of a line in a table with a row per frame; `is_valid_1` and so on go with it.
_WIDE = re.compile(r"offset_(\d+)")

_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


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
        cells = self.data[theirs]
        kind = _KINDS.get(ours, "number")
        return to_numbers(self.path, ours, cells, theirs, self.row, kind=kind)

    def of_frame(self, ours: str, theirs: str, starts: BoolArray) -> FloatArray:
        """A covariate of each frame, (T,); flags are 0 and 1. starts (N,): first rows of frames."""
        cells = self.data[theirs]
        kind = "flag" if pd.api.types.infer_dtype(cells) == "boolean" else "number"
        values = to_numbers(self.path, ours, cells, theirs, self.row, kind=kind)
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
            " {offset_m: NAME}`" + ", see `egolane show FILE`" * table.path.exists()
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
    row = row[is_there]
    line = line[is_there]
    table.refuse((line < 1) | (line > MAX_LINES), f"line is not in 1..{MAX_LINES}", row)
    is_twice = pd.Series(at[row] * MAX_LINES + line).duplicated().to_numpy()
    cure = "; remove it, or give the lines different numbers in the column line"
    if table.names.get("frame_id") is not None and "time_s" in {*table.names, *table.data}:
        cure = "; `columns: {frame_id: null}` numbers frames by their times"
    table.refuse(is_twice, f"its frame has this line twice{cure}", row)
    kept = {name: values[is_there] for name, values in found.items()}
    return at[row], {**kept, "row_line": line.astype(np.int64) - 1}


def _frames_of(table: _Table, first: int) -> tuple[IntArray, FloatArray | None]:
    """The frame id of each row (N,), and its time if there is such a column.

    - first: first frame id, if frames are numbered by their times.
    """
    path = table.path
    ids = table.names.get("frame_id")
    time = table.names.get("time_s")
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
        problem = f"no column frame_id{near_word('frame_id', table.data)}, nor time_s"
        if {"frame_id", "time_s"} & table.names.keys():
            problem = "without frame_id, frames need a column time_s, and the other way round"
        raise InputError(
            f"{path}: {problem}; the table has {', '.join(table.data)}; name yours with `columns:"
            " {frame_id: NAME}` or `{time_s: NAME, time_unit: s}`"
        )
    return frame_id.astype(np.int64), time_s
