"""Confusion matrices as heat maps: detector beside model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.report.style import (
    FAINT,
    INK,
    PROBABILITY_COLOURS,
    answers,
    axes_at,
    check_figure_path,
    is_scored,
    new_figure,
    percent,
    plain_style,
    put_title,
    save,
    series,
    text_colour,
)
from egolane_pgm.results import Result
from egolane_pgm.scoring.confusion import accuracy, check_confusion, confusion
from egolane_pgm.types import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

# Inches.
_CELL_WIDTH, _CELL_HEIGHT, _LEFT, _GAP, _HEAD, _FOOT = 0.82, 0.52, 1.25, 0.3, 0.62, 0.65
_RIGHT, _BAR = 0.85, 0.14


def confusions(result: Result) -> dict[str, IntArray]:
    """ "Detector only" (where there is a tentative vector) and "Model": (n + 1, n) counts.

    Raises InputError where no frame is annotated.
    """
    chosen = is_scored(result)
    lane, crossing = result.true_lane[chosen], result.is_crossing[chosen]
    return {
        name: confusion(assigned[chosen], lane, crossing, result.n_lanes)
        for name, (_, assigned) in answers(result).items()
    }


def column_shares(matrix: IntArray) -> FloatArray:
    """(n + 1, n): each count over its column's sum, NaN in the column of a lane never driven."""
    m = check_confusion(matrix)
    total = m.sum(axis=0)
    return np.asarray(m / np.where(total == 0, np.nan, total), dtype=np.float64)


def draw_confusion(result: Result, path: str | Path) -> Path:
    """Draw the confusion matrices of detector and model into a PNG, SVG or PDF file.

    Colour and upper number: percentage of the actual lane's frames; lower number: frames. Without
    a tentative vector only the model is drawn.
    Raises InputError without ground truth, for another extension, and for a file that cannot be
    written.
    """
    path = check_figure_path(path)
    with plain_style():
        return save(confusion_figure(result), path)


def confusion_figure(result: Result) -> Figure:
    """The figure of `draw_confusion`; the same errors."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    matrices = confusions(result)
    n = result.n_lanes
    width, height = max(n * _CELL_WIDTH, 2.2), (n + 1) * _CELL_HEIGHT
    across = _LEFT + len(matrices) * (width + _GAP) - _GAP + _RIGHT
    figure = new_figure(across, _HEAD + height + _FOOT)
    put_title(figure, series(result))
    colours = LinearSegmentedColormap.from_list("share", PROBABILITY_COLOURS)
    ramp = colours.with_extremes(bad="#efefef")
    for k, (name, matrix) in enumerate(matrices.items()):
        ax = axes_at(figure, _LEFT + k * (width + _GAP), _HEAD, width, height)
        ax.set_title(f"{name}: {percent(float(accuracy(matrix)))} % right", fontsize=9.5)
        _draw_matrix(ax, matrix, ramp)
        lanes = [f"lane {j + 1}" for j in range(n)]
        ax.set_yticks(range(n + 1), [*lanes, "Unassigned"] if k == 0 else [], fontsize=8.5)
        if k == 0:
            ax.set_ylabel("predicted (lane 1: leftmost)", fontsize=9)
        totals = [
            f"{lane}\n{int(t):,} frames" for lane, t in zip(lanes, matrix.sum(0), strict=True)
        ]
        ax.set_xticks(range(n), totals, fontsize=8)
        ax.set_xlabel("actual", fontsize=9)
    bar = axes_at(figure, across - _RIGHT + 0.15, _HEAD, _BAR, height)
    bar.set_label("colour bar")
    figure.colorbar(ScalarMappable(Normalize(0, 100), ramp), cax=bar)
    bar.tick_params(labelsize=8)
    bar.set_ylabel("% of the actual lane's frames", fontsize=8.5)
    return figure


def _draw_matrix(ax: Axes, matrix: IntArray, ramp: Colormap) -> None:
    shares = column_shares(matrix)
    image = ax.imshow(
        np.ma.masked_invalid(shares), cmap=ramp, vmin=0, vmax=1, aspect="auto", interpolation="none"
    )
    n = matrix.shape[1]
    for row in range(n + 1):
        for column in range(n):
            share = shares[row, column]
            known = bool(np.isfinite(share))
            colour = text_colour(image.cmap(image.norm(share))[:3]) if known else INK
            # The larger number is the one that the colour shows.
            for text, y, size in (
                (f"{percent(share)} %" if known else "-", row - 0.14, 9),
                (f"{int(matrix[row, column]):,}", row + 0.22, 7.5),
            ):
                ax.text(column, y, text, fontsize=size, ha="center", va="center", color=colour)
    for k in range(1, n):
        ax.axvline(k - 0.5, color=FAINT, linewidth=0.5)
    for k in range(1, n + 1):
        ax.axhline(k - 0.5, color=INK if k == n else FAINT, linewidth=1.0 if k == n else 0.5)
    ax.tick_params(length=0)
