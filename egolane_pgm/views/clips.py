"""The result of a recording of many clips in a few lines of text: how it is over all of them, and
which are the least sure. clips.csv has a row for each."""

from __future__ import annotations

import numpy as np

from egolane_pgm.inference.events import BELIEVED
from egolane_pgm.results import Result
from egolane_pgm.types import UNASSIGNED, FloatArray
from egolane_pgm.views.tables import Table

#: How many of the least sure clips are named.
WORST = 5

#: How many drives of a road whose lanes change are listed.
LISTED = 20

_SHARES = (0, 10, 50, 90, 100)


def clip_parts(result: Result) -> list[str | Table]:
    """The tables of the clips of a result, and the clips whose last belief is the least sure."""
    columns = result.clip_columns()
    clip, probability = columns["clip"], columns["probability"]
    lane, log_evidence = columns["assigned_lane"], columns["log_evidence"]
    believed = np.where(probability >= BELIEVED, lane, UNASSIGNED)
    counted = [int((believed == k).sum()) for k in range(1, result.n_lanes + 1)]
    counted.append(int((believed == UNASSIGNED).sum()))
    names = [*(f"lane {k}" for k in range(1, result.n_lanes + 1)), "no lane"]
    lanes = [[n, str(k), f"{100 * k / len(clip):.1f}"] for n, k in zip(names, counted, strict=True)]
    header = ["over the clips", "least", "10 %", "median", "90 %", "most"]
    rows = [
        ["frames", *_quantiles(columns["frames"], ".0f")],
        ["belief in the lane at its end", *_quantiles(probability, ".3f")],
        ["log evidence of a frame", *_quantiles(log_evidence, ".2f")],
    ]
    worst = np.argsort(probability, kind="stable")[:WORST]
    return [
        f"{len(clip)} clips, each from the prior on; {int(columns['changes'].sum())} lane changes"
        f" in {int((columns['changes'] > 0).sum())} of them",
        Table([f"believed ({BELIEVED:.2f}) at its end", "clips", "share, %"], lanes),
        Table(header, rows),
        "least sure: " + ", ".join(f"{clip[k]} ({probability[k]:.2f})" for k in worst),
    ]


def drive_parts(result: Result) -> list[str | Table]:
    """A table of the drives into which a road from a map cuts a recording, with their scores."""
    columns = result.clip_columns()
    header = ["drive", "lanes", "frames", "scored", "accuracy"]
    names = ("clip", "n_lanes", "frames", "frames_scored", "accuracy")
    rows = [
        [name, str(n), str(frames), str(scored), f"{right:.3f}" if scored else "-"]
        for name, n, frames, scored, right in zip(*(columns[name] for name in names), strict=True)
    ]
    parts: list[str | Table] = [Table(header, rows[:LISTED])]
    return parts + ([f"and {len(rows) - LISTED} more in clips.csv"] if len(rows) > LISTED else [])


def _quantiles(values: FloatArray, form: str) -> list[str]:
    return [f"{value:{form}}" for value in np.percentile(values, _SHARES)]
