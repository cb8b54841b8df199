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

from egolane_pgm.recordings.columns import Column, checked, plain
from egolane_pgm.recordings.table import read_columns
from egolane_pgm.tools.files import read_text, write_text
from egolane_pgm.types import InputError, LineLog, lane_truth

_INTEGER = r"\s*([+-]?[0-9]{1,18})\s*"
_ROW = re.compile(rf"{_INTEGER}[;,]{_INTEGER}[;,]\s*([01])\s*")

#: The columns of ground truth by frame, and by time.
_LABELS = {
    "lane": Column("whole", is_needed=True, others=("true_lane",)),
    "is_crossing": Column("flag", others=("crossing",)),
}
_BY_FRAME = {"frame_id": Column("whole", is_needed=True, is_full=True), **_LABELS}
_BY_TIME = {"time_s": Column("time", is_needed=True, is_full=True), **_LABELS}


def read_ground_truth(
    path: str | Path, extra_rows: Iterable[Sequence[int]] = (), log: LineLog | None = None
) -> pd.DataFrame:
    """Read the lane of each annotated frame, and the flag of a crossing into another lane.

    A row is `frame;lane;crossing` (or with commas), crossing 0 or 1. A heading and empty rows are
    skipped. A table (.parquet, or .csv with a heading frame_id or time_s) is read by `truth_of`.

    - log: the frames, for a table by time.
    - extra_rows: further rows (frame, lane, crossing). The paper counts frame 0 of the Spanish
      recording, which its file lacks.

    Raises InputError, naming the line, for a malformed row, for a file without rows, and for frames
    that do not increase.
    """
    path = Path(path)
    kind = path.suffix.lower()
    rows: list[tuple[int, ...]] = []
    lines = [] if kind == ".parquet" else read_text(path).splitlines()
    is_named = re.search(r"frame_id|time_s", "".join(lines[:1]))
    if kind == ".parquet" or (kind == ".csv" and is_named):
        known = truth_of(read_columns(path), log, str(path))
        rows = [*known.astype(int).itertuples(name=None)]
        lines = []
    for number, line in enumerate(lines, start=1):
        if match := _ROW.fullmatch(line):
            rows.append(tuple(map(int, match.groups())))
        elif line.strip() and (number > 1 or re.search(r"\d", line)):
            raise InputError(
                f"{path}: line {number}: {line.strip()[:60]!r} is not"
                " 'frame;lane;crossing' (whole numbers, crossing 0 or 1)"
            )
    if not rows:
        raise InputError(f"{path}: has no annotated row, 'frame;lane;crossing'")
    for extra in extra_rows:
        insort(rows, tuple(extra))
    frame_id, lane, crossing = np.array(rows).T
    return lane_truth(frame_id, lane, crossing == 1, str(path))


def truth_of(
    given: pd.DataFrame, log: LineLog | None = None, source: str = "ground truth in memory"
) -> pd.DataFrame:
    """The ground truth of a DataFrame, see `types.lane_truth`.

    - given: a row per frame: frame_id (or as its index), lane or true_lane (1 leftmost), and
      optionally is_crossing or crossing. Frames without a lane are not annotated. Without frame_id,
      time_s: a frame has the row whose time is nearest, at most half a frame away.
    - log: the frames, for rows by time.
    - source: for messages.

    Raises InputError for a missing column, a wrong cell, frame ids or times that do not increase,
    and times without a frame.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.ground_truth import truth_of
    >>> truth_of(pd.DataFrame({"frame_id": [7, 8, 9], "lane": [2, None, 1]}))["true_lane"].to_list()
    [2, 1]
    """
    frame = plain(given, source)
    if "frame_id" not in frame and "time_s" in frame and log is not None:
        frame = _at_frames(checked(frame, _BY_TIME, source), log, source)
    frame = checked(frame, _BY_FRAME, source).dropna(subset="lane")
    crossing = frame.get("is_crossing", pd.Series(False, frame.index)).fillna(False)
    return lane_truth(frame["frame_id"], frame["lane"], crossing, source)


def _at_frames(frame: pd.DataFrame, log: LineLog, source: str) -> pd.DataFrame:
    """Join rows by time to the frames nearest to them."""
    if frame.empty:
        raise InputError(f"{source}: has no rows")
    time_s = frame["time_s"].to_numpy()
    for name, times in ((source, time_s), (log.source, log.time_s)):
        later = np.diff(times) > 0
        if not later.all():
            row = int(later.argmin())
            before, after = times[row : row + 2]
            wrong = f"{before:.10g} is followed by {after:.10g}"
            raise InputError(f"{name}: row {row + 2}: time_s must increase, {wrong}")
    half = np.median(np.diff(log.time_s)) / 2 if len(log) > 1 else np.inf
    found = pd.merge_asof(
        pd.DataFrame({"frame_id": log.frame_id, "time_s": log.time_s}),
        frame,
        on="time_s",
        direction="nearest",
        # Times since 1970 have few digits after the point.
        tolerance=half + 1e-6,
    )
    if found["lane"].isna().all():
        spans = [f"{ends[0]:.10g} to {ends[-1]:.10g} s" for ends in (log.time_s, time_s)]
        raise InputError(
            f"{source}: no row has the time of a frame; the frames are from {spans[0]}, the rows"
            f" from {spans[1]}"
        )
    return found


def write_ground_truth(path: str | Path, truth: pd.DataFrame) -> None:
    """Write rows `frame;lane;crossing`; `read_ground_truth` returns them unchanged.

    Raises InputError if the file cannot be written.
    """
    rows = truth[["true_lane", "is_crossing"]].astype(int)
    write_text(path, rows.to_csv(sep=";", header=False, lineterminator="\n"))
