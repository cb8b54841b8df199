"""Where a study is kept: SQLite beside the results for one process, a journal for several.

Both are Optuna's own formats, so that its dashboard and `optuna.load_study` read them. Only
finished trials are written to SQLite, in one transaction per batch: a process that is killed
leaves nothing behind that would have to be cleaned up. The journal is repaired by whoever holds
its lock next, should a process have been killed in the middle of a line.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from egolane_pgm.tune.space import differences
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

SQLITE_NAME = "study.db"
JOURNAL_NAME = "study.journal"
LOCK_NAME = ".lock"

#: Seconds to wait for a database, or a study, that another process holds.
PATIENCE_S = 5.0

#: The columns that finished trials are written to directly; Optuna's own way costs 10 ms a trial.
_COLUMNS = {
    "trials": {"trial_id", "number", "study_id", "state", "datetime_start", "datetime_complete"},
    "trial_params": {"param_id", "trial_id", "param_name", "param_value", "distribution_json"},
    "trial_values": {"trial_value_id", "trial_id", "objective", "value", "value_type"},
    "trial_user_attributes": {"trial_user_attribute_id", "trial_id", "key", "value_json"},
}


class Store(Protocol):
    """Keeps the finished trials of one study."""

    def finished(self) -> list[FrozenTrial]:
        """Every trial that was finished, in order."""
        ...

    def write(self, trials: Sequence[FrozenTrial]) -> None:
        """Keep finished trials; InputError where that fails, and then none of them is kept."""
        ...


@contextlib.contextmanager
def only_one(directory: Path, patience_s: float = PATIENCE_S) -> Iterator[None]:
    """Hold a study for this process (and its workers). Raises InputError where another process
    holds it, or the directory cannot be written."""
    import fcntl

    try:
        directory.mkdir(parents=True, exist_ok=True)
        file = (directory / LOCK_NAME).open("w")
    except OSError as error:
        raise InputError(f"{directory}: cannot be written: {error.strerror}") from error
    with file:
        deadline = time.monotonic() + patience_s
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise InputError(
                        f"{directory}: another process is at work on this study; wait for it, or"
                        " name another directory with --out"
                    ) from None
                time.sleep(0.1)
        yield


def check_identity(found: Mapping[str, Any], identity: Mapping[str, Any], where: Path) -> None:
    """Raise InputError, saying what differs, where a study that is there is not the same one."""
    unlike = differences(found, json.loads(json.dumps(identity)))
    if unlike:
        raise InputError(
            f"{where}: holds another study of this name ({'; '.join(unlike[:5])});"
            " nothing was changed; name another directory with --out, or remove that one"
        )


def stored_identity(directory: Path) -> dict[str, Any] | None:
    """The identity of the study that a directory holds, None where there is none; read-only."""
    if (directory / SQLITE_NAME).exists():
        with _explained(directory / SQLITE_NAME):
            base = sqlite3.connect(
                f"file:{directory / SQLITE_NAME}?mode=ro", uri=True, timeout=PATIENCE_S
            )
            try:
                tables = base.execute("SELECT name FROM sqlite_master WHERE type='table'")
                if ("study_user_attributes",) not in tables.fetchall():
                    return None
                row = base.execute(
                    "SELECT value_json FROM study_user_attributes WHERE key = 'identity'"
                ).fetchone()
            finally:
                base.close()
        return dict(json.loads(row[0])) if row else None
    if (directory / JOURNAL_NAME).exists():
        for study in journal_storage(directory).get_all_studies():
            if "identity" in study.user_attrs:
                return dict(study.user_attrs["identity"])
    return None


class SqliteStore:
    """A study in SQLite. Raises InputError (locked, full, read-only, not a database, another
    study) in one line; use as a context manager."""

    def __init__(
        self, directory: Path, name: str, identity: Mapping[str, Any], directions: Sequence[Any]
    ) -> None:
        import optuna

        self.path = directory / SQLITE_NAME
        self.name = name
        found = stored_identity(directory)
        if found is not None:
            check_identity(found, identity, directory)
        with _explained(self.path):
            # Optuna would retry for minutes on a base that is locked: asked first.
            self.base = sqlite3.connect(self.path, timeout=PATIENCE_S, isolation_level=None)
            self.base.execute("PRAGMA journal_mode=WAL")
            self.base.execute("PRAGMA synchronous=NORMAL")
            self.base.execute("BEGIN IMMEDIATE")
            self.base.execute("ROLLBACK")
            optuna.logging.set_verbosity(optuna.logging.ERROR)
            self.storage = optuna.storages.RDBStorage(
                f"sqlite:///{self.path}", engine_kwargs={"connect_args": {"timeout": PATIENCE_S}}
            )
            study = optuna.create_study(
                storage=self.storage,
                study_name=name,
                directions=list(directions),
                load_if_exists=True,
            )
            if found is None:
                study.set_user_attr("identity", dict(identity))
            row = self.base.execute("SELECT study_id FROM studies WHERE study_name = ?", (name,))
            self.study_id = int(row.fetchone()[0])
            self.is_known = all(
                {column[1] for column in self.base.execute(f"PRAGMA table_info({table})")}
                == columns
                for table, columns in _COLUMNS.items()
            )
        self.study = study

    def finished(self) -> list[FrozenTrial]:
        """See `Store`."""
        with _explained(self.path):
            return [t for t in self.study.get_trials(deepcopy=False) if t.state.is_finished()]

    def write(self, trials: Sequence[FrozenTrial]) -> None:
        """See `Store`."""
        with _explained(self.path):
            if not self.is_known:
                self.study.add_trials(trials)
                return
            self.base.execute("BEGIN IMMEDIATE")
            try:
                for trial in trials:
                    self._insert(trial)
                self.base.execute("COMMIT")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):
                    self.base.execute("ROLLBACK")
                raise

    def _insert(self, trial: FrozenTrial) -> None:
        from optuna.distributions import distribution_to_json

        times = [
            None if t is None else t.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S.%f")
            for t in (trial.datetime_start, trial.datetime_complete)
        ]
        row = self.base.execute(
            "INSERT INTO trials (number, study_id, state, datetime_start, datetime_complete)"
            " VALUES (?, ?, ?, ?, ?)",
            (trial.number, self.study_id, trial.state.name, *times),
        )
        trial_id = row.lastrowid
        self.base.executemany(
            "INSERT INTO trial_params (trial_id, param_name, param_value, distribution_json)"
            " VALUES (?, ?, ?, ?)",
            [
                (trial_id, key, d.to_internal_repr(trial.params[key]), distribution_to_json(d))
                for key, d in trial.distributions.items()
            ],
        )
        self.base.executemany(
            "INSERT INTO trial_values (trial_id, objective, value, value_type)"
            " VALUES (?, ?, ?, 'FINITE')",
            [(trial_id, k, value) for k, value in enumerate(trial.values or ())],
        )
        self.base.executemany(
            "INSERT INTO trial_user_attributes (trial_id, key, value_json) VALUES (?, ?, ?)",
            [(trial_id, key, json.dumps(value)) for key, value in trial.user_attrs.items()],
        )

    def close(self) -> None:
        """Let go of the file."""
        self.storage.remove_session()
        self.storage.engine.dispose()
        with contextlib.suppress(sqlite3.Error):
            self.base.execute("PRAGMA journal_mode=DELETE")  # One plain file again.
        self.base.close()

    def __enter__(self) -> SqliteStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """A database's complaints as InputError."""
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (sqlite3.Error, SQLAlchemyError, StorageInternalError) as error:
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        text = str(getattr(cause, "orig", cause)).splitlines()[0]
        if "locked" in text:
            raise InputError(
                f"{path}: the database is locked by another process; close it (a dashboard, a"
                " browser) and repeat the command"
            ) from error
        raise InputError(f"{path}: {text}; finished trials up to here are kept") from error


