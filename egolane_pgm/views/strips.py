"""Lane-belief strips: the posterior of model and detector over time, and the ground truth.

Lane 1, the leftmost, is the top row and time runs to the right: a road seen from above, with the
car driving from left to right (the paper's Figure `fig:lanetransition01`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from egolane_pgm.views.events import clock
from egolane_pgm.views.frames import (
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
)

#: The most frames in a row of strips: about a pixel each at 200 dpi.
MAX_COLUMNS = 1300

#: The most rows. A longer range has longer rows, in which not each frame has a pixel.
MAX_ROWS = 8

_ERRORS = {"wrong": DETECTOR_COLOUR, "unassigned": UNASSIGNED_COLOUR}

#: Height of the title, inches.
_HEAD = 0.3

#: Height of the legend, inches.
_FOOT = 0.4

#: Height of a lane, inches: room for its number.
_LANE = 0.16

#: Height between two rows of strips, inches: room for the ticks.
_ROW_GAP = 0.45

#: Gap between two strips, lanes.
_GAP = 0.6


def result_strips(result: Result, first: int | None = None, last: int | None = None) -> Figure:
    """Draw the posterior over time, errors below each strip, lane changes and the ground truth.

    A long range continues in further rows. Several drives follow one another, numbered from 0.

    - first, last: frame ids, both included; all by default.

    Raises InputError for a range without frames.
    """
    frames, events = _on_one_axis(result.frames, result.events)
    low, high = frames_between(frames, first, last).index[[0, -1]].tolist()
    cells = strip_cells(frames, low, high)
    n_frames = high - low + 1
    n_rows = min(MAX_ROWS, -(-n_frames // MAX_COLUMNS))
    per_row = -(-n_frames // n_rows)
    names = [name for name in ("Model", "Detector", "Changes", "Truth") if name in cells]
    total = sum(cells[name].shape[1] + _GAP for name in names)
    # Constrained layout would take seconds.
    row = total * _LANE
    tall = _HEAD + n_rows * (row + _ROW_GAP) + _FOOT
    figure = new_figure(9.0, tall, layout="none")
    edges = {"left": 0.14, "right": 0.98, "top": 1 - _HEAD / tall}
    edges |= {"bottom": (_FOOT + _ROW_GAP) / tall, "hspace": _ROW_GAP / row}
    axes = figure.subplots(n_rows, 1, squeeze=False, gridspec_kw=edges)[:, 0]
    credit = "; lanes: © OpenStreetMap contributors, ODbL" * (result.experiment.road is not None)
    title = f"{title_of(result)}: frames {low} to {high}{credit}"
    figure.text(0.01, 1 - 0.08 / tall, title, va="top", fontsize=10)
    time_s = frames["time_s"].to_numpy()
    for k, ax in enumerate(axes):
        part = {name: values[k * per_row : (k + 1) * per_row] for name, values in cells.items()}
        left = low + k * per_row - 0.5
        _draw_strips(ax, part, names, events, left)
        ax.set(xlim=(left, left + per_row), ylim=(total - 0.3, 0))
        at = MaxNLocator(9, steps=[1, 2, 5, 10], integer=True).tick_values(left, left + per_row)
        at = at[(at > left) & (at < min(left + per_row, high + 1))]
        labels = [f"{x:.0f}" for x in at]
        if (np.diff(time_s) > 0).all():  # Clocks of drives differ.
            seconds = np.interp(at, frames.index, time_s).tolist()
            labels = [f"{x}\n{clock(t)}" for x, t in zip(labels, seconds, strict=True)]
        ax.set_xticks(at, labels)
    axes[-1].set_xlabel("frame, time (minutes:seconds)", labelpad=1)
    _draw_legend(figure, cells, events[events["detected_frame_id"].between(low, high)])
    return figure


def _on_one_axis(frames: pd.DataFrame, events: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Frames and lane changes with their outcome; several drives are numbered from 0."""
    if "drive" not in frames:
        return frames, events.assign(outcome=outcomes(events, frames))
    found = []
    start = 0
    for name, part in by_drive(frames):
        mine = events[events["drive"] == name]
        place = start + part.index.get_indexer(mine["detected_frame_id"])
        found.append(mine.assign(outcome=outcomes(mine, part), detected_frame_id=place))
        start += len(part)
    return frames.reset_index(drop=True), pd.concat(found)


