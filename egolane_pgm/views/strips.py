"""Lane-belief strips: the posterior of model and detector over time, and the ground truth.

Lane 1, the leftmost, is the top row and time runs to the right: a road seen from above, with the
car driving from left to right (the paper's Figure `fig:lanetransition01`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from egolane_pgm.result import Result, by_drive
from egolane_pgm.types import FloatArray, runs_of
from egolane_pgm.views.answers import (
    answers,
    frames_between,
    is_known,
    outcomes,
    title_of,
    true_lane,
)
from egolane_pgm.views.style import (
    CROSSING,
    DETECTOR_COLOUR,
    FAINT,
    INK,
    OUTCOMES,
    PROBABILITY_RAMP,
    UNASSIGNED_COLOUR,
    new_figure,
    write_figure,
)

#: The most columns in a row of strips: about one pixel each at 200 dpi.
MAX_COLUMNS = 1300

#: The most rows of strips. In a longer range a column is the mean over several frames.
MAX_ROWS = 8

#: Lanes of the map that are absent from a drive's road, with a belief below this, are left blank.
UNSEEN = 0.02

_ERRORS = {"wrong": DETECTOR_COLOUR, "unassigned": UNASSIGNED_COLOUR}

# Heights in inches; and the gap between two strips, in lanes.
_HEAD, _FOOT, _LANE, _ROW_GAP, _GAP = 0.5, 0.3, 0.16, 0.45, 0.6


def draw_strips(result: Result, file: str | Path) -> Path:
    """Draw the strips of a whole result. Raises InputError as `write_figure`."""
    return write_figure(lambda: result_strips(result), file)


def result_strips(result: Result, first: int | None = None, last: int | None = None) -> Figure:
    """Draw the strips of a result; see `strips_figure`."""
    credit = "; lanes: © OpenStreetMap contributors, ODbL" * (result.experiment.road is not None)
    return strips_figure(result.frames, result.events, title_of(result), credit, first, last)


def strips_figure(
    frames: pd.DataFrame,
    events: pd.DataFrame,
    title: str = "",
    note: str = "",
    first: int | None = None,
    last: int | None = None,
) -> Figure:
    """Draw the posterior over time, errors below each strip, lane changes and the ground truth.

    - frames, events: as a `Result` has them. Several drives follow one another, numbered from 0.
    - note: end of the title.
    - first, last: frame ids, both included; all by default.

    A long range continues in further rows. Raises InputError for a range without frames.
    """
    frames, events = _on_one_axis(frames, events)
    low, high = frames_between(frames, first, last).index[[0, -1]].tolist()
    n_frames = high - low + 1
    n_rows = min(MAX_ROWS, -(-n_frames // MAX_COLUMNS))
    each = -(-n_frames // (n_rows * MAX_COLUMNS))
    cells = strip_cells(frames, low, high, each)
    n_columns = len(cells["crossing"])
    per_row = -(-n_columns // n_rows)
    heights: dict[str, int] = {
        name: 1 if name == "Changes" else cells[name].shape[1]
        for name in ("Model", "Detector", "Changes", "Truth")
        if name in cells or name == "Changes"
    }
    total = sum(heights.values()) + _GAP * len(heights)
    # Constrained layout would take seconds.
    row = total * _LANE
    tall = _HEAD + n_rows * (row + _ROW_GAP) + _FOOT
    figure = new_figure(9.0, tall, layout="none")
    edges = {"left": 0.14, "right": 0.98, "top": 1 - _HEAD / tall}
    edges |= {"bottom": (_FOOT + _ROW_GAP) / tall, "hspace": _ROW_GAP / row}
    axes = figure.subplots(n_rows, 1, squeeze=False, gridspec_kw=edges)[:, 0]
    mean = f"; a column is the mean of {each} frames" if each > 1 else ""
    title = f"{title}: frames {low} to {high}{mean}{note}".removeprefix(": ")
    figure.text(0.01, 1 - 0.08 / tall, title, va="top", fontsize=10)
    for ax, start in zip(axes, range(0, n_columns, per_row), strict=False):
        part = {name: values[start : start + per_row] for name, values in cells.items()}
        left = low + each * start - 0.5
        right = left + each * len(part["crossing"])
        _draw_strips(ax, part, heights, left, right)
        top = sum(heights[name] + _GAP for name in ("Model", "Detector") if name in heights)
        _draw_changes(ax, events, top + 0.5)
        ax.set(xlim=(left, left + each * per_row), ylim=(total - 0.3, 0))
        _draw_ticks(ax, frames, left, right)
    place: dict[str, Any] = {"ha": "center", "va": "bottom", "linespacing": 1.6}
    axes[0].text(0.5, 1, "frame\n", transform=axes[0].transAxes, **place)
    axes[-1].set_xlabel("time (s)", labelpad=1)
    _draw_legend(figure, cells, events[events["detected_frame_id"].between(low, high)])
    return figure


def _on_one_axis(frames: pd.DataFrame, events: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Frames and lane changes with their outcome; several drives are numbered from 0."""
    if "drive" not in frames:
        return frames, events.assign(outcome=outcomes(events, frames))
    found, start = [], 0
    for name, part in by_drive(frames):
        mine = events[events["drive"] == name]
        place = start + part.index.get_indexer(mine["detected_frame_id"])
        found.append(mine.assign(outcome=outcomes(mine, part), detected_frame_id=place))
        start += len(part)
    return frames.reset_index(drop=True), pd.concat(found)


