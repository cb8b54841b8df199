"""The text of a result: its title, and what `egolane run` prints."""

from __future__ import annotations

import html
import math
from typing import Any

import pandas as pd

from egolane_pgm.inference.events import CONFIDENT, SURE
from egolane_pgm.result import Result, by_drive, lanes_of
from egolane_pgm.views.answers import is_known
from egolane_pgm.views.events import LISTED, event_lines, event_table, segments_text
from egolane_pgm.views.tables import (
    TUNED_ON,
    TUNED_ON_SHORT,
    Table,
    confusion_table,
    page,
    score_table,
    table,
    with_interval,
)

#: The parameters of a held-out block, by the experiment's `fit`.
_FITS = {
    "none": "the experiment's own parameters",
    "learn": "parameters learned on the other blocks",
    "tune": "parameters tuned on the other blocks",
}


def scores_by_side(result: Result) -> dict[str, Any]:
    """The scores of the detector, if it has an answer of its own, and of the model."""
    return {who: result.scores[who] for who in ("detector", "model") if who in result.scores}


def result_title(result: Result) -> str:
    """A result in one line: frames, accuracy of the model and the detector, how it was tuned."""
    run = result.run
    parts = [f"{run['name']!r}: {run['frames']} frames"]
    for who, scores in reversed(scores_by_side(result).items()):
        accuracy = with_interval(scores["accuracy"], scores["intervals"]["accuracy"])
        parts.append(f"{'accuracy' if who == 'model' else who} {accuracy}")
    if len(parts) == 1:
        parts.append("no ground truth")
    causal = "causal" if run["is_causal"] else "not causal"
    return f"{', '.join(parts)}; {TUNED_ON_SHORT[run['tuned_on']]}, {causal}"


def result_html(result: Result) -> str:
    """The title and a table of the scores, for a notebook."""
    parts = [f"<p>{html.escape(result_title(result))}</p>"]
    scores = scores_by_side(result)
    if scores:
        found = score_table(scores)
        frame = pd.DataFrame(found.rows, columns=found.header)
        parts.append(frame.to_html(index=False))
    notes = [f"<p>{html.escape(note)}</p>" for note in result.notes]
    return f"<div>{''.join([*parts, *notes])}</div>"


def result_text(result: Result, style: str, wide: bool) -> str:
    """The text of `egolane run`: scores and confusion matrices, or the lane over time; then the
    lane changes."""
    run, scores = result.run, result.scores
    mean = scores["mean_log_evidence"]
    first = [
        f"{run['name']}: {len(result)} frames, {result.n_lanes} lanes,"
        f" graph {run['config']['graph']},"
        f" mean log evidence {math.nan if mean is None else mean:.4f}",
        *run["why_not_causal"],
    ]
    if "blocks" in run:
        first.append(f"held out, {run['blocks']} blocks: each with {_FITS[run['fit']]}")
    sides = scores_by_side(result)
    parts: list[str | Table] = []
    if sides:
        n_scored = scores["frames_scored"]
        first.append(f"{n_scored} frames scored, without those of lane changes")
        first.append(f"parameters: {TUNED_ON[run['tuned_on']]}")
        parts.append(score_table(sides))
    else:
        first.append("no ground truth: beliefs only, no scores (ground_truth names a file)")
    if "model_all_frames" in scores:
        every = scores["model_all_frames"]
        parts.append(f"the same with the frames of untrusted labels: {every['frames_scored']}")
        parts.append(score_table({"model": every}))
    if "drive" in result.frames:
        parts += drive_parts(result)
    if sides:
        parts += [confusion_table(each["confusion"], who) for who, each in sides.items()]
    elif "drive" not in result.frames:
        last = result.node("Lane")[-1]
        at_the_end = f"at the end lane {last.argmax() + 1} is the most probable ({last.max():.2f})"
        parts.append(f"{segments_text(result.segments)}; {at_the_end}")
    share = f"{100 * scores['sure']:.1f} % of the frames"
    parts += [f"sure (a belief of at least {SURE:g}) in {share}", *event_parts(result)]
    return page(["\n".join(first), *parts], style, wide)


def drive_parts(result: Result) -> list[str | Table]:
    """A table with a row per drive: its scores, or its lane at the end."""
    is_scored = "model" in result.scores
    rows = []
    for name, frames in by_drive(result.frames):
        row: dict[str, Any] = {"drive": name, "frames": len(frames)}
        if "n_lanes" in frames:
            row["lanes"] = int(frames["n_lanes"].iloc[0])
        if is_scored:
            known = frames[is_known(frames)]
            row["scored"] = len(known)
            for who, column in (("detector", "detector_lane"), ("accuracy", "assigned_lane")):
                if column in frames:
                    right = known[column] == known["true_lane"]
                    row[who] = float(right.mean()) if len(known) else None
        else:
            last = lanes_of(frames)[-1]
            is_believed = last.max() >= CONFIDENT
            row["lane at the end"] = str(last.argmax() + 1) if is_believed else "-"
            row["probability"] = float(last.max())
        rows.append(row)
    n_sure = sum(row.get("lane at the end", "-") != "-" for row in rows)
    parts: list[str | Table] = [table(pd.DataFrame(rows[:LISTED]).set_index("drive"))]
    if len(rows) > LISTED:
        parts.append(f"and {len(rows) - LISTED} more drives")
    if not is_scored:
        parts.append(f"{n_sure} of {len(rows)} drives end in a lane of at least {CONFIDENT:.2f}")
    return parts


def event_parts(result: Result) -> list[str | Table]:
    """The table of lane changes, and their scores."""
    events = result.events
    parts: list[str | Table] = [event_table(events) if len(events) else "no lane change detected"]
    if len(events) > LISTED:
        parts.append(f"and {len(events) - LISTED} more in events.csv")
    if "within" in result.scores["events"]:
        parts.append("\n".join(event_lines(result.scores["events"])))
    return parts
