"""Error dispersion: by how many lanes the answers are off (the paper's Figures
`fig:graph-all-italy`, `fig:graph-all-spain` and `fig:comparisonBV-run3`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from egolane_pgm.result import Result
from egolane_pgm.types import IntArray
from egolane_pgm.views.answers import title_of
from egolane_pgm.views.heatmaps import confusions
from egolane_pgm.views.style import (
    ERROR_RAMP,
    MODEL_COLOUR,
    UNASSIGNED_COLOUR,
    new_figure,
    percent,
    text_colour,
)

#: The smallest share with a number in its part of the bar.
LABELLED = 0.04


def dispersion(matrix: IntArray) -> dict[str, int]:
    """Count the frames of a confusion matrix (n + 1, n) by how many lanes the answer is off."""
    lanes = np.arange(matrix.shape[1])
    off = np.abs(lanes[:, None] - lanes)
    counts = {
        f"off by {k}" if k else "correct": int(matrix[:-1][off == k].sum()) for k in lanes.tolist()
    }
    return {**counts, "unassigned": int(matrix[-1].sum())}


def dispersions(results: Sequence[Result]) -> pd.DataFrame:
    """The counts of several results: a row per result and answer.

    Raises InputError for a result without ground truth.
    """
    rows = {}
    for k, result in enumerate(results):
        matrices = confusions(result)
        note = f"{result.n_lanes} lanes, {int(matrices['Model'].sum()):,} frames"
        for name, matrix in matrices.items():
            rows[k, f"{title_of(result)}\n{note}", name] = dispersion(matrix)
    table = pd.DataFrame.from_dict(rows, orient="index").fillna(0)
    return table[[*(c for c in table if c != "unassigned"), "unassigned"]]


def dispersion_figure(results: Sequence[Result]) -> Figure:
    """Draw stacked bars of the share of correct answers, answers off by 1, 2, ... and unassigned.

    Raises InputError for a result without ground truth.
    """
    counts = dispersions(results)
    share = counts.div(counts.sum(axis=1), axis=0)
    n_off = share.shape[1] - 2
    errors = [ERROR_RAMP(k / max(n_off - 1, 1)) for k in range(n_off)]
    colours = [MODEL_COLOUR, *errors, UNASSIGNED_COLOUR]
    group = share.index.get_level_values(0).to_numpy()
    y = np.arange(len(share)) + 0.7 * group
    figure = new_figure(9, 0.9 + 0.235 * (y[-1] + 1), "Error dispersion")
    ax = figure.subplots()
    left = np.zeros(len(share))
    for name, colour in zip(share, colours, strict=True):
        values = share[name].to_numpy()
        ax.barh(y, values, 0.88, left, color=colour, ec="w", lw=0.5, label=name)
        for at, begin, value in zip(y, left, values, strict=True):
            if value >= LABELLED:
                place = {"ha": "center", "va": "center", "fontsize": 7.5}
                colour_of_text = text_colour(colour)
                ax.text(begin + value / 2, at, percent(value), color=colour_of_text, **place)
        left += values
    ax.set_yticks(y, share.index.get_level_values(2))
    place = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "ha": "right"}
    for k, title in dict(share.index.droplevel(2)).items():
        at, (name, _, note) = y[group == k].mean(), title.partition("\n")
        ax.annotate(name, (0, at), (-58, 0), va="bottom", **place)
        ax.annotate(note, (0, at), (-58, -1), va="top", fontsize=7, **place)
    ax.set(xlim=(0, 1), ylim=(y[-1] + 0.6, -0.6), xlabel="share of scored frames (%)")
    ax.set_xticks(np.linspace(0, 1, 6), [f"{v}" for v in range(0, 101, 20)])
    ax.tick_params(axis="y", length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.grid(False)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(colours), handlelength=1.2)
    return figure
