"""Figures of a study: how it went, its profile over each parameter, and which parameters matter.

They are Optuna's; the mark of the held-out score is ours.

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

from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.types import InputError
from egolane_pgm.views import study_trials as numbers
from egolane_pgm.views.answers import DETECTOR_COLOUR
from egolane_pgm.views.study_trials import Trials
from egolane_pgm.views.style import FORMATS, write_figures

#: Only trials above this quantile are shown: bad ones would squeeze the good ones together.
SHOWN_FROM = 0.05


def draw_study(
    directory: str | Path, target: str | Path | None = None, style: str = "png"
) -> list[Path]:
    """Draw history, profile and importances of a study.

    directory: as `egolane tune` leaves it. target: default `figures/` in it. style: png, pdf or
    svg. Importances are left out where there are too few trials for them. Returns the files
    written. Raises InputError for a directory without a finished study or without a finished
    trial, an unknown style, and a file that cannot be written.
    """
    if f".{style}" not in FORMATS:
        raise InputError(f"{style}: a figure is {', '.join(f[1:] for f in FORMATS)}")
    trials = numbers.read_trials(directory)
    folder = Path(target) if target is not None else Path(directory) / "figures"
    with numbers.quiet():
        return write_figures(figures_of(trials), folder, style)


def figures_of(trials: Trials) -> dict[str, Callable[[], Figure]]:
    """The figures of a study by name, each as a function that makes it."""
    drawn: dict[str, Callable[[], Figure]] = {
        "history": lambda: history_figure(trials),
        "profile": lambda: profile_figure(trials),
    }
    if numbers.importances(trials):
        drawn["importances"] = lambda: importances_figure(trials)
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


def profile_figure(trials: Trials) -> Figure:
    """Draw the score against each parameter, the later a trial the darker."""
    axes = plots.plot_slice(trials.study, target_name=_score(trials))
    first = np.asarray(axes).flat[0]
    _limit(first, trials)
    title = f"{trials.name}: {_score(trials)} against each parameter (in-sample)"
    return _titled(first, title, (2.6 * len(trials.space) + 1, 3.4))


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
