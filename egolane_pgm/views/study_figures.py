"""Figures of a study: how it went, which parameters matter, and which the data do not pin down.

History, importances, slices and pairs are Optuna's; flatness and the held-out marks are ours.

Scores are in-sample, those of the frames that were searched on, except where a figure says
otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import optuna
import optuna.visualization.matplotlib as plots
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.types import InputError
from egolane_pgm.views import study_trials as numbers
from egolane_pgm.views.answers import DETECTOR_COLOUR, FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.study_trials import TOLERANCE, Trials
from egolane_pgm.views.style import FORMATS, axes_at, new_figure, put_title, write_figures

#: Parameters whose pairs are drawn.
PAIRED = 3

#: Slices show the trials above this quantile: bad ones would squeeze the good ones together.
SHOWN_FROM = 0.05

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
    with numbers.quiet():
        return write_figures(figures_of(trials), folder, style)


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
    ax = plots.plot_optimization_history(trials.study, target_name=_score(trials))
    held_out = trials.held_out.get("all_frames", {}).get(trials.objective)
    if held_out is not None:
        ax.axhline(
            held_out, color=DETECTOR_COLOUR, linewidth=1.4, linestyle=(0, (4, 2)),
            label=f"held out: {held_out:.3f}",
        )  # fmt: skip
        ax.legend()
    _limit(ax, trials, held_out)
    n = len(trials.study.trials)
    return _titled(ax, f"{trials.name}: {_score(trials)} of {n:,} trials, in-sample", (9, 4))


def importances_figure(trials: Trials) -> Figure:
    """Draw what good scores depend on: bars, most important first."""
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    ax = plots.plot_param_importances(trials.study, evaluator)
    ax.set_xlabel("share of what sets the best tenth of the trials apart (PED-ANOVA)")
    title = f"{trials.name}: what good {_score(trials)} depends on (in-sample)"
    return _titled(ax, title, (7, 1.2 + 0.3 * len(trials.space)))


def slices_figure(trials: Trials) -> Figure:
    """Draw the score against each parameter, the later a trial the darker."""
    axes = plots.plot_slice(trials.study, target_name=_score(trials))
    first = np.asarray(axes).flat[0]
    _limit(first, trials)
    title = f"{trials.name}: {_score(trials)} against each parameter (in-sample)"
    return _titled(first, title, (2.6 * len(trials.space) + 1, 3.4))


def pairs_figure(trials: Trials, keys: list[str]) -> Figure:
    """Draw the score over the ranges of two parameters, for all pairs of `keys`."""
    axes = plots.plot_contour(trials.study, keys, target_name=_score(trials))
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
    figure.suptitle(title, parse_math=False)
    figure.set_size_inches(*size)
    # Matplotlib cannot constrain a single plot with a colour bar.
    figure.set_layout_engine("tight" if len(figure.axes) == 2 else "constrained")
    # Optuna draws with pyplot, which would keep the figure.
    plt.close(figure)
    return figure


def _limit(ax: Axes, trials: Trials, *others: float | None) -> None:
    """Show all but the worst trials, which would squeeze the good ones together, and other scores,
    with a margin."""
    sign = 1 if is_maximised(trials.objective) else -1
    shown = [sign * trials.gain.max(), sign * np.quantile(trials.gain, SHOWN_FROM)]
    shown += [score for score in others if score is not None]
    margin = 0.06 * float(np.ptp(shown)) or 0.01
    ax.set_ylim(min(shown) - margin, max(shown) + margin)


def _score(trials: Trials) -> str:
    return trials.objective.replace("_", " ")


def flatness_figure(trials: Trials) -> Figure:
    """Which values of each parameter do as well as the best, on the range that was searched; the
    best pinned down first. It is what the search has seen: the real range can only be wider."""
    good = numbers.as_good(trials)
    values = {key: sorted({point[key] for point in good}) for key in trials.space}
    bars = {key: _bars(space, values[key]) for key, space in trials.space.items()}
    share = {key: sum(width for _, width in each) for key, each in bars.items()}
    step, n = 0.42, len(bars)
    figure = new_figure(8.8, 1.3 + step * n)
    put_title(
        figure,
        f"{trials.name}: values within {TOLERANCE:g} of the best {_score(trials)} (in-sample,"
        f" {len(good):,} of {len(trials.gain):,} trials)",
    )
    ax = axes_at(figure, 1.75, 0.85, 4.3, step * n)
    nested = [each["point"] for each in trials.held_out.get("studies", ())]
    marks = (
        # The markers of a row stand above each other, so that none hides another.
        (nested, 0.0, "|", INK, "found without a part of the frames (held-out studies)"),
        ([trials.reference], -0.15, "s", DETECTOR_COLOUR, trials.reference_name),
        ([trials.study.best_params], 0.15, "o", MODEL_COLOUR, "ours"),
    )
    text: dict[str, Any] = {"fontsize": 8.5, "va": "center", "color": INK}
    keys = sorted(bars, key=lambda key: share[key])
    for row, key in enumerate(keys):
        space = trials.space[key]
        ax.plot([0, 1], [row, row], color=FAINT, linewidth=0.8, zorder=0)
        for left, width in bars[key]:
            # A range that is too narrow to see is drawn as a hair.
            ax.barh(row, max(width, 0.004), left=left, height=0.5, color=_PALE, zorder=1)
        for points, above, marker, colour, label in marks:
            at = numbers.places(space, [point[key] for point in points if key in point])
            if np.isfinite(at).any():
                is_line = marker == "|"
                ax.plot(
                    at, np.full(len(at), row + above), marker, color=colour, label=label,
                    markersize=17 if is_line else 6.5, clip_on=False,
                    markeredgecolor=colour if is_line else "white",
                    markeredgewidth=1.4 if is_line else 0.7, zorder=2 if is_line else 3,
                )  # fmt: skip
        ends = _ends(space)
        ax.text(-0.02, row, _label(space, ends[0]), **{**text, "fontsize": 8}, ha="right")
        ax.text(1.02, row, _label(space, ends[1]), **{**text, "fontsize": 8})
        seen = [_label(space, value) for value in values[key]]
        if not isinstance(space, CategoricalDistribution):
            seen = [" to ".join(dict.fromkeys([seen[0], seen[-1]]))]
        percent = f"{100 * share[key]:.0f} %" if share[key] >= 0.005 else "<1 %"
        ax.text(1.14, row, f"{', '.join(seen)}  ({percent})", **text)
    ax.text(1.14, -0.75, "as good (share of range)", **text)
    ax.set_yticks(range(n), keys, fontsize=9)
    ax.tick_params(axis="y", length=0, pad=38)
    ax.set(xticks=[], xlim=(-0.005, 1.005), ylim=(n - 0.5, -0.5))
    ax.spines[:].set_visible(False)
    handles, names = ax.get_legend_handles_labels()
    drawn = {"as good as the best": Patch(color=_PALE), **dict(zip(names, handles, strict=True))}
    across, down = figure.get_size_inches()
    figure.legend(
        drawn.values(), drawn.keys(), loc="upper left", ncols=len(drawn), fontsize=8.5,
        bbox_to_anchor=(0.0, 1 - 0.3 / down), frameon=False,
    )  # fmt: skip
    note = (
        "A wide bar: the data do not pin the parameter down. The search sees part of what is as"
        " good: bars can only be too short."
    )
    figure.text(0.12 / across, 0.14 / down, note, fontsize=8.5, color=INK)
    return figure


def _bars(space: BaseDistribution, values: list[Any]) -> list[tuple[float, float]]:
    """The left end and the width of what good values take of the range: choices one by one, numbers
    from the least to the largest."""
    at, cell = numbers.places(space, values), numbers.cell(space)
    if isinstance(space, CategoricalDistribution):
        return [(float(each) - cell / 2, cell) for each in at]
    return [(float(at[0]) - cell / 2, float(at[-1] - at[0]) + cell)]


def _ends(space: BaseDistribution) -> tuple[Any, Any]:
    if isinstance(space, CategoricalDistribution):
        return space.choices[0], space.choices[-1]
    assert isinstance(space, (IntDistribution, FloatDistribution))
    return space.low, space.high


def _label(space: BaseDistribution, value: Any) -> str:
    """A value for people."""
    if not isinstance(space, FloatDistribution):
        return str(value)
    # An open range, (0, 3], begins a hair inside: for people it begins at 0.
    return "0" if abs(value) <= 1e-5 * (space.high - space.low) else f"{value:.3g}"
