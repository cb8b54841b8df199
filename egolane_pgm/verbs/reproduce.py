"""The verb `reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pandas as pd

from egolane_pgm.paper import Reproduction, Runs, parse_runs, reproduce_run
from egolane_pgm.tools.options import Option, StrPath
from egolane_pgm.tools.progress import bar
from egolane_pgm.views.tables import page, table

EXAMPLES = ("egolane reproduce --runs 1-5", "egolane reproduce --format latex > table.tex")


def reproduce(
    *,
    runs: Annotated[Runs, Option("TEXT")] = "1-10",
    parameters: Literal["recovered", "published"] = "recovered",
    out: Annotated[StrPath | None, Option("DIR")] = None,
) -> Reproduction:
    """Repeat the paper's ten runs and compare with the 20 published tables.

    - runs: e.g. 1-5,7.
    - parameters: recovered (by a search; run 5 from the authors' code), or as printed (truncated).
    - out: folder for a result directory per run.

    Returns a `Reproduction`; iterating gives the `Result` of each run. Raises InputError for a run
    that the paper does not have, and if a recording is missing.

    >>> import egolane_pgm as ego
    >>> ego.reproduce(runs=[3, 4])  # doctest: +SKIP
    Reproduction(runs 3, 4: 0 of 31084 classified frames off; recovered, in-sample)
    >>> ego.reproduce(runs=[1, 11])
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: run 11: the paper has runs 1 to 10
    """
    done = []
    for number in bar(parse_runs(runs), desc="runs", unit="run"):
        done.append(reproduce_run(number, parameters))
        if out is not None:
            done[-1].run.save(Path(out) / done[-1].run.name)
    return Reproduction(done, parameters)


def text(done: Reproduction, style: str) -> str:
    """The output of the command: accuracy, F1 and log-loss, with the paper's in parentheses."""
    scores = done.table()
    shown = pd.DataFrame({"off": scores["frames_off"]})
    for key, name in {"accuracy": "accuracy", "f1": "F1", "log_loss": "log-loss"}.items():
        pairs = zip(scores[key], scores[f"{key}_in_paper"], strict=True)
        shown[f"{name} (paper)"] = [f"{ours:.4f} ({theirs:.2f})" for ours, theirs in pairs]
    last = (
        f"{done.summary}: cells of the published matrices that differ (parameters:"
        f" {done.parameters}; in-sample, as in the paper)"
    )
    return page([table(scores if style == "csv" else shown), last], style)
