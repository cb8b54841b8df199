"""Figures of a study: how it went, which parameters matter, and which the data do not pin down.

Scores are in-sample, those of the frames that were searched on, except where a figure says
otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.files import make_directory
from egolane_pgm.report import study_trials as numbers
from egolane_pgm.report.study_trials import TOLERANCE, Searched, Trials
from egolane_pgm.report.style import (
    DETECTOR_COLOUR,
    FAINT,
    FORMATS,
    INK,
    MODEL_COLOUR,
    axes_at,
    new_figure,
    put_title,
    write_figure,
)
from egolane_pgm.types import BoolArray, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Parameters whose pairs are drawn.
PAIRED = 4

#: Slices show the trials above this quantile: bad ones would squeeze the good ones together.
SHOWN_FROM = 0.05

_GRID = "#ececec"

#: The markers of a row stand above each other, so that none hides another.
_OFFSET = {"|": 0.0, "s": -0.15, "o": 0.15}
_PALE, _DOTS = "#9ecae1", {"rasterized": True, "linewidths": 0}


def draw_study(
    directory: str | Path, target: str | Path | None = None, style: str = "png"
) -> list[Path]:
    """Draw history, importances, slices, pairs and flatness of a study.

    directory: as `egolane tune` leaves it. target: default `figures/` in it. style: png, pdf or
    svg. Importances and pairs are left out where there are too few trials, or parameters, for
    them. Returns the files written. Raises InputError for a directory without a finished study or
    without a finished trial, an unknown style, and a file that cannot be written.
    """
    if f".{style}" not in FORMATS:
        raise InputError(f"{style}: a figure is {', '.join(f[1:] for f in FORMATS)}")
    trials = numbers.read_trials(directory)
    folder = Path(target) if target is not None else Path(directory) / "figures"
    make_directory(folder)
    importance = numbers.importances(trials)
    drawn: dict[str, Callable[[], Figure]] = {
        "history": lambda: history_figure(trials),
        "slices": lambda: slices_figure(trials),
        "flatness": lambda: flatness_figure(trials),
    }
    if importance:
        drawn["importances"] = lambda: importances_figure(trials, importance)
        if len(importance) > 1:
            drawn["pairs"] = lambda: pairs_figure(trials, list(importance)[:PAIRED])
    return [write_figure(make, folder / f"{name}.{style}") for name, make in drawn.items()]


def history_figure(trials: Trials) -> Figure:
    """The score of each trial, the best so far and, where there is one, the held-out score."""
    figure = new_figure(7.2, 3.7)
    put_title(figure, f"{trials.name}: {_score(trials)} of {len(trials.score):,} trials, in-sample")
    ax = axes_at(figure, 0.75, 0.62, 6.25, 2.55)
    best = numbers.best_so_far(trials)
    ax.scatter(trials.number, trials.score, s=6, color=_PALE, label="trial", **_DOTS)  # type: ignore[arg-type]
    # From the first trial's score onwards, level to the end.
    ax.step(
        trials.number, best, where="post", color=MODEL_COLOUR, linewidth=1.6,
        label=f"best so far (in-sample): {best[-1]:.3f}",
    )  # fmt: skip
    shown = [best[-1], np.quantile(trials.gain, SHOWN_FROM) * (1 if trials.is_maximised else -1)]
    if np.isfinite(trials.held_out):
        ax.axhline(
            trials.held_out, color=DETECTOR_COLOUR, linewidth=1.4, linestyle=(0, (4, 2)),
            label=f"held out: {trials.held_out:.3f}",
        )  # fmt: skip
        shown.append(trials.held_out)
    _limit(ax, shown)
    ax.set_xlim(-0.01 * trials.number[-1] - 0.5, 1.01 * trials.number[-1] + 0.5)
    ax.set_xlabel("trial", fontsize=9)
    ax.set_ylabel(_score(trials), fontsize=9)
    _plain(ax)
    _legend_above(ax, 3)
    return figure


def importances_figure(trials: Trials, importance: dict[str, float]) -> Figure:
    """Bars, most important first."""
    n = len(importance)
    figure = new_figure(5.6, 0.95 + 0.27 * n)
    put_title(figure, f"{trials.name}: what good {_score(trials)} depends on (in-sample)")
    ax = axes_at(figure, 1.15, 0.45, 4.2, 0.27 * n)
    keys, shares = list(importance), list(importance.values())
    ax.barh(range(n), shares, height=0.62, color=MODEL_COLOUR)
    for row, share in enumerate(shares):
        ax.text(share, row, f" {share:.2f}", va="center", fontsize=8.5, color=INK)
    ax.set_yticks(range(n), keys, fontsize=9)
    ax.set_ylim(n - 0.5, -0.5)
    ax.set_xlim(0, 1.14 * max(shares))
    _plain(ax, "x")
    ax.tick_params(axis="y", length=0, labelsize=9)
    ax.set_xlabel("share of what sets the best tenth of the trials apart (PED-ANOVA)", fontsize=8.5)
    return figure


def slices_figure(trials: Trials) -> Figure:
    """The score against each parameter, with the best score per bin and the best trial."""
    columns = min(4, len(trials.searched))
    rows = -(-len(trials.searched) // columns)
    wide, high, gap, line = 2.0, 1.65, 0.16, 0.62
    figure = new_figure(0.75 + columns * (wide + gap), 0.75 + rows * (high + line))
    put_title(figure, f"{trials.name}: {_score(trials)} against each parameter (in-sample)")
    bottom = np.quantile(trials.gain, SHOWN_FROM) * (1 if trials.is_maximised else -1)
    for k, searched in enumerate(trials.searched):
        row, column = divmod(k, columns)
        ax = axes_at(figure, 0.65 + column * (wide + gap), 0.7 + row * (high + line), wide, high)
        x = trials.values[searched.key]
        # The latest trials on top: an adaptive search narrows down to where they are.
        dots = ax.scatter(x, trials.score, c=trials.number, cmap=_late(), s=5, **_DOTS)  # type: ignore[arg-type]
        edges, best = numbers.best_per_bin(trials, searched.key)
        ax.stairs(best, edges, baseline=None, color=INK, linewidth=1.1, label="best per bin")
        ax.plot(
            [x[trials.best]], [trials.score[trials.best]], marker="*", markersize=11,
            color=DETECTOR_COLOUR, markeredgecolor="white", linestyle="none", zorder=4,
            label="best trial", clip_on=False,
        )  # fmt: skip
        _limit(ax, [trials.score[trials.best], bottom])
        _range_axis(ax, searched, "x")
        ax.set_xlabel(searched.key, fontsize=9, labelpad=2)
        _plain(ax)
        if column:
            ax.tick_params(labelleft=False)
        else:
            ax.set_ylabel(_score(trials), fontsize=9)
        if k == 0:
            dots.set_label("trial, the later the darker (the worst 5 % are not shown)")
            handles = ax.get_legend_handles_labels()
            figure.legend(
                *handles, loc="upper left", ncols=3, fontsize=8.5, frameon=False,
                bbox_to_anchor=(0.0, 1 - 0.28 / figure.get_size_inches()[1]),
            )  # fmt: skip
    return figure


def pairs_figure(trials: Trials, keys: list[str]) -> Figure:
    """The best score in each cell of two parameters' ranges, for all pairs of `keys`."""
    pairs = list(combinations(keys, 2))
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    side, across, down = 1.9, 0.72, 0.58
    width = columns * (side + across) + 0.95
    figure = new_figure(max(width, 4.0), 0.45 + rows * (side + down))
    put_title(figure, f"{trials.name}: best {_score(trials)} of two parameters (in-sample)")
    searched = {s.key: s for s in trials.searched}
    best = trials.score[trials.best]
    grids = [numbers.best_per_cell(trials, x, y) for x, y in pairs]
    # Cells with one unlucky trial must not take up the colours of the good ones.
    worst = np.nanquantile(
        np.concatenate([grid[2].ravel() for grid in grids]), 0.25 if trials.is_maximised else 0.75
    )
    low, high = sorted((float(worst), float(best)))
    for k, ((x, y), (edges_x, edges_y, grid)) in enumerate(zip(pairs, grids, strict=True)):
        row, column = divmod(k, columns)
        ax = axes_at(
            figure, 0.62 + column * (side + across), 0.45 + row * (side + down), side, side
        )
        mesh = ax.pcolormesh(
            edges_x, edges_y, np.ma.masked_invalid(grid), vmin=low, vmax=high, rasterized=True,
            cmap="cividis" if trials.is_maximised else "cividis_r",
        )  # fmt: skip
        ax.plot(
            [trials.values[x][trials.best]], [trials.values[y][trials.best]], marker="*",
            markersize=12, color=DETECTOR_COLOUR, markeredgecolor="white", linestyle="none",
            clip_on=False, zorder=4,
        )  # fmt: skip
        if x in trials.reference and y in trials.reference:
            ax.plot(
                [trials.reference[x]], [trials.reference[y]], marker="s", markersize=7.5,
                markerfacecolor="white", markeredgecolor=INK, linestyle="none",
            )  # fmt: skip
        for key, axis in ((x, "x"), (y, "y")):
            _range_axis(ax, searched[key], axis)
        ax.set_xlabel(x, fontsize=9, labelpad=2)
        ax.set_ylabel(y, fontsize=9, labelpad=2)
        ax.tick_params(labelsize=8)
    bar = axes_at(figure, width - 0.82, 0.45, 0.14, rows * (side + down) - down)
    colours = figure.colorbar(mesh, cax=bar, extend="min" if trials.is_maximised else "max")
    colours.ax.tick_params(labelsize=8)
    colours.ax.set_title("best", fontsize=8.5, pad=10)
    note = "star: the best trial" + (
        f"; square: {trials.reference_name}" if trials.reference else ""
    )
    figure.text(
        0.12 / figure.get_size_inches()[0], 0.06 / figure.get_size_inches()[1],
        f"{note}; white: never tried", fontsize=8.5, color=INK,
    )  # fmt: skip
    return figure


