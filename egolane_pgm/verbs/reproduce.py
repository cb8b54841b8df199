"""The verb `reproduce`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from egolane_pgm.drive_table import DriveTable
from egolane_pgm.fleet import numbers_of
from egolane_pgm.paper import Runs, load_published, parse_runs, reproduce_json, reproduce_run
from egolane_pgm.recordings import catalog
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, Progress, StrPath, path_of
from egolane_pgm.views.tables import Table, confusion_table, reproduction_rows

EXAMPLES = ("egolane reproduce --runs 1-5", "egolane reproduce --format latex > table.tex")


def reproduce(
    *,
    runs: Annotated[Runs, Option("TEXT")] = "1-10",
    parameters: Literal["recovered", "published"] = "recovered",
    matrices: bool = False,
    if_available: bool = False,
    out: Annotated[StrPath | None, Option("DIR")] = None,
    progress: Progress = None,
) -> DriveTable | None:
    """The paper's ten runs: ours beside the 20 published tables, and the difference.

    - runs: e.g. 1-5,7.
    - parameters: recovered (by a search; run 5 from the authors' code), or as printed (truncated).
    - matrices: print every confusion matrix too.
    - if_available: without the recordings: offer the download, or say how to get them, and end
      well.
    - out: keep a result directory per run.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns a `DriveTable` with a row per run. Raises InputError for a run that the paper does not
    have, and where a recording is missing.

    >>> import egolane_pgm as ego
    >>> ego.reproduce(runs=[3, 4])  # doctest: +SKIP
    DriveTable(runs 3, 4: 0 of 31084 classified frames off; recovered parameters, in-sample)
    >>> ego.reproduce(runs=[1, 11])
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: run 11: the paper has runs 1 to 10
    """
    numbers = parse_runs(runs)
    if if_available and not _have_recordings():
        return None
    done, found = [], {}
    for number in bar(numbers, progress, desc="runs", unit="run"):
        result = reproduce_run(number, parameters)
        done.append(result)
        found[result.run.name] = result.run
        if out is not None:
            result.run.save(Path(path_of(out, "out")) / result.run.name, figures=False)
    document = reproduce_json(done, parameters)
    entries = document["runs"]
    parts: list[str | Table] = [
        Table(*reproduction_rows(document, load_published()), labels=2, leaves_out=True)
    ]
    if matrices:
        parts += [
            confusion_table(entry[kind]["confusion"], f"run {entry['run']}, {kind}")
            for entry in entries
            for kind in ("detector", "model")
        ]
    classified = sum(2 * int(entry["frames_scored"]) for entry in entries)
    off = document["total_frames_off"]
    parts.append(
        f"{off} of {classified} classified frames differ from the published matrices"
        f" (parameters: {parameters}; in-sample, as in the paper)"
    )
    title = (
        f"runs {', '.join(map(str, numbers))}: {off} of {classified} classified frames off;"
        f" {parameters} parameters, in-sample"
    )
    rows = [
        {"name": name, "error": None, **numbers_of(entry)}
        for name, entry in zip(found, entries, strict=True)
    ]
    return DriveTable(title, rows, parts, document, found)


def _have_recordings() -> bool:
    """Whether the paper's recordings are there. If not, offer to download them, or print where they
    were looked for and how to get them."""
    if _all_found():
        return True
    size = sum(file.size for file in catalog.list_files()) / 1e6
    question = f"Download the paper's recordings ({size:.0f} MB) to {catalog.download_folder()}?"
    if sys.stdin.isatty() and input(f"{question} [y/N]: ").strip().lower() in ("y", "yes"):
        try:
            problems = catalog.problems(catalog.fetch())
        except InputError as error:
            problems = [str(error)]
        for line in problems:
            sys.stderr.write(f"egolane: {line}\n")
        if _all_found():
            return True
    places = " and ".join(map(str, catalog.data_folders()))
    print(f"The paper's recordings (rle/*.bag) are not there; looked in {places}.")
    print(
        f"To get them: `egolane data fetch` ({size:.0f} MB), or set EGOLANE_DATA to the folder that"
        " has rle/."
    )
    return False


def _all_found() -> bool:
    try:
        for file in catalog.list_files():
            catalog.find_file(file.target)
    except InputError:
        return False
    return True
