"""Error-dispersion charts: how many lanes the answers are off (the paper's Figures
`fig:graph-all-italy`, `fig:graph-all-spain` and `fig:comparisonBV-run3`).

A bar divides the annotated, non-crossing frames into right, off by 1, 2, ... lanes, and Unassigned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from egolane_pgm.results import Result
from egolane_pgm.types import InputError, IntArray
from egolane_pgm.views.answers import (
    FAINT,
    INK,
    RIGHT_COLOUR,
    UNASSIGNED_COLOUR,
    percent,
    title_of,
    title_with_frames,
)
from egolane_pgm.views.heatmaps import confusions
from egolane_pgm.views.style import (
    axes_at,
    new_figure,
    off_colours,
    put_title,
    text_colour,
)

# The layout, in inches; and the smallest share that is labelled.
_WIDTH, _RIGHT, _EDGE, _NAMES = 9.0, 0.25, 0.12, 1.05
_BAR, _BAR_GAP, _GROUP_GAP, _HEAD, _FOOT = 0.24, 0.04, 0.2, 0.64, 0.5
_LABELLED = 0.04
_LEGEND_COLUMNS = 6


class Group(NamedTuple):
    """Bars that belong together, with a title and, in smaller type, a note.

    - bars: by their names, (n + 1,) frames that are right, off by 1 to n - 1 lanes, Unassigned.
    """

    title: str
    note: str
    bars: Mapping[str, IntArray]


def dispersion(matrix: IntArray) -> IntArray:
    """The counts of a bar, (n + 1,), from a confusion matrix (n + 1, n)."""
    n = matrix.shape[1]
    off = np.abs(np.arange(n)[:, None] - np.arange(n))
    right_or_off = np.bincount(off.ravel(), weights=matrix[:-1].ravel(), minlength=n)
    return np.append(right_or_off, matrix[-1].sum()).astype(np.int64)


def dispersions(result: Result) -> dict[str, IntArray]:
    """The bars of "Detector only" (if there is a tentative vector) and "Model".

    Raises InputError if no frame is annotated.
    """
    return {name: dispersion(matrix) for name, matrix in confusions(result).items()}


def dispersion_figure(results: Sequence[Result]) -> Figure:
    """Draws the error dispersion of several results in one figure, detector and model side by side.

    Raises InputError for a result without ground truth, naming it.
    """
    groups = []
    for result in results:
        bars = dispersions(result)
        note = f"{result.n_lanes} lanes, {int(bars['Model'].sum()):,} frames"
        groups.append(Group(title_of(result), note, bars))
    return _bar_sheet(groups, "Error dispersion", max(r.n_lanes for r in results))


def bonus_ablation_figure(with_bonus: Result, without_bonus: Result) -> Figure:
    """Draws the effect of the bonus value: one recording with it and without it (the paper's Figure
    `fig:comparisonBV-run3`).

    Raises InputError as `dispersion_figure` does, and if the two results differ in frames, ground
    truth or tentative vector.
    """
    _check_ablation(with_bonus, without_bonus)
    value = with_bonus.config["parameters"]["bonus_value"]
    found, lost = dispersions(with_bonus), dispersions(without_bonus)
    groups = []
    for name, counts in found.items():
        change = 100 * (lost[name][0] - counts[0]) / counts.sum()
        pair = {f"BV = {value:g}": counts, "no BV": lost[name]}
        groups.append(Group(name, f"right without BV: {change:+.1f} points", pair))
    title = f"Bonus value (BV), {title_with_frames(with_bonus).replace(': ', ', ')}"
    others = _other_differences(with_bonus, without_bonus)
    title += f"; also different: {', '.join(others)}" if others else "; all else the same"
    return _bar_sheet(groups, title, with_bonus.n_lanes)


def _check_ablation(with_bonus: Result, without_bonus: Result) -> None:
    for name in ("frame_id", "true_lane", "is_crossing"):
        if not np.array_equal(getattr(with_bonus, name), getattr(without_bonus, name)):
            raise InputError(
                f"{with_bonus.directory} and {without_bonus.directory}: {name} differs; a"
                " comparison needs the same recording and ground truth"
            )
    if (with_bonus.tentative is None) != (without_bonus.tentative is None):
        lacks = with_bonus if with_bonus.tentative is None else without_bonus
        raise InputError(f"{lacks.directory}: has no tentative vector, the other result has one")


def _other_differences(a: Result, b: Result) -> list[str]:
    """The other differences between two experiments; a fair ablation has none."""
    left, right = a.config["parameters"], b.config["parameters"]
    names = [k for k in sorted({*left, *right} - {"bonus_value"}) if left.get(k) != right.get(k)]
    keys = ("evidence", "graph", "filter", "evidence_reading")
    return names + [k for k in keys if a.config.get(k) != b.config.get(k)]


def _bar_sheet(groups: Sequence[Group], title: str, n_lanes: int) -> Figure:
    group_height = [len(g.bars) * (_BAR + _BAR_GAP) - _BAR_GAP for g in groups]
    height = sum(group_height) + _GROUP_GAP * len(groups)
    left = _left_margin(groups)
    head = _HEAD + 0.2 * (n_lanes // _LEGEND_COLUMNS)
    figure = new_figure(_WIDTH, head + height + _FOOT)
    put_title(figure, title, _EDGE)
    ax = axes_at(figure, left, head, _WIDTH - left - _RIGHT, height)
    ax.set_xlim(0, 1)
    ax.set_ylim(height, 0)
    outer = (_EDGE - left) / (_WIDTH - left - _RIGHT)
    at, ticks = _GROUP_GAP / 2, []
    for group, tall in zip(groups, group_height, strict=True):
        size = min(8.5, 8.5 * (left - _NAMES - _EDGE) / (0.068 * len(group.title)))
        ax.text(
            outer, at + tall / 2 - 0.015, group.title, va="bottom", fontsize=size, color=INK,
            parse_math=False,
        )  # fmt: skip
        ax.text(outer, at + tall / 2 + 0.03, group.note, va="top", fontsize=7.5, color=INK)
        for k, (name, counts) in enumerate(group.bars.items()):
            top = at + k * (_BAR + _BAR_GAP)
            ticks.append((top + _BAR / 2, name))
            _draw_bar(ax, counts, top)
        at += tall + _GROUP_GAP
        if group is not groups[-1]:
            between = [at - _GROUP_GAP / 2] * 2
            ax.plot([outer, 1], between, color=FAINT, linewidth=0.6, clip_on=False)
    ax.set_yticks([y for y, _ in ticks], [label for _, label in ticks], fontsize=8.5)
    ax.tick_params(axis="y", length=0)
    ax.set_xticks(np.linspace(0, 1, 6), [f"{v} %" for v in range(0, 101, 20)], fontsize=8.5)
    ax.set_xlabel("share of the annotated frames that are not crossing", fontsize=9)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    _draw_legend(figure, n_lanes, left)
    return figure


def _left_margin(groups: Sequence[Group]) -> float:
    """The width for the names of groups and bars, inches; even longer names get smaller type."""
    widest = max(max(0.068 * len(g.title), 0.06 * len(g.note)) for g in groups)
    return min(_EDGE + widest + _NAMES, 4.0)


def categories(n_lanes: int) -> dict[str, str]:
    """Right, off by 1 to n - 1 lanes, Unassigned: their names and colours."""
    off = [f"off by {k} lane{'s' if k > 1 else ''}" for k in range(1, n_lanes)]
    colours = dict(zip(off, off_colours(n_lanes - 1), strict=True))
    return {"right": RIGHT_COLOUR, **colours, "Unassigned": UNASSIGNED_COLOUR}


def _draw_bar(ax: Axes, counts: IntArray, top: float) -> None:
    left = 0.0
    named = categories(len(counts) - 1).items()
    for share, (name, colour) in zip(counts / counts.sum(), named, strict=True):
        ax.barh(
            top, share, _BAR, left=left, align="edge", color=colour, edgecolor="white",
            linewidth=0.5, label=name,
        )  # fmt: skip
        if share >= _LABELLED:
            ax.text(
                left + share / 2, top + _BAR / 2 + 0.008, percent(share), fontsize=8,
                ha="center", va="center", color=text_colour(colour),
            )  # fmt: skip
        left += share


def _draw_legend(figure: Figure, n_lanes: int, left: float) -> None:
    # The names for more than four lanes need the whole width.
    start = left if n_lanes <= 4 and left < 3.2 else _EDGE
    named = categories(n_lanes).items()
    figure.legend(
        handles=[Patch(facecolor=colour, label=name) for name, colour in named],
        loc="upper left",
        bbox_to_anchor=(start / _WIDTH, 1 - 0.42 / figure.get_figheight()),
        ncols=min(n_lanes + 1, _LEGEND_COLUMNS),
        frameon=False,
        fontsize=8.5,
        borderaxespad=0,
        handlelength=1.2,
        columnspacing=1.4,
    )