def flatness_figure(trials: Trials, tolerance: float = TOLERANCE) -> Figure:
    """Which values of each parameter do as well as the best, on the range that was searched; the
    best pinned down first."""
    flat = numbers.flat_ranges(trials, tolerance)
    good = numbers.as_good(trials, tolerance)
    rows = sorted(trials.searched, key=lambda s: flat[s.key].share)
    step, n = 0.42, len(rows)
    figure = new_figure(8.8, 1.3 + step * n)
    put_title(
        figure,
        f"{trials.name}: values within {tolerance:g} of the best {_score(trials)} (in-sample,"
        f" {int(good.sum()):,} of {len(good):,} trials)",
    )
    ax = axes_at(figure, 1.75, 0.85, 4.3, step * n)
    for row, s in enumerate(rows):
        here = flat[s.key]
        ax.plot([0, 1], [row, row], color=FAINT, linewidth=0.8, zorder=0)
        ends = s.share(np.array([here.low, here.high]))
        half = 0.5 / (s.high - s.low + 1) if s.is_integer else 0.0
        if s.choices:
            for cell in np.unique(trials.values[s.key][good]):
                at = float(s.share(np.array([cell]))[0])
                ax.barh(row, 2 * half, left=at - half, height=0.5, color=_PALE, zorder=1)
        else:
            # A range that is too narrow to see is drawn as a hair.
            length = max(float(ends[1] - ends[0]) + 2 * half, 0.004)
            ax.barh(row, length, left=ends[0] - half, height=0.5, color=_PALE, zorder=1)
        for k, point in enumerate(trials.nested):
            _mark(
                ax,
                s,
                point,
                row,
                "|",
                INK,
                "found without a part of the frames (held-out studies)" if k == 0 else None,
            )
        _mark(ax, s, trials.reference, row, "s", DETECTOR_COLOUR, trials.reference_name)
        best = {s.key: float(trials.values[s.key][trials.best])}
        _mark(ax, s, best, row, "o", MODEL_COLOUR, "ours")
        ax.text(-0.02, row, s.label(s.low), fontsize=8, ha="right", va="center", color=INK)
        ax.text(1.02, row, s.label(s.high), fontsize=8, ha="left", va="center", color=INK)
        ax.text(
            1.14, row, f"{_span(s, here, trials, good)}  ({_percent(here.share)})",
            fontsize=8.5, va="center", color=INK,
        )  # fmt: skip
    ax.text(1.14, -0.75, "as good (share of range)", fontsize=8.5, va="center", color=INK)
    ax.set_yticks(range(n), [s.key for s in rows], fontsize=9)
    ax.tick_params(axis="y", length=0, pad=38)
    ax.set_xticks([])
    ax.set_xlim(-0.005, 1.005)
    ax.set_ylim(n - 0.5, -0.5)
    for spine in ax.spines.values():
        spine.set_visible(False)
    handles, names = ax.get_legend_handles_labels()
    unique = dict(zip(names, handles, strict=True))
    from matplotlib.patches import Patch

    unique = {"as good as the best": Patch(color=_PALE), **unique}
    figure.legend(
        unique.values(), unique.keys(), loc="upper left", ncols=len(unique), fontsize=8.5,
        bbox_to_anchor=(0.0, 1 - 0.3 / figure.get_size_inches()[1]), frameon=False,
    )  # fmt: skip
    note = (
        "A wide bar: the data do not pin the parameter down. The search sees part of what is as"
        " good: bars can only be too short."
    )
    across, down = figure.get_size_inches()
    figure.text(0.12 / across, 0.14 / down, note, fontsize=8.5, color=INK)
    return figure


