"""The verb `data`."""

from __future__ import annotations

import sys
from typing import Literal

from egolane_pgm.recordings import catalog
from egolane_pgm.types import InputError

EXAMPLES = ("egolane data list", "egolane data fetch")


def data(action: Literal["list", "fetch"]) -> str:
    """List the paper's recordings, or download the missing ones.

    `list` prints the search folders and the state of each file. `fetch` checks every sha256, keeps
    good files, and downloads the others to the last of these folders (`$XDG_CACHE_HOME`).

    Returns the list, or the number of good files. Raises InputError if a file is not good.
    """
    if action == "list":
        folders = [f"looked in: {folder}" for folder in catalog.data_folders()]
        files = [
            f"{file.status:>10}  {file.size / 1e6:6.2f} MB  {catalog.BASE_URL}/{file.name}"
            for file in catalog.list_files()
        ]
        return "\n".join([*folders, *files])
    problems = catalog.fetch()
    n_files = len(catalog.list_files())
    n_good = f"{n_files - len(problems)} of {n_files} files are there and good"
    if problems:
        for line in problems:
            sys.stderr.write(f"egolane: {line}\n")
        raise InputError(n_good)
    return n_good