def strip_cells(frames: pd.DataFrame, low: int, high: int) -> dict[str, FloatArray]:
    """The content of the strips, (frames, lanes), by name; a missing frame is NaN.

    "Model", "Detector", "Truth" and, with one value per frame, "Changes" (empty), "crossing",
    "wrong Model", "unassigned Model", ...

    - low, high: frame ids, both included.
    """
    frames = frames.loc[low:high]
    known = is_known(frames)
    truth = true_lane(frames)
    cells: dict[str, Any] = {"crossing": frames["is_crossing"].eq(True).fillna(False)}
    cells["Changes"] = np.zeros(len(frames))
    for name, each in answers(frames).items():
        cells[name] = each.belief
        cells[f"wrong {name}"] = known & (each.assigned != truth) & (each.assigned > 0)
        cells[f"unassigned {name}"] = known & (each.assigned == 0)
        if not np.isnan(truth).all():
            one_hot = truth[:, None] == np.arange(1, each.belief.shape[1] + 1)
            cells["Truth"] = np.where(np.isnan(truth)[:, None], np.nan, one_hot)
    every = range(low, high + 1)
    return {
        name: pd.DataFrame(np.asarray(values, float), frames.index).reindex(every).to_numpy()
        for name, values in cells.items()
    }


def _draw_strips(
    ax: Axes,
    cells: Mapping[str, FloatArray],
    names: Sequence[str],
    events: pd.DataFrame,
    left: float,
) -> None:
    """Draw one row of strips; y counts lanes from the top, x frames from `left`."""
    top: float = 0
    ticks: dict[float, str] = {}
    crossing = _spans(cells["crossing"], left)
    edges = [x for begin, length in crossing for x in (begin, begin + length)]
    for name in names:
        length, n = cells[name].shape
        right = left + length
        box = ((left, top), length, n)
        if name == "Changes":
            for (direction, outcome), some in events.groupby(["direction", "outcome"]):
                at = some["detected_frame_id"]
                marker = "^" if direction < 0 else "v"
                look: Any = {"ms": 4.5, "color": OUTCOMES[outcome], "mew": 0, "zorder": 4}
                ax.plot(at, np.full(len(at), top + 0.5), marker, **look)
        else:
            ax.add_patch(Rectangle(*box, fc="w", ec=FAINT, hatch="//////", lw=0))
            ax.imshow(
                np.ma.masked_invalid(cells[name].T), PROBABILITY_RAMP, aspect="auto",
                interpolation="nearest",
                vmin=0, vmax=1, extent=(left, right, top + n, top), zorder=1,
            )  # fmt: skip
            ax.hlines(top + np.arange(1, n), left, right, FAINT, lw=0.5, zorder=2)
            ticks |= {top + k + 0.5: f"{k + 1}{' (left)' * (k == 0)}" for k in range(n)}
        if f"wrong {name}" in cells:
            ax.vlines(edges, top, top + n, INK, (0, (3, 2)), lw=0.5, zorder=2)
            for mark, colour in _ERRORS.items():
                spans = _spans(cells[f"{mark} {name}"], left)
                ax.broken_barh(spans, (top + n + 0.06, 0.3), color=colour, lw=0.3, zorder=2)
        if name == "Truth":
            ax.broken_barh(crossing, (top, n), color=CROSSING, lw=0, zorder=2)
        ax.add_patch(Rectangle(*box, fill=False, ec=INK, lw=0.7, zorder=3, clip_on=False))
        ax.annotate(
            name, (0, top + n / 2), (-38, 0), ("axes fraction", "data"), "offset points",
            ha="right", va="center", weight="bold",
        )  # fmt: skip
        top += n + _GAP
    ax.set_yticks(list(ticks), list(ticks.values()), fontsize=7)
    ax.tick_params(axis="x", length=2.5, pad=1.5)
    ax.tick_params(axis="y", length=0, pad=1)
    ax.spines[:].set_visible(False)
    ax.grid(False)


def _spans(marked: FloatArray, left: float) -> list[tuple[float, float]]:
    """Begin and length, in frames, of the runs of marked frames, (F, 1)."""
    return [(left + a, b - a) for a, b in runs_of(marked[:, 0] > 0)]


def _draw_legend(figure: Figure, cells: Mapping[str, FloatArray], events: pd.DataFrame) -> None:
    shades = [Patch(fc=PROBABILITY_RAMP(p), ec=FAINT, label=f"{p:g}") for p in (0, 0.5, 1.0)]
    entries: list[Any] = [Line2D([], [], ls="", label="probability:"), *shades]
    if "Truth" in cells:
        colours = {**_ERRORS, "crossing": CROSSING}
        entries += [Patch(color=colour, label=label) for label, colour in colours.items()]
    if any(np.isnan(values).any() for values in cells.values()):
        entries.append(Patch(fc="w", ec=FAINT, hatch="//////", lw=0, label="no data"))
    marks = [("^", INK, "change to the left"), ("v", INK, "to the right")] * bool(len(events))
    if "delay_s" in events:
        marks += [
            ("d", OUTCOMES[name], name) for name in OUTCOMES if name in set(events["outcome"])
        ]
    entries += [Line2D([], [], ls="", marker=m, color=c, label=label) for m, c, label in marks]
    figure.legend(
        handles=entries, loc="lower left", bbox_to_anchor=(0.01, 0), ncols=len(entries),
        handlelength=1.1, columnspacing=0.8, handletextpad=0.4, fontsize=7.5,
    )  # fmt: skip
