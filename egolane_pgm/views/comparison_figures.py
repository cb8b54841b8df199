"""The figures of a comparison: the accuracy of several experiments on several recordings, and how
that differs from the first one's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from egolane_pgm.types import InputError
from egolane_pgm.views.answers import FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.comparison_tables import entries_of, experiment_names, trusted_or_all
from egolane_pgm.views.style import axes_at, new_figure, put_title, write_figure

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

#: Where fewer than three of these are on the axis, it names every twentieth, or every hundredth.
_FINER = tuple(tuple(k / n for k in range(1, n)) for n in (20, 100))

_COLUMN, _LEFT, _RIGHT, _HEAD, _FOOT, _HEIGHT = 0.16, 0.9, 0.15, 0.4, 0.45, 3.4


def draw_all(document: Mapping[str, Any], folder: Path) -> None:
    """Write accuracy.png, and differences.png of several experiments. Raises InputError as
    `write_figure`."""
    write_figure(lambda: comparison_figure(document), folder / "accuracy.png")
    if _is_different(document):
        write_figure(lambda: differences_figure(document), folder / "differences.png")


def comparison_figure(document: Mapping[str, Any]) -> Figure:
    """Draws the accuracy of each experiment on each recording, with 95 % block-bootstrap intervals
    if the drive is long enough for them.

    document: as `egolane compare --json` writes it. Frames whose labels are not trusted are left
    out. The axis is logarithmic in the share of errors and ends at 0.9997; larger accuracies are
    drawn there. Filled markers are held out or not tuned, hollow ones in-sample.
    """
    recordings = document["recordings"]
    names = experiment_names(document)
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
        colour, marker = _look(k)
        for r, recording in enumerate(recordings):
            entry = next((e for e in recording["experiments"] if e["name"] == name), None)
            if entry is None:
                continue
            scores = trusted_or_all(entry["scores"])
            hollow = entry["tuned_on"] in ("same_frames", "unknown")
            is_hollow |= hollow
            x = r + (k - (len(names) - 1) / 2) * step
            heights = [_height(v) for v in scores["intervals"]["accuracy"] or ()]
            if heights:
                ax.plot([x, x], heights, color=colour, linewidth=1.6, zorder=2)
            ax.plot(
                [x], [_height(scores["accuracy"])], linestyle="none", marker=marker, markersize=5,
                markeredgecolor=colour, markerfacecolor="white" if hollow else colour, zorder=3,
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
    _name_accuracies(ax, low, high)
    ax.set_ylabel("accuracy (errors on a log scale)", fontsize=9)
    ax.grid(axis="y", color="#ececec", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.07 if not is_long else -0.2),
        ncols=columns, fontsize=8.5, frameon=False,
    )  # fmt: skip
    return figure


#: Panels side by side; inches: their width, a row's height, the space between two panels, that
#: above a panel and that below it.
_PANELS, _PANEL, _ROW, _GAP, _ABOVE, _BELOW = 4, 1.7, 0.19, 0.22, 0.3, 0.3


def differences_figure(document: Mapping[str, Any]) -> Figure:
    """Draws the accuracy of each experiment but the first less that of the first, on each recording
    and on all of them, with paired 95 % intervals.

    document: as `egolane compare --json` writes it. Frames whose labels are not trusted are left
    out. A marker is filled where zero is outside the interval; a short drive has no interval.

    Raises InputError where no recording has two experiments.
    """
    names = experiment_names(document)
    if not _is_different(document):
        raise InputError("comparison: a difference needs two experiments on a recording")
    found = {name: _differences(document, name) for name in names[1:]}
    titles, recordings = list(found[names[1]]), document["recordings"]
    values = [v for each in found.values() for bounds in each.values() for v in bounds or ()]
    reach = 1.15 * max(map(abs, values), default=1.0)
    rows, columns = -(-len(found) // _PANELS), min(_PANELS, len(found))
    margin = 0.3 + 0.07 * max(map(len, titles))
    height = _ROW * len(titles) + 0.1
    step = _ABOVE + height + _BELOW
    figure = new_figure(margin + columns * (_PANEL + _GAP) + 0.1, 0.3 + rows * step + 0.2)
    put_title(figure, f"Accuracy less that of {names[0]}, with paired 95 % intervals", size=10)
    for k, (name, differences) in enumerate(found.items()):
        row, column = divmod(k, _PANELS)
        left, top = margin + column * (_PANEL + _GAP), 0.3 + row * step + _ABOVE
        ax = axes_at(figure, left, top, _PANEL, height)
        ax.axvline(0, color=INK, linewidth=0.8, zorder=1)
        for y, found_here in enumerate(differences.values()):
            if found_here is None:
                continue
            value, low, high = found_here
            is_mean = y == len(recordings)
            ax.plot([low, high], [y, y], color=MODEL_COLOUR, linewidth=1.4, zorder=2)
            ax.plot(
                [value], [y], marker="D" if is_mean else "o", markersize=4.5,
                markeredgecolor=MODEL_COLOUR, zorder=3,
                markerfacecolor="white" if low <= 0 <= high else MODEL_COLOUR,
            )  # fmt: skip
        if len(titles) > len(recordings):
            ax.axhline(len(recordings) - 0.5, color=FAINT, linewidth=0.6, zorder=0)
        ax.set_title(name, fontsize=9, loc="left", color=INK)
        ax.set_ylim(len(titles) - 0.5, -0.5)
        ax.set_xlim(-reach, reach)
        ax.locator_params(axis="x", nbins=4)
        ax.set_yticks(range(len(titles)), titles if column == 0 else [""] * len(titles))
        ax.tick_params(labelsize=8, length=2)
        ax.grid(axis="x", color="#ececec", linewidth=0.6)
        ax.set_axisbelow(True)
        if k + _PANELS >= len(found):
            ax.set_xlabel("accuracy difference", fontsize=8.5)
    return figure


def _is_different(document: Mapping[str, Any]) -> bool:
    return any(entry["difference"] for _, entry in entries_of(document))


def _differences(document: Mapping[str, Any], name: str) -> dict[str, tuple[float, ...] | None]:
    """By recording, and for all of them, the difference of the accuracy with its interval."""
    titles = [_short(str(recording["title"])) for recording in document["recordings"]]
    found: dict[str, tuple[float, ...] | None] = dict.fromkeys(titles)
    for title, entry in entries_of(document):
        if entry["name"] == name and entry["difference"] is not None:
            bounds = trusted_or_all(entry["difference"])["accuracy"]
            found[_short(title)] = bounds and tuple(bounds)
    for entry in document["together"]:
        if entry["name"] == name and entry["difference"] is not None:
            bounds = entry["difference"]["accuracy"]
            found[f"all {entry['recordings']}"] = bounds and tuple(bounds)
    return found


def _name_accuracies(ax: Axes, low: float, high: float) -> None:
    """Ticks at accuracies within these heights."""
    seen = [[v for v in some if low <= _height(v) <= high] for some in (_TICKS, *_FINER)]
    named = next((some for some in seen if len(some) > 2), seen[0])
    labels = [f"{v:g}" if v < _LARGEST else f"{v:g}+" for v in named]
    ax.set_yticks([_height(v) for v in named], labels)


def _look(k: int) -> tuple[str, str]:
    """Colour and marker of the k-th series: the eighth has the first one's colour and the second
    one's marker."""
    return SERIES[k % len(SERIES)][0], SERIES[(k + k // len(SERIES)) % len(SERIES)][1]


def _height(accuracy: float) -> float:
    """The place of an accuracy on the axis: the logarithm of the share of errors, on which 0.99 and
    0.999 differ as much as 0.9 and 0.99."""
    return -math.log10(1 - min(accuracy, _LARGEST))


def _short(title: str) -> str:
    return title if len(title) <= 24 else f"{title[:23]}…"
