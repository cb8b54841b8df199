"""Annotated ground truth: a text file with `frame;lane;crossing` per line, lane 1 leftmost.

In memory it is a DataFrame, see `types.lane_truth`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.tools.files import read_text, write_text
from egolane_pgm.types import InputError, lane_truth

if TYPE_CHECKING:
    import pandas as pd

_INTEGER = r"\s*([+-]?[0-9]{1,18})\s*"
_ROW = re.compile(rf"{_INTEGER}[;,]{_INTEGER}[;,]\s*([01])\s*")


def read_ground_truth(path: str | Path, extra_rows: Iterable[Sequence[int]] = ()) -> pd.DataFrame:
    """Read the lane of each annotated frame, and whether the vehicle is crossing into another lane.

    A line is `frame;lane;crossing` (or with commas), crossing 0 or 1. A heading and empty lines are
    skipped.

    - extra_rows: more rows (frame, lane, crossing), put in where their frame belongs; the paper
      counts frame 0 of the Spanish recording, which its file leaves out.

    Raises InputError, naming the file and the line, for a line that is malformed, frames that
    repeat or decrease, a file without rows, and an extra row of a frame that the file has.
    """
    path = Path(path)
    rows: list[tuple[int, int, int]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        row = _row(line)
        if not line.strip() or (row is None and number == 1 and not re.search(r"\d", line)):
            continue
        if row is None:
            raise InputError(
                f"{path}: line {number}: {line.strip()[:60]!r} is not"
                " 'frame;lane;crossing' (whole numbers, crossing 0 or 1)"
            )
        if rows and row[0] <= rows[-1][0]:
            last = rows[-1][0]
            how = "occurs twice" if row[0] == last else f"comes after frame {last}"
            raise InputError(f"{path}: line {number}: frame {row[0]} {how}; frames must increase")
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: no ground truth in it, it has no line 'frame;lane;crossing'")
    table = np.array(rows)
    for extra in extra_rows:
        at = np.searchsorted(table[:, 0], extra[0])
        if extra[0] in table[at : at + 1, 0]:
            raise InputError(f"{path}: extra row {list(extra)}: frame {extra[0]} is there already")
        table = np.insert(table, at, extra, axis=0)
    return lane_truth(table[:, 0], table[:, 1], table[:, 2] == 1, str(path))


def write_ground_truth(path: str | Path, truth: pd.DataFrame) -> None:
    """Write `frame;lane;crossing` lines, which `read_ground_truth` reads back as they were.

    Raises InputError where the file cannot be written.
    """
    rows = truth[["true_lane", "is_crossing"]].astype(int).itertuples()
    text = "".join(f"{frame};{lane};{crossing}\n" for frame, lane, crossing in rows)
    write_text(path, text)


def _row(line: str) -> tuple[int, int, int] | None:
    match = _ROW.fullmatch(line)
    return (int(match[1]), int(match[2]), int(match[3])) if match else None
