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
from egolane_pgm.views.answers import is_known, outcomes, true_lane

#: Wrong segments that are closer to each other are joined, seconds.
JOIN_S = 1.0


def worst_segments(frames: pd.DataFrame) -> pd.DataFrame:
    """List the segments with wrong answers.

    Without ground truth: those in which no lane has the probability `SURE`.

    Columns: begin_s and end_s, and those that are shown.
    """
    known, lane, truth = is_known(frames), frames["assigned_lane"].to_numpy(), true_lane(frames)
    wrong = known & (lane != truth) if known.any() else lanes_of(frames).max(axis=1) < SURE
    time_s, rows = frames["time_s"].to_numpy(), []
    for start, stop in merged_runs(wrong, time_s, JOIN_S):
        begin, end = time_s[start], time_s[stop - 1]
        part = start + np.flatnonzero(wrong[start:stop])
        row = {"begin_s": begin, "end_s": end, "time (s)": f"{begin:.1f} to {end:.1f}"}
        row |= {"frames": len(part), "answer": _lanes(lane[part])}
        rows.append(row | {"truth": _lanes(truth[part])} if known.any() else row)
    return pd.DataFrame(rows)


def lane_changes(result: Result) -> pd.DataFrame:
    """List the reported lane changes with their outcome, and the true changes that were missed.

    Columns: begin_s and end_s, to_lane and direction (0 if missed), and those that are shown.
    """
    frames, events, rows = result.frames, result.events, []
    truth = truth_of(frames)
    if truth is not None:
        matched = match_events(events, truth, result.frame_rate, max(TOLERANCES_S))
        true = true_changes(truth)
        time_s = frames["time_s"].loc[truth.index].to_numpy()
        for k in set(range(len(true))) - set(matched):
            begin, end = time_s[true.start[k]], time_s[true.end[k]]
            row = {"begin_s": begin, "end_s": end, "to_lane": 0, "direction": 0}
            lanes = f"{true.from_lane[k]} → {true.to_lane[k]}"
            rows.append({**row, "time (s)": f"{begin:.1f}", "lanes": lanes, "outcome": "missed"})
    for event, found in zip(events.to_dict("records"), outcomes(events, frames), strict=True):
        row = {"begin_s": event["time_s"], "end_s": event["detected_time_s"]}
        row |= {"to_lane": event["to_lane"], "direction": event["direction"]}
        lanes = f"{event['from_lane']} → {event['to_lane']}"
        lanes = lanes if event["from_lane"] else SIDES[event["direction"]]
        row |= {"time (s)": f"{event['time_s']:.1f}", "lanes": lanes, "outcome": found}
        rows.append(row | ({"delay (s)": f"{event['delay_s']:+.1f}"} if found == "correct" else {}))
    return pd.DataFrame(rows)


def _lanes(lanes: Any) -> str:
    return ", ".join(f"{lane:.0f}" if lane else "none" for lane in np.unique(lanes))
