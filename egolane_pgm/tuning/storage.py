"""Where a study is kept: a journal beside the results, or any storage of Optuna's.

Optuna's own commands, its dashboard and `optuna.load_study` read all of them.
"""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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

from egolane_pgm.files import make_directory
from egolane_pgm.report.study_trials import quiet
from egolane_pgm.tuning.search import Settings, new_study
from egolane_pgm.tuning.space import Point, differences
from egolane_pgm.types import InputError

JOURNAL_NAME = "study.journal"

#: A worker on a database says so often that it is alive, and is taken for dead after so long.
HEARTBEAT_S, GRACE_S = 15, 60

#: A lock on a journal that is held so long was left by a process that was killed.
LOCK_GRACE_S = 5


class _Journal(JournalFileBackend):
    """Optuna's journal, without waiting for the disk after each line: a trial writes a dozen.

    A killed process loses nothing by that, a machine without power its last seconds. Raises
    InputError for a file that cannot be written, and then leaves no half line behind.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lock = JournalFileOpenLock(str(path), LOCK_GRACE_S)
        super().__init__(str(path), self.lock)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs)
        try:
            # A lock that an interruption left behind would be waited for.
            with _interrupted_later():
                self.lock.acquire()
                try:
                    with self.path.open("ab", buffering=0) as file:
                        size = file.tell()
                        if file.write(lines.encode()) < len(lines.encode()):
                            file.truncate(size)
                            raise OSError(28, "No space left on device")
                finally:
                    self.lock.release()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error


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
            return JournalStorage(_Journal(path))
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        except (ValueError, KeyError) as error:
            raise InputError(f"{path}: is damaged, or no journal of Optuna's: {error}") from error
    try:
        with quiet():
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
    study = new_study(settings, storage=storage, study_name=name)
    if "identity" not in study.user_attrs:
        study.set_user_attr("identity", dict(identity))
    if not study.get_trials(deepcopy=False):
        for point in starts:
            study.enqueue_trial(dict(point), skip_if_exists=True)
    return study


def check_study(storage: BaseStorage, name: str, identity: Mapping[str, Any]) -> None:
    """Raise InputError, saying what differs, where a storage holds another study of a name."""
    if name not in [study.study_name for study in storage.get_all_studies()]:
        return
    study = optuna.load_study(study_name=name, storage=storage)
    unlike = differences(study.user_attrs.get("identity", identity), identity)
    if unlike:
        raise InputError(
            f"study {name}: the storage holds another study of this name ({'; '.join(unlike[:5])});"
            " nothing was changed; name another directory with --out, or another storage"
        )


@contextmanager
def storage_errors(url: str | None) -> Iterator[None]:
    """What a storage complains of while a study runs, as InputError."""
    try:
        yield
    except StorageInternalError as error:
        where = f"--storage {url}" if url else JOURNAL_NAME
        raise InputError(
            f"{where}: {_reason(error)}; complete trials are kept, repeat the command to go on"
        ) from error


def _reason(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(getattr(error, "orig", error)).splitlines() or [type(error).__name__]
    return str(lines[0])
