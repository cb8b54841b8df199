"""Where Optuna keeps studies: a journal file, or any database that Optuna supports."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from optuna.exceptions import StorageInternalError
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from egolane_pgm.tools.files import check_no_link, make_directory
from egolane_pgm.types import InputError

#: How often a new database is opened, and the time between, seconds.
_TRIES = 3
_WAIT_S = 0.5

#: The journal in the directory of a study.
JOURNAL_NAME = "study.journal"


def open_storage(storage: str) -> BaseStorage:
    """Open a storage: a URL (`postgresql://...`, `sqlite:///...`), or a journal file.

    Raises InputError, one line, if that fails.
    """
    is_file = "://" not in storage
    if is_file:
        make_directory(Path(storage).parent)
        check_no_link(Path(storage))
    try:
        return JournalStorage(_Journal(Path(storage))) if is_file else _open_database(storage)
    # Drivers of databases have different errors; a damaged journal raises others in Optuna.
    except Exception as error:
        raise InputError(f"{named(storage)}: cannot be used: {_reason(error)}") from error


def _open_database(url: str) -> RDBStorage:
    """Open a database; its tables may be made by another process at the same moment."""
    for _ in range(_TRIES - 1):
        with suppress(SQLAlchemyError):
            return RDBStorage(url)
        time.sleep(_WAIT_S)
    return RDBStorage(url)


class _Journal(JournalFileBackend):
    """Optuna's journal without flushing the disk after each line, which takes longer than a trial.

    A power failure loses the last seconds.
    """

    def __init__(self, path: Path) -> None:
        # A lock older than five seconds was left by a process that was killed.
        self.path = path
        self.lock = JournalFileOpenLock(str(path), grace_period=5)
        super().__init__(str(path), self.lock)
        self.append_logs([])

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        self.lock.acquire()
        try:
            with self.path.open("ab+") as file:
                _cut_half_line(file)
                file.writelines(json.dumps(log).encode() + b"\n" for log in logs)
        finally:
            self.lock.release()


def _cut_half_line(file: BinaryIO) -> None:
    """Cut off the end of a file after its last line, which a full disk or a kill left there."""
    end = file.seek(0, os.SEEK_END)
    while end > 0:
        file.seek(end - 1)
        if file.read(1) == b"\n":
            break
        end -= 1
    file.truncate(end)


@contextmanager
def storage_errors(storage: str | None) -> Iterator[None]:
    """Turn errors of a storage into InputError: a lost database, a full disk.

    While Optuna stores a result or locks a journal, it turns Ctrl-C into one of these, or another.
    """
    try:
        yield
    except Exception as error:
        each: BaseException | None = error
        while each is not None and not isinstance(each, KeyboardInterrupt):
            each = each.__context__
        if each is not None:
            raise KeyboardInterrupt from None
        if not isinstance(error, (OSError, SQLAlchemyError, StorageInternalError)):
            raise
        why = f"{_reason(error)}; complete trials are kept, repeat the command to go on"
        raise InputError(f"{named(storage or 'study')}: {why}") from error


def named(storage: str) -> str:
    """A storage in a message, without its password."""
    if "://" not in storage:
        return storage
    return f"storage: {make_url(storage).set(query={}).render_as_string()}"


def _reason(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(getattr(error, "orig", error)).splitlines() or [type(error).__name__]
    return str(lines[0])
