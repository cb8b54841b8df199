"""Lane changes, and the lane over time, as tables and text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from egolane_pgm.inference.events import CONFIDENT
from egolane_pgm.types import DATED_S, UNASSIGNED
from egolane_pgm.views.tables import Table, cell, table

#: Number of rows of a table of drives or lane changes, and of segments in words.
LISTED = 10


def event_table(events: pd.DataFrame) -> Table:
    """A table of lane changes, a row each."""
    is_known = events["from_lane"] != UNASSIGNED
    side = {-1: "left", 1: "right"}
    columns = {
        "drive": events.get("drive"),
        "time, s": events["time_s"],
        "frame": events["frame_id"],
        "from": events["from_lane"].astype(object).where(is_known, "?"),
        "to": events["to_lane"].astype(object).where(is_known, events["direction"].map(side)),
        "probability": events["probability"].where(is_known),
        "detected, s": events["detected_time_s"],
    }
    if "delay_s" in events:
        delay = events["delay_s"].map(lambda value: cell(value, "+.1f"))
        columns["delay, s"] = delay.where(events["delay_s"].notna(), "no change")
    frame = pd.DataFrame({name: values for name, values in columns.items() if values is not None})
    frame = frame.set_index(frame.columns[0])
    frame.index = frame.index.map(lambda value: cell(value, 1))
    return table(frame, {"time, s": 1, "detected, s": 1})


def segments_text(segments: Sequence[tuple[int, float, float]]) -> str:
    """The lane over time in words.

    - segments: lane (0 unknown), from second, to second.
    """
    if not segments:
        return f"no lane has a probability of at least {CONFIDENT:.2f} in any frame"
    parts = [
        f"lane {lane or 'unknown'} from {clock(start)} to {clock(end)}"
        for lane, start, end in segments[:LISTED]
    ]
    more = [f"and {len(segments) - LISTED} more"] * (len(segments) > LISTED)
    return ", ".join([*parts, *more])


def clock(seconds: float) -> str:
    """A time as 1:02.3 or 1:00:02.3; a time since 1970 as the time of day, UTC."""
    seconds = round(seconds % 86400 if seconds >= DATED_S else seconds, 1)
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02d}:{rest:04.1f}" if hours else f"{minutes}:{rest:04.1f}"


def event_lines(scores: Mapping[str, Any]) -> list[str]:
    """The scores of lane changes (`events` in scores.json) in a few lines of text."""
    lines = [f"{scores['changes']} true lane changes, {scores['detected']} reported:"]
    for seconds, found in scores["within"].items():
        lines.append(
            f"  within {seconds} s: precision {cell(found['precision'])},"
            f" recall {cell(found['recall'])}, {cell(found['false_per_hour'], 1)} false per hour"
        )
    median, p90 = (cell(scores["delay_s"][key], "+.1f") for key in ("median", "p90"))
    lines.append(f"  delay from the end of the crossing: {median} s (median), {p90} s (90 %)")
    return lines
