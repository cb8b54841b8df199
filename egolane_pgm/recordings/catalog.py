"""The public data set of the paper: addresses, checksums, download, and where files are found."""

from __future__ import annotations

import hashlib
import os
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import urlsplit

from platformdirs import user_cache_path

from egolane_pgm.tools.files import in_home
from egolane_pgm.types import InputError

#: The folder `bag/` of github trigal/rle at tag SpecialIssueTIV.submission.1 (BSD licence).
COMMIT = "e35b76afbbd579190ea4194446ef02980289880a"
BASE_URL = f"https://raw.githubusercontent.com/trigal/rle/{COMMIT}/bag"


@dataclass(frozen=True)
class DataFile:
    """A public file: its name, which is also its path below the base address, its size in bytes,
    its checksum, and which of the paper's recordings it is."""

    name: str
    size: int
    sha256: str
    what: str

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
        """The file is there and has the right checksum."""
        return self.status in ("downloaded", "present")


_FILES = (
    DataFile(
        "special.issue.italy.mono.noClothoid.yesLines.bag",
        2092715,
        "d8040c50fdfc1cc834c48ca2c0d3d54fb41d4a76cf0c64698ed9fc28ee9760bb",
        "run 1, Italy, ML",
    ),
    DataFile(
        "special.issue.italy.stereo.noClothoid.yesLines.bag",
        2091485,
        "eaeb23907d5e9704ceb562c0a6d710e8fcf885353796dc67ada981d9989486fa",
        "run 2, Italy, SL",
    ),
    DataFile(
        "A4-5FULL-MONO.bag",
        2093141,
        "952d9a5fb69340cace106d57b5810e03c1df0f2d6221971d31366afe3e07ea4d",
        "run 3, Italy, MC",
    ),
    DataFile(
        "A4-5FULL-STEREOv2.bag",
        2094835,
        "dd4d3a0ecbfaf861d6d50e640ae318c2ee1da926e3229b228385faf94fd988ce",
        "run 4, Italy, SC",
    ),
    DataFile(
        "mldhighway.a4.001_2017-12-18-12-38-52.bag",
        1796297,
        "06c2e4beefcc07c43915ad9be57f475b2c597547048a3f357810c54fa7911860",
        "run 5, Italy, MLD",
    ),
    DataFile(
        "special.issue.spain.mono.noClothoid.yesLines.left._2018-01-13-23-56-11.bag",
        1599529,
        "8cd14676570be56bcce97e4801ac12baa600439f18f54a54b27e6ca75d7747d1",
        "run 6, Spain, ML",
    ),
    DataFile(
        "special.issue.spain.stereo.noClothoid.yesLines.left._2018-01-14-23-06-51.bag",
        1599802,
        "4328f3928fea873c3ea153a5e89f1a25cdabca54b5fc6675b73b0d8c9cea209c",
        "run 7, Spain, SL",
    ),
    DataFile(
        "special.issue.spain.mono.yesClothoid.noLines.left._2018-01-14-11-59-09.bag",
        1598902,
        "5fdff87ce116c6edff71ae1ad0fbaab428297e6feb728c0cdfe524454dbbef3d",
        "run 8, Spain, MC",
    ),
    DataFile(
        "special.issue.spain.stereo.yesClothoid.noLines.left.bag",
        1599442,
        "cf04bfd9f1ffa62f845c3c5d3092e8a9f26af0901e18f75db6e4d74ee4cbe016",
        "run 9, Spain, SC",
    ),
    DataFile(
        "mldhighway.isislab.001_2017-12-15-17-07-21.bag",
        1732573,
        "cc529e5ff22ac37fb89a37ef5b0f02112c6a0c854095d1f25a8a00c8ea5b57cc",
        "run 10, Spain, MLD",
    ),
    DataFile(
        "GT-A4FULL.txt",
        88996,
        "ca21a765cbda9b3599c29e4b40113b2642670ef465e2f873863a7228faff12cc",
        "ground truth, Italy",
    ),
    DataFile(
        "ISIS_01.txt",
        86895,
        "2c985c4c7f46933d2be31cd619afe25efc1c43b3394919bade4b2b101e58c2d8",
        "ground truth, Spain",
    ),
)


def list_files() -> tuple[DataFile, ...]:
    """The files of the data set: ten recordings and two ground truths."""
    return _FILES


def download_folder() -> Path:
    """The user's cache folder for this package (XDG_CACHE_HOME is respected)."""
    return user_cache_path("egolane_pgm")


