"""Tables of lines: CSV, Parquet, or a DataFrame.

`recording.columns` names the columns; by default they have our names, `columns.COLUMNS`, in one of
two forms.

- A row per line, which is also the form that is written: frame_id, line, offset_m and others. A
  frame without lines is a row with an empty line and offset.
- A row per frame: frame_id, offset_1, offset_2, ... and, if known, is_valid_1, is_continuous_1,
  lri_1, ... An empty offset is a line that is not there.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings.columns import FRAME_RATE, plain
from egolane_pgm.recordings.lines import lines_of_columns
from egolane_pgm.tools.files import atomic, read_parquet, reading, write_parquet
from egolane_pgm.types import InputError, LineLog


def read_table(
    path: str | Path, *, frame_rate: float = FRAME_RATE, columns: Columns | None = None
) -> LineLog:
    """Read the lines of a CSV or Parquet file, T frames of at most L lines.

    - frame_rate: frames per second; without a column time_s, time is frame id over frame rate.
    - columns: names of the columns, if they are not ours.

    Raises InputError for a file that cannot be read, and as `recordings.lines.lines_of_columns`.
    """
    return lines_of_columns(read_columns(Path(path)), columns, Path(path), frame_rate)


def lines_of(
    given: LineLog | pd.DataFrame,
    *,
    frame_rate: float = FRAME_RATE,
    columns: Columns | None = None,
    path: Path = Path("in memory"),
) -> LineLog:
    """The lines of a DataFrame, as `read_table`; a LineLog is returned as it is.

    - given: frame_id and line may be its index. A frame without a row counts as not recorded.
    - path: name of the lines in messages.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.table import lines_of
    >>> lines = {"frame_id": [7, 7, 8], "time_s": [0.28, 0.28, 0.32], "offset_m": [-1.8, 1.7, 0]}
    >>> lines_of(pd.DataFrame(lines))
    LineLog('in memory': 2 frames, ids 7 to 8, at most 2 lines each)
    """
    if isinstance(given, LineLog):
        return given
    return lines_of_columns(plain(given, str(path)), columns, path, frame_rate)


def read_columns(path: Path) -> pd.DataFrame:
    """Read a whole CSV or Parquet file; see `recordings.columns.plain`.

    The separator of a CSV is the most frequent one of its heading. With semicolons numbers may have
    a decimal comma.
    """
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() == ".parquet":
        return plain(read_parquet(path), str(path))
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        separator = max(",;\t|", key=file.readline().count)
    decimal = "," if separator == ";" else "."
    with reading(path, "CSV"):
        # Several times as fast as pandas, which would also rename columns of one name.
        table = csv.read_csv(
            path,
            parse_options=csv.ParseOptions(delimiter=separator),
            convert_options=csv.ConvertOptions(decimal_point=decimal, strings_can_be_null=True),
        ).to_pandas(split_blocks=True, types_mapper={pa.bool_(): pd.BooleanDtype()}.get)
    return plain(table, str(path))


def write_table(path: str | Path, log: LineLog) -> None:
    """Write a log as CSV or Parquet, by extension; `read_table` returns its recorded frames.

    Times are left out if they are frame id over FRAME_RATE. Raises InputError for a log of several
    clips, whose borders a table does not keep, for another extension, and if the file cannot be
    written.
    """
    path = Path(path)
    table = log.take(~log.is_missing).to_pandas().reset_index()
    if log.clip is not None:
        raise InputError(f"{log.source}: has several clips; a written file holds one drive")
    if np.array_equal(log.time_s, log.frame_id / FRAME_RATE):
        del table["time_s"]
    if path.suffix.lower() == ".parquet":
        write_parquet(path, table)
    elif path.suffix.lower() == ".csv":
        rows = pa.Table.from_pandas(table, preserve_index=False)
        with atomic(path) as temporary, temporary.open("wb") as file:
            # pyarrow would put the names in quotes.
            file.write((",".join(rows.column_names) + "\n").encode())
            csv.write_csv(rows, file, csv.WriteOptions(include_header=False))
    else:
        raise InputError(f"{path}: unknown extension '{path.suffix}' of a table (.csv, .parquet)")
