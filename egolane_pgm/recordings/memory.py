"""Recordings and ground truth that are in memory: in a DataFrame of pandas, or in our own arrays.

The names of a file's columns are those of a DataFrame's, see `recordings.table`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.experiment import Columns, Experiment
from egolane_pgm.recordings.columns import FRAME_RATE, check_whole, typed
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.source import IN_MEMORY, Read
from egolane_pgm.recordings.table import lines_of_frame, with_index
from egolane_pgm.types import InputError, LaneTruth, LineLog, suggestion

if TYPE_CHECKING:
    import pandas as pd


def in_memory(
    experiment: Experiment, lines: LineLog | pd.DataFrame, truth: LaneTruth | pd.DataFrame | None
) -> Read:
    """What an experiment would read from a file, of lines and ground truth that are in memory.

    - experiment: says the frame rate of lines without times, and what their columns are called.

    Raises InputError as `lines_of` and `truth_of`.
    """
    recording = experiment.recording
    log = lines_of(lines, frame_rate=recording.frame_rate, columns=recording.columns)
    rate = rate_of(log.frame_id, log.time_s)
    return Read(log, None if truth is None else truth_of(truth), rate=rate)


def lines_of(
    given: LineLog | pd.DataFrame,
    *,
    frame_rate: float = FRAME_RATE,
    columns: Columns | None = None,
) -> LineLog:
    """The lines of a DataFrame, T frames of at most L lines; a LineLog is what it is.

    - given: a row per line (frame_id, offset_m, and line, is_valid, is_continuous, lri where they
      are known) or per frame (frame_id, offset_1, offset_2, ...); with a column time_s, seconds,
      where frames have times. frame_id, or frame_id and line, may be its index. A frame without
      lines is a row with an empty offset: one without a row counts as not recorded.
    - frame_rate: frames per second; without time_s, time is frame id over frame rate.
    - columns: which columns are what, where they are not called as ours.

    Raises InputError for anything else, and as `recordings.table.read_table`.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.memory import lines_of
    >>> seen = {"frame_id": [7, 7, 8], "time_s": [0.28, 0.28, 0.32], "offset_m": [-1.8, 1.7, -1.9]}
    >>> lines_of(pd.DataFrame(seen))
    LineLog('in memory': 2 frames, ids 7 to 8, at most 2 lines each)
    """
    if isinstance(given, LineLog):
        return given
    _check_frame(given, "recording", "lines")
    return lines_of_frame(given, Path(IN_MEMORY), frame_rate, columns)


def truth_of(given: LaneTruth | pd.DataFrame) -> LaneTruth:
    """The ground truth in a DataFrame, T frames; a LaneTruth is what it is.

    - given: a row per frame: frame_id (or as its index), lane (1 leftmost) and, where it is known,
      is_crossing or crossing. Frames without a lane are not annotated.

    Raises InputError for anything else, for a missing column, a cell that does not fit, and frame
    ids that do not increase.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.memory import truth_of
    >>> truth_of(pd.DataFrame({"frame_id": [7, 8, 9], "lane": [2, None, 1]}))
    LaneTruth('ground truth in memory': 2 frames, ids 7 to 9, 0 crossing)
    """
    if isinstance(given, LaneTruth):
        return given
    _check_frame(given, "ground_truth", "lanes")
    path = Path(f"ground truth {IN_MEMORY}")
    frame = with_index(given).rename(columns={"crossing": "is_crossing"})
    cells = {}
    for name in ("frame_id", "lane", "is_crossing"):
        if name in frame:
            cells[name] = typed(path, name, frame[name])
        elif name != "is_crossing":
            raise InputError(f"{path}: no column {name}{suggestion(name, frame.columns)}")
    for name in ("frame_id", "lane"):
        check_whole(path, cells, name, np.arange(len(frame)))
    known = ~np.isnan(cells["lane"]) & ~np.isnan(cells["frame_id"])
    kept = {name: values[known] for name, values in cells.items()}
    crossing = kept.get("is_crossing", np.zeros(known.sum())) == 1
    ids, lane = kept["frame_id"].astype(np.int64), kept["lane"].astype(np.int64)
    return LaneTruth(ids, lane, crossing, source=str(path))


def _check_frame(given: Any, what: str, of: str) -> None:
    if not hasattr(given, "reset_index"):
        raise InputError(f"{what}: {given!r:.60} is neither a file nor a DataFrame of {of}")
