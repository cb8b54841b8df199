"""Figures of a board: accuracy with intervals and sure-but-wrong frames, and calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from egolane_pgm.views.answers import FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.benchmark_tables import Place
from egolane_pgm.views.style import axes_at, new_figure

#: By track and title: the scores of the recordings of an entry on a track.
OnTracks = Mapping[str, Mapping[str, Sequence[Mapping[str, Any]]]]

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")

#: Bins of fewer frames are left out of a calibration curve.
_FEW_FRAMES = 300


def places_figure(
    places: Mapping[str, Mapping[str, Place | None]], on: OnTracks, titles: Sequence[str]
) -> Figure:
    """Draws of each track the accuracy of the entries, with 95 % intervals, and how many of all
    frames they are sure of and wrong.

    - places: by track and title. titles: of the entries, the first one at the top.
    """
    wide, left, row = 1.9, 3.3, 0.2
    tall = row * len(titles)
    figure = new_figure(left + wide * len(places) + 0.15, 2 * tall + 1.6)
    at = {title: k for k, title in enumerate(titles)}
    for k, (track, entries) in enumerate(places.items()):
        upper = axes_at(figure, left + k * wide, 0.4, wide - 0.15, tall)
        lower = axes_at(figure, left + k * wide, tall + 1.05, wide - 0.15, tall)
        for title, place in entries.items():
            if place is None:
                continue
            (accuracy, interval, _), y, rows = place, at[title], on[track][title]
            wrong = sum(r["sure"] - r["sure_right"] for r in rows) / sum(r["scored"] for r in rows)
            if interval is not None:
                upper.plot(interval, [y, y], color=MODEL_COLOUR, linewidth=1.2)
            upper.plot([accuracy], [y], "o", color=MODEL_COLOUR, markersize=4)
            lower.barh(y, 100 * wrong, color="#d55e00", height=0.7)
        upper.set_title(track, fontsize=9, color=INK)
        upper.set_xlim(0, 1.02)
        upper.set_xticks([0, 0.5, 1])
        upper.set_xlabel("balanced accuracy", fontsize=8)
        lower.set_xlabel("sure but wrong, % of frames", fontsize=8)
        for ax in (upper, lower):
            ax.set_ylim(len(titles) - 0.5, -0.5)
            ax.set_yticks(range(len(titles)), titles if k == 0 else [], fontsize=7.5)
            ax.tick_params(axis="x", labelsize=7.5)
            ax.grid(color="#ececec", linewidth=0.6)
            ax.set_axisbelow(True)
    return figure


def calibration_figure(on: OnTracks, titles: Sequence[str]) -> Figure:
    """Draws of each track how often entries are right, by how probable they say it is."""
    across, side = 4, 2.3
    rows = -(-len(on) // across)
    figure = new_figure(across * (side + 0.45) + 0.3, rows * (side + 0.7) + 0.75)
    for k, (track, entries) in enumerate(on.items()):
        left, top = 0.5 + k % across * (side + 0.4), 0.95 + k // across * (side + 0.7)
        ax = axes_at(figure, left, top, side, side)
        ax.plot([0, 1], [0, 1], color=FAINT, linewidth=1)
        for colour, title in zip(_COLOURS, filter(entries.get, titles), strict=False):
            sums = np.sum([row["reliability"] for row in entries[title]], axis=0)
            count, sure, right = sums[:, sums[0] >= _FEW_FRAMES]
            ax.plot(
                sure / count, right / count, "o-",
                color=colour, markersize=3, linewidth=1.2, label=title,
            )  # fmt: skip
        ax.set_xlim(0.15, 1.02)
        _finish(figure, ax, track, is_first=k == 0)
    figure.text(0.5, 0.01, "largest probability (upwards: share right)", fontsize=8, ha="center")
    return figure


def lanes_figure(on: OnTracks, titles: Sequence[str]) -> Figure:
    """Draws the accuracy of entries against the number of lanes, for each kind of tracks
    with more than one number."""
    found: dict[str, dict[str, dict[int, list[tuple[float, float]]]]] = {}
    for track, entries in on.items():
        for title in filter(entries.get, titles):
            by_lanes = found.setdefault(track.split(",")[0], {}).setdefault(title, {})
            for row in entries[title]:
                counts = (row["recalls"], row["lanes_driven"])
                by_lanes.setdefault(row["n_lanes"], []).append(counts)
    several = {
        kind: entries
        for kind, entries in found.items()
        if len({n for each in entries.values() for n in each}) > 1
    }
    side = 2.6
    figure = new_figure(max(2, len(several)) * (side + 0.5) + 0.3, side + 1.4)
    for k, (kind, of_kind) in enumerate(several.items()):
        ax = axes_at(figure, 0.55 + k * (side + 0.45), 0.9, side, side)
        for colour, (title, by_lanes) in zip(_COLOURS, of_kind.items(), strict=False):
            n_lanes = sorted(by_lanes)
            values = [np.divide(*np.sum(by_lanes[n], axis=0)) for n in n_lanes]
            ax.plot(n_lanes, values, "o-", color=colour, markersize=4, linewidth=1.3, label=title)
        ax.set_xticks(n_lanes)
        ax.set_xlabel("lanes (upwards: balanced accuracy)", fontsize=8)
        _finish(figure, ax, kind, is_first=k == 0)
    return figure


def _finish(figure: Figure, ax: Axes, title: str, is_first: bool) -> None:
    ax.set_title(title, fontsize=9, color=INK)
    ax.set_ylim(-0.02, 1.02)
    ax.tick_params(labelsize=7.5)
    ax.grid(color="#ececec", linewidth=0.6)
    if is_first:
        handles, labels = ax.get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", ncols=3, fontsize=7.5, frameon=False)
