"""Wrong segments and lane changes of a result of one drive, as lists with their times."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.inference.events import SURE
from egolane_pgm.result import Result, lanes_of, truth_of
from egolane_pgm.scoring.events import TOLERANCES_S, match_events
from egolane_pgm.scoring.events import lane_changes as true_changes
from egolane_pgm.types import SIDES, merged_runs
from egolane_pgm.views.frames import is_known, outcomes, true_lane
from egolane_pgm.views.tables import cell

#: Wrong segments that are closer to each other are joined, seconds.
JOIN_S = 1.0


def worst_segments(frames: pd.DataFrame) -> pd.DataFrame:
    """List the segments with wrong answers.

    Without ground truth: those in which no lane has the probability `SURE`.

    Columns: begin_s and end_s, and those that are shown.
    """
    known = is_known(frames)
    lane = frames["assigned_lane"].to_numpy()
    truth = true_lane(frames)
    wrong = known & (lane != truth) if known.any() else lanes_of(frames).max(axis=1) < SURE
    time_s = frames["time_s"].to_numpy()
    rows = []
    for start, stop in merged_runs(wrong, time_s, JOIN_S):
        part = start + np.flatnonzero(wrong[start:stop])
        row = {"begin_s": time_s[start], "end_s": time_s[stop - 1]}
        row |= {"frames": len(part), "answer": _lanes(lane[part])}
        rows.append(row | {"truth": _lanes(truth[part])} if known.any() else row)
    return pd.DataFrame(rows)


def lane_changes(result: Result) -> pd.DataFrame:
    """List the reported lane changes with their outcome, and the true changes that were missed.

    Columns: begin_s and end_s, to_lane and direction (0 if missed), and those that are shown.
    """
    frames = result.frames
    events = result.events
    sides = events["direction"].map(SIDES)
    pairs = _arrows(events)
    table = events[["to_lane", "direction"]].assign(
        begin_s=events["time_s"],
        end_s=events["detected_time_s"],
        lanes=pairs.where(events["from_lane"] > 0, sides),
        outcome=outcomes(events, frames),
    )
    truth = truth_of(frames)
    if truth is None:
        return table
    matched = match_events(events, truth, result.frame_rate, max(TOLERANCES_S))
    true = true_changes(truth).drop(index=np.unique(matched[matched >= 0]))
    time_s = frames["time_s"].loc[truth.index].to_numpy()
    missed = true.assign(lanes=_arrows(true), to_lane=0, direction=0, outcome="missed")
    missed = missed.assign(begin_s=time_s[true["start"]], end_s=time_s[true["end"]])
    table["delay (s)"] = [cell(delay, "+.1f") for delay in events["delay_s"]]
    return pd.concat([table, missed[table.columns.drop("delay (s)")]], ignore_index=True)


def _arrows(changes: pd.DataFrame) -> pd.Series:
    return changes["from_lane"].astype(str) + " → " + changes["to_lane"].astype(str)


def _lanes(lanes: Any) -> str:
    return ", ".join(f"{lane:.0f}" if lane else "none" for lane in np.unique(lanes))
