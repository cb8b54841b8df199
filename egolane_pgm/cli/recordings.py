"""Whether the paper's recordings are there."""

from __future__ import annotations

import sys

import click

from egolane_pgm.recordings import catalog
from egolane_pgm.types import InputError


def have_recordings() -> bool:
    """Whether the paper's recordings are there. If not, offer to download them, or print where they
    were looked for and how to get them."""
    if _all_found():
        return True
    size = sum(file.size for file in catalog.list_files()) / 1e6
    if sys.stdin.isatty() and click.confirm(
        f"Download the paper's recordings ({size:.0f} MB) to {catalog.download_folder()}?"
    ):
        try:
            problems = catalog.problems(catalog.fetch())
        except InputError as error:
            problems = [str(error)]
        for line in problems:
            click.echo(f"egolane: {line}", err=True)
        if _all_found():
            return True
    places = " and ".join(map(str, catalog.data_folders()))
    click.echo(f"The paper's recordings (rle/*.bag) are not there; looked in {places}.")
    click.echo(
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
