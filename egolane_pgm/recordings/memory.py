"""Lines and ground truth in memory, as DataFrames whose columns are named as those of a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings.columns import FRAME_RATE, lines_of_columns, typed
from egolane_pgm.recordings.table import check_columns
from egolane_pgm.types import InputError, LineLog, lane_truth, suggestion

if TYPE_CHECKING:
    import pandas as pd


def lines_of(
    given: LineLog | pd.DataFrame,
    *,
    frame_rate: float = FRAME_RATE,
    columns: Columns | None = None,
    path: Path = Path("in memory"),
) -> LineLog:
    """The lines of a DataFrame, T frames of at most L lines; a LineLog is what it is.

    - given: a row per line (frame_id, offset_m, and line, is_valid, is_continuous, lri where they
      are known) or per frame (frame_id, offset_1, offset_2, ...); with a column time_s, seconds,
      where frames have times. frame_id, or frame_id and line, may be its index. A frame without
      lines is a row with an empty offset: one without a row counts as not recorded.
    - frame_rate: frames per second; without time_s, time is frame id over frame rate.
    - columns: which columns are what, where they are not called as ours.
    - path: names the lines in messages.

    Raises InputError for anything else, and as `recordings.columns.lines_of_columns`.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.memory import lines_of
    >>> seen = {"frame_id": [7, 7, 8], "time_s": [0.28, 0.28, 0.32], "offset_m": [-1.8, 1.7, -1.9]}
    >>> lines_of(pd.DataFrame(seen))
    LineLog('in memory': 2 frames, ids 7 to 8, at most 2 lines each)
    """
    if isinstance(given, LineLog):
        return given
    frame = _with_index(given, "recording", "lines")
    check_columns(path, list(frame.columns))
    return lines_of_columns({name: frame[name] for name in frame}, columns, path, frame_rate)


def truth_of(given: pd.DataFrame) -> pd.DataFrame:
    """The ground truth of a DataFrame, as `recordings.ground_truth` describes it.

    - given: a row per frame: frame_id (or as its index), lane or true_lane (1 leftmost), and
      optionally is_crossing or crossing. Frames without a lane are not annotated.

    Raises InputError for anything else, for a missing column, a cell that does not fit, and frame
    ids that do not increase.

    >>> import pandas as pd
    >>> from egolane_pgm.recordings.memory import truth_of
    >>> truth_of(pd.DataFrame({"frame_id": [7, 8, 9], "lane": [2, None, 1]}))["true_lane"].to_list()
    [2, 1]
    """
    path = Path("ground truth in memory")
    frame = _with_index(given, "ground_truth", "lanes")
    frame = frame.rename(columns={"crossing": "is_crossing", "true_lane": "lane"})
    cells = {}
    for name in ("frame_id", "lane", "is_crossing"):
        if name in frame:
            cells[name] = typed(path, name, frame[name])
        elif name != "is_crossing":
            raise InputError(f"{path}: no column {name}{suggestion(name, frame.columns)}")
    known = ~np.isnan(cells["lane"]) & ~np.isnan(cells["frame_id"])
    kept = {name: values[known] for name, values in cells.items()}
    crossing = kept.get("is_crossing", np.zeros(known.sum())) == 1
    return lane_truth(kept["frame_id"], kept["lane"], crossing, str(path))


def _with_index(given: Any, what: str, of: str) -> pd.DataFrame:
    """A DataFrame with its index among its columns, whose names are text."""
    if not hasattr(given, "reset_index"):
        raise InputError(f"{what}: {given!r:.60} is neither a file nor a DataFrame of {of}")
    frame: pd.DataFrame = given.rename(columns=str)
    names = [name for name in frame.index.names if name is not None and name not in frame]
    return frame.reset_index(names)
