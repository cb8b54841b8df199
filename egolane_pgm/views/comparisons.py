"""The table of a comparison of results."""

from __future__ import annotations

import pandas as pd

from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.views.tables import LOG_EVIDENCE, TUNED_ON_SHORT, Table, page, table

#: The scores of a comparison that are printed; a wide table and CSV have all.
_PRINTED = ("accuracy", "f1", "log_loss", "log_evidence")

LEGEND = (
    "Means over the recordings, with 95 % intervals (block bootstrap); differences to the first"
    " row, with paired intervals. Frames of untrusted labels are left out."
)


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
