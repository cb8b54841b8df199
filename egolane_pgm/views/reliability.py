"""Reliability diagrams: how often an answer is correct, over its probability."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from egolane_pgm.result import Result
from egolane_pgm.scoring.probabilistic import (
    N_BINS,
    CalibrationCurve,
    calibration_curve,
    expected_calibration_error,
)
from egolane_pgm.views.answers import answers, scored, title_with_frames
from egolane_pgm.views.style import ANSWER_STYLE, FAINT, INK, new_figure

#: Bins with fewer frames are drawn hollow and not connected: their accuracy is mostly chance.
FEW_FRAMES = 30


def reliabilities(result: Result) -> dict[str, tuple[CalibrationCurve, float]]:
    """The calibration curve and expected calibration error of "Detector", if there, and "Model".

    Raises InputError without ground truth.
    """
    frames = scored(result)
    truth = frames["true_lane"].to_numpy(np.int64), np.zeros(len(frames), dtype=bool)
    return {
        name: (calibration_curve(belief, *truth), expected_calibration_error(belief, *truth))
        for name, (belief, _) in answers(frames).items()
    }


def reliability_figure(result: Result) -> Figure:
    """Draw the calibration curves of detector and model, and the number of frames in each bin.

    The legend has the expected calibration error (ECE). Raises InputError without ground truth.
    """
    found = reliabilities(result)
    figure = new_figure(5, 5.4, title_with_frames(result))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.plot([0, 1], [0, 1], color=FAINT, lw=1.2, label="perfect calibration")
    edges, width = np.arange(N_BINS) / N_BINS, 0.84 / N_BINS / len(found)
    lowest, has_few = 1.0, False
    for k, (name, (curve, error)) in enumerate(found.items()):
        colour, marker, dashes = ANSWER_STYLE[name]
        enough = curve.count >= FEW_FRAMES
        few = ~enough & (curve.count > 0)
        has_few |= bool(few.any())
        for mask, face, line in ((enough, colour, dashes), (few, "w", "")):
            upper.plot(
                curve.confidence[mask], curve.accuracy[mask], ls=line, marker=marker, ms=5,
                color=colour, mfc=face, lw=1.3,
            )  # fmt: skip
        label = f"{name}, ECE {error:.3f}"
        upper.plot([], [], color=colour, marker=marker, ls=dashes, ms=5, label=label)
        left = edges + k * width + 0.08 / N_BINS
        lower.bar(left, curve.count, width, align="edge", color=colour)
        lowest = min(lowest, float(edges[curve.count > 0].min()))
    if has_few:
        upper.plot([], [], "o", mfc="w", mec=INK, ms=5, label=f"fewer than {FEW_FRAMES} frames")
    upper.set(xlim=(lowest - 0.01, 1.01), ylim=(-0.03, 1.03))
    upper.set_ylabel("share correct (Unassigned is wrong)")
    lower.set(yscale="log", ylabel="frames", xlabel="largest probability over the lanes")
    lower.yaxis.set_major_formatter("{x:,.0f}")
    lower.yaxis.set_minor_locator(NullLocator())
    figure.legend(loc="outside lower center", ncols=2)
    return figure
