"""Where Optuna keeps studies: a journal file, or any database that Optuna supports."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from optuna.exceptions import StorageInternalError
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from sqlalchemy.engine import make_url
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from egolane_pgm.tools.files import make_directory
from egolane_pgm.types import InputError

#: The journal in the directory of a study.
JOURNAL_NAME = "study.journal"


def open_storage(storage: str) -> BaseStorage:
    """Open a storage: a URL (`postgresql://...`, `sqlite:///...`), or a journal file.

    Raises InputError, one line, if that fails.
    """
    try:
        if "://" not in storage:
            make_directory(Path(storage).parent)
            return JournalStorage(_Journal(Path(storage)))
        try:
            return RDBStorage(storage)
        except IntegrityError:
            # Another worker has just created the tables.
            return RDBStorage(storage)
    except InputError:
        raise
    except ImportError as error:
        name = error.name or getattr(error.__cause__, "name", None)
        raise InputError(
            f"{named(storage)}: needs the package {name}: pip install {name}"
        ) from error
    # Drivers of databases have different errors; a damaged journal raises others in Optuna.
    except Exception as error:
        raise InputError(f"{named(storage)}: cannot be used: {_reason(error)}") from error


class _Journal(JournalFileBackend):
    """Optuna's journal without flushing the disk after each line, which takes longer than a trial.

    A power failure loses the last seconds.
    """

    def __init__(self, path: Path) -> None:
        # A lock older than five seconds was left by a process that was killed.
        self.path, self.lock = path, JournalFileOpenLock(str(path), grace_period=5)
        super().__init__(str(path), self.lock)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        self.lock.acquire()
        try:
            with self.path.open("ab") as file:
                file.writelines(json.dumps(log).encode() + b"\n" for log in logs)
        finally:
            self.lock.release()


@contextmanager
def storage_errors(storage: str | None) -> Iterator[None]:
    """Turn errors of a storage into InputError: a lost database, a full disk.

    Ctrl-C comes out as KeyboardInterrupt: while Optuna stores a result or locks a journal, it
    raises UnboundLocalError or RuntimeError instead.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        # Optuna may raise another error while it handles the first one.
        each: BaseException | None = error
        while each is not None:
            if not isinstance(each, Exception):
                raise type(each)(*each.args) from None
            if isinstance(each, (OSError, SQLAlchemyError, StorageInternalError)):
                why = f"{_reason(each)}; complete trials are kept, repeat the command to go on"
                raise InputError(f"{named(storage or 'study')}: {why}") from error
            each = each.__context__
        raise


def named(storage: str) -> str:
    """A storage in a message, without its password."""
    try:
        if "://" in storage:
            return f"storage: {make_url(storage).set(query={}).render_as_string()}"
    except SQLAlchemyError:
        return "storage"
    return storage


def _reason(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(getattr(error, "orig", error)).splitlines() or [type(error).__name__]
    return str(lines[0])
