"""Accuracy-coverage curves: how accurate the answers are if only sure enough beliefs give one."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.results import Result
from egolane_pgm.scoring.probabilistic import CoverageCurve, coverage_curve
from egolane_pgm.views.answers import INK, scored_answers, title_with_frames
from egolane_pgm.views.style import ANSWER_STYLE, axes_at, new_figure, put_title

#: The values of `unassigned_below` that are marked on the curves.
MARKED = (0.5, 0.9, 0.99)


def coverage_curves(result: Result) -> dict[str, CoverageCurve]:
    """The curves of "Detector only" (if there is a tentative vector) and "Model".

    Raises InputError if no frame is annotated.
    """
    return {
        name: coverage_curve(belief, lane, crossing)
        for name, (belief, _, lane, crossing) in scored_answers(result).items()
    }


def coverage_figure(result: Result) -> Figure:
    """Draws the share of right answers over the share of frames that get one, as the probability
    that an answer needs falls from 1. Some values of `unassigned_below` are marked.

    Raises InputError without ground truth.
    """
    curves = coverage_curves(result)
    figure = new_figure(5.2, 4.3)
    put_title(figure, title_with_frames(result))
    ax = axes_at(figure, 0.75, 0.75, 4.25, 2.95)
    lowest = 1.0
    for name, curve in curves.items():
        colour, marker, dashes = ANSWER_STYLE[name]
        # The curve begins at one answer in a hundred frames; fewer say nothing about accuracy.
        shown = curve.coverage >= 0.01
        ax.plot(
            curve.coverage[shown], curve.accuracy[shown], linestyle=dashes, color=colour,
            linewidth=1.5, label=name,
        )  # fmt: skip
        if shown.any():
            lowest = min(lowest, float(curve.accuracy[shown].min()))
        for below in MARKED:
            coverage, accuracy = curve.at(below)
            if coverage < 0.01 or np.isnan(accuracy):
                continue
            lowest = min(lowest, accuracy)
            ax.plot(
                [coverage], [accuracy], marker=marker, markersize=5.5, color=colour,
                linestyle="none", zorder=3,
            )  # fmt: skip
            ax.annotate(
                f"{below:g}", (coverage, accuracy), textcoords="offset points", xytext=(4, 5),
                fontsize=8, color=INK,
            )  # fmt: skip
    margin = 0.08 * (1 - lowest) + 0.002
    ax.set_xlim(-0.015, 1.06)
    ax.set_ylim(max(0.0, lowest - margin), 1 + margin)
    ax.set_xlabel("coverage: share of frames with an answer", fontsize=9)
    ax.set_ylabel("share of answers that are right", fontsize=9)
    ax.tick_params(labelsize=8.5)
    ax.grid(color="#ececec", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=8.5, frameon=False,
        title="marked: unassigned_below", title_fontsize=8, borderaxespad=0.2,
    )  # fmt: skip
    return figure
