"""The text of a table of runs."""

from __future__ import annotations

import pandas as pd

from egolane_pgm.result import TAG
from egolane_pgm.views.tables import page, table

#: The columns of the summary that are printed, and their names.
_COLUMNS = {
    "frames": "frames",
    "frames_scored": "scored",
    "detector.accuracy": "detector",
    "model.accuracy": "accuracy",
    "model.intervals.accuracy.low": "accuracy_low",
    "model.intervals.accuracy.high": "accuracy_high",
    "model.f1": "F1",
    "model.log_loss": "log-loss",
    "seconds": "seconds",
    "error": "error",
}


def runs_text(summary: pd.DataFrame, style: str, wide: bool) -> str:
    """The text of `egolane run --table`: a row per run.

    - summary: as `runs.run_table` returns it.
    """
    tags = [column for column in summary if str(column).startswith(TAG)]
    shown = summary[[*tags, *(c for c in _COLUMNS if c in summary)]].dropna(axis=1, how="all")
    counts = [c for c in ("frames", "frames_scored") if c in shown]
    shown = shown.astype(dict.fromkeys(counts, "Int64"))
    names = {tag: str(tag).removeprefix(TAG) for tag in tags}
    printed = table(shown.rename(columns=names | _COLUMNS), {"seconds": 1})
    if style == "csv":
        printed = table(summary)
    return page([printed], style, wide)
