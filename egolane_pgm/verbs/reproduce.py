"""The verb `reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pandas as pd

from egolane_pgm.paper import Reproduction, Runs, parse_runs, reproduce_run
from egolane_pgm.recordings import catalog
from egolane_pgm.tools.progress import bar
from egolane_pgm.verbs.options import Option, Progress, StrPath, path_of
from egolane_pgm.views.tables import page, table

EXAMPLES = ("egolane reproduce --runs 1-5", "egolane reproduce --format latex > table.tex")


def reproduce(
    *,
    runs: Annotated[Runs, Option("TEXT")] = "1-10",
    parameters: Literal["recovered", "published"] = "recovered",
    if_available: bool = False,
    out: Annotated[StrPath | None, Option("DIR")] = None,
    progress: Progress = None,
) -> Reproduction | None:
    """Repeat the paper's ten runs and compare with the 20 published tables.

    - runs: e.g. 1-5,7.
    - parameters: recovered (by a search; run 5 from the authors' code), or as printed (truncated).
    - if_available: without the recordings, print how to get them and succeed.
    - out: folder for a result directory per run.
    - progress: whether to show a bar; by default in a terminal only.

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
    numbers = parse_runs(runs)
    if if_available and not _have_recordings():
        return None
    done = []
    for number in bar(numbers, progress, desc="runs", unit="run"):
        done.append(reproduce_run(number, parameters))
        if out is not None:
            done[-1].run.save(Path(path_of(out, "out")) / done[-1].run.name)
    return Reproduction(done, parameters)


def text(done: Reproduction | None, style: str, wide: bool) -> str:
    """The output of the command: accuracy, F1 and log-loss, with the paper's in parentheses."""
    if done is None:
        return ""
    scores = done.table()
    shown = pd.DataFrame({"off": scores["frames_off"]})
    for key, name in {"accuracy": "accuracy", "f1": "F1", "log_loss": "log-loss"}.items():
        pairs = zip(scores[key], scores[f"{key}_in_paper"], strict=True)
        shown[f"{name} (paper)"] = [f"{ours:.4f} ({theirs:.2f})" for ours, theirs in pairs]
    last = (
        f"{done.summary}: cells of the published matrices that differ (parameters:"
        f" {done.parameters}; in-sample, as in the paper)"
    )
    return page([table(scores if style == "csv" else shown), last], style, wide)


def _have_recordings() -> bool:
    """Whether the paper's recordings are there; if not, print how to get them."""
    files, folders = catalog.list_files(), catalog.data_folders()
    if all(file.path.is_file() for file in files):
        return True
    places, size = " and ".join(map(str, folders)), sum(file.size for file in files) / 1e6
    print(f"The paper's recordings (rle/*.bag) are not in {places}.")
    print(
        f"To get them: `egolane data fetch` ({size:.0f} MB), or set EGOLANE_DATA to the folder that"
        " has rle/."
    )
    return False
