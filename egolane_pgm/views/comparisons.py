"""The table and the figure of a comparison of results."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.types import InputError
from egolane_pgm.views.style import FAINT, INK, MODEL_COLOUR, new_figure
from egolane_pgm.views.tables import LOG_EVIDENCE, TUNED_ON_SHORT, Table, page, table

#: The scores of a comparison that are printed; a wide table and CSV have all.
_PRINTED = ("accuracy", "f1", "log_loss", "log_evidence")

LEGEND = (
    "Means over the recordings, with 95 % intervals (block bootstrap); differences to the first"
    " row, with paired intervals. Frames of untrusted labels are left out."
)

#: Ticks of the axis; accuracies above the last are drawn there.
_ACCURACIES = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9997)


def comparison_text(found: pd.DataFrame, style: str) -> str:
    """The output of `egolane compare`: a table per score, and one of the lane changes.

    - found: as `comparing.compare` returns it.
    """
    if style == "csv":
        return page([table(found)], style)
    short = [
        ", ".join(TUNED_ON_SHORT.get(each, each) for each in str(cell).split(", "))
        for cell in found["tuned_on"]
    ]
    counts = sorted(set(found["recordings"].astype(str)))
    parts: list[str | Table] = [f"recordings per row: {', '.join(counts)}"]
    names = SCORES if style == "wide" else _PRINTED
    scores = {key: SCORES[key].short_label for key in names if key in found}
    for key, name in scores.items():
        of_score = found[[c for c in found if c == key or c.startswith(f"{key}_")]]
        renamed = of_score.rename(columns=lambda c, key=key, name=name: c.replace(key, name, 1))
        renamed = renamed.assign(tuned_on=short) if key == next(iter(scores)) else renamed
        parts.append(table(renamed, {f"{name}_difference": "+.3f"}))
    if "log_evidence" in found:
        sizes = found.reindex(columns=["free_parameters", "bic"]).rename(columns={"bic": "BIC"})
        parts.append(table(sizes, {"free_parameters": "g", "BIC": 1}))
        parts.append(f"In nats; larger is better. {LOG_EVIDENCE}")
    parts.append(found.attrs.get("log_evidence", ""))
    events = found.filter(regex="^event_").dropna(how="all")
    if len(events.columns) and len(events):
        renamed = events.rename(columns=lambda c: c.removeprefix("event_"))
        renamed = renamed.rename(columns={"delay_s": "median delay, s"})
        parts.append("lane changes, reported within 1 s")
        parts.append(table(renamed, {"false_per_hour": 1, "median delay, s": "+.2f"}))
    return page([*parts, LEGEND], style)


def comparison_figure(found: pd.DataFrame) -> Figure:
    """Draw the accuracy of each row with its interval, on a logit axis.

    Rows with several index levels are grouped by the first; hollow markers are in-sample.
    """
    if "accuracy" not in found:
        raise InputError("out: the figure is of accuracy, which needs ground truth")
    names = [
        ", ".join(map(str, name)) if isinstance(name, tuple) else str(name) for name in found.index
    ]
    is_hollow = found["tuned_on"].str.contains("same_frames|same_drive|unknown").to_numpy(bool)
    y = np.arange(float(len(found)))
    if found.index.nlevels > 1:
        y += 0.5 * pd.factorize(found.index.get_level_values(0))[0]
    columns = found[["accuracy", "accuracy_low", "accuracy_high"]].astype(float)
    value, low, high = columns.to_numpy().T
    figure = new_figure(7, 1.2 + 0.25 * (y[-1] + 1), "Accuracy, with 95 % intervals")
    ax = figure.subplots()
    ax.hlines(y, low, high, MODEL_COLOUR, lw=1.4)
    shown = np.minimum(value, _ACCURACIES[-1])
    highest = np.nanmax([value, high])
    for mask, face in ((~is_hollow, MODEL_COLOUR), (is_hollow, "w")):
        ax.plot(
            shown[mask], y[mask], "o", ms=5.5, color=MODEL_COLOUR, mfc=face, ls="", clip_on=False
        )
    for at in np.flatnonzero(np.diff(y) > 1):
        ax.axhline((y[at] + y[at + 1]) / 2, color=FAINT, lw=0.6)
    ax.set(ylim=(y[-1] + 0.6, -0.6), xlabel="accuracy (logit scale)")
    ax.set_yticks(y, names)
    ax.tick_params(axis="y", length=0)
    ax.set_xscale("logit")
    # From an interval below the data to the first tick above it.
    low_end = max(np.nanmin([value, low]) - 0.03, 0.01)
    ticks = [v for v in _ACCURACIES if low_end <= v]
    ticks = ticks[: int(np.searchsorted(ticks[:-1], highest)) + 1]
    ax.set_xticks(ticks, [f"{v:g}" for v in ticks])
    ax.set_xlim(low_end, ticks[-1])
    ax.xaxis.set_minor_locator(NullLocator())
    if is_hollow.any():
        ax.plot([], [], "o", color=INK, mfc="w", ls="", label="hollow: in-sample")
        figure.legend(loc="outside lower right")
    return figure
