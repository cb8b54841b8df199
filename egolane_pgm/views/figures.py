"""Figures of scores: confusion matrices, reliability, coverage, error dispersion.

Each is a function of the frames of a result (`Result.frames`); InputError without annotated ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from egolane_pgm.scoring.confusion import (
    N_BINS,
    calibration_curve,
    confusion,
    coverage_curve,
    expected_calibration_error,
    scores_from_confusion,
)
from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.views.answers import answers, scored
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

T = TypeVar("T")

#: Reliability bins with fewer frames are drawn hollow and not connected: mostly chance.
FEW_FRAMES = 30

#: The values of `min_confidence` that are marked on coverage curves, and where these begin.
MARKED, LEAST_COVERAGE = (0.5, 0.9, 0.99), 0.01

#: The smallest share with a number in its part of a bar.
LABELLED = 0.04


def _measured(frames: pd.DataFrame, measure: Callable[..., T]) -> dict[str, T]:
    """A score of the detector, if it has an answer, and of the model.

    - measure: function of posterior, assigned lane, true lane and crossing flag.
    """
    known = scored(frames)
    truth = known["true_lane"].to_numpy(np.int64), np.zeros(len(known), dtype=bool)
    return {name: measure(*answer, *truth) for name, answer in answers(known).items()}


def confusions(frames: pd.DataFrame) -> dict[str, IntArray]:
    """The confusion matrices (n + 1, n) of the answers."""

    def measure(belief: FloatArray, lane: Any, truth: Any, crossing: Any) -> IntArray:
        return confusion(lane, truth, crossing, belief.shape[1])

    return _measured(frames, measure)


def _titled(frames: pd.DataFrame, title: str) -> str:
    return f"{title}: {len(scored(frames)):,} frames" if title else ""


def confusion_figure(frames: pd.DataFrame, title: str = "") -> Figure:
    """Draw the confusion matrices of detector and model.

    Colour and upper number are the percentage of a true lane's frames, the lower number counts
    frames.
    """
    matrices = confusions(frames)
    n = matrices["Model"].shape[1]
    size = 1.8 + len(matrices) * max(0.8 * n + 0.2, 2.2), 1.4 + 0.48 * (n + 1)
    figure = new_figure(*size, _titled(frames, title))
    axes = figure.subplots(1, len(matrices), squeeze=False, sharey=True)[0]
    ramp = PROBABILITY_RAMP.with_extremes(bad="#efefef")
    for ax, (name, counts) in zip(axes, matrices.items(), strict=True):
        total = counts.sum(axis=0)
        share = counts / np.where(total == 0, np.nan, total)
        image = ax.imshow(100 * share, cmap=ramp, vmin=0, vmax=100, aspect="auto")
        for (row, column), count in np.ndenumerate(counts):
            is_used = total[column] > 0
            colour = text_colour(ramp(share[row, column])) if is_used else INK
            place: dict[str, Any] = {"ha": "center", "va": "center", "color": colour}
            text = f"{percent(float(share[row, column]))} %" if is_used else "-"
            ax.text(column, row - 0.13, text, **place)
            ax.text(column, row + 0.23, f"{int(count):,}", fontsize=7, **place)
        ax.vlines(np.arange(1, n) - 0.5, -0.5, n + 0.5, FAINT, lw=0.5)
        ax.hlines(np.arange(1, n) - 0.5, -0.5, n - 0.5, FAINT, lw=0.5)
        ax.hlines(n - 0.5, -0.5, n - 0.5, INK, lw=1)
        ax.set_title(
            f"{name}: {percent(float(scores_from_confusion(counts)['accuracy']))} % correct"
        )
        ax.set_xticks(range(n), [f"lane {k + 1}\n{int(t):,}" for k, t in enumerate(total)])
        ax.set_yticks(range(n + 1), [*(f"lane {k + 1}" for k in range(n)), "Unassigned"])
        ax.set_xlabel("true lane, number of frames")
        ax.tick_params(length=0)
        ax.grid(False)
    axes[0].set_ylabel("predicted (lane 1: leftmost)")
    bar = figure.colorbar(image, ax=axes, aspect=30, pad=0.01)
    bar.set_label("% of the true lane's frames")
    return figure


def reliabilities(frames: pd.DataFrame) -> dict[str, tuple[dict[str, FloatArray], float]]:
    """The calibration curves of the answers, and their expected calibration errors."""
    return _measured(
        frames,
        lambda belief, _, *truth: (
            calibration_curve(belief, *truth),
            expected_calibration_error(belief, *truth),
        ),
    )


def reliability_figure(frames: pd.DataFrame, title: str = "") -> Figure:
    """Draw the calibration curves of detector and model, and the number of frames in each bin.

    The legend has the expected calibration error (ECE).
    """
    found = reliabilities(frames)
    figure = new_figure(5, 5.4, _titled(frames, title))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.plot([0, 1], [0, 1], color=FAINT, lw=1.2, label="perfect calibration")
    edges, width = np.arange(N_BINS) / N_BINS, 0.84 / N_BINS / len(found)
    lowest, has_few = 1.0, False
    for k, (name, (curve, error)) in enumerate(found.items()):
        colour, marker, dashes = ANSWER_STYLE[name]
        count = curve["count"]
        enough = count >= FEW_FRAMES
        few = ~enough & (count > 0)
        has_few |= bool(few.any())
        look: Any = {"color": colour, "marker": marker, "ms": 5}
        for mask, face, line in ((enough, colour, dashes), (few, "w", "")):
            x, y = curve["confidence"][mask], curve["accuracy"][mask]
            upper.plot(x, y, ls=line, mfc=face, lw=1.3, **look)
        upper.plot([], [], ls=dashes, label=f"{name}, ECE {error:.3f}", **look)
        left = edges + k * width + 0.08 / N_BINS
        lower.bar(left, count, width, align="edge", color=colour)
        lowest = min(lowest, float(edges[count > 0].min()))
    if has_few:
        upper.plot([], [], "o", mfc="w", mec=INK, ms=5, label=f"fewer than {FEW_FRAMES} frames")
    upper.set(xlim=(lowest - 0.01, 1.01), ylim=(-0.03, 1.03))
    upper.set_ylabel("share correct (Unassigned is wrong)")
    lower.set(yscale="log", ylabel="frames", xlabel="largest probability over the lanes")
    lower.yaxis.set_major_formatter("{x:,.0f}")
    lower.yaxis.set_minor_locator(NullLocator())
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def coverage_curves(frames: pd.DataFrame) -> dict[str, dict[str, FloatArray]]:
    """The coverage curves of the answers."""
    return _measured(frames, lambda belief, _, *truth: coverage_curve(belief, *truth))


def coverage_figure(frames: pd.DataFrame, title: str = "") -> Figure:
    """Draw the share of correct answers over the share of frames with an answer.

    Some values of `min_confidence`, the least probability of an answer, are marked.
    """
    curves = coverage_curves(frames)
    figure = new_figure(5, 4, _titled(frames, title))
    ax = figure.subplots()
    lowest = 1.0
    for name, curve in curves.items():
        colour, marker, dashes = ANSWER_STYLE[name]
        coverage, accuracy = curve["coverage"], curve["accuracy"]
        shown = coverage >= LEAST_COVERAGE
        ax.plot(
            coverage[shown], accuracy[shown], ls=dashes, color=colour, lw=1.5, label=name
        )  # fmt: skip
        lowest = min(lowest, float(accuracy[shown].min(initial=1.0)))
        for below in MARKED:
            k = np.count_nonzero(curve["threshold"] >= below) - 1
            if k < 0 or coverage[k] < LEAST_COVERAGE:
                continue
            at = float(coverage[k]), float(accuracy[k])
            ax.plot(*at, marker=marker, ms=5.5, color=colour, zorder=3)
            ax.annotate(f"{below:g}", at, (4, 5), textcoords="offset points", fontsize=8)
    margin = 0.08 * (1 - lowest) + 0.002
    ax.set(xlim=(-0.015, 1.06), ylim=(max(0.0, lowest - margin), 1 + margin))
    ax.set_xlabel("coverage: share of frames with an answer")
    ax.set_ylabel("share of answers that are correct")
    figure.legend(loc="outside lower center", ncols=2, title="marked: min_confidence")
    return figure


def dispersion(matrix: IntArray) -> dict[str, int]:
    """Count the frames of a confusion matrix (n + 1, n) by how many lanes the answer is off."""
    lanes = np.arange(matrix.shape[1])
    off = np.bincount(np.abs(lanes[:, None] - lanes).ravel(), matrix[:-1].ravel()).astype(int)
    names = ["correct", *(f"off by {k}" for k in lanes[1:])]
    return {**dict(zip(names, off.tolist(), strict=True)), "unassigned": int(matrix[-1].sum())}


def dispersions(results: Sequence[tuple[str, pd.DataFrame]]) -> pd.DataFrame:
    """The counts of several results: a row per result and answer.

    - results: titles and frames.
    """
    rows = {}
    for k, (title, frames) in enumerate(results):
        for name, matrix in confusions(frames).items():
            note = f"{matrix.shape[1]} lanes, {int(matrix.sum()):,} frames"
            rows[k, f"{title}\n{note}", name] = dispersion(matrix)
    table = pd.DataFrame.from_dict(rows, orient="index").fillna(0)
    return table[[*(c for c in table if c != "unassigned"), "unassigned"]]


def dispersion_figure(results: Sequence[tuple[str, pd.DataFrame]]) -> Figure:
    """Draw stacked bars of the share of correct answers, answers off by 1, 2, ... and unassigned.

    As the paper's Figures `fig:graph-all-italy`, `fig:graph-all-spain` and `fig:comparisonBV-run3`.

    - results: titles and frames.
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
                x, ink = begin + value / 2, text_colour(colour)
                ax.text(x, at, percent(value), ha="center", va="center", fontsize=7.5, color=ink)
        left += values
    ax.set_yticks(y, share.index.get_level_values(2))
    place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "center"}
    for k, title in dict(share.index.droplevel(2)).items():
        at = y[group == k].mean()
        ax.annotate(title, (0, at), (-58, 0), textcoords="offset points", fontsize=7.5, **place)
    ax.set(xlim=(0, 1), ylim=(y[-1] + 0.6, -0.6), xlabel="share of scored frames (%)")
    ax.set_xticks(np.linspace(0, 1, 6), [f"{v}" for v in range(0, 101, 20)])
    ax.tick_params(axis="y", length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.grid(False)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(colours), handlelength=1.2)
    return figure
