"""The lateral offsets of a recording's lines over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from egolane_pgm.types import LineLog
from egolane_pgm.views.answers import FAINT, MODEL_COLOUR


def draw_lines(ax: Axes, log: LineLog) -> None:
    """Draw the offsets of the lines over time, in metres, left above."""
    time = np.broadcast_to(log.time_s[:, np.newaxis], log.offset_m.shape)
    for chosen, colour, label in (
        (~log.is_valid, FAINT, "not valid"),
        (log.is_valid & ~log.is_continuous, MODEL_COLOUR, "valid"),
        (log.is_valid & log.is_continuous, "#d55e00", "valid, continuous"),
    ):
        seen = chosen & np.isfinite(log.offset_m)
        if seen.any():
            ax.plot(time[seen], log.offset_m[seen], ".", markersize=2.5, color=colour, label=label)
    # Left of the vehicle is above, as lane 1 is in the strips.
    ax.invert_yaxis()
    ax.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
    ax.set_ylabel("offset [m], left above", fontsize=9)
    ax.tick_params(labelsize=8)
    if ax.lines[1:]:
        ax.legend(
            fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), frameon=False, ncols=3,
            markerscale=4, borderaxespad=0.2,
        )  # fmt: skip
