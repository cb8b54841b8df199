"""The figure of a fleet: accuracy by tag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from egolane_pgm.fleet import pooled
from egolane_pgm.types import InputError
from egolane_pgm.views.answers import FAINT, MODEL_COLOUR
from egolane_pgm.views.style import ANSWER_STYLE, axes_at, new_figure, put_title


def fleet_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Accuracy with its interval over drives, of all drives and of those with each tag.

    - rows: of summary.parquet. Raises InputError where no drive has scores.
    """
    found = [each for each in pooled(rows) if each.accuracy is not None]
    if not found:
        raise InputError("no drive of the fleet has scores, so there is nothing to draw")
    names = [f"{each.tag} {each.value}".strip() or "all drives" for each in found]
    left = 0.4 + 0.085 * max(map(len, names)) + 0.5
    height = 0.32 * len(found) + 0.2
    figure = new_figure(left + 4.2, 0.5 + height + 0.9)
    put_title(figure, "Accuracy of all scored frames of the drives", size=10)
    ax = axes_at(figure, left, 0.5, 4.0, height)
    for k, each in enumerate(found):
        if each.interval is not None:
            ax.plot(each.interval, [k, k], color=MODEL_COLOUR, linewidth=2)
        for answer, accuracy in (("Detector only", each.detector), ("Model", each.accuracy)):
            colour, marker, _ = ANSWER_STYLE[answer]
            if accuracy is not None:
                label = answer if k == 0 else None
                ax.plot(accuracy, k, marker, color=colour, label=label, linestyle="none")
    ax.set_yticks(
        range(len(found)), [f"{name} ({e.scored})" for name, e in zip(names, found, strict=True)]
    )
    ax.set_ylim(len(found) - 0.5, -0.5)
    ax.grid(axis="x", color=FAINT, linewidth=0.5)
    ax.set_xlabel("accuracy; lines: 95 %, whole drives drawn; (number of drives)", fontsize=8)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.45 / height), ncol=2, frameon=False)
    return figure
