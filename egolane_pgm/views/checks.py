"""Predictive checks of a result, as a figure and as text."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from egolane_pgm.checking import INTERVAL
from egolane_pgm.result import Result
from egolane_pgm.views.frames import title_of
from egolane_pgm.views.style import DETECTOR_COLOUR as ORANGE
from egolane_pgm.views.style import FAINT, INK, new_figure
from egolane_pgm.views.style import MODEL_COLOUR as BLUE
from egolane_pgm.views.tables import Table, cell, page, table

#: The three values of a statistic: colour and marker.
_SOURCES = {"posterior": (BLUE, "o"), "model": (ORANGE, "s"), "truth": (INK, "D")}


def check_text(result: Result, found: pd.DataFrame, calibration: pd.DataFrame) -> str:
    """The predictive checks of a result as a table, and the worst prediction of each node.

    - found, calibration: as `check` and `prediction_calibration` return them.
    """
    parts: list[str | Table] = [f"{title_of(result)}: does the model look like the data?"]
    for name, value in found["truth"].dropna().items():
        parts.append(f"ground truth: {value:.0f} {name}")
    if impossible := result.scores.get("impossible_frames"):
        parts.append(f"the model does not allow {impossible} frame(s); their evidence is ignored")
    shown = found.drop(columns=["truth", "probability"]).rename_axis("statistic")
    digits = {name: _decimals(value) for name, value in shown.max(axis=1).items()}
    parts.append(table(shown.assign(p=found["probability"].map("{:.2f}".format)), digits))
    parts.append(
        f"posterior: paths drawn given the evidence, model: drives drawn without evidence, with"
        f" {INTERVAL[1] - INTERVAL[0]:g} % intervals; p: probability of a drive of the model at"
        " least as far out as the posterior, on either side"
    )
    for node, rows in calibration.groupby("node", sort=False):
        often = rows[rows["count"] >= 0.01 * rows["count"].sum()]
        worst = often.loc[(often["comes"] - often["predicted"]).abs().idxmax()]
        parts.append(
            f"{node}, one frame ahead: values predicted with {worst['predicted']:.2f} come in"
            f" {worst['comes']:.2f} of {worst['count']:,.0f} predictions (the largest gap)"
        )
    return page(parts)


def _decimals(value: float) -> int:
    return 0 if value >= 100 else 1 if value >= 10 else 2


def check_figure(found: pd.DataFrame, calibration: pd.DataFrame, title: str) -> Figure:
    """Draw each statistic by truth, posterior and model, and the calibration one frame ahead.

    - found, calibration: as in `check_text`.
    """
    n_rows = max(3, len(found))
    interval = f"statistics with {INTERVAL[1] - INTERVAL[0]:g} % intervals of the draws"
    figure = new_figure(9.2, 1.2 + 1.05 * n_rows, f"{title}: {interval}")
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    grid = halves[0].add_gridspec(n_rows, 1)
    for k, (name, row) in enumerate(found.iterrows()):
        ax = halves[0].add_subplot(grid[k, 0])
        shown = [source for source in _SOURCES if row[source] == row[source]]
        for y, source in enumerate(shown):
            (colour, marker) = _SOURCES[source]
            value = row[source]
            ax.plot([value], [y], marker, color=colour, ms=6)
            if source != "truth":
                ax.hlines(y, row[f"{source}_low"], row[f"{source}_high"], colour, lw=2)
            place: dict[str, Any] = {"xytext": (0, 5), "textcoords": "offset points"}
            ax.annotate(cell(value, _decimals(value)), (value, y), ha="center", **place)
        ax.set_yticks(range(len(shown)), shown)
        ax.set(ylim=(len(shown) - 0.5, -0.8), title=name)
        ax.margins(x=0.1)
        ax.xaxis.set_major_locator(MaxNLocator(6))
        ax.tick_params(axis="y", length=0)
        ax.spines[["top", "right", "left"]].set_visible(False)
        ax.grid(axis="y", visible=False)
    ax = halves[1].subplots()
    most = max([1, *calibration["count"]])
    ax.plot([0, 1], [0, 1], color=FAINT, lw=1.2, zorder=1)
    nodes = calibration.groupby("node", sort=False)
    for (node, rows), (colour, marker) in zip(nodes, cycle(_SOURCES.values()), strict=False):
        x = rows["predicted"]
        y = rows["comes"]
        area = 10 + 190 * rows["count"] / most
        ax.plot(x, y, color=colour, lw=0.7)
        ax.scatter(x, y, area, colour, marker=marker, alpha=0.75, lw=0, zorder=3)
        ax.plot([], [], marker, color=colour, ls="", label=node)
    ax.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    ax.set(title="Calibration one frame ahead", xlabel="predicted probability of a value")
    ax.set_ylabel("share of the frames in which it comes")
    sizes = f"area: number of predictions, at most {most:,}"
    sizes = "no node is observed alone" if calibration.empty else sizes
    entries = ax.get_legend_handles_labels()
    halves[1].legend(*entries, loc="outside lower center", ncols=4, title=sizes)
    return figure