def journal_storage(directory: Path) -> optuna.storages.JournalStorage:
    """Optuna's journal of a study, with a lock that dies with its process."""
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    path = directory / JOURNAL_NAME

    class Backend(JournalFileBackend):
        def append_logs(self, logs: list[dict[str, Any]]) -> None:
            # As Optuna's, less an fsync per line: a killed process loses nothing without it.
            lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs).encode()
            try:
                with locked(directory / f"{JOURNAL_NAME}.lock"):
                    _cut_torn_line(path)
                    with path.open("ab", buffering=0) as file:
                        if file.write(lines) != len(lines):
                            raise OSError(errno.ENOSPC, "No space left on device")
            except OSError as error:
                raise InputError(f"{path}: cannot be written: {error.strerror}") from error

    try:
        return JournalStorage(Backend(str(path)))
    except OSError as error:
        raise InputError(f"{path}: cannot be opened: {error.strerror}") from error


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """A lock between processes that the kernel takes from a holder that dies."""
    import fcntl

    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _cut_torn_line(path: Path) -> None:
    """Drop a last line without its end: whoever wrote it is dead, since we hold the lock."""
    with contextlib.suppress(FileNotFoundError), path.open("rb+") as file:
        size = file.seek(0, os.SEEK_END)
        if size == 0:
            return
        file.seek(size - 1)
        if file.read(1) == b"\n":
            return
        start = max(0, size - (1 << 20))
        file.seek(start)
        kept = file.read().rfind(b"\n") + 1
        file.truncate(start + kept)
