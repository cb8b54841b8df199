"""Figures of a study: how it went, which parameters matter, and which the data do not pin down.

History, importances, slices and pairs are Optuna's; flatness and the held-out marks are ours.

Scores are in-sample, those of the frames that were searched on, except where a figure says
otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import optuna
import optuna.visualization.matplotlib as plots
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from egolane_pgm.tools.files import make_directory
from egolane_pgm.types import BoolArray, InputError
from egolane_pgm.views import study_trials as numbers
from egolane_pgm.views.answers import DETECTOR_COLOUR, FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.study_trials import TOLERANCE, Searched, Trials
from egolane_pgm.views.style import FORMATS, axes_at, new_figure, put_title, write_figure

#: Parameters whose pairs are drawn.
PAIRED = 3

#: Slices show the trials above this quantile: bad ones would squeeze the good ones together.
SHOWN_FROM = 0.05

#: The markers of a row stand above each other, so that none hides another.
_OFFSET = {"|": 0.0, "s": -0.15, "o": 0.15}
_PALE = "#9ecae1"


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
    drawn = figures_of(trials)
    with numbers.quiet():
        return [write_figure(make, folder / f"{name}.{style}") for name, make in drawn.items()]


def figures_of(trials: Trials) -> dict[str, Callable[[], Figure]]:
    """The figures of a study by name, each as a function that makes it."""
    importance = numbers.importances(trials)
    drawn: dict[str, Callable[[], Figure]] = {
        "history": lambda: history_figure(trials),
        "slices": lambda: slices_figure(trials),
        "flatness": lambda: flatness_figure(trials),
    }
    if importance:
        drawn["importances"] = lambda: importances_figure(trials)
        if len(importance) > 1:
            drawn["pairs"] = lambda: pairs_figure(trials, list(importance)[:PAIRED])
    return drawn


def history_figure(trials: Trials) -> Figure:
    """Draw the score of each trial, the best so far and, where there is one, the held-out score."""
    ax = plots.plot_optimization_history(numbers.study_of(trials), target_name=_score(trials))
    if np.isfinite(trials.held_out):
        ax.axhline(
            trials.held_out, color=DETECTOR_COLOUR, linewidth=1.4, linestyle=(0, (4, 2)),
            label=f"held out: {trials.held_out:.3f}",
        )  # fmt: skip
        ax.legend()
    shown = [trials.score[trials.best], np.quantile(trials.gain, SHOWN_FROM) * _sign(trials)]
    _limit(ax, [v for v in (*shown, trials.held_out) if np.isfinite(v)])
    n = len(trials.score)
    return _titled(ax, f"{trials.name}: {_score(trials)} of {n:,} trials, in-sample", (9, 4))


def importances_figure(trials: Trials) -> Figure:
    """Draw what good scores depend on: bars, most important first."""
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    ax = plots.plot_param_importances(numbers.study_of(trials), evaluator)
    ax.set_xlabel("share of what sets the best tenth of the trials apart (PED-ANOVA)")
    title = f"{trials.name}: what good {_score(trials)} depends on (in-sample)"
    return _titled(ax, title, (7, 1.2 + 0.3 * len(trials.searched)))


def slices_figure(trials: Trials) -> Figure:
    """Draw the score against each parameter, the later a trial the darker."""
    axes = plots.plot_slice(numbers.study_of(trials), target_name=_score(trials))
    # The worst trials would squeeze the good ones together.
    bottom = np.quantile(trials.gain, SHOWN_FROM) * _sign(trials)
    first = np.asarray(axes).flat[0]
    _limit(first, [trials.score[trials.best], bottom])
    title = f"{trials.name}: {_score(trials)} against each parameter (in-sample)"
    return _titled(first, title, (2.6 * len(trials.searched) + 1, 3.4))


def pairs_figure(trials: Trials, keys: list[str]) -> Figure:
    """Draw the score over the ranges of two parameters, for all pairs of `keys`."""
    axes = plots.plot_contour(numbers.study_of(trials), keys, target_name=_score(trials))
    title = f"{trials.name}: {_score(trials)} over two parameters (in-sample)"
    side = 3.2 * len(keys)
    return _titled(np.asarray(axes).flat[0], title, (side + 1, side))


def _titled(ax: Axes, title: str, size: tuple[float, float]) -> Figure:
    """The figure of Optuna's axes, with a title and a size of ours."""
    figure = ax.figure
    assert isinstance(figure, Figure)
    if len(figure.axes) == 1:
        ax.set_title("", loc="left")
        ax.set_title("")
    figure.suptitle(title)
    figure.set_size_inches(*size)
    # Matplotlib cannot constrain a single plot with a colour bar.
    figure.set_layout_engine("tight" if len(figure.axes) == 2 else "constrained")
    # Optuna draws with pyplot, which would keep the figure.
    plt.close(figure)
    return figure


def _sign(trials: Trials) -> int:
    return 1 if trials.is_maximised else -1


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


def _limit(ax: Axes, values: list[float]) -> None:
    """Show from the smallest to the largest of these, with a margin."""
    low, high = float(min(values)), float(max(values))
    margin = 0.06 * (high - low) or 0.01
    ax.set_ylim(low - margin, high + margin)


def _score(trials: Trials) -> str:
    return trials.objective.replace("_", " ")
