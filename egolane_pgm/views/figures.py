"""Figures of scores: confusion matrices, reliability, error dispersion.

Each is a function of the frames of a result (`Result.frames`); InputError without annotated ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from egolane_pgm.scoring.confusion import confusion, scores_from_confusion
from egolane_pgm.scoring.scores import N_BINS, SCORES, calibration_curve
from egolane_pgm.types import IntArray
from egolane_pgm.views.frames import answers, scored
from egolane_pgm.views.style import (
    ANSWER_STYLE,
    ERROR_RAMP,
    FAINT,
    INK,
    MODEL_COLOUR,
    PROBABILITY_RAMP,
    UNASSIGNED_COLOUR,
    new_figure,
    text_colour,
)
from egolane_pgm.views.tables import percent

#: Reliability bins with fewer frames are drawn hollow and not connected: mostly chance.
FEW_FRAMES = 30

#: The smallest share with a number in its part of a bar.
LABELLED = 0.04


def confusions(frames: pd.DataFrame) -> dict[str, IntArray]:
    """The confusion matrices (n + 1, n) of the answers."""
    return {
        who: confusion(each.assigned, each.lane, each.is_crossing, each.belief.shape[1])
        for who, each in answers(scored(frames)).items()
    }


def _titled(frames: pd.DataFrame, title: str) -> str:
    return f"{title}: {len(scored(frames)):,} frames" if title else ""


def confusion_figure(frames: pd.DataFrame, title: str = "") -> Figure:
    """Draw the confusion matrices of detector and model.

    Colour and upper number are the percentage of a true lane's frames, the lower number counts
    frames.
    """
    matrices = confusions(frames)
    n = matrices["Model"].shape[1]
    size = 1.3 + len(matrices) * max(0.8 * n + 0.2, 2.2), 1.4 + 0.48 * (n + 1)
    figure = new_figure(*size, _titled(frames, title))
    axes = figure.subplots(1, len(matrices), squeeze=False, sharey=True)[0]
    for ax, (name, counts) in zip(axes, matrices.items(), strict=True):
        total = counts.sum(axis=0)
        share = np.nan_to_num(counts / np.maximum(total, 1))
        ax.imshow(share, PROBABILITY_RAMP, vmin=0, vmax=1, aspect="auto")
        for (row, column), count in np.ndenumerate(counts):
            colour = text_colour(PROBABILITY_RAMP(share[row, column]))
            place: dict[str, Any] = {"ha": "center", "va": "center", "color": colour}
            text = f"{percent(share[row, column])} %" if total[column] else "-"
            ax.text(column, row - 0.13, text, **place)
            ax.text(column, row + 0.23, f"{int(count):,}", fontsize=7, **place)
        ax.vlines(np.arange(1, n) - 0.5, -0.5, n + 0.5, FAINT, lw=0.5)
        ax.hlines(np.arange(1, n) - 0.5, -0.5, n - 0.5, FAINT, lw=0.5)
        ax.hlines(n - 0.5, -0.5, n - 0.5, INK, lw=1)
        accuracy = scores_from_confusion(counts)["accuracy"]
        ax.set_title(f"{name}: {percent(float(accuracy))} % correct")
        ax.set_xticks(range(n), [f"lane {k + 1}\n{int(t):,}" for k, t in enumerate(total)])
        ax.set_yticks(range(n + 1), [*(f"lane {k + 1}" for k in range(n)), "Unassigned"])
        ax.set_xlabel("true lane, number of frames (100 %)")
        ax.tick_params(length=0)
        ax.grid(False)
    axes[0].set_ylabel("predicted (lane 1: leftmost)")
    return figure


def reliability_figure(frames: pd.DataFrame, title: str = "") -> Figure:
    """Draw the calibration curves of detector and model, and the number of frames in each bin.

    The legend has the expected calibration error (ECE).
    """
    both = answers(scored(frames))
    figure = new_figure(5, 5.4, _titled(frames, title))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.plot([0, 1], [0, 1], color=FAINT, lw=1.2, label="perfect calibration")
    edges = np.arange(N_BINS) / N_BINS
    width = 0.84 / N_BINS / len(both)
    lowest = 1.0
    for k, (name, each) in enumerate(both.items()):
        curve = calibration_curve(each)
        error = SCORES["expected_calibration_error"].of(each)
        colour, marker, dashes = ANSWER_STYLE[name]
        x = curve["confidence"]
        y = curve["accuracy"]
        count = curve["count"]
        few = (count < FEW_FRAMES) & (count > 0)
        look: Any = {"color": colour, "marker": marker, "ms": 5, "lw": 1.3}
        label = f"{name}, ECE {error:.3f}"
        upper.plot(x[count >= FEW_FRAMES], y[count >= FEW_FRAMES], ls=dashes, label=label, **look)
        label = f"{name}, fewer than {FEW_FRAMES} frames"
        upper.plot(x[few], y[few], ls="", mfc="w", label=label if few.any() else None, **look)
        left = edges + k * width + 0.08 / N_BINS
        lower.bar(left, count, width, align="edge", color=colour)
        lowest = min(lowest, float(edges[count > 0].min()))
    upper.set(xlim=(lowest - 0.01, 1.01), ylim=(-0.03, 1.03))
    upper.set_ylabel("share correct (Unassigned is wrong)")
    lower.set(yscale="log", ylabel="frames", xlabel="largest probability over the lanes")
    lower.yaxis.set_major_formatter("{x:,.0f}")
    lower.yaxis.set_minor_locator(NullLocator())
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def dispersion(matrix: IntArray) -> dict[str, int]:
    """Count the frames of a confusion matrix (n + 1, n) by how many lanes the answer is off."""
    lanes = np.arange(matrix.shape[1])
    off = np.bincount(np.abs(lanes[:, None] - lanes).ravel(), matrix[:-1].ravel()).astype(int)
    names = ["correct", *(f"off by {k}" for k in lanes[1:])]
    return {**dict(zip(names, off.tolist(), strict=True)), "unassigned": int(matrix[-1].sum())}


def dispersion_figure(results: Sequence[tuple[str, pd.DataFrame]]) -> Figure:
    """Draw stacked bars of the share of correct answers, answers off by 1, 2, ... and unassigned.

    As the paper's Figures `fig:graph-all-italy`, `fig:graph-all-spain` and `fig:comparisonBV-run3`.

    - results: titles and frames.
    """
    rows: dict[Any, dict[str, int]] = {}
    y: list[float] = []
    for k, (title, frames) in enumerate(results):
        for name, matrix in confusions(frames).items():
            note = (
                f"{matrix.shape[1]} lanes, {int(matrix.sum()):,} frames" if name == "Model" else ""
            )
            rows[k, f"{title}: {name}\n{note}".rstrip()] = dispersion(matrix)
            y.append(len(y) + 0.5 * k)
    counts = pd.DataFrame.from_dict(rows, orient="index").fillna(0)
    names = [*(c for c in counts if c != "unassigned"), "unassigned"]
    share = counts[names].div(counts.sum(axis=1), axis=0)
    errors = ERROR_RAMP(np.linspace(0, 1, len(names) - 2))
    figure = new_figure(9, 0.9 + 0.27 * (y[-1] + 1), "Error dispersion")
    ax = figure.subplots()
    left = np.zeros(len(share))
    for name, colour in zip(names, [MODEL_COLOUR, *errors, UNASSIGNED_COLOUR], strict=True):
        values = share[name].to_numpy()
        bars = ax.barh(y, values, 0.88, left, color=colour, ec="w", lw=0.5, label=name)
        labels = [percent(value) if value >= LABELLED else "" for value in values]
        ax.bar_label(bars, labels, label_type="center", fontsize=7.5, color=text_colour(colour))
        left += values
    ax.set_yticks(y, share.index.get_level_values(1))
    ax.set(xlim=(0, 1), ylim=(y[-1] + 0.6, -0.6), xlabel="share of scored frames (%)")
    ax.set_xticks(np.linspace(0, 1, 6), [f"{v}" for v in range(0, 101, 20)])
    ax.tick_params(axis="y", length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.grid(False)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(names), handlelength=1.2)
    return figure