def strip_cells(frames: pd.DataFrame, low: int, high: int, each: int = 1) -> dict[str, FloatArray]:
    """The content of the strips, (columns, lanes), by name; a missing frame is NaN.

    "Model", "Detector", "Truth" and, with one value per column, "crossing", "wrong Model", ...

    - low, high: frame ids, both included.
    - each: number of frame ids whose mean is one column.
    """
    frames = frames.loc[low:high]
    known, truth = is_known(frames), true_lane(frames)
    cells: dict[Any, Any] = {("crossing", 0): frames["is_crossing"].eq(True).fillna(False)}
    for name, (belief, assigned) in answers(frames).items():
        lanes = range(1, belief.shape[1] + 1)
        if "n_lanes" in frames:
            # The map may be wrong by a lane: a belief in an absent lane is drawn.
            is_absent = np.array(lanes) > frames["n_lanes"].to_numpy()[:, None]
            belief = np.where(is_absent & (belief < UNSEEN), np.nan, belief)
        cells |= {(name, k): belief[:, k - 1] for k in lanes}
        cells[f"wrong {name}", 0] = known & (assigned != truth) & (assigned > 0)
        cells[f"unassigned {name}", 0] = known & (assigned == 0)
        if not np.isnan(truth).all():
            cells |= {("Truth", k): np.where(known, truth == k, np.nan) for k in lanes}
    table = pd.DataFrame(cells, index=frames.index).astype(float)
    table = table.reindex(range(low, high + 1))
    if each > 1:
        table = table.groupby((table.index - low) // each).mean()
    return {str(name): table[name].to_numpy() for name in table.columns.unique(0)}


def _draw_strips(
    ax: Axes, cells: Mapping[str, FloatArray], heights: Mapping[str, int], left: float, right: float
) -> None:
    """Draw one row of strips; y counts lanes from the top, x frames."""
    step = (right - left) / len(cells["crossing"])
    top: float = 0
    ticks: dict[float, str] = {}
    crossing = _spans(cells["crossing"], left, step)
    edges = [x for begin, length in crossing for x in (begin, begin + length)]
    for name, n in heights.items():
        box = (left, top), right - left, n
        if name != "Changes":
            values = np.ma.masked_invalid(cells[name].T)
            if np.ma.is_masked(values):
                ax.add_patch(Rectangle(*box, fc="w", ec=FAINT, hatch="//////", lw=0))
            x, y = (left, right), (top, top + n)
            ax.pcolorfast(x, y, values, cmap=PROBABILITY_RAMP, vmin=0, vmax=1, zorder=1)
            ax.hlines(top + np.arange(1, n), left, right, FAINT, lw=0.5, zorder=2)
            ticks |= {top + k + 0.5: f"{k + 1}{' (left)' * (k == 0)}" for k in range(n)}
        if f"wrong {name}" in cells:
            ax.vlines(edges, top, top + n, INK, (0, (3, 2)), lw=0.5, zorder=2)
            for mark, colour in _ERRORS.items():
                spans = _spans(cells[f"{mark} {name}"], left, step)
                ax.broken_barh(spans, (top + n + 0.06, 0.3), color=colour, lw=0, zorder=2)
        if name == "Truth":
            ax.broken_barh(crossing, (top, n), color=CROSSING, lw=0, zorder=2)
        ax.add_patch(Rectangle(*box, fill=False, ec=INK, lw=0.7, zorder=3, clip_on=False))
        ax.annotate(
            name, (0, top + n / 2), (-38, 0), ("axes fraction", "data"), "offset points",
            ha="right", va="center", weight="bold",
        )  # fmt: skip
        top += n + _GAP
    ax.set_yticks(list(ticks), list(ticks.values()), fontsize=7)
    ax.tick_params(axis="y", length=0, pad=1)
    ax.spines[:].set_visible(False)
    ax.grid(False)


def _spans(share: FloatArray, left: float, step: float) -> list[tuple[float, float]]:
    """Begin and length, in frames, of the runs of columns, (C, 1), with a share above 0."""
    return [(left + a * step, (b - a) * step) for a, b in runs_of(share[:, 0] > 0)]


def _draw_changes(ax: Axes, events: pd.DataFrame, y: float) -> None:
    """Draw reported lane changes as triangles that point to the side of the new lane."""
    for (direction, outcome), some in events.groupby(["direction", "outcome"]):
        marker = "^" if direction < 0 else "v"
        at = some["detected_frame_id"].to_numpy(float)
        ax.plot(at, np.full(len(at), y), marker, ms=4.5, color=OUTCOMES[outcome], mew=0, zorder=4)


def _draw_ticks(ax: Axes, frames: pd.DataFrame, left: float, right: float) -> None:
    """Number the frames above a row, and the seconds below it."""
    ids, time_s = frames.index.to_numpy(float), frames["time_s"].to_numpy()
    if (np.diff(time_s) > 0).all():
        seconds = _ticks(*np.interp([left, right], ids, time_s))
        ax.set_xticks(np.interp(seconds, time_s, ids), [f"{t:g}" for t in seconds])
    else:
        ax.set_xticks([])  # Clocks of drives differ.
    ax.tick_params(axis="x", length=2.5, pad=1.5)
    marks, above = _ticks(left, right), ax.secondary_xaxis("top")
    above.set_xticks(marks, [f"{x:.12g}" for x in marks])
    above.tick_params(length=2.5, pad=1.5)
    above.spines[:].set_visible(False)


def _ticks(low: float, high: float) -> FloatArray:
    ticks = np.asarray(MaxNLocator(9, steps=[1, 2, 5, 10]).tick_values(low, high))
    return ticks[(ticks >= low) & (ticks <= high)]


def _draw_legend(figure: Figure, cells: Mapping[str, FloatArray], events: pd.DataFrame) -> None:
    shades = [Patch(fc=PROBABILITY_RAMP(p / 4), ec=FAINT, label=f"{p / 4:g}") for p in range(5)]
    entries: list[Any] = [Line2D([], [], ls="", label="probability:"), *shades]
    if "Truth" in cells:
        colours = {**_ERRORS, "crossing": CROSSING}
        entries += [Patch(color=colour, label=label) for label, colour in colours.items()]
    is_elsewhere = ~(cells["crossing"][:, 0] > 0)
    if any(np.isnan(values[is_elsewhere]).any() for values in cells.values()):
        entries.append(Patch(fc="w", ec=FAINT, hatch="//////", lw=0, label="no data"))
    marks = [("^", INK, "change to the left"), ("v", INK, "to the right")] * bool(len(events))
    if not set(events["outcome"]) <= {"not annotated"}:
        known = [name for name in OUTCOMES if name in set(events["outcome"])]
        marks += [("d", OUTCOMES[name], name) for name in known]
    entries += [Line2D([], [], ls="", marker=m, color=c, label=label) for m, c, label in marks]
    figure.legend(
        handles=entries, loc="lower left", bbox_to_anchor=(0.01, 0), ncols=len(entries),
        handlelength=1.1, columnspacing=0.8, handletextpad=0.4, fontsize=7.5,
    )  # fmt: skip
