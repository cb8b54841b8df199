"""The verb `reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from egolane_pgm.paper import Reproduction, Runs, load_published, parse_runs, reproduce_run
from egolane_pgm.recordings import catalog
from egolane_pgm.tools.progress import bar
from egolane_pgm.verbs.given import Option, Progress, StrPath, path_of
from egolane_pgm.views.tables import Table, confusion_table, page, reproduction_rows

EXAMPLES = ("egolane reproduce --runs 1-5", "egolane reproduce --format latex > table.tex")


def reproduce(
    *,
    runs: Annotated[Runs, Option("TEXT")] = "1-10",
    parameters: Literal["recovered", "published"] = "recovered",
    matrices: bool = False,
    if_available: bool = False,
    out: Annotated[StrPath | None, Option("DIR")] = None,
    progress: Progress = None,
) -> Reproduction | None:
    """Repeat the paper's ten runs and compare with the 20 published tables.

    - runs: e.g. 1-5,7.
    - parameters: recovered (by a search; run 5 from the authors' code), or as printed (truncated).
    - matrices: print every confusion matrix too.
    - if_available: without the recordings: say how to get them, and end well.
    - out: keep a result directory per run.
    - progress: whether a bar shows how far it is; None for in a terminal.

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
    return Reproduction(done, parameters, matrices)


def text(done: Reproduction | None, style: str, wide: bool) -> str:
    """The output of the command."""
    if done is None:
        return ""
    document = done.document
    parts: list[str | Table] = [Table(*reproduction_rows(document, load_published()), labels=2)]
    if done.matrices:
        parts += [
            confusion_table(entry[kind]["confusion"], f"run {entry['run']}, {kind}")
            for entry in document["runs"]
            for kind in ("detector", "model")
        ]
    parts.append(
        f"{done.summary}: cells of the published matrices that differ (parameters:"
        f" {done.parameters}; in-sample, as in the paper)"
    )
    return page(parts, style, wide)


def _have_recordings() -> bool:
    """Whether the paper's recordings are there. If not, print where they were looked for and how to
    get them."""
    files, folders = catalog.list_files(), catalog.data_folders()
    if all(file.path.is_file() for file in files):
        return True
    places, size = " and ".join(map(str, folders)), sum(file.size for file in files) / 1e6
    print(f"The paper's recordings (rle/*.bag) are not there; looked in {places}.")
    print(
        f"To get them: `egolane data fetch` ({size:.0f} MB), or set EGOLANE_DATA to the folder that"
        " has rle/."
    )
    return False
