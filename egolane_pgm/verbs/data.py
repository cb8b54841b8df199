"""The paper's recordings: list and check them, download them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from egolane_pgm.recordings import catalog
from egolane_pgm.types import InputError
from egolane_pgm.verbs.options import Option

EXAMPLES = ("egolane data fetch",)

Folder = Annotated[str | Path | None, Option("DIRECTORY")]


def list_files() -> str:
    """What the data set consists of, and which files are there and good."""
    looked = [f"looked in: {folder}" for folder in catalog.data_folders()]
    files = [
        f"{outcome.status:>10}  {outcome.file.size / 1e6:6.2f} MB"
        f"  {catalog.BASE_URL}/{outcome.file.name}"
        for outcome in catalog.verify()
    ]
    return "\n".join([*looked, *files])


def fetch(*, folder: Folder = None) -> str:
    """Download what is missing; checks every sha256, keeps good files.

    - folder: where to put them.

    Returns how many files are good. Raises InputError where one is not.
    """
    outcomes = catalog.fetch(folder)
    said = f"{sum(each.ok for each in outcomes)} of {len(outcomes)} files are there and good"
    problems = catalog.problems(outcomes)
    if problems:
        for line in problems:
            sys.stderr.write(f"egolane: {line}\n")
        raise InputError(said)
    return said


data = {"list": list_files, "fetch": fetch}
