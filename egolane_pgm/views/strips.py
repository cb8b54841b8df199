"""Lane-belief strips: the beliefs of model and detector over time, with the ground truth below (the
paper's Figure `fig:lanetransition01`).

Lane 1 is the top row and time runs to the right, as on a road seen from above on which the car
drives from left to right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import AutoLocator

from egolane_pgm.results import Result
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, InputError, IntArray, runs_of
from egolane_pgm.views.answers import (
    CROSSING,
    FAINT,
    INK,
    UNSEEN,
    answers,
    lane_names,
    title_of,
)
from egolane_pgm.views.style import PROBABILITY_RAMP, axes_at, new_figure, put_title, write_figure

#: The most columns in a row of strips: about one pixel each at 200 dpi.
MAX_COLUMNS = 1300

#: The most rows of strips in a figure. In a longer range a column is the mean over frames.
MAX_ROWS = 8

# The layout, in inches.
_WIDTH, _LEFT, _LEFT_NAME, _RIGHT = 9.0, 1.5, 0.2, 0.2
_LANE, _STRIP_MIN, _STRIP_GAP = 0.2, 0.78, 0.07
_TICKS, _TICK, _ROW_GAP, _HEAD, _FOOT = 0.2, 0.05, 0.14, 0.42, 0.72
_DASHES = (0, (3, 2))


@dataclass(frozen=True)
class Strips:
    """One row of strips, for the frame ids from `first` to `last`, both included.

    - edge: (C + 1,) the first frame id of each of the C columns, and last + 1
    - beliefs: the mean beliefs (n, C) of "Model" and, if there is a tentative vector, "Detector
      only", with lane 1 in row 0; NaN where no frame was recorded
    - truth: (n, C) share of the annotated, non-crossing frames in each lane; NaN where there are
      none. None without ground truth.
    - is_crossing: (C,) whether the column has a crossing frame
    - road_lanes: (C,) lanes of the road, as the map says, the most of the column's frames; None for
      a road on which they do not change
    """

    first: int
    last: int
    edge: IntArray
    beliefs: Mapping[str, FloatArray]
    truth: FloatArray | None
    is_crossing: BoolArray
    road_lanes: IntArray | None = None

    @property
    def images(self) -> dict[str, FloatArray]:
        """The probabilities of each strip, (n, C), from above."""
        truth = {} if self.truth is None else {"Ground truth": self.truth}
        return {**self.beliefs, **truth}

    @property
    def frames_per_column(self) -> int:
        """The largest number of frame ids in a column."""
        return int(np.diff(self.edge).max())

    @property
    def crossings(self) -> list[tuple[int, int]]:
        """The runs of crossing columns: their first frame id, and the one after the last."""
        return [(int(self.edge[a]), int(self.edge[b])) for a, b in runs_of(self.is_crossing)]


def frame_range(result: Result, first: int | None, last: int | None) -> tuple[int, int]:
    """The first and the last frame id to draw; None stands for the recording's own.

    Raises InputError, with the recording's range, for a range without frames.
    """
    ids = result.frame_id
    if not len(ids):
        raise InputError(f"{result.directory}: has no frames to draw")
    low = int(ids[0]) if first is None else int(first)
    high = int(ids[-1]) if last is None else int(last)
    if not ((ids >= low) & (ids <= high)).any():
        raise InputError(
            f"{result.directory}: the range {low} to {high} has no frames; the recording has frame"
            f" ids {int(ids[0])} to {int(ids[-1])}"
        )
    return max(low, int(ids[0])), min(high, int(ids[-1]))


def strip_columns(result: Result, first: int, last: int, max_columns: int = MAX_COLUMNS) -> Strips:
    """The strips of the frame ids from first to last, both included.

    Each frame id has a column of its own if there are at most `max_columns`; otherwise a column is
    the mean over several. Missing frames stay NaN, so that a gap shows as a gap.
    """
    span = last - first + 1
    n_columns = min(span, max_columns)
    edge = first + np.arange(n_columns + 1) * span // n_columns
    chosen = (result.frame_id >= first) & (result.frame_id <= last)
    column = np.searchsorted(edge, result.frame_id[chosen], side="right") - 1
    beliefs = {
        name: _column_means(belief[chosen], column, n_columns)
        for name, (belief, _) in reversed(answers(result).items())
    }
    lane, crossing = result.true_lane[chosen], result.is_crossing[chosen]
    is_known = (lane != UNASSIGNED) & ~crossing
    truth = None
    if (result.true_lane != UNASSIGNED).any():
        one_hot = np.eye(result.n_lanes)[lane[is_known] - 1]
        truth = _column_means(one_hot, column[is_known], n_columns)
    is_crossing = np.bincount(column[crossing], minlength=n_columns) > 0
    road = None
    if result.road_lanes is not None:
        road = np.zeros(n_columns, dtype=np.int64)
        np.maximum.at(road, column, result.road_lanes[chosen])
        no_lane = np.arange(result.n_lanes)[:, None] >= road
        for image in (*beliefs.values(), *([] if truth is None else [truth])):
            # The map may be wrong by a lane: what is believed there is shown.
            image[no_lane & (np.nan_to_num(image) < UNSEEN)] = np.nan
    return Strips(first, last, edge.astype(np.int64), beliefs, truth, is_crossing, road)


def _column_means(values: FloatArray, column: IntArray, n_columns: int) -> FloatArray:
    count = np.bincount(column, minlength=n_columns).astype(np.float64)
    count[count == 0] = np.nan
    sums = [np.bincount(column, weights=v, minlength=n_columns) for v in values.T]
    return np.stack(sums) / count


def split_range(first: int, last: int, max_columns: int = MAX_COLUMNS) -> list[tuple[int, int]]:
    """Splits a range into rows of equal length (to a frame): as few as possible, at most
    MAX_ROWS."""
    span = last - first + 1
    rows = min(MAX_ROWS, -(-span // max_columns))
    edge = [first + k * span // rows for k in range(rows + 1)]
    return [(a, b - 1) for a, b in pairwise(edge)]


def draw_strips(result: Result, path: str | Path) -> Path:
    """Draws the lane-belief strips of a whole recording. Raises InputError as `write_figure`."""
    return write_figure(lambda: strips_figure(result), path)


def strips_figure(result: Result, first: int | None = None, last: int | None = None) -> Figure:
    """The lane-belief strips.

    - first, last: frame ids, both included; the whole recording by default. A range that is too
      long for one row continues in the next. Beyond MAX_ROWS rows, columns are means over frames,
      and the title says so. Without ground truth or tentative vector their strip is left out.

    Raises InputError for a range without frames, with the recording's.
    """
    low, high = frame_range(result, first, last)
    rows = [strip_columns(result, a, b) for a, b in split_range(low, high)]
    strip = max(_STRIP_MIN, _LANE * result.n_lanes)
    n_strips = len(rows[0].beliefs) + (rows[0].truth is not None)
    block = n_strips * (strip + _STRIP_GAP) - _STRIP_GAP + 2 * _TICKS
    end = _HEAD + len(rows) * (block + _ROW_GAP) - _ROW_GAP
    figure = new_figure(_WIDTH, end + _FOOT)
    averaged = rows[0].frames_per_column
    note = f"; each column is the mean of up to {averaged} frames" if averaged > 1 else ""
    put_title(figure, f"{title_of(result)}: frames {low} to {high}{note}", _LEFT, 10)
    # One pair of axes in inches holds all strips: axes for each, with ticks that place themselves,
    # take more than twice the time.
    sheet = axes_at(figure, 0, 0, _WIDTH, end + _FOOT)
    sheet.set(label="strips", xlim=(0, _WIDTH), ylim=(end + _FOOT, 0))
    sheet.set_axis_off()
    # All rows have the same scale, though one may be a frame shorter than another.
    longest = max(s.last - s.first + 1 for s in rows)
    frame_width = (_WIDTH - _LEFT - _RIGHT) / longest
    tops = [
        _HEAD + k * (block + _ROW_GAP) + _TICKS + np.arange(float(n_strips)) * (strip + _STRIP_GAP)
        for k in range(len(rows))
    ]
    for strips, at in zip(rows, tops, strict=True):
        _draw_row(sheet, result, strips, at, strip, frame_width)
    _draw_cells(sheet, rows, np.concatenate(tops), strip)
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    sheet.text(middle, _HEAD, "frame id", fontsize=9, ha="center", va="bottom")
    sheet.text(middle, end, "time [s]", fontsize=9, ha="center", va="top")
    _draw_legend(figure, result, rows, end + 0.26)
    if result.config.get("road"):
        said = "lanes of the map: © OpenStreetMap contributors, ODbL"
        sheet.text(_WIDTH - _RIGHT, end + _FOOT - 0.06, said, fontsize=7, ha="right", va="bottom")
    return figure


def _draw_cells(sheet: Axes, rows: list[Strips], tops: FloatArray, height: float) -> None:
    """Draw the probabilities of all strips as one image, with empty cells between the strips: one
    image for each would take three times the time."""
    images = [image for strips in rows for image in strips.images.values()]
    n_lanes, n_columns = len(images[0]), max(image.shape[1] for image in images)
    cells = np.full((len(images), n_lanes + 1, n_columns), np.nan)
    for cell, image in zip(cells, images, strict=True):
        cell[:-1, : image.shape[1]] = image
    x = np.linspace(_LEFT, _WIDTH - _RIGHT, n_columns + 1)
    y = tops[:, None] + np.arange(n_lanes + 1) * height / n_lanes
    show_belief(sheet, x, y.ravel(), cells.reshape(-1, n_columns)[:-1])


def _draw_row(
    sheet: Axes,
    result: Result,
    strips: Strips,
    tops: FloatArray,
    height: float,
    frame_width: float,
) -> None:
    """Draw what surrounds the cells of one row's strips; everything is in inches from the top left.

    - tops: where each strip begins.
    """
    lanes = np.arange(result.n_lanes)
    left, right = _LEFT, _LEFT + (strips.last - strips.first + 1) * frame_width
    for at, name in zip(tops, strips.images, strict=True):
        sheet.text(
            _LEFT_NAME, at + height / 2, name.replace(" ", "\n"), rotation=90, fontsize=9,
            fontweight="bold", ha="center", va="center",
        )  # fmt: skip
        middles = at + (lanes + 0.5) * height / len(lanes)
        for middle, lane in zip(middles, lane_names(len(lanes)), strict=True):
            sheet.text(left - 0.05, middle, lane, fontsize=8, ha="right", va="center_baseline")
        if strips.road_lanes is not None:
            right_edge = np.where(strips.road_lanes > 0, strips.road_lanes, np.nan)
            edges = left + (strips.edge - strips.first) * frame_width
            right_edge = at + right_edge * height / len(lanes)
            sheet.stairs(right_edge, edges, baseline=None, color=INK, linewidth=0.9, zorder=2.2)
    boxes = [_box(left, right, at, height) for at in tops]
    blank = [
        box
        for box, image in zip(boxes, strips.images.values(), strict=True)
        if np.isnan(image).any()
    ]
    sheet.add_collection(
        PolyCollection(
            blank, facecolors="white", edgecolors=FAINT, hatch="//////", linewidths=0, zorder=0
        )
    )
    edges_of_lanes = [
        [(left, y), (right, y)] for at in tops for y in at + lanes[1:] * height / len(lanes)
    ]
    _add_lines(sheet, edges_of_lanes, FAINT, 0.6)
    crossings = [
        (left + (a - strips.first) * frame_width, left + (b - strips.first) * frame_width)
        for a, b in strips.crossings
    ]
    if strips.truth is not None:
        grey = [_box(a, b, tops[-1], height) for a, b in crossings]
        sheet.add_collection(PolyCollection(grey, facecolors=CROSSING, label="crossings", zorder=2))
    begins_and_ends = [
        [(x, at), (x, at + height)]
        for at in tops[: len(strips.beliefs)]
        for crossing in crossings
        for x in crossing
    ]
    _add_lines(sheet, begins_and_ends, INK, 0.5, linestyles=[_DASHES])
    rate = float(result.run["frame_rate"])
    ticks = [
        *_draw_ticks(sheet, strips, tops[0], -_TICK, 1.0, frame_width),
        *_draw_ticks(sheet, strips, tops[-1] + height, _TICK, rate, frame_width),
    ]
    outlines = [[*box, box[0]] for box in boxes]
    _add_lines(sheet, [*outlines, *ticks], "black", 0.8, zorder=2.5)


def _draw_ticks(
    sheet: Axes, strips: Strips, at: float, length: float, rate: float, frame_width: float
) -> list[list[tuple[float, float]]]:
    """Number the frames, or with their rate the seconds, at a strip's edge; returns the ticks,
    which point up where the length is negative."""
    ends = (strips.first - 0.5) / rate, (strips.last + 0.5) / rate
    ticks = []
    for value in AutoLocator().tick_values(*ends):
        if ends[0] <= value <= ends[1]:
            x = _LEFT + (value * rate - strips.first + 0.5) * frame_width
            va = "top" if length > 0 else "bottom"
            sheet.text(x, at + 1.4 * length, f"{value:.12g}", fontsize=8, ha="center", va=va)
            ticks.append([(x, at), (x, at + length)])
    return ticks


def _box(left: float, right: float, top: float, height: float) -> list[tuple[float, float]]:
    return [(left, top), (right, top), (right, top + height), (left, top + height)]


def _add_lines(sheet: Axes, lines: Any, colour: str, width: float, **style: Any) -> None:
    """Draw lines as one artist: thousands of their own take seconds."""
    sheet.add_collection(LineCollection(lines, colors=colour, linewidths=width, **style))


def show_belief(ax: Axes, x: FloatArray, y: FloatArray, cells: FloatArray) -> None:
    """Draw probabilities, (rows, columns), as an image; where they are NaN it stays empty.

    - x, y: the edges of the columns and of the rows; if all are alike, the first and the last do.
    """
    shown = np.ma.masked_invalid(cells)
    ax.pcolorfast(x, y, shown, cmap=PROBABILITY_RAMP, vmin=0, vmax=1, zorder=1)


def _draw_legend(figure: Figure, result: Result, rows: list[Strips], top: float) -> None:
    bar = axes_at(figure, _LEFT, top, 1.6, 0.13)
    bar.set_label("colour bar")
    shades = ScalarMappable(Normalize(0, 1), PROBABILITY_RAMP)
    figure.colorbar(shades, cax=bar, orientation="horizontal")
    bar.tick_params(labelsize=8, pad=1.5)
    bar.set_xlabel("probability of the lane", fontsize=8, labelpad=1)
    entries: list[Patch | Line2D] = []
    if any(s.is_crossing.any() for s in rows):
        entries.append(Patch(facecolor=CROSSING, label="lane change (ground truth)"))
        entries.append(
            Line2D([], [], color=INK, linewidth=0.8, linestyle=_DASHES, label="its begin and end")
        )
    reasons = blank_reasons(result, rows[0].first, rows[-1].last)
    if reasons:
        label = " or ".join(reasons)
        entries.append(Patch(facecolor="white", edgecolor=FAINT, hatch="//////", label=label))
    if entries:
        figure.legend(
            handles=entries,
            loc="upper right",
            bbox_to_anchor=(1 - _RIGHT / _WIDTH, 1 - (top - 0.02) / figure.get_figheight()),
            ncols=len(entries) if len(reasons) < 2 else 2,
            frameon=False,
            fontsize=8,
            borderaxespad=0,
            columnspacing=1.2,
        )


def blank_reasons(result: Result, first: int, last: int) -> list[str]:
    """The reasons why a strip is blank somewhere in a range of frame ids, for the legend."""
    chosen = (result.frame_id >= first) & (result.frame_id <= last)
    reasons = []
    if chosen.sum() < last - first + 1:
        reasons.append("no frame recorded")
    if result.road_lanes is not None and (result.road_lanes[chosen] < result.n_lanes).any():
        reasons.append("no lane on the map")
    unknown = result.true_lane == UNASSIGNED
    if unknown[chosen].any() and not unknown.all():
        reasons.append("not annotated")
    return reasons
