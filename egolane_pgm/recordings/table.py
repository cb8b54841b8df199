"""Recordings of lines as tables: CSV, Parquet or a DataFrame of pandas.

`recording.columns` names the columns; without it they have our own names, `columns.COLUMNS`, in one
of two forms.

- One row per line, which is also how they are written: frame_id, line, offset_m and others. A frame
  without lines is one row with an empty line and offset.
- One row per frame: frame_id, offset_1, offset_2, ... and, if known, is_valid_1, is_continuous_1,
  lri_1, ... An empty offset is a line that is not there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings.columns import FRAME_RATE, lines_of_columns
from egolane_pgm.tools.files import atomic, read_parquet, write_parquet
from egolane_pgm.types import InputError, LineLog

#: The endings of tables.
TABLES = (".csv", ".tsv", ".parquet")


def read_table(
    path: str | Path, *, frame_rate: float = FRAME_RATE, columns: Columns | None = None
) -> LineLog:
    """Read the lines of a CSV or Parquet table, T frames of at most L lines.

    - frame_rate: frames per second; without a column time_s, time is frame id over frame rate.
    - columns: which columns are what, where they are not called as ours.

    Raises InputError for a file that is missing or no such table, and as
    `recordings.columns.lines_of_columns`.
    """
    path = Path(path)
    table = read_columns(path)
    named = dict(zip(table.column_names, table.columns, strict=True))
    return lines_of_columns(named, columns, path, frame_rate)


def write_table(path: str | Path, log: LineLog) -> None:
    """Write a log as CSV or Parquet (by extension); `read_table` gives it back as it was.

    Raises InputError for another extension, or where the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".parquet":
        write_parquet(path, rows_of(log))
    elif path.suffix.lower() == ".csv":
        _write_csv(path, rows_of(log))
    else:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")


def rows_of(log: LineLog) -> pd.DataFrame:
    """The rows of a log; with time_s unless it follows from the frame id, and with is_missing if a
    frame is."""
    is_there = (
        log.is_valid | log.is_continuous | ~np.isnan(log.offset_m) | ~np.isnan(log.lri)
    )  # all other cells are padding
    n_frames, n_lines = is_there.shape
    if n_frames and n_lines and not is_there[:, -1].any():
        is_there[0, -1] = True  # an empty line keeps the width of the padding
    rows = log.rows(is_there)
    if np.array_equal(log.time_s, log.frame_id / FRAME_RATE):
        del rows["time_s"]
    if log.is_missing.any():
        rows["is_missing"] = log.is_missing[np.searchsorted(log.frame_id, rows["frame_id"])]
    return rows


def _write_csv(path: Path, rows: pd.DataFrame) -> None:
    table = pa.Table.from_pandas(rows, preserve_index=False)
    with atomic(path) as temporary, temporary.open("wb") as file:
        file.write((",".join(table.column_names) + "\n").encode())
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))


def read_columns(path: Path) -> pa.Table:
    """A whole CSV or Parquet file. pyarrow finds the types of the columns.

    The separator of a CSV is the most frequent one of its heading. If it is a semicolon, numbers
    may have a decimal comma.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    extension = path.suffix.lower()
    if extension == ".parquet":
        return pa.Table.from_pandas(read_parquet(path), preserve_index=False)
    if extension not in TABLES:
        raise InputError(
            f"{path}: unknown extension '{path.suffix}' of a table ({', '.join(TABLES)})"
        )
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        separator = max(",;\t|", key=file.readline().count)
    try:
        table = csv.read_csv(
            path,
            parse_options=csv.ParseOptions(delimiter=separator),
            convert_options=csv.ConvertOptions(
                decimal_point="," if separator == ";" else ".", strings_can_be_null=True
            ),
        )
    except (OSError, pa.ArrowInvalid, UnicodeDecodeError) as error:
        problem = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: cannot be read as CSV ({problem})") from None
    names = [name.strip() for name in table.column_names]
    check_columns(path, names)
    return table.rename_columns(names)


def check_columns(path: Path, names: list[str]) -> None:
    """Raise InputError for a column that occurs more than once."""
    twice = [name for name in names if name and names.count(name) > 1]
    if twice:
        raise InputError(f"{path}: column {twice[0]} occurs more than once")
