"""The paper's recordings: list and check them, download them."""

from __future__ import annotations

import sys

from egolane_pgm.recordings import catalog
from egolane_pgm.types import InputError

EXAMPLES = ("egolane data fetch",)


def list_files() -> str:
    """List the files of the data set, their folder, and whether their checksums are right."""
    folders = [f"looked in: {folder}" for folder in catalog.data_folders()]
    files = [
        f"{file.status:>10}  {file.size / 1e6:6.2f} MB  {catalog.BASE_URL}/{file.name}"
        for file in catalog.list_files()
    ]
    return "\n".join([*folders, *files])


def fetch() -> str:
    """Download what is missing; checks every sha256, keeps good files.

    Files go to the cache folder that `egolane data list` prints last (`$XDG_CACHE_HOME`).

    Returns the number of good files. Raises InputError if a file is not good.
    """
    problems, n_files = catalog.fetch(), len(catalog.list_files())
    n_good = f"{n_files - len(problems)} of {n_files} files are there and good"
    if problems:
        for line in problems:
            sys.stderr.write(f"egolane: {line}\n")
        raise InputError(n_good)
    return n_good


data = {"list": list_files, "fetch": fetch}
