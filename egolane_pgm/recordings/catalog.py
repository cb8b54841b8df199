"""The public data set of the paper: addresses, checksums, download, and where files are found."""

from __future__ import annotations

import functools
import os
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

from egolane_pgm.tools.files import file_sha256
from egolane_pgm.types import InputError

#: The folder `bag/` of github trigal/rle at tag SpecialIssueTIV.submission.1 (BSD licence).
COMMIT = "e35b76afbbd579190ea4194446ef02980289880a"
BASE_URL = f"https://raw.githubusercontent.com/trigal/rle/{COMMIT}/bag"


@dataclass(frozen=True)
class DataFile:
    """A public file: its checksum, its size in bytes, and its name, which is also its path below
    the base address."""

    sha256: str
    size: int
    name: str

    @property
    def target(self) -> str:
        """Where it lies in the download folder, and in `$EGOLANE_DATA`."""
        return f"rle/{self.name}"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a download or a check of one file.

    - status: "downloaded", "present" (there and good), "failed", "missing" or "bad" (wrong
      checksum).
    - message: one line that says what is wrong, "" if nothing is.
    """

    file: DataFile
    path: Path
    status: str
    message: str = ""

    @property
    def ok(self) -> bool:
        """Whether the file is there and has the right checksum."""
        return not self.message


@functools.cache
def list_files() -> tuple[DataFile, ...]:
    """The files of the data set: ten recordings and two ground truths."""
    rows = Path(__file__).with_suffix(".txt").read_text().splitlines()[1:]
    words = [row.split() for row in rows]
    return tuple(DataFile(sha256, int(size), name) for sha256, size, name, *_ in words)


def download_folder() -> Path:
    """The user's cache folder for this package (XDG_CACHE_HOME is respected)."""
    return Path(_pooch().os_cache("egolane_pgm"))


def _pooch() -> ModuleType:
    with warnings.catch_warnings():
        # In a notebook tqdm, which pooch imports, warns of widgets that nobody asked for.
        warnings.simplefilter("ignore")
        import pooch
    module: ModuleType = pooch
    return module


def data_folders() -> list[Path]:
    """The folders that are looked in for the data set, the first one that has a file first:
    `$EGOLANE_DATA`, then the download folder."""
    data = os.environ.get("EGOLANE_DATA", "")
    return [Path(data).expanduser(), download_folder()] if data else [download_folder()]


def verify(folder: str | Path | None = None) -> list[Outcome]:
    """Check every file of the data set.

    - folder: where they are; by default where a run takes each of them from (`data_folders`). A
      file that is nowhere is missing in the download folder.
    """
    folders = data_folders() if folder is None else [Path(folder).expanduser()]
    outcomes = []
    for file in list_files():
        places = [each / file.target for each in folders]
        path = next((place for place in places if place.is_file()), places[-1])
        status, message = "present", ""
        if not path.is_file():
            status, message = "missing", f"{path}: no such file; `egolane data fetch` gets it"
        elif file_sha256(path) != file.sha256:
            status = "bad"
            message = f"{path}: wrong checksum, `egolane data fetch` gets it again"
        outcomes.append(Outcome(file, path, status, message))
    return outcomes


def fetch(folder: str | Path | None = None) -> list[Outcome]:
    """Download the files that are not there yet; one Outcome per file.

    - folder: where they go (default: the download folder).

    A file that is there and good is not asked for again, and content with a wrong checksum never
    takes the place of anything. Raises InputError if the server cannot be reached.
    """
    # pooch depends on it, and raises its errors.
    import requests

    pooch = _pooch()
    # pooch would report each step on standard error.
    pooch.get_logger().setLevel("ERROR")
    loader = pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=30)
    outcomes = []
    for found in verify(download_folder() if folder is None else folder):
        name, path = found.file.name, found.path
        if not found.ok:
            known = {name: f"sha256:{found.file.sha256}"}
            store = pooch.create(path.parent, f"{BASE_URL}/", registry=known, retry_if_failed=1)
            try:
                store.fetch(name, downloader=loader)
                found = Outcome(found.file, path, "downloaded")
            except (requests.ConnectionError, requests.Timeout):
                raise InputError(f"{BASE_URL}: no connection; is the network up?") from None
            except (OSError, ValueError) as error:
                is_io = isinstance(error, OSError)
                why = " ".join(str(error).split())[:160] if is_io else "it has a wrong checksum"
                message = f"{name}: {BASE_URL}/{name}: not downloaded to {path}: {why}"
                found = replace(found, status="failed", message=message)
        outcomes.append(found)
    return outcomes


def problems(outcomes: list[Outcome]) -> list[str]:
    """The messages of what went wrong, one line each."""
    return [outcome.message for outcome in outcomes if not outcome.ok]
