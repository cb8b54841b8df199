"""Wrong segments and lane changes of a result, as lists whose rows are places on the time axis."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.inference.events import SURE
from egolane_pgm.result import Result, by_drive, lanes_of, truth_of
from egolane_pgm.scoring.events import TOLERANCES_S, match_events
from egolane_pgm.scoring.events import lane_changes as true_changes
from egolane_pgm.types import SIDES, FloatArray
from egolane_pgm.views.answers import is_known, outcomes, true_lane

#: Wrong segments that are closer to each other are joined, seconds.
JOIN_S = 1.0

#: Gap on the axis between two drives; kept as recorded if it is less than MAX_GAP_S, seconds.
GAP_S, MAX_GAP_S = 5.0, 60.0


def with_axis(frames: pd.DataFrame) -> pd.DataFrame:
    """Add `x_s`: seconds on the time axis, where several drives follow one another."""
    parts: list[FloatArray] = []
    for _, drive in by_drive(frames):
        x_s = drive["time_s"].to_numpy(np.float64)
        if parts and not 0 < x_s[0] - parts[-1][-1] < MAX_GAP_S:
            x_s = x_s - x_s[0] + parts[-1][-1] + GAP_S
        parts.append(x_s)
    return frames.assign(x_s=np.concatenate(parts))


def worst_segments(frames: pd.DataFrame) -> pd.DataFrame:
    """List the segments with wrong answers, the longest first.

    Without ground truth: those in which no lane has the probability `SURE`.

    - frames: of one result, with `x_s`.

    Columns: begin_s and end_s (on the axis), and those that are shown.
    """
    known, lane, truth = is_known(frames), frames["assigned_lane"].to_numpy(), true_lane(frames)
    wrong = known & (lane != truth) if known.any() else lanes_of(frames).max(axis=1) < SURE
    x_s, time_s = frames["x_s"].to_numpy(), frames["time_s"].to_numpy()
    [bad] = np.nonzero(wrong)
    rows = []
    for part in np.split(bad, 1 + np.flatnonzero(np.diff(x_s[bad]) > JOIN_S)) if len(bad) else []:
        first, last = part[0], part[-1]
        row = {"begin_s": x_s[first], "end_s": x_s[last], **_name(frames.iloc[first])}
        row["time (s)"] = f"{time_s[first]:.1f} to {time_s[last]:.1f}"
        row |= {"frames": len(part), "answer": _lanes(lane[part])}
        rows.append(row | {"truth": _lanes(truth[part])} if known.any() else row)
    return pd.DataFrame(sorted(rows, key=lambda row: -row["frames"]))


def lane_changes(result: Result, frames: pd.DataFrame) -> pd.DataFrame:
    """List the reported lane changes with their outcome, and the true ones that were missed.

    - frames: of the result, with `x_s`.

    Columns: begin_s and end_s (on the axis), to_lane and direction (0 if missed), and those that
    are shown.
    """
    rows = [row for _, drive in by_drive(frames) for row in _changes_of_drive(result, drive)]
    return pd.DataFrame(sorted(rows, key=lambda row: row["begin_s"]))


def _changes_of_drive(result: Result, frames: pd.DataFrame) -> Iterator[dict[str, Any]]:
    events, truth, name = result.events, truth_of(frames), _name(frames.iloc[0])
    if name:
        events = events[events["drive"] == name["drive"]]
    shift = frames["x_s"].iloc[0] - frames["time_s"].iloc[0]
    if truth is not None:
        matched = match_events(events, truth, result.frame_rate, max(TOLERANCES_S))
        true = true_changes(truth)
        time_s = frames["time_s"].loc[truth.index].to_numpy()
        for k in set(range(len(true))) - set(matched):
            begin, end = time_s[true.start[k]], time_s[true.end[k]]
            place = {"begin_s": begin + shift, "end_s": end + shift, "to_lane": 0}
            place |= {"direction": 0, **name}
            lanes = f"{true.from_lane[k]} → {true.to_lane[k]}"
            yield {**place, "time (s)": f"{begin:.1f}", "lanes": lanes, "outcome": "missed"}
    for event, found in zip(events.to_dict("records"), outcomes(events, frames), strict=True):
        place = {"begin_s": event["time_s"] + shift, "end_s": event["detected_time_s"] + shift}
        place |= {"to_lane": event["to_lane"], "direction": event["direction"], **name}
        lanes = f"{event['from_lane']} → {event['to_lane']}"
        lanes = lanes if event["from_lane"] else SIDES[event["direction"]]
        row = {**place, "time (s)": f"{event['time_s']:.1f}", "lanes": lanes, "outcome": found}
        yield row | ({"delay (s)": f"{event['delay_s']:+.1f}"} if found == "correct" else {})


def _lanes(lanes: Any) -> str:
    return ", ".join(f"{lane:.0f}" if lane else "none" for lane in np.unique(lanes))


def _name(row: pd.Series) -> dict[str, Any]:
    return {"drive": row["drive"]} if "drive" in row else {}
