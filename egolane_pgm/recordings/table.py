"""Recordings of lines as tables, CSV or Parquet, in one of two forms. `COLUMNS` says what the
columns mean.

- One row per line, which is also how they are written: frame_id, line, offset_m and others. A frame
  without lines is one row with an empty line and offset.
- One row per frame: frame_id, offset_1, offset_2, ... and, where they are known, is_valid_1,
  is_continuous_1, lri_1, ... (also offset_m_1, valid_1, continuous_1). An empty offset is a line
  that is not there.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from csv import reader as csv_rows
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv

from egolane_pgm.recordings.rosbag import MAX_LINES
from egolane_pgm.tools.files import arrow_table, atomic, open_parquet, write_parquet
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog, suggestion

NEEDED = ("frame_id", "line", "offset_m")
OPTIONAL = ("is_valid", "is_continuous", "lri", "is_missing")

#: What each column means.
COLUMNS = {
    "frame_id": "number of the frame; increases, the rows of a frame stand together",
    "line": "1, 2, ... within the frame, in the detector's order",
    "offset_m": "where the line passes the car, metres, negative to the left",
    "is_valid": "whether the detector trusts the line; left out, it does",
    "is_continuous": "whether the line is not dashed; left out, none is",
    "lri": "line reliability index: in how many of the last frames it was seen; left out, unknown",
    "is_missing": "marks frames that `missing_frames: predict` put in",
}

#: What a cell of each column must be.
CELLS = dict.fromkeys(("frame_id", "line", "offset_m", "lri"), "a number") | dict.fromkeys(
    ("is_valid", "is_continuous", "is_missing"), "true, false, 1 or 0"
)

#: How truth values are written in a CSV file; pyarrow keeps the blanks around them.
_WORDS = {
    value: [f"{a}{word}{b}" for word in words for a in ("", " ") for b in ("", " ")]
    for value, words in (
        (True, ("true", "True", "TRUE", "1", "1.0")),
        (False, ("false", "False", "FALSE", "0", "0.0")),
    )
}


#: So many rows of a Parquet file are read at a time.
ROWS = 2**16

#: A column of a table with one row per frame: what it is, and of which line.
_OF_LINE = re.compile(r"(offset|is_valid|valid|is_continuous|continuous|lri|offset_m)_([1-9]\d?)")
_MEANT = {"offset": "offset_m", "valid": "is_valid", "continuous": "is_continuous"}


def read_table(
    path: str | Path, *, frame_rate: float = 10.0, columns: Mapping[str, str] | None = None
) -> LineLog:
    """Read the lines of a CSV or Parquet table (by extension), T frames of at most L lines.

    Without a column is_valid every line is valid, without is_continuous none is continuous, without
    lri the LRI is unknown (NaN). Other columns are ignored with one warning.

    - frame_rate: frames per second; time is frame id over frame rate.
    - columns: for a column of ours the name that it has in the table, `{"offset_m": "lateral"}`.

    Raises InputError for a file that is missing or no such table, a missing column (the ones that
    are there get listed), no rows, a cell that does not fit its column (with its place), frames
    that decrease, a line given twice in a frame, and a valid line without a finite offset.
    """
    path = Path(path)
    return _assemble(path, pa.concat_tables(_tables(path, frame_rate, columns or {})), frame_rate)


def iterate_table(
    path: str | Path,
    *,
    frame_rate: float = 10.0,
    columns: Mapping[str, str] | None = None,
    rows: int = ROWS,
) -> Iterator[LineLog]:
    """`read_table` in parts of whole frames, so that a table may be of any length.

    - rows: of the table, so many at a time, at most; in a CSV file as many as are in a block.

    Raises InputError as that, for a row when it gets there.
    """
    path = Path(path)
    # The rows of the last frame, which may go on in the next part, and how many came before them.
    kept: Any = None
    first_row, last = 0, None
    for table in _tables(path, frame_rate, columns or {}, rows):
        part = table if kept is None else pa.concat_tables([kept, table])
        frame = part["frame_id"].to_numpy()
        n_whole = len(frame) - int(np.argmax(np.append(frame[::-1] != frame[-1:], True)))
        kept = part.slice(n_whole)
        if len(kept) > MAX_LINES:
            n_whole = len(frame)
        if n_whole:
            log = _assemble(path, part.slice(0, n_whole), frame_rate, first_row, last)
            first_row, last = first_row + n_whole, int(log.frame_id[-1])
            yield log
    yield _assemble(path, kept, frame_rate, first_row, last)


def _tables(
    path: Path, frame_rate: float, columns: Mapping[str, str], rows: int | None = None
) -> Iterator[Any]:
    """The rows of a file, part after part, in the types that they need; rows: of a part, None where
    all of them will be held."""
    if not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"{path}: frame_rate {frame_rate} must be greater than 0")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    read = {".csv": _read_csv, ".parquet": _read_parquet}.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
    has_rows = False
    for part in read(path, columns, rows):
        if len(part):
            has_rows = True
            yield part
    if not has_rows:
        raise InputError(f"{path}: the table has no rows")


def write_table(path: str | Path, log: LineLog) -> None:
    """Write a log as CSV or Parquet (by extension); `read_table` gives it back as it was.

    Raises InputError for another extension, or where the file cannot be written.
    """
    path = Path(path)
    write = {".csv": _write_csv, ".parquet": write_parquet}.get(path.suffix.lower())
    if write is None:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
    write(path, rows_of(log, says_missing=bool(log.is_missing.any())))


# --- writing -----------------------------------------------------------------------------------


def rows_of(log: LineLog, *, says_missing: bool) -> Any:
    """The rows of a log, of pyarrow; says_missing: whether there is a column is_missing."""
    is_there = (
        log.is_valid | log.is_continuous | ~np.isnan(log.offset_m) | ~np.isnan(log.lri)
    )  # all other cells are padding
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
        "frame_id": log.frame_id[frame],
        "line": np.ma.masked_array(line + 1, no_line),
        "offset_m": np.ma.masked_array(column(log.offset_m, np.nan), no_line),
        "is_valid": column(log.is_valid, False),
        "is_continuous": column(log.is_continuous, False),
        "lri": np.ma.masked_array(lri, np.isnan(lri)),
    }
    if says_missing:
        columns["is_missing"] = log.is_missing[frame]
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


def _is_per_frame(names: Iterable[str]) -> bool:
    return "line" not in names and any(name.startswith("offset_m_") for name in names)


def _check_columns(path: Path, names: list[str]) -> list[str]:
    """The columns to read. Raises InputError for a missing one, and warns once of all that are
    ignored."""
    known: set[str] = set(COLUMNS)
    needed: tuple[str, ...] = NEEDED
    if _is_per_frame(names):
        numbers = [n.removeprefix("offset_m_") for n in names if n.startswith("offset_m_")]
        needed = ("frame_id",)
        kinds = ("offset_m", "is_valid", "is_continuous", "lri")
        known = {"frame_id", "is_missing", *(f"{kind}_{k}" for kind in kinds for k in numbers)}
    lacking = [name for name in needed if name not in names]
    if lacking:
        raise InputError(
            f"{path}: no column {', '.join(lacking)}; the table has {', '.join(names) or 'none'};"
            " it needs a row per line (frame_id, line, offset_m) or per frame (frame_id, offset_1,"
            " offset_2, ...); `columns: {offset_m: NAME}` says what yours are called"
        )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{path}: column {', '.join(twice)} occurs more than once")
    extra = [name for name in names if name not in known]
    if extra:
        unused = [name for name in known if name not in (*names, *NEEDED)]
        said = []
        for name in extra:
            hint = suggestion(name, unused)
            said.append(name + (hint if "did you mean" in hint else ""))
        warnings.warn(f"{path}: ignored column(s) {', '.join(said)}", UserWarning, stacklevel=3)
    return [name for name in names if name in known]


def _read_csv(path: Path, columns: Mapping[str, str], rows: int | None) -> Iterator[Any]:
    try:
        with path.open(encoding="utf-8-sig") as file:
            names = [name.strip() for name in next(csv_rows([file.readline().strip()]), [])]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as CSV ({error})") from None
    if not names:
        raise InputError(f"{path}: the file is empty")
    names = _renamed(path, names, columns)
    keep = _check_columns(path, names)
    try:
        parts = csv.open_csv(
            path,
            csv.ReadOptions(use_threads=False, column_names=names, skip_rows=1),
            csv.ParseOptions(ignore_empty_lines=True),
            csv.ConvertOptions(
                column_types={name: _type(name) for name in keep},
                include_columns=keep,
                null_values=["", " "],
                true_values=_WORDS[True],
                false_values=_WORDS[False],
            ),
        )
        for part in parts:
            yield pa.table(part)
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        text = " ".join(str(error).split())
        if "too short" in text:
            raise InputError(f"{path}: the table has no rows") from None
        cell = re.search(r"column #(\d+): Row #(\d+): .* invalid value '(.*)'", text)
        if cell is None:
            raise InputError(f"{path}: cannot be read as CSV ({text[:160]})") from None
        name = names[int(cell[1])]
        place = _place(path, int(cell[2]) - 2)
        raise InputError(f"{place}: {name} is {cell[3][:40]!r}, not {_needs(name)}") from None


def _read_parquet(path: Path, columns: Mapping[str, str], rows: int | None) -> Iterator[Any]:
    with open_parquet(path) as file:
        given = list(file.schema_arrow.names)
        names = _renamed(path, given, columns)
        there = {name: given[names.index(name)] for name in _check_columns(path, names)}
        # One row group after the other: asked for all, pyarrow keeps what it has read.
        for group in range(file.num_row_groups):
            for part in file.iter_batches(rows or ROWS, [group], list(there.values())):
                yield pa.table({name: _typed(path, name, part[c]) for name, c in there.items()})


def _typed(path: Path, name: str, column: Any) -> Any:
    """A column of a Parquet file, which may hold text or other numbers, in the type it needs."""
    wanted, given = _type(name), column.type
    try:
        if pa.types.is_dictionary(given):
            column = column.cast(given.value_type)
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            column = pc.utf8_trim_whitespace(column)
        elif pa.types.is_boolean(column.type) and not pa.types.is_boolean(wanted):
            raise pa.ArrowInvalid
        elif pa.types.is_boolean(wanted) and not pa.types.is_boolean(column.type):
            # To pyarrow every number but 0 is true; 7 is more likely another column.
            is_flag = pc.is_in(column.cast(pa.float64()), pa.array([0.0, 1.0, None]))
            if not pc.all(is_flag).as_py():
                raise pa.ArrowInvalid
        return column.cast(wanted, safe=False)
    except pa.ArrowException as error:
        text = " ".join(str(error).split())[:120]
        raise InputError(
            f"{path}: column {name} has type {given}, which is not {_needs(name)}"
            + (f" ({text})" if text else "")
        ) from None


def _needs(name: str) -> str:
    """What a cell of a column must be."""
    return CELLS[re.sub(r"_\d+$", "", name)]


def _type(name: str) -> Any:
    return pa.float64() if _needs(name) == "a number" else pa.bool_()


def _place(path: Path, row: int) -> str:
    """Where a row is, as an editor would say it (CSV), or counted from 1 (Parquet)."""
    if path.suffix.lower() != ".csv":
        return f"{path}: row {row + 1}"
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        filled = (number for number, line in enumerate(file, start=1) if line.strip())
        return f"{path}: line {next(islice(filled, row + 1, None), row + 2)}"


@dataclass(frozen=True)
class _Rows:
    """The cells of a table as arrays (N,); `is_null` says which cells are empty, `place` in which
    row of the file each stands."""

    path: Path
    values: dict[str, NDArray[Any]]
    is_null: dict[str, BoolArray]
    place: IntArray

    def refuse(self, bad: BoolArray, why: str) -> None:
        """Raise InputError for the first row that is bad; `{}` in `why` becomes its frame id."""
        if bad.any():
            row = int(np.argmax(bad))
            place = _place(self.path, int(self.place[row]))
            raise InputError(f"{place}: " + why.format(self.values["frame_id"][row]))


def _assemble(
    path: Path, table: Any, frame_rate: float, first_row: int = 0, before: int | None = None
) -> LineLog:
    """The frames of a table, or of a part of it: first_row is where that begins, before the id of
    the frame before it."""
    rows = _convert(path, table, first_row)
    if _is_per_frame(table.column_names):
        rows = _per_line(rows)
    n_rows = len(rows.values["frame_id"])
    for name in ("frame_id", "is_missing"):
        if name in rows.is_null:
            rows.refuse(rows.is_null[name], f"{name} is empty")
    frame, line = rows.values["frame_id"], rows.values["line"] - 1
    has_line = ~rows.is_null["line"]
    step = np.diff(frame, prepend=frame[:1] if before is None else before)
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
    """Marks the rows among `which` whose key occurs in an earlier one of them."""
    again = np.zeros(len(key), dtype=bool)
    rows = np.flatnonzero(which)
    _, first = np.unique(key[rows], return_index=True)
    again[rows] = True
    again[rows[first]] = False
    return again


def _convert(path: Path, table: Any, first_row: int) -> _Rows:
    """The columns as arrays; an empty number is NaN, an empty flag False."""
    values, is_null = {}, {}
    for name in table.column_names:
        column = table[name].combine_chunks()
        blank = np.nan if _needs(name) == "a number" else False
        values[name] = column.fill_null(blank).to_numpy(zero_copy_only=False)
        is_null[name] = column.is_null().to_numpy(zero_copy_only=False)
    place = first_row + np.arange(len(table))
    for name in ("frame_id", "line"):
        if name not in values:
            continue
        number = values[name]
        # pandas writes whole numbers beside empty cells as 12.0, and empty ones may be NaN.
        is_null[name] |= np.isnan(number)
        with np.errstate(invalid="ignore"):
            whole = (np.floor(number) == number) & (np.abs(number) < 2.0**53)
        bad = ~is_null[name] & ~whole
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{_place(path, int(place[row]))}: {name} is {number[row]}, not a whole number"
            )
        values[name] = np.where(is_null[name], 0, number).astype(np.int64)
    return _Rows(path, values, is_null, place)


def _per_line(rows: _Rows) -> _Rows:
    """The rows of a table that has one for each frame, as those of one that has one for each
    line."""
    offsets = [name for name in rows.values if name.startswith("offset_m_")]
    number = np.array([int(name.removeprefix("offset_m_")) for name in offsets])
    kinds = {re.sub(r"_\d+$", "", name) for name in rows.values} - {"frame_id", "is_missing"}
    there = np.stack([~np.isnan(rows.values[name]) for name in offsets], axis=1)
    for k, name in enumerate(offsets):
        # A line that is said to be valid is there, and without an offset it is a mistake.
        valid = rows.values.get(name.replace("offset_m", "is_valid"))
        if valid is not None:
            there[:, k] |= valid
    n_frames = len(there)
    blank = np.asarray(~there.any(axis=1))
    at, slot = np.nonzero(np.column_stack([there, blank]))
    has_line = slot < len(offsets)
    of_frame: list[str] = [name for name in ("frame_id", "is_missing") if name in rows.values]
    values = {name: rows.values[name][at] for name in of_frame}
    is_null = {name: rows.is_null[name][at] for name in of_frame}
    for kind in kinds:
        otherwise = {"offset_m": np.nan, "lri": np.nan, "is_valid": True}.get(kind, False)
        absent = np.full(n_frames, otherwise)
        cells = [rows.values.get(f"{kind}_{k}", absent) for k in number]
        empty = [rows.is_null.get(f"{kind}_{k}", np.zeros_like(blank)) for k in number]
        values[kind] = np.stack([*cells, absent], axis=1)[at, slot]
        is_null[kind] = np.stack([*empty, blank], axis=1)[at, slot]
    values["line"] = np.where(has_line, np.append(number, 0)[slot], 0)
    is_null["line"] = ~has_line
    return _Rows(rows.path, values, is_null, rows.place[at])
