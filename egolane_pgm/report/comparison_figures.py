"""The figure of a comparison: the accuracy of several experiments on several recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from egolane_pgm.report.comparison_tables import experiment_names, trusted_or_all
from egolane_pgm.report.style import FAINT, INK, axes_at, new_figure, put_title, write_figure
from egolane_pgm.types import InputError

#: Okabe and Ito's colours, and a marker each, so that the figure can be read without colour.
SERIES = (
    ("#d55e00", "s"),
    ("#0072b2", "o"),
    ("#009e73", "^"),
    ("#cc79a7", "D"),
    ("#e69f00", "v"),
    ("#56b4e9", "P"),
    ("#000000", "X"),
)

#: The accuracies that the axis names, and the largest one that is drawn at its own place.
_TICKS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9997)
_LARGEST = 0.9997

_COLUMN, _LEFT, _RIGHT, _HEAD, _FOOT, _HEIGHT = 0.16, 0.9, 0.15, 0.4, 0.45, 3.4


def draw_comparison(document: Mapping[str, Any], path: str | Path) -> Path:
    """Draws the accuracy of each experiment on each recording, with 95 % block-bootstrap intervals
    if the drive is long enough for them.

    document: as `egolane compare --json` writes it. Frames whose labels are not trusted are left
    out. The axis is logarithmic in the share of errors and ends at 0.9997; larger accuracies are
    drawn there. Filled markers are held out or not tuned, hollow ones in-sample.

    Raises InputError for a document without experiments, and as `write_figure` does.
    """
    return write_figure(lambda: comparison_figure(document), path)


def comparison_figure(document: Mapping[str, Any]) -> Figure:
    """The figure of `draw_comparison`."""
    recordings = document["recordings"]
    names = experiment_names(document)
    if not names:
        raise InputError("comparison: no experiment to draw")
    wide = max(3.2, len(recordings) * (len(names) + 1.5) * _COLUMN)
    columns = max(1, int(wide / 1.6))
    rows = -(-(len(names) + 1) // columns)
    titles = [str(recording["title"]) for recording in recordings]
    is_long = len(titles) > 1 and max(map(len, titles)) > 10
    foot = _FOOT + 0.2 * rows + 0.6 * is_long
    figure = new_figure(_LEFT + wide + _RIGHT, _HEAD + _HEIGHT + foot)
    put_title(figure, "Accuracy on frames that are not crossing, with 95 % intervals", size=10)
    ax = axes_at(figure, _LEFT, _HEAD, wide, _HEIGHT)
    step = 1 / (len(names) + 1.5)
    is_hollow = False
    for k, name in enumerate(names):
        colour, marker = SERIES[k % len(SERIES)]
        for r, recording in enumerate(recordings):
            for entry in recording["experiments"]:
                if entry["name"] != name:
                    continue
                scores = trusted_or_all(entry["scores"])
                hollow = entry["tuned_on"] in ("same_frames", "unknown")
                is_hollow |= hollow
                x = r + (k - (len(names) - 1) / 2) * step
                interval = scores["intervals"]["accuracy"]
                if interval is not None:
                    ax.plot(
                        [x, x],
                        [_height(v) for v in interval],
                        color=colour,
                        linewidth=1.6,
                        zorder=2,
                    )
                height = _height(scores["accuracy"])
                ax.plot(
                    [x], [height], linestyle="none", marker=marker, markersize=5,
                    markeredgecolor=colour, markerfacecolor="white" if hollow else colour,
                    zorder=3,
                )  # fmt: skip
        ax.plot([], [], color=colour, marker=marker, markersize=5, linewidth=1.6, label=name)
    if is_hollow:
        ax.plot(
            [], [], linestyle="none", marker="o", markersize=5, markeredgecolor=INK,
            markerfacecolor="white", label="hollow: in-sample",
        )  # fmt: skip
    for r in range(1, len(recordings)):
        ax.axvline(r - 0.5, color=FAINT, linewidth=0.6, zorder=0)
    ax.set_xlim(-0.5, len(recordings) - 0.5)
    ax.set_xticks(range(len(titles)), [_short(t) for t in titles], fontsize=8.5)
    if is_long:
        ax.tick_params(axis="x", labelrotation=20)
    ax.tick_params(axis="x", length=0)
    ax.tick_params(axis="y", labelsize=8.5)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high)
    named = [v for v in _TICKS if low <= _height(v) <= high]
    ax.set_yticks([_height(v) for v in named], [_tick(v) for v in named])
    ax.set_ylabel("accuracy (errors on a log scale)", fontsize=9)
    ax.grid(axis="y", color="#ececec", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.07 if not is_long else -0.2),
        ncols=columns, fontsize=8.5, frameon=False,
    )  # fmt: skip
    return figure


def _height(accuracy: float) -> float:
    """The place of an accuracy on the axis: the logarithm of the share of errors, on which 0.99 and
    0.999 differ as much as 0.9 and 0.99."""
    return -math.log10(1 - min(accuracy, _LARGEST))


def _tick(accuracy: float) -> str:
    return f"{accuracy:g}" if accuracy < _LARGEST else f"{accuracy:g}+"


def _short(title: str) -> str:
    return title if len(title) <= 24 else f"{title[:23]}…"
