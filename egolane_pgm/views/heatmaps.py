"""Confusion matrices as heat maps: detector and model side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.result import Result
from egolane_pgm.scoring.confusion import accuracy, confusion
from egolane_pgm.types import IntArray
from egolane_pgm.views.answers import answers, scored, title_with_frames
from egolane_pgm.views.style import (
    FAINT,
    INK,
    PROBABILITY_RAMP,
    new_figure,
    percent,
    text_colour,
)


def confusions(result: Result) -> dict[str, IntArray]:
    """The confusion matrices (n + 1, n) of "Detector", if it has an answer, and "Model".

    Raises InputError without ground truth.
    """
    frames = scored(result)
    truth = frames["true_lane"].to_numpy(np.int64)
    crossing = np.zeros(len(frames), dtype=bool)
    return {
        name: confusion(assigned, truth, crossing, result.n_lanes)
        for name, (_, assigned) in answers(frames).items()
    }


def confusion_figure(result: Result) -> Figure:
    """Draw the confusion matrices of detector and model.

    Colour and upper number are the percentage of a true lane's frames, the lower number counts
    frames. Raises InputError without ground truth.
    """
    matrices = confusions(result)
    n = result.n_lanes
    size = 1.8 + len(matrices) * max(0.8 * n + 0.2, 2.2), 1.4 + 0.48 * (n + 1)
    figure = new_figure(*size, title_with_frames(result))
    axes = figure.subplots(1, len(matrices), squeeze=False, sharey=True)[0]
    ramp = PROBABILITY_RAMP.with_extremes(bad="#efefef")
    for ax, (name, counts) in zip(axes, matrices.items(), strict=True):
        total = counts.sum(axis=0)
        share = counts / np.where(total == 0, np.nan, total)
        image = ax.imshow(100 * share, cmap=ramp, vmin=0, vmax=100, aspect="auto")
        for (row, column), count in np.ndenumerate(counts):
            is_used = total[column] > 0
            colour = text_colour(ramp(share[row, column])) if is_used else INK
            place = {"ha": "center", "va": "center", "color": colour}
            text = f"{percent(share[row, column])} %" if is_used else "-"
            ax.text(column, row - 0.13, text, **place)
            ax.text(column, row + 0.23, f"{int(count):,}", fontsize=7, **place)
        ax.vlines(np.arange(1, n) - 0.5, -0.5, n + 0.5, FAINT, lw=0.5)
        ax.hlines(np.arange(1, n) - 0.5, -0.5, n - 0.5, FAINT, lw=0.5)
        ax.hlines(n - 0.5, -0.5, n - 0.5, INK, lw=1)
        ax.set_title(f"{name}: {percent(float(accuracy(counts)))} % correct")
        ax.set_xticks(range(n), [f"lane {k + 1}\n{int(t):,}" for k, t in enumerate(total)])
        ax.set_yticks(range(n + 1), [*(f"lane {k + 1}" for k in range(n)), "Unassigned"])
        ax.set_xlabel("true lane, number of frames")
        ax.tick_params(length=0)
        ax.grid(False)
    axes[0].set_ylabel("predicted (lane 1: leftmost)")
    bar = figure.colorbar(image, ax=axes, aspect=30, pad=0.01)
    bar.set_label("% of the true lane's frames")
    return figure