def _mark(
    ax: Axes, s: Searched, point: object, row: int, marker: str, colour: str, label: str | None
) -> None:
    assert isinstance(point, dict)
    if s.key not in point:
        return
    at = float(s.share(np.array([point[s.key]]))[0])
    if not 0 <= at <= 1:
        return
    size = 17 if marker == "|" else 6.5
    ax.plot(
        [at], [row + _OFFSET[marker]], marker=marker, markersize=size, color=colour,
        linestyle="none", clip_on=False, markeredgecolor=colour if marker == "|" else "white",
        markeredgewidth=1.4 if marker == "|" else 0.7, label=label,
        zorder=2 if marker == "|" else 3,
    )  # fmt: skip


def _span(s: Searched, flat: numbers.Flat, trials: Trials, good: BoolArray) -> str:
    if s.choices:
        return ", ".join(s.label(v) for v in np.unique(trials.values[s.key][good]))
    return (
        s.label(flat.low)
        if flat.low == flat.high
        else f"{s.label(flat.low)} to {s.label(flat.high)}"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "<1 %"


def _range_axis(ax: Axes, s: Searched, axis: str) -> None:
    edges = s.edges(2)
    (ax.set_xlim if axis == "x" else ax.set_ylim)(edges[0], edges[-1])
    which = ax.xaxis if axis == "x" else ax.yaxis
    if s.choices:
        which.set_ticks(range(len(s.choices)), list(s.choices))
    elif s.is_integer:
        from matplotlib.ticker import MaxNLocator

        which.set_major_locator(MaxNLocator(6, integer=True))


def _limit(ax: Axes, values: list[float]) -> None:
    """Show from the smallest to the largest of these, with a margin."""
    low, high = float(min(values)), float(max(values))
    margin = 0.06 * (high - low) or 0.01
    ax.set_ylim(low - margin, high + margin)


def _late() -> object:
    """Pale to dark blue."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("late", ["#d6e6f4", "#5fa5d6", "#00355c"])


def _score(trials: Trials) -> str:
    return trials.objective.replace("_", " ")


def _plain(ax: Axes, grid: str = "both") -> None:
    ax.tick_params(labelsize=8.5)
    ax.grid(axis=grid, color=_GRID, linewidth=0.6)  # type: ignore[arg-type]
    ax.set_axisbelow(True)


def _legend_above(ax: Axes, columns: int) -> None:
    ax.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, fontsize=8.5, frameon=False,
        borderaxespad=0.2,
    )  # fmt: skip
