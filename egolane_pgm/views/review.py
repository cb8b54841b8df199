"""Pictures of a recording's labels for whoever checks them: lines, belief, label, confidence."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from egolane_pgm.labelling import Labels
from egolane_pgm.types import InputError, IntArray, LineLog, runs_of
from egolane_pgm.views.answers import (
    CROSSING,
    DETECTOR_COLOUR,
    FAINT,
    INK,
    MODEL_COLOUR,
    PROBABILITY_COLOURS,
    lane_names,
)
from egolane_pgm.views.strips import show_belief
from egolane_pgm.views.style import axes_at, new_figure, put_title, write_figure

#: What is shown before and after the frames that are asked about, seconds.
BESIDE_S = 4.0

#: How many pictures a review has: of the stretches in which most frames are expected to be wrong.
PICTURES = 10

#: Smaller probabilities are drawn as this.
SMALLEST = 1e-4

_LEFT, _WIDTH = 1.3, 7.5


def draw_review(labels: Labels, folder: Path) -> list[Path]:
    """Draw the worst stretches of the review list, a picture each. Returns the files, the worst
    first. Raises InputError where one cannot be written."""
    files = []
    for k, each in enumerate(labels.worst[:PICTURES], start=1):
        path = folder / f"review_{k:02d}_frames_{each.first}_to_{each.last}.png"
        write_figure(partial(review_figure, labels, each.first, each.last), path)
        files.append(path)
    return files


def review_figure(labels: Labels, first: int, last: int) -> Figure:
    """The lines' offsets over time, the belief over lanes with the label, and the confidence.

    - first, last: frame ids between which a human is asked; some seconds before and after are
      shown too.

    Raises InputError for a range without frames.
    """
    run, ids = labels.run, labels.frame_id
    asked = np.flatnonzero((ids >= first) & (ids <= last))
    if not len(asked):
        raise InputError(
            f"{labels.lines.source}: the range {first} to {last} has no frames; the recording"
            f" has frame ids {int(ids[0])} to {int(ids[-1])}"
        )
    rate = run.experiment.recording.frame_rate
    begin, end = ids[asked[0]] / rate - BESIDE_S, ids[asked[-1]] / rate + BESIDE_S
    rows = np.flatnonzero((ids / rate >= begin) & (ids / rate <= end))
    stretch = labels.stretch(int(asked[0]), int(asked[-1]) + 1)
    n_lanes = run.experiment.n_lanes
    strip = max(1.0, 0.3 * n_lanes)
    figure = new_figure(_LEFT + _WIDTH + 0.2, 4.9 + strip)
    lanes = " or ".join(map(str, stretch.lanes))
    put_title(figure, f"{run.experiment.name}: frames {first} to {last}, lane {lanes}?", 0.12, 10)
    if stretch.why:
        why = stretch.why if len(stretch.why) < 120 else stretch.why[:117] + "..."
        figure.text(0.12 / figure.get_figwidth(), 1 - 0.32 / figure.get_figheight(), why,
                    fontsize=8, va="top", color=INK)  # fmt: skip
    panels = [axes_at(figure, _LEFT, 0.6, _WIDTH, 2.2), axes_at(figure, _LEFT, 3.2, _WIDTH, strip)]
    panels.append(axes_at(figure, _LEFT, 3.4 + strip, _WIDTH, 0.9))
    _draw_lines(panels[0], labels.lines.take(rows))
    _draw_belief(panels[1], labels, rows)
    _draw_confidence(panels[2], labels, rows)
    for ax in panels:
        ax.set_xlim(begin, end)
        for edge in ((ids[asked[0]] - 0.5) / rate, (ids[asked[-1]] + 0.5) / rate):
            ax.axvline(edge, color=INK, linewidth=0.7, linestyle=(0, (3, 2)))
        ax.tick_params(labelbottom=ax is panels[-1], labelsize=8)
    panels[-1].set_xlabel(
        "time [s]; to review: between the dashed lines; above the black line the label is not sure",
        fontsize=9,
    )
    return figure


def _draw_lines(ax: Axes, log: LineLog) -> None:
    """Draw the offsets of the lines over time, in metres, left above."""
    time = np.broadcast_to(log.time_s[:, np.newaxis], log.offset_m.shape)
    for chosen, colour, label in (
        (~log.is_valid, FAINT, "not valid"),
        (log.is_valid & ~log.is_continuous, MODEL_COLOUR, "valid"),
        (log.is_valid & log.is_continuous, "#d55e00", "valid, continuous"),
    ):
        seen = chosen & np.isfinite(log.offset_m)
        if seen.any():
            ax.plot(time[seen], log.offset_m[seen], ".", markersize=2.5, color=colour, label=label)
    # Left of the vehicle is above, as lane 1 is in the strips.
    ax.invert_yaxis()
    ax.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
    ax.set_ylabel("offset [m], left above", fontsize=9)
    ax.tick_params(labelsize=8)
    if ax.lines[1:]:
        ax.legend(
            fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), frameon=False, ncols=3,
            markerscale=4, borderaxespad=0.2,
        )  # fmt: skip


def _draw_belief(ax: Axes, labels: Labels, rows: IntArray) -> None:
    """The belief over lanes, lane 1 on top as the road's left is in the lines' panel."""
    run, ids = labels.run, labels.frame_id[rows]
    n_lanes, rate = run.experiment.n_lanes, run.experiment.recording.frame_rate
    column = ids - ids[0]
    image = np.full((n_lanes, int(column[-1]) + 1), np.nan)
    image[:, column] = run.beliefs.lane[rows].T
    ends = np.array([ids[0] - 0.5, ids[-1] + 0.5]) / rate
    show_belief(ax, ends, np.array([0.5, n_lanes + 0.5]), image)
    # White edges set the marks off from a dark belief.
    marks: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white"}
    ax.plot(
        ids / rate, labels.lane[rows] - 0.15, "o", markersize=3.5, color=DETECTOR_COLOUR,
        markeredgewidth=0.3, label="label", **marks,
    )  # fmt: skip
    for start, stop in runs_of(labels.is_crossing[rows]):
        ax.axvspan((ids[start] - 0.5) / rate, (ids[stop - 1] + 0.5) / rate, ymax=0.06, color=INK)
    truth = run.truth
    if truth is not None:
        inside = (truth.frame_id >= ids[0]) & (truth.frame_id <= ids[-1])
        known = inside & ~truth.is_crossing
        ax.plot(
            truth.frame_id[known] / rate, truth.lane[known] + 0.25, "s", markersize=3.5,
            color="black", markeredgewidth=0.5, label="annotated", **marks,
        )  # fmt: skip
        for start, stop in runs_of(inside & truth.is_crossing):
            edges = (truth.frame_id[start] - 0.5) / rate, (truth.frame_id[stop - 1] + 0.5) / rate
            ax.axvspan(*edges, ymin=0.94, color=CROSSING)
    for k in range(1, n_lanes):
        ax.axhline(k + 0.5, color=FAINT, linewidth=0.6)
    ax.set_ylim(n_lanes + 0.5, 0.5)
    ax.set_yticks(range(1, n_lanes + 1), lane_names(n_lanes))
    handles, _ = ax.get_legend_handles_labels()
    handles.append(Patch(color=PROBABILITY_COLOURS[3], label="belief"))
    handles.append(Patch(color=INK, label="labelled crossing (below)"))
    if truth is not None:
        handles.append(Patch(color=CROSSING, label="annotated crossing (above)"))
    ax.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1, 1), ncols=5, fontsize=7.5,
        frameon=False, borderaxespad=0.2, columnspacing=1.2, handlelength=1.2,
    )  # fmt: skip


def _draw_confidence(ax: Axes, labels: Labels, rows: IntArray) -> None:
    rate = labels.run.experiment.recording.frame_rate
    wrong = np.maximum(1 - labels.confidence[rows], SMALLEST)
    ax.semilogy(
        labels.frame_id[rows] / rate, wrong, ".-", markersize=2.5, linewidth=0.6, color=MODEL_COLOUR
    )
    ax.axhline(max(1 - labels.below, SMALLEST), color=INK, linewidth=0.8)
    ax.set_ylim(SMALLEST / 2, 2)
    ax.set_yticks([SMALLEST, 0.01, 1])
    ax.minorticks_off()
    ax.set_ylabel("probability that\nthe label is wrong", fontsize=8)
