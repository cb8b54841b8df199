"""Columns of a table, or fields of messages: names, types, units and cells.

Each table that comes in, from a file or from memory, is checked here. `recording.columns` maps our
names of the columns of lines, `COLUMNS`, to other names; the default is our own name.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from decimal import Decimal
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings.clock import EPOCH_S, PER_SECOND, unit_of
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import FloatArray, InputError, IntArray, near_word

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

#: Columns as callers give them: a section, a dict, or `ours=theirs,ours=theirs`.
ColumnsGiven = Columns | Mapping[str, Any] | str | Sequence[str]

#: Columns of a line, without its offset.
OF_LINE = ("is_valid", "is_continuous", "lri")


class Column(NamedTuple):
    """A column of a table that comes in.

    - kind: "number", "whole", "flag" (true or false) or "time" (seconds).
    - is_needed: a table without the column is refused.
    - is_full: empty cells are refused.
    - others: further names of the column.
    """

    kind: str = "number"
    is_needed: bool = False
    is_full: bool = False
    others: tuple[str, ...] = ()


#: Flags as text.
_WORDS = {"true": True, "false": False}

#: The type of a column without and with empty cells, by its kind.
_TYPES = {
    "number": ("float64", "float64"),
    "time": ("float64", "float64"),
    "whole": ("int64", "Int64"),
    "flag": ("bool", "boolean"),
}


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


# --- tables --------------------------------------------------------------------------------------


def checked(
    given: Any,
    declared: Mapping[str, Column],
    source: str,
    names: Mapping[str, str] = MappingProxyType({}),
) -> pd.DataFrame:
    """Check a table, and give each declared column our name and its type.

    - given: a DataFrame, of a file or in memory; its index counts as columns.
    - declared: the columns by our names. Other columns are returned as they are.
    - source: the file, for messages.
    - names: names of columns in the table, by ours.

    Raises InputError as `plain`, for a column that is missing, and as `to_numbers`.
    """
    table = plain(given, source)
    found: dict[str, pd.Series] = {}
    for ours, (kind, is_needed, is_full, others) in declared.items():
        theirs = names.get(ours) or next(filter(table.__contains__, (ours, *others)), ours)
        if theirs not in table:
            if is_needed or ours in names:
                near = f"{near_word(theirs, table)}; the table has {', '.join(table)}"
                raise InputError(f"{source}: no column {theirs}{near}")
            continue
        cells = table[theirs]
        if kind == "time":
            cells = pd.Series(to_seconds(source, ours, cells, theirs))
        else:
            cells = pd.Series(to_numbers(source, ours, cells, theirs, kind=kind))
        is_empty = cells.isna().to_numpy(dtype=bool)
        if is_full and is_empty.any():
            raise InputError(f"{source}: row {int(is_empty.argmax()) + 1}: {theirs} is empty")
        found[ours] = cells.astype(_TYPES[kind][not is_full])
    return table.assign(**found)


def plain(given: Any, source: str) -> pd.DataFrame:
    """A DataFrame with its index among its columns, each with one name, which is text.

    Raises InputError for another object, for names of several levels and for repeated names.
    """
    if not isinstance(given, pd.DataFrame):
        raise InputError(f"{source}: {given!r:.60} is neither a file nor a DataFrame")
    if given.columns.nlevels > 1:
        raise InputError(
            f"{source}: the columns have names of {given.columns.nlevels} levels, such as"
            f" {', '.join(map(str, given.columns[0]))}; give each a single name, e.g. offset_1"
        )
    table = given.rename(columns=lambda name: str(name).strip())
    categories = table.columns[[isinstance(t, pd.CategoricalDtype) for t in table.dtypes]]
    named = [k for k, n in enumerate(table.index.names) if n is not None and str(n) not in table]
    table = table.reset_index(named, allow_duplicates=True).rename(columns=str)
    twice = table.columns[table.columns.duplicated() & (table.columns != "")]
    if len(twice):
        raise InputError(f"{source}: column {twice[0]} occurs more than once")
    return table.reset_index(drop=True).astype(dict.fromkeys(categories, object))


# --- cells ---------------------------------------------------------------------------------------


def to_seconds(
    path: str | Path,
    name: str,
    column: Any,
    theirs: str = "",
    rows: IntArray | None = None,
    unit: str | None = None,
) -> FloatArray:
    """A column as times in seconds, (N,): numbers, durations, or dates (UTC without a zone).

    - unit: the unit of numbers; None for seconds, if no other unit can be set.

    Other parameters and errors: see `to_numbers`.
    """
    cells = pd.Series(column)
    dates = _dates(cells)
    if dates is not None:
        ticks = dates.astype(np.int64).to_numpy()
        return np.where(dates.isna(), np.nan, _divided(ticks, PER_SECOND[dates.dt.unit]))
    per = PER_SECOND[unit or "s"]
    if pd.api.types.is_integer_dtype(cells) and not cells.hasnans:
        time_s = _divided(cells.to_numpy(np.int64), per)
    else:
        time_s = to_numbers(path, name, cells, theirs, rows) / per
    latest = float(np.nanmax(np.abs(time_s), initial=0))
    right = unit_of(latest * per, EPOCH_S)
    if latest > 1e11 or (latest > EPOCH_S[1] and right is not None):
        cure = "" if right is None else f"; it is in {right}: convert it to seconds"
        if unit is not None and right is not None:
            cure = f"; set `columns: {{time_unit: {right}}}`"
        raise InputError(
            f"{path}: {theirs or name} is {latest * per:.4g}, which is not a time in"
            f" {unit or 's'}{cure}"
        )
    return time_s


def _dates(cells: pd.Series) -> Any:
    """Cells as dates or durations, also parsed from text; None for numbers and other cells."""
    kind = pd.api.types.infer_dtype(cells)
    if kind in ("datetime64", "timedelta64"):
        return cells
    if kind not in ("string", "datetime", "date", "timedelta"):
        return None
    with contextlib.suppress(TypeError, ValueError):
        cells.to_numpy(np.float64, na_value=np.nan)
        return None
    with contextlib.suppress(TypeError, ValueError):
        return pd.to_datetime(cells, utc=True, format="ISO8601")
    with contextlib.suppress(TypeError, ValueError):
        return pd.to_timedelta(cells)
    return None


def _divided(ticks: IntArray, per_second: int) -> FloatArray:
    """Ticks in seconds. Nanoseconds since 1970 have more digits than a float."""
    time_s: FloatArray = ticks // per_second + ticks % per_second / per_second
    return time_s


def to_numbers(
    path: str | Path,
    name: str,
    column: Any,
    theirs: str = "",
    rows: IntArray | None = None,
    *,
    kind: str = "number",
) -> FloatArray:
    """The cells of a column as numbers, (N,); NaN if empty. Text is parsed.

    - name: our name of the column.
    - column: of pandas, or an array.
    - theirs: the name in the table, if it is another one.
    - rows (N,): the row of the file of each cell, for messages.
    - kind: "number", "whole", or "flag" (true, false, 1 or 0).

    Raises InputError, with its row, for a cell that is not a number, not whole, or not a flag.
    """
    cells = pd.Series(column)
    is_bool = kind == "flag" and pd.api.types.is_bool_dtype(cells)
    if is_bool or pd.api.types.is_any_real_numeric_dtype(cells):
        values: FloatArray = cells.to_numpy(np.float64, na_value=np.nan)
        bad = np.zeros(len(cells), dtype=bool)
    else:
        parsed = [_number(cell, kind == "flag") for cell in cells]
        bad = np.array([number is None for number in parsed], dtype=bool)
        values = np.array([np.nan if n is None else n for n in parsed], dtype=np.float64)
    needed = "not a number"
    if kind == "flag":
        needed = "not true, false, 1 or 0"
        bad |= ~(np.isnan(values) | np.isin(values, (0, 1)))
    elif kind == "whole":
        needed = "not a whole number"
        # pandas writes whole numbers as 12.0 if other cells of the column are empty.
        bad |= ~(np.isnan(values) | (np.floor(values) == values)) | np.isinf(values)
        if not bad.any():
            needed = "larger than 2**53"
            bad = np.abs(values) >= 2.0**53
    if bad.any():
        k = int(np.argmax(bad))
        row = 1 + int(k if rows is None else rows[k])
        theirs = name if theirs in ("", name) else f"{theirs} ({name})"
        cell = cells.tolist()[k]
        raise InputError(f"{path}: row {row}: {theirs} is {cell!r:.40}, {needed}")
    return values


def _number(cell: Any, is_flag: bool) -> float | None:
    """A cell as a number; NaN if it is empty, None if it is not a number."""
    if isinstance(cell, (str, bytes)):
        cell = cell.strip().lower() or None
        cell = _WORDS.get(cell, cell) if is_flag else cell
    if cell is None or cell is pd.NA or cell is pd.NaT:
        return np.nan
    is_number = isinstance(cell, (str, bytes, Real, Decimal, np.bool_))
    if is_number and (is_flag or not isinstance(cell, (bool, np.bool_))):
        with contextlib.suppress(ValueError, OverflowError):
            return float(cell)
    return None