def find_file(
    path: str | Path,
    base: str | Path | None = None,
    *,
    folders: bool = False,
    is_fetched: bool = True,
) -> Path:
    """Find the file that a path in an experiment means.

    An absolute path is taken as it is. Any other is looked for below `base` (the folder of the
    YAML), then below `$EGOLANE_DATA`, then in the download folder.

    - folders: the path may be a folder too.
    - is_fetched: the public data may have the file, so the message names `egolane data fetch`.

    Raises InputError, with every place that was looked in, if it is nowhere.
    """
    wanted = in_home(path)
    if wanted.is_absolute():
        places = [wanted]
    else:
        bases = [Path.cwd() if base is None else Path(base), *data_folders()]
        places = [folder / wanted for folder in bases]
    for place in places:
        if place.is_file() or (folders and place.is_dir()):
            return place
    looked = ", ".join(str(place) for place in places)
    help_ = "run `egolane data fetch`, or set EGOLANE_DATA to the folder that has it"
    raise InputError(
        f"{path}: no such file; looked for {looked}"
        + (f"; {help_}" if is_fetched and not wanted.is_absolute() else "")
    )


def data_folders() -> list[Path]:
    """The folders that are looked in for the data set, the first one that has a file first:
    `$EGOLANE_DATA`, then the download folder."""
    data = os.environ.get("EGOLANE_DATA", "")
    return [in_home(data), download_folder()] if data else [download_folder()]


def verify(folder: str | Path | None = None) -> list[Outcome]:
    """Check every file of the data set.

    - folder: where they are; by default where a run takes each of them from (`data_folders`). A
      file that is nowhere is missing in the download folder.
    """
    if folder is not None:
        return [_verify(file, in_home(folder) / file.target) for file in _FILES]
    places = [[place / file.target for place in data_folders()] for file in _FILES]
    found = [next((p for p in paths if p.is_file()), paths[-1]) for paths in places]
    return [_verify(file, path) for file, path in zip(_FILES, found, strict=True)]


def _verify(file: DataFile, path: Path) -> Outcome:
    if not path.is_file():
        return Outcome(file, path, "missing", f"{path}: no such file; `egolane data fetch` gets it")
    try:
        with path.open("rb") as content:
            good = hashlib.file_digest(content, "sha256").hexdigest() == file.sha256
    except OSError as error:
        return Outcome(file, path, "bad", f"{path}: cannot be read: {error.strerror}")
    if good:
        return Outcome(file, path, "present")
    return Outcome(file, path, "bad", f"{path}: wrong checksum, `egolane data fetch` gets it again")


def fetch(
    base_url: str | None = None, folder: str | Path | None = None, progress: bool = True
) -> list[Outcome]:
    """Download the files that are not there yet; one Outcome per file.

    - base_url: a mirror with the same file names (default: GitHub).
    - folder: where they go (default: the download folder).
    - progress: a bar for each file on standard error, where that is a terminal.

    A file that is there and good is not asked for again, and content with a wrong checksum never
    takes the place of anything. A file that fails does not keep the others, unless the server
    cannot be reached at all. Raises InputError for an address that is not http or https.
    """
    address = (BASE_URL if base_url is None else base_url).rstrip("/")
    host = urlsplit(address).netloc.rpartition("@")[2]
    if urlsplit(address).scheme not in ("http", "https") or not host:
        raise InputError(f"base_url {base_url}: needs an address http://... or https://...")
    with warnings.catch_warnings():
        # In a notebook tqdm, which pooch imports, warns of widgets that nobody asked for.
        warnings.simplefilter("ignore")
        import pooch
        import requests
    # pooch would report each step on standard error.
    pooch.get_logger().setLevel("ERROR")
    loader = pooch.HTTPDownloader(progressbar=progress and sys.stderr.isatty(), timeout=30)
    # The temporary file of pooch, which becomes the file, can be read by its owner only.
    umask = os.umask(0)
    os.umask(umask)
    outcomes, unreachable = [], ""
    for found in verify(download_folder() if folder is None else folder):
        name, path = found.file.name, found.path
        if not found.ok and not unreachable:
            known = {name: f"sha256:{found.file.sha256}"}
            store = pooch.create(path.parent, f"{address}/", registry=known, retry_if_failed=1)
            try:
                store.fetch(name, downloader=loader)
                path.chmod(0o666 & ~umask)
                found = Outcome(found.file, path, "downloaded")
            except (requests.ConnectionError, requests.Timeout):
                # Every other file would wait for the same server.
                unreachable = (
                    f"{name}: {address}/{name}: no connection to {host}; is the network up?"
                )
            except (OSError, ValueError) as error:
                is_io = isinstance(error, OSError)
                why = " ".join(str(error).split())[:160] if is_io else "it has a wrong checksum"
                said = f"{name}: {address}/{name}: not downloaded to {path}: {why}"
                found = replace(found, status="failed", message=said)
        if not found.ok and unreachable:
            found = replace(found, status="failed", message=unreachable)
        outcomes.append(found)
    return outcomes


def problems(outcomes: list[Outcome]) -> list[str]:
    """The different messages of what went wrong, one line each."""
    return list(dict.fromkeys(outcome.message for outcome in outcomes if not outcome.ok))
