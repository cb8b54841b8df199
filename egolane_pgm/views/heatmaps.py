"""Confusion matrices as heat maps: detector and model side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure

from egolane_pgm.results import Result
from egolane_pgm.scoring.confusion import accuracy, confusion
from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.views.answers import FAINT, INK, percent, scored_answers, title_with_frames
from egolane_pgm.views.style import PROBABILITY_RAMP, axes_at, new_figure, put_title, text_colour

# The layout, in inches.
_CELL_WIDTH, _CELL_HEIGHT, _LEFT, _GAP, _HEAD, _FOOT = 0.82, 0.52, 1.25, 0.3, 0.62, 0.65
_RIGHT, _BAR = 0.85, 0.14


def confusions(result: Result) -> dict[str, IntArray]:
    """The confusion matrices (n + 1, n) of "Detector only" (if there is a tentative vector) and
    "Model". Raises InputError if no frame is annotated."""
    return {
        name: confusion(assigned, lane, crossing, result.n_lanes)
        for name, (_, assigned, lane, crossing) in scored_answers(result).items()
    }


def column_shares(matrix: IntArray) -> FloatArray:
    """Each count over the sum of its column, (n + 1, n); NaN in the column of an unused lane."""
    total = matrix.sum(axis=0)
    return np.asarray(matrix / np.where(total == 0, np.nan, total), dtype=np.float64)


def confusion_figure(result: Result) -> Figure:
    """Draws the confusion matrices of detector and model.

    The colour and the upper number of a cell are the percentage of the actual lane's frames; the
    lower number counts frames. Without a tentative vector only the model is drawn. Raises
    InputError without ground truth.
    """
    matrices = confusions(result)
    n = result.n_lanes
    width, height = max(n * _CELL_WIDTH, 2.2), (n + 1) * _CELL_HEIGHT
    across = _LEFT + len(matrices) * (width + _GAP) - _GAP + _RIGHT
    figure = new_figure(across, _HEAD + height + _FOOT)
    put_title(figure, title_with_frames(result))
    ramp = PROBABILITY_RAMP.with_extremes(bad="#efefef")
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
            # The larger number is the share, which the colour shows as well.
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
