"""The public data set of the paper: addresses, checksums, download, folders."""

from __future__ import annotations

import functools
import os
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

from egolane_pgm.tools.files import file_sha256
from egolane_pgm.types import InputError

#: The folder `bag/` of github trigal/rle at tag SpecialIssueTIV.submission.1 (BSD licence).
COMMIT = "e35b76afbbd579190ea4194446ef02980289880a"
BASE_URL = f"https://raw.githubusercontent.com/trigal/rle/{COMMIT}/bag"


@dataclass(frozen=True)
class DataFile:
    """A public file.

    - size: bytes.
    - name: path below the base address.
    """

    sha256: str
    size: int
    name: str

    @property
    def target(self) -> str:
        """Path below the download folder, and below `$EGOLANE_DATA`."""
        return f"rle/{self.name}"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a download or a check of one file.

    - status: "downloaded", "present", "failed", "missing" or "bad" (wrong checksum).
    - problem: one line, "" if the file is there and has the right checksum.
    """

    file: DataFile
    path: Path
    status: str
    problem: str = ""


@functools.cache
def list_files() -> tuple[DataFile, ...]:
    """The files of the data set: ten recordings and two ground truths."""
    rows = Path(__file__).with_suffix(".txt").read_text().splitlines()[1:]
    words = [row.split() for row in rows]
    return tuple(DataFile(sha256, int(size), name) for sha256, size, name, *_ in words)


def data_folders() -> list[Path]:
    """The folders to search for the data set: `$EGOLANE_DATA`, then the user's cache folder, which
    is the download folder (`$XDG_CACHE_HOME` is respected)."""
    from platformdirs import user_cache_dir

    data = os.environ.get("EGOLANE_DATA", "")
    named = [Path(data).expanduser()] if data else []
    return [*named, Path(user_cache_dir("egolane_pgm"))]


def verify() -> list[Outcome]:
    """Check every file of the data set in the first of `data_folders` that has it."""
    outcomes = []
    for file in list_files():
        places = [each / file.target for each in data_folders()]
        path = next((place for place in places if place.is_file()), places[-1])
        if not path.is_file():
            problem = f"{path}: no such file; `egolane data fetch` downloads it"
            outcomes.append(Outcome(file, path, "missing", problem))
        elif file_sha256(path) != file.sha256:
            problem = f"{path}: wrong checksum; `egolane data fetch` downloads it again"
            outcomes.append(Outcome(file, path, "bad", problem))
        else:
            outcomes.append(Outcome(file, path, "present"))
    return outcomes


def fetch() -> list[Outcome]:
    """Download the files that are missing or bad; one Outcome per file.

    Content with a wrong checksum never replaces a file. Raises InputError if the server cannot be
    reached.
    """
    with warnings.catch_warnings():
        # tqdm, which pooch imports, warns of missing widgets in a notebook.
        warnings.simplefilter("ignore")
        import pooch
    # pooch raises its errors.
    import requests

    # pooch would report each step on standard error.
    pooch.get_logger().setLevel("ERROR")
    loader = pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=30)
    outcomes = []
    for found in verify():
        file, path = found.file, found.path
        if found.problem:
            known = {file.name: f"sha256:{file.sha256}"}
            store = pooch.create(path.parent, f"{BASE_URL}/", registry=known, retry_if_failed=1)
            try:
                store.fetch(file.name, downloader=loader)
                found = Outcome(file, path, "downloaded")
            except (requests.ConnectionError, requests.Timeout):
                raise InputError(f"{BASE_URL}: no connection; is the network up?") from None
            except (OSError, ValueError) as error:
                is_io = isinstance(error, OSError)
                why = " ".join(str(error).split())[:160] if is_io else "wrong checksum"
                problem = f"{BASE_URL}/{file.name}: not downloaded to {path}: {why}"
                found = Outcome(file, path, "failed", problem)
        outcomes.append(found)
    return outcomes
