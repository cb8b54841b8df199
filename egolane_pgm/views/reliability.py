"""Calibration curves: how often the belief is right, against how often it says that it is."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.results import Result
from egolane_pgm.scoring.probabilistic import (
    N_BINS,
    CalibrationCurve,
    calibration_curve,
    expected_calibration_error,
)
from egolane_pgm.views.answers import FAINT, INK, scored_answers, title_with_frames
from egolane_pgm.views.style import ANSWER_STYLE, axes_at, new_figure, put_title

#: A bin with fewer frames is drawn hollow, because its accuracy says little.
FEW_FRAMES = 30


def reliabilities(result: Result) -> dict[str, tuple[CalibrationCurve, float]]:
    """The calibration curve and the expected calibration error (0 to 1) of "Detector only" (if
    there is a tentative vector) and "Model". Raises InputError if no frame is annotated."""
    return {
        name: (
            calibration_curve(belief, lane, crossing),
            expected_calibration_error(belief, lane, crossing),
        )
        for name, (belief, _, lane, crossing) in scored_answers(result).items()
    }


def reliability_figure(result: Result) -> Figure:
    """Draws the calibration curves of detector and model, and the number of frames in each bin.

    There are 15 equal-width bins of the largest probability. The legend gives the expected
    calibration error (ECE). Without a tentative vector only the model is drawn. Raises InputError
    without ground truth.
    """
    found = reliabilities(result)
    figure = new_figure(5.2, 5.7)
    put_title(figure, title_with_frames(result))
    upper = axes_at(figure, 0.7, 0.85, 4.3, 3.1)
    lower = axes_at(figure, 0.7, 4.07, 4.3, 1.1)
    upper.plot([0, 1], [0, 1], color=FAINT, linewidth=1.2, label="perfectly calibrated", zorder=1)
    edge = np.linspace(0, 1, N_BINS + 1)
    bar = 0.8 / (N_BINS * len(found))
    for k, (name, (curve, error)) in enumerate(found.items()):
        colour, marker, dashes = ANSWER_STYLE[name]
        filled = curve.count > 0
        upper.plot(
            curve.confidence[filled], curve.accuracy[filled], linestyle=dashes, color=colour,
            linewidth=1.4, zorder=2,
        )  # fmt: skip
        for enough, face in ((True, colour), (False, "white")):
            some = filled & ((curve.count >= FEW_FRAMES) == enough)
            upper.plot(
                curve.confidence[some], curve.accuracy[some], linestyle="none", marker=marker,
                markersize=5.5, markeredgecolor=colour, markerfacecolor=face, zorder=3,
            )  # fmt: skip
        label = f"{name}, ECE {error:.3f}"
        upper.plot(
            [], [], color=colour, linestyle=dashes, marker=marker, markersize=5.5, label=label
        )
        left = edge[:-1] + 0.1 / N_BINS + k * bar
        lower.bar(left, curve.count, bar, align="edge", color=colour, label=name)
    if any(((c.count > 0) & (c.count < FEW_FRAMES)).any() for c, _ in found.values()):
        upper.plot(
            [], [], linestyle="none", marker="o", markerfacecolor="white", markeredgecolor=INK,
            markersize=5.5, label=f"fewer than {FEW_FRAMES} frames",
        )  # fmt: skip
    # The axis begins near 1 / n, as the largest of n probabilities is at least that.
    lowest = np.floor(N_BINS / result.n_lanes) / N_BINS if result.n_lanes > 1 else 0.0
    for ax in (upper, lower):
        ax.set_xlim(lowest - 0.015, 1.015)
        ax.tick_params(labelsize=8.5)
        ax.grid(color="#ececec", linewidth=0.6)
        ax.set_axisbelow(True)
    upper.set_ylim(-0.02, 1.02)
    upper.tick_params(labelbottom=False)
    upper.set_ylabel("share right (Unassigned is wrong)", fontsize=9)
    upper.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=8.5, frameon=False,
        borderaxespad=0.3,
    )  # fmt: skip
    lower.set_yscale("log")
    lower.set_ylim(0.7, None)
    lower.set_ylabel("frames (log)", fontsize=9)
    lower.set_xlabel("largest probability over the lanes", fontsize=9)
    return figure
