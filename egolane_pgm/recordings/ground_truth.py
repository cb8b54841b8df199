"""Annotated ground truth: a text file with a row `frame;lane;crossing` per frame, lane 1 leftmost.

In memory it is a DataFrame, see `types.lane_truth`.
"""

from __future__ import annotations

import re
from bisect import insort
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.recordings.columns import to_numbers
from egolane_pgm.recordings.table import with_index
from egolane_pgm.tools.files import read_text, write_text
from egolane_pgm.types import InputError, lane_truth, suggestion

_INTEGER = r"\s*([+-]?[0-9]{1,18})\s*"
_ROW = re.compile(rf"{_INTEGER}[;,]{_INTEGER}[;,]\s*([01])\s*")


def read_ground_truth(path: str | Path, extra_rows: Iterable[Sequence[int]] = ()) -> pd.DataFrame:
    """Read the lane of each annotated frame, and the flag of a crossing into another lane.

    A row is `frame;lane;crossing` (or with commas), crossing 0 or 1. A heading and empty rows are
    skipped.

    - extra_rows: further rows (frame, lane, crossing). The paper counts frame 0 of the Spanish
      recording, which its file lacks.

    Raises InputError, naming the line, for a malformed row, for a file without rows, and for frames
    that do not increase.
    """
    rows: list[tuple[int, ...]] = []
    for number, line in enumerate(read_text(Path(path)).splitlines(), start=1):
        if match := _ROW.fullmatch(line):
            rows.append(tuple(map(int, match.groups())))
        elif line.strip() and (number > 1 or re.search(r"\d", line)):
            raise InputError(
                f"{path}: line {number}: {line.strip()[:60]!r} is not"
                " 'frame;lane;crossing' (whole numbers, crossing 0 or 1)"
            )
    if not rows:
        raise InputError(f"{path}: has no row 'frame;lane;crossing'")
    for extra in extra_rows:
        insort(rows, tuple(extra))
    frame_id, lane, crossing = np.array(rows).T
    return lane_truth(frame_id, lane, crossing == 1, str(path))


def truth_of(given: pd.DataFrame) -> pd.DataFrame:
    """The ground truth of a DataFrame, see `types.lane_truth`.

    - given: a row per frame: frame_id (or as its index), lane or true_lane (1 leftmost), and
      optionally is_crossing or crossing. Frames without a lane are not annotated.

    Raises InputError for a missing column, a wrong cell, and frame ids that do not increase.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.ground_truth import truth_of
    >>> truth_of(pd.DataFrame({"frame_id": [7, 8, 9], "lane": [2, None, 1]}))["true_lane"].to_list()
    [2, 1]
    """
    path = Path("ground truth in memory")
    frame = with_index(given, "ground_truth")
    frame = frame.rename(columns={"crossing": "is_crossing", "true_lane": "lane"})
    for name in ("frame_id", "lane"):
        if name not in frame:
            raise InputError(f"{path}: no column {name}{suggestion(name, frame.columns)}")
    frame = frame.dropna(subset=["frame_id", "lane"])
    frame_id, lane = (to_numbers(path, name, frame[name]) for name in ("frame_id", "lane"))
    crossing = np.zeros(len(frame))
    if "is_crossing" in frame:
        crossing = to_numbers(path, "is_crossing", frame["is_crossing"])
    return lane_truth(frame_id, lane, crossing == 1, str(path))


def write_ground_truth(path: str | Path, truth: pd.DataFrame) -> None:
    """Write rows `frame;lane;crossing`; `read_ground_truth` returns them unchanged.

    Raises InputError if the file cannot be written.
    """
    rows = truth[["true_lane", "is_crossing"]].astype(int)
    write_text(path, rows.to_csv(sep=";", header=False, lineterminator="\n"))
