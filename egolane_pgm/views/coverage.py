"""Accuracy-coverage curves: the accuracy if only beliefs above a threshold give an answer."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.result import Result
from egolane_pgm.scoring.probabilistic import CoverageCurve, coverage_curve
from egolane_pgm.views.answers import answers, scored, title_with_frames
from egolane_pgm.views.style import ANSWER_STYLE, new_figure

#: The values of `unassigned_below` that are marked on the curves.
MARKED = (0.5, 0.9, 0.99)

#: The curves begin here: the accuracy of fewer answers is mostly chance.
LEAST_COVERAGE = 0.01


def coverage_curves(result: Result) -> dict[str, CoverageCurve]:
    """The curves of "Detector", if it has an answer, and "Model".

    Raises InputError without ground truth.
    """
    frames = scored(result)
    truth = frames["true_lane"].to_numpy(np.int64), np.zeros(len(frames), dtype=bool)
    return {name: coverage_curve(belief, *truth) for name, (belief, _) in answers(frames).items()}


def coverage_figure(result: Result) -> Figure:
    """Draw the share of correct answers over the share of frames with an answer.

    Some values of `unassigned_below`, the least probability of an answer, are marked. Raises
    InputError without ground truth.
    """
    curves = coverage_curves(result)
    figure = new_figure(5, 4, title_with_frames(result))
    ax = figure.subplots()
    lowest = 1.0
    for name, curve in curves.items():
        colour, marker, dashes = ANSWER_STYLE[name]
        shown = curve.coverage >= LEAST_COVERAGE
        ax.plot(
            curve.coverage[shown], curve.accuracy[shown], ls=dashes, color=colour, lw=1.5,
            label=name,
        )  # fmt: skip
        lowest = min(lowest, float(curve.accuracy[shown].min(initial=1.0)))
        for below in MARKED:
            coverage, accuracy = curve.at(below)
            if coverage < LEAST_COVERAGE:
                continue
            ax.plot(coverage, accuracy, marker=marker, ms=5.5, color=colour, zorder=3)
            place = {"textcoords": "offset points", "xytext": (4, 5), "fontsize": 8}
            ax.annotate(f"{below:g}", (coverage, accuracy), **place)
    margin = 0.08 * (1 - lowest) + 0.002
    ax.set(xlim=(-0.015, 1.06), ylim=(max(0.0, lowest - margin), 1 + margin))
    ax.set_xlabel("coverage: share of frames with an answer")
    ax.set_ylabel("share of answers that are correct")
    figure.legend(loc="outside lower center", ncols=2, title="marked: unassigned_below")
    return figure
