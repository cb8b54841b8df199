"""Where a study is kept: a journal beside the results, or any storage of Optuna's.

Optuna's own commands, its dashboard and `optuna.load_study` read all of them.
"""

from __future__ import annotations

import io
import json
import os
import shlex
import signal
import threading
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import optuna
from optuna.exceptions import StorageInternalError
from optuna.storages import (
    BaseStorage,
    JournalStorage,
    RDBStorage,
    RetryHeartbeatStaleTrialCallback,
)
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import TrialState
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from egolane_pgm.report.study_trials import quiet
from egolane_pgm.tools.files import make_directory, temporary_folder
from egolane_pgm.tuning.search import Settings, new_study
from egolane_pgm.tuning.space import Point, differences
from egolane_pgm.types import InputError

JOURNAL_NAME = "study.journal"

#: A worker on a database says so often that it is alive, and is taken for dead after so long.
HEARTBEAT_S, GRACE_S = 15, 60

#: What to do about a study that is damaged.
_AGAIN = "begin another study with --out or --storage"

#: A lock on a journal that is held so long was left by a process that was killed.
LOCK_GRACE_S = 5


class _Lock(JournalFileOpenLock):
    """Optuna's lock, which other users of the journal heed, given back in one step: Optuna takes
    two, and leaves a file that nobody removes where the process is killed between them.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(f"{path}.lock")
        super().__init__(str(path), LOCK_GRACE_S)

    def release(self) -> None:
        self.path.unlink(missing_ok=True)


class _Journal(JournalFileBackend):
    """Optuna's journal, without waiting for the disk after each line: a trial writes a dozen.

    A killed process loses nothing by that, a machine without power its last seconds. Raises
    InputError for a file that cannot be written, and then leaves no half line behind; for a damaged
    line, which it names.

    - line: that was read last, from 1.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.line = path, 0
        self.lock = _Lock(path)
        super().__init__(str(path), self.lock)
        # Optuna passes over a damaged line at the end, and stumbles over it once others follow.
        *lines, _ = path.read_bytes().split(b"\n")
        if lines and not _is_json(lines[-1]):
            self.line = 1 + [_is_json(line) for line in lines].index(False)
            raise self.damaged()

    def damaged(self) -> InputError:
        """An error that names the line that was read last, and says how to go on without it."""
        kept = f"sed -i '{self.line},$d' {shlex.quote(str(self.path))}"
        return InputError(
            f"{self.path}: line {self.line}: is damaged, or no journal of Optuna's; to go on with"
            f" what is before that line: {kept}"
        )

    def read_logs(self, log_number_from: int) -> Generator[dict[str, Any], None, None]:
        self.line = log_number_from
        try:
            for log in super().read_logs(log_number_from):
                self.line += 1
                yield log
        except ValueError as error:
            self.line += 1
            raise self.damaged() from error

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs)
        try:
            # A lock that an interruption left behind would be waited for.
            with _interrupted_later():
                self.lock.acquire()
                try:
                    with self.path.open("a+b", buffering=0) as file:
                        size = self._whole(file)
                        if file.write(lines.encode()) < len(lines.encode()):
                            file.truncate(size)
                            raise OSError(28, "No space left on device")
                finally:
                    self.lock.release()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error

    def _whole(self, file: io.FileIO) -> int:
        """The size of the file, without the half line of a process that was killed."""
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 1))
        if file.read() not in (b"", b"\n"):
            file.seek(0)
            size = file.readall().rfind(b"\n") + 1
            file.truncate(size)
        return size


