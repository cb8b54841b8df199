"""Where a study is kept: Optuna's journal next to the results, or any other storage of Optuna's.

Optuna's own commands, its dashboard and `optuna.load_study` read all of them.
"""

from __future__ import annotations

import json
import os
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
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from egolane_pgm.tools.files import make_directory
from egolane_pgm.tuning.search import Settings, new_study
from egolane_pgm.tuning.space import Point, differences
from egolane_pgm.types import InputError
from egolane_pgm.views.study_trials import quiet

JOURNAL_NAME = "study.journal"

#: Seconds between signs of life of a worker on a database, and until it is taken for dead.
HEARTBEAT_S, GRACE_S = 15, 60


def open_storage(url: str | None, directory: Path) -> BaseStorage:
    """Open the storage of a study.

    - url: of a database, as Optuna takes it (`sqlite:///...`, `postgresql://...`, `mysql://...`);
      None for the journal in `directory`.

    Raises InputError, one line, where that fails.
    """
    try:
        if url is None:
            make_directory(directory)
            return JournalStorage(_Journal(directory / JOURNAL_NAME))
        with quiet():
            return RDBStorage(
                url,
                heartbeat_interval=HEARTBEAT_S,
                grace_period=GRACE_S,
                heartbeat_stale_trial_callback=RetryHeartbeatStaleTrialCallback(),
            )
    except InputError:
        raise
    except ImportError as error:
        name = error.name or getattr(error.__cause__, "name", None)
        raise InputError(f"{_named(url)}: needs the package {name}: pip install {name}") from error
    # Whatever a database's driver raises (no such host, user or file), or Optuna where somebody
    # changed a journal.
    except Exception as error:
        journal = f"{directory / JOURNAL_NAME}: cannot be used as Optuna's journal"
        raise InputError(f"{journal if url is None else _named(url)}: {_reason(error)}") from error


class _Journal(JournalFileBackend):
    """Optuna's journal, without waiting for the disk after each of the dozen lines of a trial,
    which would take longer than the trial. A machine that loses power loses its last seconds."""

    def __init__(self, path: Path) -> None:
        # A lock that is held for five seconds was left by a process that was killed.
        self.path, self.lock = path, JournalFileOpenLock(str(path), grace_period=5)
        super().__init__(str(path), self.lock)
        with self._alone():
            content = path.read_bytes()
            if not content.endswith(b"\n"):
                # The half line of such a process. Optuna would write the next one behind it.
                os.truncate(path, content.rfind(b"\n") + 1)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        with self._alone(), self.path.open("ab") as file:
            file.writelines(json.dumps(log).encode() + b"\n" for log in logs)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        self.lock.acquire()
        try:
            yield
        finally:
            self.lock.release()


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
    if not study.get_trials(deepcopy=False) and not study.user_attrs:
        # Whoever began it was stopped at once.
        return
    # Studies without a part once had the number of trials among it, which may grow.
    before = {k: v for k, v in study.user_attrs.get("identity", {}).items() if k != "trials"}
    unlike = differences(before, identity)
    if unlike:
        raise InputError(
            f"study {name}: the storage holds another study of this name ({'; '.join(unlike[:5])});"
            " nothing was changed; name another directory, or another storage"
        )


def check_place(url: str | None, directory: Path, name: str, identity: Mapping[str, Any]) -> None:
    """As `check_study`, for the storage that `open_storage` would open; none is made."""
    if url is not None or (directory / JOURNAL_NAME).exists():
        with storage_errors(url):
            check_study(open_storage(url, directory), name, identity)


@contextmanager
def storage_errors(url: str | None) -> Iterator[None]:
    """What a storage complains of while a study runs, as InputError: a database that went away, a
    full disk. Optuna may raise an error of its own over it."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        first: BaseException = error
        while not isinstance(first, (OSError, SQLAlchemyError, StorageInternalError)):
            if first.__context__ is None:
                raise
            first = first.__context__
        kept = "complete trials are kept, repeat the command to go on"
        raise InputError(f"{_named(url)}: {_reason(first)}; {kept}") from error


def _named(url: str | None) -> str:
    """A storage in a message, without its password."""
    if url is None:
        return JOURNAL_NAME
    try:
        return f"storage: {make_url(url).set(query={}).render_as_string()}"
    except SQLAlchemyError:
        return "storage"


def _reason(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(getattr(error, "orig", error)).splitlines() or [type(error).__name__]
    return str(lines[0])
