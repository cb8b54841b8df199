"""Recordings of lines as tables, CSV or Parquet: one row per line.

Columns: frame_id, line (1, 2, ... within the frame, in the detector's order), offset_m,
is_valid, is_continuous, lri. A frame without lines is one row with an empty line and offset.
Frames that `missing_frames: predict` put in are marked in a further column, is_missing.
"""

from __future__ import annotations

import warnings
from csv import reader as csv_rows
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.files import atomic, write_parquet
from egolane_pgm.recordings.rosbag import MAX_LINES
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog, suggestion

NEEDED = ("frame_id", "line", "offset_m")
OPTIONAL = ("is_valid", "is_continuous", "lri", "is_missing")
COLUMNS = (*NEEDED, *OPTIONAL)


def read_table(path: str | Path, *, frame_rate: float = 10.0) -> LineLog:
    """The lines of a CSV or Parquet table (by extension), T frames of at most L lines.

    Columns that a detector lacks: without is_valid every line is valid, without is_continuous
    none is continuous, without lri the LRI is unknown (NaN). Other columns are ignored, which one
    warning says. frame_rate: frames per second; time is frame id over frame rate.

    Raises InputError for a file that is missing or no such table, a missing column (the ones that
    are there get listed), no rows, a cell that does not fit its column (with its place), frames
    that decrease, a line given twice in a frame, and a valid line without a finite offset.
    """
    path = Path(path)
    if not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"{path}: frame_rate {frame_rate} must be greater than 0")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    read = {".csv": _read_csv, ".parquet": _read_parquet}.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
    return _assemble(path, read(path), frame_rate)


def write_table(path: str | Path, log: LineLog) -> None:
    """Write a log as CSV or Parquet (by extension); `read_table` gives it back as it was.

    Raises InputError for another extension, or where the file cannot be written.
    """
    path = Path(path)
    write = {".csv": _write_csv, ".parquet": write_parquet}.get(path.suffix.lower())
    if write is None:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
    write(path, _to_arrow(log))


# --- writing -----------------------------------------------------------------------------------


def _to_arrow(log: LineLog) -> Any:
    import pyarrow as pa

    is_there = (
        log.is_valid | log.is_continuous | ~np.isnan(log.offset_m) | ~np.isnan(log.lri)
    )  # everything else is padding
    n_frames, n_lines = is_there.shape
    if n_frames and n_lines and not is_there[:, -1].any():
        is_there[0, -1] = True  # an empty line says how wide the padding is
    empty = np.flatnonzero(~is_there.any(axis=1))
    frame, line = np.nonzero(is_there)
    frame, line = np.concatenate([frame, empty]), np.concatenate([line, np.full(len(empty), -1)])
    order = np.argsort(frame, kind="stable")
    frame, line = frame[order], line[order]
    no_line = line < 0

    def column(values: NDArray[Any], otherwise: float | bool) -> NDArray[Any]:
        if n_lines == 0:
            return np.full(len(frame), otherwise, dtype=values.dtype)
        return np.where(no_line, otherwise, values[frame, line])

    lri = column(log.lri, np.nan)
    columns = {
        "frame_id": pa.array(log.frame_id[frame]),
        "line": pa.array(line + 1, mask=no_line),
        "offset_m": pa.array(column(log.offset_m, np.nan), mask=no_line),
        "is_valid": pa.array(column(log.is_valid, False)),
        "is_continuous": pa.array(column(log.is_continuous, False)),
        "lri": pa.array(lri, mask=np.isnan(lri)),
    }
    if log.is_missing.any():
        columns["is_missing"] = pa.array(log.is_missing[frame])
    return pa.table(columns)


def _write_csv(path: Path, table: Any) -> None:
    from pyarrow import csv

    with atomic(path) as temporary, temporary.open("wb") as file:
        file.write((",".join(table.column_names) + "\n").encode())
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))


# --- reading -----------------------------------------------------------------------------------


def _check_columns(path: Path, names: list[str]) -> list[str]:
    """The columns to read; InputError for a missing one, one warning for all ignored ones."""
    lacking = [name for name in NEEDED if name not in names]
    if lacking:
        raise InputError(
            f"{path}: no column {', '.join(lacking)}; the table has {', '.join(names) or 'none'}"
        )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{path}: column {', '.join(twice)} occurs more than once")
    extra = [name for name in names if name not in COLUMNS]
    if extra:
        unused = [name for name in OPTIONAL if name not in names]
        said = []
        for name in extra:
            hint = suggestion(name, unused)
            said.append(name + (hint if "did you mean" in hint else ""))
        warnings.warn(f"{path}: ignored column(s) {', '.join(said)}", UserWarning, stacklevel=3)
    return [name for name in names if name in COLUMNS]