def _is_json(line: bytes) -> bool:
    try:
        json.loads(line)
    except ValueError:
        return False
    return True


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Let a signal that comes while the block runs take effect once it has ended."""
    if threading.current_thread() is not threading.main_thread():
        # Signals are handled in the main thread only.
        yield
        return
    came: list[int] = []
    before = {
        which: signal.signal(which, lambda number, _: came.append(number))
        for which in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for which, handler in before.items():
            signal.signal(which, handler)
        for number in came:
            signal.raise_signal(number)


def open_storage(url: str | None, directory: Path) -> BaseStorage:
    """Open the storage of a study.

    - url: of a database, as Optuna takes it (`sqlite:///...`, `postgresql://...`, `mysql://...`);
      None for the journal in `directory`.

    Raises InputError, one line, where that fails.
    """
    if url is None:
        path = directory / JOURNAL_NAME
        make_directory(directory)
        try:
            journal = _Journal(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        try:
            return JournalStorage(journal)
        except (InputError, MemoryError):
            raise
        # Whatever Optuna stumbles over in a line that is JSON.
        except Exception as error:
            raise journal.damaged() from error
    try:
        with quiet():
            _make_database(url)
            return RDBStorage(
                url,
                heartbeat_interval=HEARTBEAT_S,
                grace_period=GRACE_S,
                heartbeat_stale_trial_callback=RetryHeartbeatStaleTrialCallback(),
            )
    except ImportError as error:
        raise InputError(
            f"--storage {url}: needs the package {error.name}: pip install {error.name}"
        ) from error
    # Whatever a database's driver raises: no such host, no such user, no such file.
    except Exception as error:
        raise InputError(f"--storage {url}: {_reason(error)}") from error


def _make_database(url: str) -> None:
    """Make the file of a SQLite database with all tables, or none: Optuna makes one table after
    the other, and a process that is killed meanwhile would leave some for ever without an index."""
    where = make_url(url)
    name = where.database or ""
    if where.get_backend_name() != "sqlite" or name.startswith((":memory:", "file:")) or not name:
        return
    path = Path(name)
    if path.exists() or not path.parent.is_dir():
        return
    with temporary_folder(path.parent) as folder:
        made = folder / path.name
        storage = RDBStorage(where.set(database=str(made)).render_as_string(hide_password=False))
        storage.remove_session()
        storage.engine.dispose()
        # Another process may have made it meanwhile; not every file system has second names.
        with suppress(OSError):
            os.link(made, path)


def open_study(
    storage: BaseStorage,
    name: str,
    settings: Settings,
    identity: Mapping[str, Any],
    starts: Sequence[Point] = (),
) -> optuna.Study:
    """Open a study of a storage, or begin it.

    - identity: what makes two studies the same one; kept in `study.user_attrs`.
    - starts: points that a new study tries first.

    Raises InputError where the storage holds another study of that name.
    """
    check_study(storage, name, identity)
    with _damaged(name):
        study = new_study(settings, storage=storage, study_name=name)
    _check_trials(study, len(settings.objectives), set(identity["space"]["searched"]))
    if "identity" not in study.user_attrs:
        study.set_user_attr("identity", dict(identity))
    if not study.get_trials(deepcopy=False):
        for point in starts:
            study.enqueue_trial(dict(point), skip_if_exists=True)
    return study


def check_study(storage: BaseStorage, name: str, identity: Mapping[str, Any]) -> None:
    """Raise InputError, saying what differs, where a storage holds another study of a name."""
    with _damaged(name):
        if name not in [study.study_name for study in storage.get_all_studies()]:
            return
        study = optuna.load_study(study_name=name, storage=storage)
        was = study.user_attrs.get("identity", identity)
    unlike = differences(was if isinstance(was, Mapping) else {"identity": was}, identity)
    if unlike:
        raise InputError(
            f"study {name}: the storage holds another study of this name ({'; '.join(unlike[:5])});"
            " nothing was changed; name another directory with --out, or another storage"
        )


def check_place(url: str | None, directory: Path, name: str, identity: Mapping[str, Any]) -> None:
    """As `check_study`, for the storage that `open_storage` would open; none is made."""
    if url is not None or (directory / JOURNAL_NAME).exists():
        with storage_errors(url):
            check_study(open_storage(url, directory), name, identity)


def _check_trials(study: optuna.Study, n_scores: int, searched: set[str]) -> None:
    """Raise InputError for a study with trials that no search has made."""
    with _damaged(study.study_name):
        trials = study.get_trials(deepcopy=False)
    for trial in trials:
        is_whole = len(trial.values or ()) == n_scores and searched <= set(trial.params)
        if trial.state == TrialState.COMPLETE and not is_whole:
            raise InputError(
                f"study {study.study_name}: is damaged: trial {trial.number} is complete without"
                f" its scores or parameters; {_AGAIN}"
            )


@contextmanager
def _damaged(name: str) -> Iterator[None]:
    """Whatever Optuna stumbles over in a study that somebody damaged, as InputError."""
    try:
        yield
    except InputError:
        raise
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(f"study {name}: is damaged: {error}; {_AGAIN}") from error


@contextmanager
def storage_errors(url: str | None) -> Iterator[None]:
    """What a storage complains of while a study runs, as InputError."""
    try:
        yield
    except (StorageInternalError, SQLAlchemyError) as error:
        where = f"--storage {url}" if url else JOURNAL_NAME
        raise InputError(
            f"{where}: {_reason(error)}; complete trials are kept, repeat the command to go on"
        ) from error


def _reason(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(getattr(error, "orig", error)).splitlines() or [type(error).__name__]
    return str(lines[0])
