"""The text of a result: its title, and the output of `egolane run`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.inference.events import CONFIDENT, SURE, lane_segments
from egolane_pgm.result import TAG, Result, by_drive, lanes_of
from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.views.events import LISTED, event_lines, event_table, segments_text
from egolane_pgm.views.frames import answers, is_known
from egolane_pgm.views.tables import (
    LOG_EVIDENCE,
    TUNED_ON,
    TUNED_ON_SHORT,
    Table,
    cell,
    confusion_table,
    page,
    percent,
    score_table,
    table,
    with_interval,
)

#: The columns of a table of runs that are printed, and their names.
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


def scores_by_side(result: Result) -> dict[str, Any]:
    """The scores of the detector, if it has an answer, and of the model."""
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


def result_text(result: Result, style: str = "markdown") -> str:
    """The output of `egolane run`: the score, or the lane over time, then the lane changes.

    - style: of the tables; all but markdown add all scores, confusion matrices, and every drive
      and lane change.
    """
    wide = style != "markdown"
    run = result.run
    sides = scores_by_side(result)
    events = result.events
    several = "drive" in result.frames
    most = None if wide else LISTED
    parts: list[str | Table] = ["\n".join(_head(result, sides))]
    if wide and sides:
        parts.append(score_table(sides))
        every = result.scores.get("model_all_frames")
        if every:
            parts.append(f"the same with the frames of untrusted labels: {every['frames_scored']}")
            parts.append(score_table({"model": every}))
        parts += [confusion_table(each["confusion"], who) for who, each in sides.items()]
    if several:
        parts += drive_parts(result, most)
    if len(events) and (wide or not several):
        parts.append(event_table(events[:most]))
    if wide and "within" in result.scores["events"]:
        parts.append("\n".join(event_lines(result.scores["events"])))
    if wide:
        mean = cell(result.scores["mean_log_evidence"], 4)
        share = f"{percent(result.scores['sure'])} % of the frames"
        parts.append(
            f"graph {run['config']['graph']}: mean log evidence {mean}; probability of the lane at"
            f" least {SURE:g} in {share}\n({LOG_EVIDENCE})"
        )
    else:
        more = f"all {len(events)} lane changes: events.csv or --format wide"
        last = [more] * (len(events) > LISTED and not several)
        last += ["all scores and confusion matrices: scores.json or --format wide"] * bool(sides)
        parts.append("\n".join(last))
    return page(parts, style)


def _head(result: Result, sides: dict[str, Any]) -> list[str]:
    """The first lines: score or lane over time, the drive, and the number of lane changes."""
    run = result.run
    scores = result.scores
    if sides:
        accuracy = sides["model"]["accuracy"]
        detector = sides.get("detector", {}).get("accuracy")
        alone = f", detector alone {percent(detector)} %" if detector is not None else ""
        lines = [
            f"{run['name']}: right in {percent(accuracy)} % of {scores['frames_scored']}"
            f" frames{alone}"
        ]
    elif "drive" in result.frames:
        lines = [f"{run['name']}: no ground truth, no scores"]
    else:
        lane = result.node("Lane")
        time_s = result.frames["time_s"].to_numpy()
        last = lane[-1]
        lines = [
            f"{run['name']}: {segments_text(lane_segments(lane, result.events, time_s))}",
            f"most probable at the end: lane {last.argmax() + 1} ({last.max():.2f});"
            " no ground truth, no scores",
        ]
    causal = "causal" if run["is_causal"] else "not causal"
    lines.append(
        f"{len(result)} frames, {result.n_lanes} lanes, {causal}; parameters:"
        f" {TUNED_ON[run['tuned_on']]}"
    )
    lines += run["why_not_causal"]
    if "blocks" in run:
        lines.append(f"held out, {run['blocks']} blocks; fit.method: {run['fit']}")
    found = scores["events"]
    n_events = len(result.events)
    if "within" in found:
        within = found["within"]["1"]
        lines.append(
            f"lane changes: {found['changes']} annotated, {n_events} reported; within 1 s recall"
            f" {cell(within['recall'], 2)}, precision {cell(within['precision'], 2)}"
        )
    else:
        lines.append(f"lane changes: {n_events} reported")
    return lines


def drive_parts(result: Result, most: int | None = LISTED) -> list[str | Table]:
    """A table with a row per drive: its scores, or its lane at the end.

    - most: number of rows; None for all.
    """
    rows = []
    for name, frames in by_drive(result.frames):
        row: dict[str, Any] = {"drive": name, "frames": len(frames)}
        if "n_lanes" in frames:
            row["lanes"] = int(frames["n_lanes"].iloc[0])
        if "model" in result.scores:
            row["scored"] = int(is_known(frames).sum())
            for who, each in answers(frames).items():
                accuracy = SCORES["accuracy"].of(each) if row["scored"] else np.nan
                row["accuracy" if who == "Model" else "detector"] = accuracy
        else:
            last = lanes_of(frames)[-1]
            row["lane at the end"] = str(last.argmax() + 1) if last.max() >= CONFIDENT else "-"
            row["probability"] = float(last.max())
        rows.append(row)
    parts: list[str | Table] = [table(pd.DataFrame(rows[:most]).set_index("drive"))]
    if most is not None and len(rows) > most:
        parts.append(f"and {len(rows) - most} more drives")
    return parts


def runs_text(summary: pd.DataFrame, style: str) -> str:
    """The output of `egolane run --table`: a row per run.

    - summary: as `runs.run_table` returns it.
    """
    if style == "csv":
        return page([table(summary)], style)
    tags = [column for column in summary if str(column).startswith(TAG)]
    shown = summary[[*tags, *(c for c in _COLUMNS if c in summary)]].dropna(axis=1, how="all")
    counts = [c for c in ("frames", "frames_scored") if c in shown]
    shown = shown.astype(dict.fromkeys(counts, "Int64"))
    names = {tag: str(tag).removeprefix(TAG) for tag in tags}
    return page([table(shown.rename(columns=names | _COLUMNS), {"seconds": 1})], style)
