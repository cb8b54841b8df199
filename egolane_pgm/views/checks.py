"""Predictive checks and sensitivity of a result, as figures and as text."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from egolane_pgm.checking import INTERVAL, TRUE_CHANGES
from egolane_pgm.result import Result
from egolane_pgm.views.answers import title_of
from egolane_pgm.views.style import (
    CROSSING,
    DETECTOR_COLOUR,
    FAINT,
    INK,
    MODEL_COLOUR,
    new_figure,
)
from egolane_pgm.views.tables import Table, cell, page, table

#: The three values of a statistic: colour and marker.
_SOURCES = {"truth": (INK, "D"), "posterior": (MODEL_COLOUR, "o"), "model": (DETECTOR_COLOUR, "s")}

#: Colour and marker of the observed nodes (Okabe and Ito).
_NODES = [(MODEL_COLOUR, "o"), (DETECTOR_COLOUR, "s"), ("#009e73", "^"), (INK, "D")]

#: The scores of a sensitivity: factor and unit of the axis.
_SCORES = {
    "log_loss": (1, "nats per frame; less is better"),
    "accuracy": (100, "percentage points"),
    "log_evidence": (1, "nats, sum over the frames"),
}
_JUDGES = (
    "log evidence judges how well the model describes the lines; on the paper's recordings it"
    " ranked models nearly opposite to held-out lanes"
)

#: Colour and offset of the bars of a number moved down or up.
_SIDES = {"down": (DETECTOR_COLOUR, -0.19), "up": (MODEL_COLOUR, 0.19)}

_SHARE = f"{INTERVAL[1] - INTERVAL[0]:g} %"


def check_text(result: Result, found: pd.DataFrame, calibration: pd.DataFrame) -> str:
    """The predictive checks of a result as a table, and the worst prediction of each node.

    - found: as `checking.check` returns it, with its usual statistics.
    - calibration: as `checking.prediction_calibration` returns it.
    """
    parts: list[str | Table] = [f"{title_of(result)}: does the model look like the data?"]
    true = found["truth"].get(TRUE_CHANGES, np.nan)
    if true == true:
        parts.append(f"ground truth: {true:.0f} {TRUE_CHANGES}")
    if impossible := result.scores.get("impossible_frames"):
        parts.append(f"the model does not allow {impossible} frame(s); their evidence is ignored")
    shown = found.drop(columns="truth").rename(columns={"probability": "p"})
    largest = shown.drop(columns="p").max(axis=1)
    digits = {name: _decimals(value) for name, value in largest.items()}
    shown["p"] = [f"{p:.2f}" if p == p else "-" for p in shown["p"]]
    parts.append(table(shown.rename_axis("statistic"), digits))
    parts.append(
        f"posterior: paths drawn given the evidence, model: drives drawn without it, each with the"
        f" {_SHARE} interval of the draws; p: probability of a drive of the model at least as far"
        " out as the posterior, on either side"
    )
    lines = []
    for node, rows in calibration.groupby("node", sort=False):
        often = rows[rows["count"] >= 0.01 * rows["count"].sum()]
        worst = often.loc[(often["comes"] - often["predicted"]).abs().idxmax()]
        lines.append(
            f"{node}, one frame ahead: what is predicted with {worst['predicted']:.2f} comes in"
            f" {worst['comes']:.2f} of {worst['count']:,.0f} predictions (the largest gap)"
        )
    return page([*parts, "\n".join(lines)])


def _decimals(value: float) -> int:
    return 0 if value >= 100 else 1 if value >= 10 else 2


def check_figure(found: pd.DataFrame, calibration: pd.DataFrame, title: str = "") -> Figure:
    """Draw each statistic by truth, posterior and model, and the calibration one frame ahead.

    - found, calibration: as in `check_text`.
    """
    title = f"{title}: statistics with {_SHARE} intervals of the draws" if title else ""
    n_rows = max(3, len(found))
    figure = new_figure(9.2, 1.2 + 1.05 * n_rows, title)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    left, right = halves
    axes = left.subplots(n_rows, 1)
    for ax, (name, row) in zip(axes, found.iterrows(), strict=False):
        _draw_statistic(ax, str(name), row)
    for ax in axes[len(found) :]:
        ax.remove()
    ax = right.subplots()
    ax.plot([0, 1], [0, 1], color=FAINT, lw=1.2, zorder=1)
    most = max([1, *calibration["count"]])
    for k, (node, rows) in enumerate(calibration.groupby("node", sort=False)):
        colour, marker = _NODES[k % len(_NODES)]
        x, y = rows["predicted"], rows["comes"]
        ax.plot(x, y, color=colour, lw=0.7)
        area = 10 + 190 * rows["count"] / most
        ax.scatter(x, y, area, colour, marker=marker, alpha=0.75, lw=0, zorder=3)
        ax.plot([], [], marker, color=colour, ls="", label=node)
    ax.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    ax.set_title("Calibration one frame ahead")
    ax.set_xlabel("predicted probability of a value")
    ax.set_ylabel("share of the frames in which it comes")
    if calibration.empty:
        ax.text(0.5, 0.1, "no node is observed alone", ha="center")
    else:
        sizes = f"area: number of predictions, at most {most:,}"
        right.legend(loc="outside lower center", ncols=4, title=sizes)
    return figure


def _draw_statistic(ax: Axes, name: str, row: pd.Series) -> None:
    shown = [source for source in _SOURCES if row[source] == row[source]]
    for y, source in enumerate(shown):
        colour, marker = _SOURCES[source]
        value = row[source]
        if f"{source}_low" in row:
            ax.hlines(y, row[f"{source}_low"], row[f"{source}_high"], colour, lw=2)
        ax.plot([value], [y], marker, color=colour, ms=6)
        ax.annotate(
            cell(value, _decimals(value)),
            (value, y),
            (0, 5),
            textcoords="offset points",
            ha="center",
        )
    ax.set_yticks(range(len(shown)), shown)
    ax.set(ylim=(len(shown) - 0.5, -0.8))
    ax.set_title(name)
    ax.margins(x=0.1)
    ax.xaxis.set_major_locator(MaxNLocator(6))
    ax.tick_params(axis="y", length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.grid(axis="y", visible=False)


def sensitivity_figure(found: pd.DataFrame, title: str = "") -> Figure:
    """Draw how far each score moves with each number, the most important number at the top.

    - found: as `studies.sensitivity` returns it.
    """
    panels = [name for name in _SCORES if found[f"{name}_down"].notna().any()]
    moved = found[[f"{panels[0]}_{side}" for side in _SIDES]].abs().max(axis=1).fillna(0)
    found = found.loc[moved.sort_values(ascending=False, kind="stable").index]
    y, title = np.arange(len(found)), f"{title}: each number moved alone" if title else ""
    figure = new_figure(9.2, 1.7 + 0.34 * len(found), title)
    axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for ax, name in zip(axes, panels, strict=True):
        factor, label = _SCORES[name]
        for side, (colour, offset) in _SIDES.items():
            change = factor * found[f"{name}_{side}"]
            ax.barh(y + offset, change, 0.36, color=colour, label=f"number moved {side}")
        for k in np.flatnonzero(found[[f"{name}_down", f"{name}_up"]].isna().all(axis=1)):
            ax.text(0, k, " not comparable", fontsize=7, va="center", color=CROSSING)
        ax.axvline(0, color=INK, lw=0.8)
        ax.set(title=f"change of {name.replace('_', ' ')}", xlabel=label)
        ax.xaxis.set_major_locator(MaxNLocator(4))
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
    axes[0].set_yticks(
        y,
        [
            f"{name}   {row.value_low:.4g} < {row.value:.4g} < {row.value_high:.4g}"
            for name, row in found.iterrows()
        ],
    )
    axes[0].set_ylim(len(found) - 0.5, -0.5)
    look: Any = {"loc": "outside lower left", "ncols": 2, "alignment": "left"}
    figure.legend(*axes[0].get_legend_handles_labels(), title=_JUDGES, **look)
    return figure