def _read_csv(path: Path) -> Any:
    import pyarrow as pa
    from pyarrow import csv

    try:
        with path.open(encoding="utf-8-sig") as file:
            header = file.readline()
            has_rows = any(line.strip() for line in file)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as CSV ({error})") from None
    raw_names = [name.strip() for name in next(csv_rows([header.strip()]), [])]
    if not raw_names:
        raise InputError(f"{path}: the file is empty")
    keep = _check_columns(path, raw_names)
    if not has_rows:
        raise InputError(f"{path}: the table has no rows")
    try:
        return csv.read_csv(
            path,
            csv.ReadOptions(use_threads=False, column_names=raw_names, skip_rows=1),
            csv.ParseOptions(ignore_empty_lines=True),
            csv.ConvertOptions(
                column_types={name: pa.string() for name in keep},
                include_columns=keep,
                null_values=[""],
                strings_can_be_null=True,
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        text = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: cannot be read as CSV ({text})") from None


def _read_parquet(path: Path) -> Any:
    import pyarrow as pa
    from pyarrow import parquet

    # Given a name, pyarrow takes what is before a colon for the scheme of an address.
    try:
        names = list(parquet.ParquetFile(pa.OSFile(str(path))).schema_arrow.names)
    except (pa.ArrowException, OSError) as error:
        text = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a whole Parquet file ({text})") from None
    keep = _check_columns(path, names)
    try:
        return parquet.ParquetFile(pa.OSFile(str(path))).read(columns=keep)
    except (pa.ArrowException, OSError) as error:
        text = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: the Parquet file is damaged ({text})") from None


@dataclass(frozen=True)
class _Rows:
    """The cells of a table as arrays (N,); `is_null` says which cells are empty."""

    path: Path
    values: dict[str, NDArray[Any]]
    is_null: dict[str, BoolArray]

    def place(self, row: int) -> str:
        """Where a row is, as an editor would say it (CSV), or counted from 1 (Parquet)."""
        if self.path.suffix.lower() != ".csv":
            return f"{self.path}: row {row + 1}"
        with self.path.open(encoding="utf-8-sig", errors="replace") as file:
            filled = [number for number, line in enumerate(file, start=1) if line.strip()]
        return f"{self.path}: line {filled[row + 1] if row + 1 < len(filled) else row + 2}"

    def refuse(self, bad: BoolArray, why: str) -> None:
        """InputError at the first row that is bad; `{}` in `why` is its frame id."""
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(f"{self.place(row)}: " + why.format(self.values["frame_id"][row]))


def _assemble(path: Path, table: Any, frame_rate: float) -> LineLog:
    rows = _convert(path, table)
    n_rows = len(rows.values["frame_id"])
    if n_rows == 0:
        raise InputError(f"{path}: the table has no rows")
    for name in ("frame_id", "is_missing"):
        if name in rows.is_null:
            rows.refuse(rows.is_null[name], f"{name} is empty")
    frame, line = rows.values["frame_id"], rows.values["line"] - 1
    has_line = ~rows.is_null["line"]
    step = np.diff(frame, prepend=frame[:1])
    rows.refuse(step < 0, "frame {} comes after a later one; sort the table by frame_id")
    rows.refuse(has_line & ((line < 0) | (line >= MAX_LINES)), f"line is not in 1..{MAX_LINES}")
    rows.refuse(~has_line & ~rows.is_null["offset_m"], "frame {} has an offset without a line")
    starts = step != 0
    starts[0] = True
    at = np.cumsum(starts) - 1
    alone = np.bincount(at)[at] == 1
    rows.refuse(~has_line & ~alone, "frame {} has a row without a line beside others")
    n_lines = int(line[has_line].max(initial=-1)) + 1
    rows.refuse(_occurs_again(at * (n_lines + 1) + line, has_line), "frame {} has this line twice")

    offset = _offsets(rows, has_line)
    valid = rows.values.get("is_valid", np.ones(n_rows, dtype=bool))
    continuous = rows.values.get("is_continuous", np.zeros(n_rows, dtype=bool))
    lri = rows.values.get("lri", np.full(n_rows, np.nan))
    for name in ("is_valid", "is_continuous"):
        if name in rows.is_null:
            rows.refuse(rows.is_null[name] & has_line, f"frame {{}} has a line with empty {name}")
    rows.refuse(
        has_line & valid & ~np.isfinite(offset),
        "frame {} has a valid line without a finite offset; drop it or mark it not valid",
    )
    missing = rows.values.get("is_missing", np.zeros(n_rows, dtype=bool))

    return LineLog.from_rows(
        frame[starts],
        frame_rate,
        at[has_line],
        offset[has_line],
        valid[has_line],
        continuous[has_line],
        lri[has_line],
        row_line=line[has_line],
        is_missing=missing[starts],
        source=str(path),
    )


def _offsets(rows: _Rows, has_line: BoolArray) -> FloatArray:
    values: FloatArray = rows.values["offset_m"]
    if "is_valid" not in rows.values:
        rows.refuse(
            has_line & np.isnan(values),
            "frame {} has a line without an offset; leave line empty too, or add column is_valid",
        )
    return values


def _occurs_again(key: IntArray, which: BoolArray) -> BoolArray:
    """True where a key, among `which`, was there in an earlier row."""
    again = np.zeros(len(key), dtype=bool)
    rows = np.flatnonzero(which)
    _, first = np.unique(key[rows], return_index=True)
    again[rows] = True
    again[rows[first]] = False
    return again


# --- cells -------------------------------------------------------------------------------------


def _convert(path: Path, table: Any) -> _Rows:
    rows = _Rows(path, {}, {})
    kinds = {"frame_id": _to_int, "line": _to_int, "offset_m": _to_float, "lri": _to_float}
    for name in table.column_names:
        column = table[name].combine_chunks()
        values, is_null = kinds.get(name, _to_bool)(rows, name, column)
        rows.values[name] = values
        rows.is_null[name] = is_null
    return rows


def _plain(rows: _Rows, name: str, column: Any) -> Any:
    """The column as text, number or bool; InputError for any other type."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    kind = column.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return pc.utf8_trim_whitespace(column)
    if pa.types.is_null(kind):
        return column.cast(pa.float64())
    if any(f(kind) for f in (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean)):
        return column
    raise InputError(f"{rows.path}: column {name} has type {kind}, needs numbers or true/false")


def _bad_cell(rows: _Rows, name: str, column: Any, fits: Any, need: str) -> InputError:
    """The error for the first cell that does not fit."""
    for row, cell in enumerate(column.to_pylist()):
        if cell is not None and not fits(cell):
            return InputError(f"{rows.place(row)}: {name} is {str(cell)[:40]!r}, not {need}")
    return InputError(f"{rows.path}: column {name} holds something that is not {need}")


def _to_float(rows: _Rows, name: str, column: Any) -> tuple[FloatArray, BoolArray]:
    import pyarrow as pa

    column = _plain(rows, name, column)
    is_null = column.is_null().to_numpy(zero_copy_only=False)
    try:
        if pa.types.is_boolean(column.type):
            raise pa.ArrowInvalid
        numbers = column.cast(pa.float64(), safe=False)
    except pa.ArrowInvalid:

        def fits(cell: object) -> bool:
            try:
                pa.array([cell]).cast(pa.float64())
            except pa.ArrowInvalid:
                return False
            return not isinstance(cell, bool)

        raise _bad_cell(rows, name, column, fits, "a number") from None
    values = np.array(numbers.fill_null(np.nan).to_numpy(zero_copy_only=False), dtype=np.float64)
    return values, is_null


def _to_int(rows: _Rows, name: str, column: Any) -> tuple[IntArray, BoolArray]:
    import pyarrow as pa

    column = _plain(rows, name, column)
    is_null = column.is_null().to_numpy(zero_copy_only=False)
    try:
        if pa.types.is_boolean(column.type) or pa.types.is_floating(column.type):
            raise pa.ArrowInvalid
        numbers = column.cast(pa.int64())
    except pa.ArrowInvalid:  # "12.0", which pandas makes of whole numbers beside empty cells
        floats, _ = _to_float(rows, name, column)
        is_null = is_null | np.isnan(floats)
        whole = is_null | ((np.floor(floats) == floats) & (np.abs(floats) < 2.0**53))
        if not whole.all():
            row = int(np.argmin(whole))
            raise InputError(
                f"{rows.place(row)}: {name} is {floats[row]}, not a whole number"
            ) from None
        return np.where(is_null, 0.0, floats).astype(np.int64), is_null
    values = np.array(numbers.fill_null(0).to_numpy(zero_copy_only=False), dtype=np.int64)
    return values, is_null


def _to_bool(rows: _Rows, name: str, column: Any) -> tuple[BoolArray, BoolArray]:
    import pyarrow as pa

    column = _plain(rows, name, column)
    is_null = column.is_null().to_numpy(zero_copy_only=False)
    known = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
    encoded = column.cast(pa.string()).dictionary_encode()
    words = [str(word).lower() for word in encoded.dictionary.to_pylist()]
    if any(word not in known for word in words):
        raise _bad_cell(
            rows, name, column, lambda cell: str(cell).lower() in known, "true, false, 1 or 0"
        )
    index = encoded.indices.fill_null(len(words)).to_numpy(zero_copy_only=False)
    return np.array([*(known[word] for word in words), False], dtype=bool)[index], is_null
