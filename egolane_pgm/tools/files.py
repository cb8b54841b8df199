"""Write files atomically; read text, YAML and Parquet, with errors in one line.

A file is written in a hidden folder with a random name and then renamed, so that it is either whole
or absent, and two programs may write the same file. A killed process leaves the hidden folder.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic_core import to_jsonable_python

from egolane_pgm.tools.yaml import dump_yaml, parse_yaml
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd

#: The value of `version` in YAML files; it changes with the meaning of a key.
YAML_VERSION = 1


def file_sha256(path: Path) -> str:
    """Return the checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def checksum(content: Mapping[str, Any], folder: Path, names: Iterable[str]) -> str:
    """Return a checksum of the content of a JSON file and of those files in `folder` that exist."""
    files = [folder / name for name in names]
    sums = [file_sha256(file) for file in files if file.exists()]
    return hashlib.sha256("".join([json_text(content), *sums]).encode()).hexdigest()


# --- writing ---------------------------------------------------------------------------------


@contextlib.contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Create a folder, in `parent` or the system's place, and remove it when the block ends."""
    place = None if parent is None else parent.absolute()
    with tempfile.TemporaryDirectory(
        prefix=".egolane-", dir=place, ignore_cleanup_errors=True
    ) as folder:
        yield Path(folder)


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file, which replaces `path` if the block does not raise.

    Missing folders are created. Raises InputError, naming `path`, for an OSError.
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
    """Write a file. Raises InputError if it cannot be written."""
    with atomic(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8. Raises InputError if it cannot be written."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file. Raises InputError if it cannot be written."""
    write_text(path, json_text(content))


def json_text(content: Mapping[str, Any]) -> str:
    """Format as JSON."""
    return json.dumps(to_jsonable(content), indent=1) + "\n"


def write_yaml(path: Path, content: Mapping[str, Any], heading: str = "") -> None:
    """Write a YAML file, keys in their order. Raises InputError if it cannot be written.

    - heading: comments above the keys.
    """
    text = dump_yaml({"version": YAML_VERSION, **to_jsonable(content)})
    write_text(path, heading + text)


def write_parquet(path: Path, frame: pd.DataFrame) -> None:
    """Write a DataFrame without its index. Raises InputError if it cannot be written."""
    with atomic(path) as temporary:
        frame.to_parquet(temporary, index=False)


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a Parquet file. Raises InputError if it cannot be read."""
    import pandas as pd
    from pyarrow import parquet

    with reading(path, "Parquet"), path.open("rb") as file:
        try:
            return pd.read_parquet(file)
        except (NotImplementedError, TypeError, ValueError, LookupError):
            # The types that pandas noted in the file do not fit its columns.
            return parquet.read_table(file).to_pandas(ignore_metadata=True)


def to_jsonable(value: Any) -> Any:
    """Convert to plain Python types, for JSON and YAML; NaN and infinity become None."""
    return to_jsonable_python(value, inf_nan_mode="null", fallback=_of_numpy)


def _of_numpy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")


# --- directories -----------------------------------------------------------------------------


def make_directory(directory: Path) -> None:
    """Create a directory and its parents. Raises InputError if that fails, and for a link."""
    check_no_link(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{directory}: cannot be created: {error.strerror}") from error


def check_no_link(path: Path) -> None:
    """Raise InputError for an output path that is a link; its parents may be links."""
    if path.is_symlink():
        raise InputError(f"{path}: is a link; name another path")


@contextlib.contextmanager
def replaced_directory(path: Path, is_ours: Callable[[str], bool]) -> Iterator[Path]:
    """Yield a new folder, which takes the place of `path` if the block does not raise.

    The two are exchanged in one step, so that others see the older folder or the new one, whole.

    - is_ours: whether a file of the older folder, by its name, goes with it; others stay.

    Raises InputError, naming `path`, for an OSError.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path.parent) as folder:
            new = folder / path.name
            new.mkdir()
            yield new
            with contextlib.suppress(FileExistsError):
                path.mkdir()
            _exchange(new, path)
            for other in new.iterdir():
                if not is_ours(other.name) and not (path / other.name).exists():
                    other.rename(path / other.name)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _exchange(first: Path, second: Path) -> None:
    """Exchange two folders in one step (Linux), or else in three."""
    exchange = 2  # RENAME_EXCHANGE of <linux/fs.h>.
    here = -100  # AT_FDCWD of <fcntl.h>: relative to the current folder.
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    if rename and not rename(here, os.fsencode(first), here, os.fsencode(second), exchange):
        return
    third = first.with_suffix(".older")
    second.rename(third)
    first.rename(second)
    third.rename(first)


def check_place(path: Path) -> None:
    """Raise InputError if a path cannot be written."""
    nearest = path.absolute().parent
    try:
        while not nearest.exists():
            nearest = nearest.parent
        # Permissions are not enough (root, read-only file systems).
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written, {nearest} is not a writable directory ({error.strerror})"
        ) from error


def check_not_read(file: Path, read: Iterable[Path]) -> None:
    """Raise InputError if an output file is one of the input files."""
    if file.exists() and any(other.exists() and other.samefile(file) for other in read):
        raise InputError(f"{file}: is read here; name another file")


# --- reading ---------------------------------------------------------------------------------


@contextlib.contextmanager
def reading(path: Path, what: str, cure: str = "") -> Iterator[None]:
    """Turn any error of a library for damaged bytes into an InputError that names the file.

    - what: the kind of file. cure: advice, for the message.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:
        problem = getattr(error, "strerror", None) or " ".join(str(error).split())[:120]
        problem = problem.rstrip(".") or type(error).__name__
        raise InputError(f"{path}: cannot be read as {what} ({problem}){cure}") from None


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, with or without a byte order mark; InputError if it cannot be."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: is not text in UTF-8") from error
    except (OSError, ValueError) as error:
        # A path with a NUL character is a ValueError.
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from error


def read_yaml(path: Path, example: str) -> dict[str, Any]:
    """Read the keys and values of a YAML file, without `version`.

    - example: a line of such a file, for the message if it has no keys.

    Raises InputError if it cannot be read, is not YAML or has an unknown version.
    """
    content = parse_yaml(read_text(path), str(path))
    if not isinstance(content, dict):
        raise InputError(f"{path}: needs keys and values, e.g. '{example}'")
    return without_version(content, str(path))


def without_version(content: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the keys without `version`. Raises InputError for an unknown version."""
    content = dict(content)
    version = content.pop("version", YAML_VERSION)
    if version != YAML_VERSION or isinstance(version, bool):
        raise InputError(
            f"{source}: version: {version!r} is not {YAML_VERSION}, the one known here"
        )
    return content
