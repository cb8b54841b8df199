"""The public data set of the paper: addresses, checksums, download, folders."""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path
from typing import NamedTuple

from egolane_pgm.tools.files import file_sha256
from egolane_pgm.types import InputError

#: The folder `bag/` of github trigal/rle at tag SpecialIssueTIV.submission.1 (BSD licence).
COMMIT = "e35b76afbbd579190ea4194446ef02980289880a"
BASE_URL = f"https://raw.githubusercontent.com/trigal/rle/{COMMIT}/bag"


class DataFile(NamedTuple):
    """A public file. size: bytes. name: path below the base address."""

    sha256: str
    size: int
    name: str

    @property
    def path(self) -> Path:
        """The file in the first of `data_folders` that has it, else in the download folder."""
        places = [folder / "rle" / self.name for folder in data_folders()]
        return next((place for place in places if place.is_file()), places[-1])

    @property
    def status(self) -> str:
        """ "present", "missing", or "bad" (wrong checksum)."""
        if not self.path.is_file():
            return "missing"
        return "present" if file_sha256(self.path) == self.sha256 else "bad"


@functools.cache
def list_files() -> tuple[DataFile, ...]:
    """The files of the data set: ten recordings and two ground truths."""
    rows = Path(__file__).with_suffix(".txt").read_text().splitlines()[1:]
    words = [row.split() for row in rows]
    return tuple(DataFile(sha256, int(size), name) for sha256, size, name, *_ in words)


def data_folders() -> list[Path]:
    """The folders to search for the data set: `$EGOLANE_DATA`, then the user's cache folder, which
    is the download folder (`$XDG_CACHE_HOME` is respected)."""
    # A dependency of pooch, which takes long to import.
    from platformdirs import user_cache_dir

    data = os.environ.get("EGOLANE_DATA", "")
    named = [Path(data).expanduser()] if data else []
    return [*named, Path(user_cache_dir("egolane_pgm"))]


def fetch() -> list[str]:
    """Download the files that are missing or bad; return a line for each that fails.

    Content with a wrong checksum never replaces a file. Raises InputError if the server cannot be
    reached.
    """
    import pooch

    # pooch raises its errors.
    import requests

    # pooch would report each step on standard error.
    pooch.get_logger().setLevel("ERROR")
    loader = pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=30)
    problems = []
    for file in list_files():
        if file.status == "present":
            continue
        url = f"{BASE_URL}/{file.name}"
        known = f"sha256:{file.sha256}"
        try:
            pooch.retrieve(url, known, file.name, file.path.parent, downloader=loader)
        except (requests.ConnectionError, requests.Timeout):
            raise InputError(f"{BASE_URL}: no connection; is the network up?") from None
        except (OSError, ValueError) as error:
            why = " ".join(str(error).split())[:160]
            problems.append(f"{url}: not downloaded to {file.path}: {why}")
    return problems
