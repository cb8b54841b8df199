"""Files: how they are written whole, read as text or YAML, and refused in one line.

A file is written in a hidden folder beside its place, whose random name nobody else uses, and then
renamed: a file that has the name is whole, a file that was there before stays until then, and two
programs that write the same file do not damage it. The user's umask decides who may read it. A
process that is killed leaves the hidden folder behind.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic_core import to_jsonable_python

from egolane_pgm.tools.yaml import dump_yaml, parse_yaml
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd

#: Of the YAML files that the package reads (optional there) and writes. It changes where a key gets
#: another meaning, so that an old program refuses a new file in one line.
YAML_VERSION = 1


def file_sha256(path: Path) -> str:
    """The checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# --- writing ---------------------------------------------------------------------------------


@contextlib.contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """A new folder in `parent`, or where the system keeps temporary files, which only its owner may
    read and which is removed when the block ends. Raises OSError where it cannot be made."""
    place = None if parent is None else parent.absolute()
    with tempfile.TemporaryDirectory(
        prefix=".egolane-", dir=place, ignore_cleanup_errors=True
    ) as folder:
        yield Path(folder)


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """The name of a file to write, which takes the place of `path` when the block ends well.

    Folders that are not there yet are made. No file is left where the block does not end well.
    Raises InputError, naming `path`, for an OSError of the block or where the file cannot be put
    in its place.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path.parent) as folder:
            yield folder / path.name
            (folder / path.name).replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file. Raises InputError where it cannot be written."""
    with atomic(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole file of text, UTF-8. Raises InputError where it cannot be written."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON. Raises InputError where it cannot be written."""
    write_text(path, json_text(content))


def json_text(content: Mapping[str, Any]) -> str:
    """The text of a JSON file."""
    return json.dumps(plain(content), indent=1) + "\n"


def write_yaml(path: Path, content: Mapping[str, Any], heading: str = "") -> None:
    """Write YAML, keys in their order, innermost lists in one line; the heading, comments, above
    it. Raises InputError where it cannot be written."""
    text = dump_yaml({"version": YAML_VERSION, **plain(content)})
    write_text(path, heading + text)


def write_parquet(path: Path, frame: pd.DataFrame) -> None:
    """Write a DataFrame without its index. Raises InputError if it cannot be written."""
    with atomic(path) as temporary:
        frame.to_parquet(temporary, index=False)


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a Parquet file. Raises InputError if it cannot be read."""
    import pandas as pd

    try:
        # Its error says in plain words what is wrong with the place.
        path.stat()
        with path.open("rb") as file:
            return pd.read_parquet(file)
    except (OSError, ValueError) as error:
        if why := getattr(error, "strerror", None):
            raise InputError(f"{path}: cannot be read: {why}") from None
        said = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: is not a whole Parquet file ({said})") from None


def plain(value: Any) -> Any:
    """The same in plain Python types, for JSON and YAML; NaN and infinity become None."""
    return to_jsonable_python(value, inf_nan_mode="null", fallback=_of_numpy)


def _of_numpy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")


# --- directories -----------------------------------------------------------------------------


def make_directory(directory: Path) -> None:
    """Create a directory and its parents. Raises InputError where that cannot be done."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{directory}: cannot be created: {error.strerror}") from error


def check_place(path: Path) -> None:
    """Raise InputError where no file or directory of that name could be put."""
    nearest = path.absolute().parent
    try:
        while not nearest.exists():
            nearest = nearest.parent
        # Permissions alone do not tell (root, read-only file systems); nothing is left behind.
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written, {nearest} is not a writable directory ({error.strerror})"
        ) from error


def check_not_read(file: Path, read: Iterable[Path]) -> None:
    """Raise InputError where a file to be written is one of those that are read."""
    if file.exists() and any(other.exists() and other.samefile(file) for other in read):
        raise InputError(f"{file}: is read here; name another file")


# --- reading ---------------------------------------------------------------------------------


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, without the mark that some editors put before it. Raises
    InputError where it cannot be read or is no text."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: is not text in UTF-8") from error


def read_yaml(path: Path, example: str) -> dict[str, Any]:
    """The keys and values of a YAML file, without its `version`.

    Raises InputError where it cannot be read or is no YAML; where it has no keys, with the example
    of a line that it might have; and for a version that this program does not know.
    """
    content = parse_yaml(read_text(path), str(path))
    if not isinstance(content, dict):
        raise InputError(f"{path}: needs keys and values, e.g. '{example}'")
    return without_version(content, str(path))


def without_version(content: Mapping[str, Any], source: str) -> dict[str, Any]:
    """The keys without `version`. Raises InputError for a version that is not known here."""
    content = dict(content)
    version = content.pop("version", YAML_VERSION)
    if version != YAML_VERSION or isinstance(version, bool):
        raise InputError(
            f"{source}: version: {version!r} is not {YAML_VERSION}, the one known here"
        )
    return content
