"""Figures of a board: accuracy with intervals and sure-but-wrong frames, and calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.views.answers import FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.style import axes_at, new_figure

#: What is drawn of an entry on a track: accuracy, its interval, share of sure but wrong frames.
Drawn = tuple[float, tuple[float, float] | None, float]

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")


def places_figure(drawn: Mapping[str, Mapping[str, Drawn]], titles: Sequence[str]) -> Figure:
    """Draws of each track the accuracy of the entries, with 95 % intervals, and how many of all
    frames they are sure of and wrong.

    - drawn: by track and title. titles: of the entries, the first one at the top.
    """
    wide, left, row = 1.9, 3.3, 0.2
    tall = row * len(titles)
    figure = new_figure(left + wide * len(drawn) + 0.15, 2 * tall + 1.6)
    at = {title: k for k, title in enumerate(titles)}
    for k, (track, entries) in enumerate(drawn.items()):
        upper = axes_at(figure, left + k * wide, 0.4, wide - 0.15, tall)
        lower = axes_at(figure, left + k * wide, tall + 1.05, wide - 0.15, tall)
        for title, (accuracy, interval, sure_wrong) in entries.items():
            y = at[title]
            if interval is not None:
                upper.plot(interval, [y, y], color=MODEL_COLOUR, linewidth=1.2)
            upper.plot([accuracy], [y], "o", color=MODEL_COLOUR, markersize=4)
            lower.barh(y, 100 * sure_wrong, color="#d55e00", height=0.7)
        upper.set_title(track, fontsize=9, color=INK)
        upper.set_xlim(0, 1.02)
        upper.set_xlabel("balanced accuracy", fontsize=8)
        lower.set_xlabel("sure but wrong, % of frames", fontsize=8)
        for ax in (upper, lower):
            ax.set_ylim(len(titles) - 0.5, -0.5)
            ax.set_yticks(range(len(titles)), titles if k == 0 else [], fontsize=7.5)
            ax.tick_params(axis="x", labelsize=7.5)
            ax.grid(color="#ececec", linewidth=0.6)
            ax.set_axisbelow(True)
    return figure


def calibration_figure(curves: Mapping[str, Mapping[str, Any]], few: int = 100) -> Figure:
    """Draws of each track how often entries are right, by how probable they say it is.

    - curves: by track and title, per bin the frames, the sum of their largest probability and how
      many are right, (3, B). Bins of fewer than `few` frames are left out.
    """
    across, side = 4, 2.3
    rows = -(-len(curves) // across)
    figure = new_figure(across * (side + 0.45) + 0.3, rows * (side + 0.7) + 0.75)
    for k, (track, entries) in enumerate(curves.items()):
        left, top = 0.5 + k % across * (side + 0.4), 0.95 + k // across * (side + 0.7)
        ax = axes_at(figure, left, top, side, side)
        ax.plot([0, 1], [0, 1], color=FAINT, linewidth=1)
        for colour, (title, (count, sums, right)) in zip(_COLOURS, entries.items(), strict=False):
            kept = np.asarray(count) >= few
            frames = np.asarray(count)[kept]
            ax.plot(
                np.asarray(sums)[kept] / frames, np.asarray(right)[kept] / frames, "o-",
                color=colour, markersize=3, linewidth=1.2, label=title,
            )  # fmt: skip
        ax.set_title(track, fontsize=9, color=INK)
        ax.set_xlim(0.15, 1.02)
        ax.set_ylim(-0.02, 1.02)
        ax.tick_params(labelsize=7.5)
        ax.grid(color="#ececec", linewidth=0.6)
        if k == 0:
            handles, labels = ax.get_legend_handles_labels()
            figure.legend(handles, labels, loc="upper left", ncols=3, fontsize=8, frameon=False)
    figure.text(0.5, 0.01, "largest probability (right of it: share right)", fontsize=8, ha="center")
    return figure
