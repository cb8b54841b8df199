"""Where studies are kept: what survives, what is refused, and that Optuna reads it."""

from __future__ import annotations

import resource
import signal
import sqlite3
from pathlib import Path
from typing import Any

import optuna
import pytest

from egolane_pgm.tune import storage
from egolane_pgm.tune.storage import SqliteStore, journal_storage, only_one, stored_identity
from egolane_pgm.tune.study import Settings, run_study
from egolane_pgm.types import InputError
from tests.kits.tuning_kit import bowl, plain_space, told

SPACE = plain_space()
IDENTITY = {"space": {"searched": {"x0": [0.0, 1.0]}}, "seed": 0}


def settings(trials: int) -> Settings:
    return Settings(("accuracy",), "evolution", trials, 0)


def store(folder: Path, identity: Any = IDENTITY) -> SqliteStore:
    return SqliteStore(folder, "drive", identity, ["maximize"])


def test_optuna_reads_what_was_written_and_so_do_we(tmp_path: Path) -> None:
    with store(tmp_path) as kept:
        done = run_study(SPACE, bowl, settings(70), store=kept)
        assert kept.is_known
    assert not list(tmp_path.glob("*-wal"))
    study = optuna.load_study(study_name="drive", storage=f"sqlite:///{tmp_path}/study.db")
    assert told(study.trials) == told(done.trials)
    assert [t.number for t in study.trials] == list(range(70))
    assert study.best_value == done.best_value
    assert study.trials[3].distributions == done.trials[3].distributions
    assert study.trials[3].datetime_complete == done.trials[3].datetime_complete
    with store(tmp_path) as kept:
        assert told(kept.finished()) == told(done.trials)


def test_a_schema_that_is_not_known_is_written_by_optuna_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(storage._COLUMNS, "trials", {"another"})
    with store(tmp_path) as kept:
        assert not kept.is_known
        done = run_study(SPACE, bowl, settings(33), store=kept)
        assert told(kept.finished()) == told(done.trials)


def test_a_study_goes_on_to_a_larger_total(tmp_path: Path) -> None:
    whole = told(run_study(SPACE, bowl, settings(100)).trials)
    for trials in (40, 100):
        with store(tmp_path) as kept:
            run_study(SPACE, bowl, settings(trials), store=kept)
    with store(tmp_path) as kept:
        assert told(kept.finished()) == whole


def test_another_search_space_under_the_same_name_is_refused_and_nothing_changed(
    tmp_path: Path,
) -> None:
    with store(tmp_path) as kept:
        run_study(SPACE, bowl, settings(30), store=kept)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    other = {"space": {"searched": {"x0": [0.0, 0.5]}}, "seed": 0}
    with pytest.raises(InputError) as caught:
        store(tmp_path, other)
    assert "space.searched.x0: [0.0, 1.0], now [0.0, 0.5]" in str(caught.value)
    assert "seed" not in str(caught.value)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_the_identity_is_read_without_writing(tmp_path: Path) -> None:
    assert stored_identity(tmp_path) is None
    store(tmp_path).close()
    before = sorted(p.name for p in tmp_path.iterdir())
    assert stored_identity(tmp_path) == IDENTITY
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_a_locked_database_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "PATIENCE_S", 0.1)
    with store(tmp_path) as kept:
        run_study(SPACE, bowl, settings(30), store=kept)
        other = sqlite3.connect(tmp_path / "study.db", isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(InputError, match=r"study\.db: the database is locked by another"):
            run_study(SPACE, bowl, settings(60), store=kept)
        other.execute("ROLLBACK")
        other.close()
        assert len(run_study(SPACE, bowl, settings(60), store=kept).trials) == 60


def test_a_database_that_is_locked_from_the_start_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store(tmp_path).close()
    monkeypatch.setattr(storage, "PATIENCE_S", 0.1)
    other = sqlite3.connect(tmp_path / "study.db", isolation_level=None)
    other.execute("PRAGMA locking_mode=EXCLUSIVE")
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InputError, match="the database is locked"):
        store(tmp_path)
    other.close()


def test_a_file_that_is_no_database_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "study.db").write_text("this is no database " * 100)
    with pytest.raises(InputError, match=r"study\.db: file is not a database"):
        store(tmp_path)


def test_a_full_disk_is_one_clear_line_and_what_was_finished_stays(tmp_path: Path) -> None:
    with store(tmp_path) as kept:
        run_study(SPACE, bowl, settings(30), store=kept)
        pages = kept.base.execute("PRAGMA page_count").fetchone()[0]
        kept.base.execute(f"PRAGMA max_page_count={pages + 2}")
        with pytest.raises(InputError, match="database or disk is full; finished trials"):
            run_study(SPACE, bowl, settings(3000), store=kept)
    with store(tmp_path) as kept:
        n = len(kept.finished())
        assert n >= 30
        assert n % 30 == 0
        assert len(run_study(SPACE, bowl, settings(n + 30), store=kept).trials) == n + 30


def test_a_journal_on_a_full_disk_is_one_clear_line(tmp_path: Path) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    study = optuna.create_study(storage=journal_storage(tmp_path), study_name="drive")
    study.add_trial(optuna.trial.create_trial(value=1.0))
    try:
        size = (tmp_path / "study.journal").stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 20, limit[1]))
        for _ in range(2):
            with pytest.raises(InputError, match=r"study\.journal: cannot be written"):
                study.add_trial(optuna.trial.create_trial(value=2.0))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)
    again = optuna.load_study(study_name="drive", storage=journal_storage(tmp_path))
    again.add_trial(optuna.trial.create_trial(value=3.0))
    assert [t.value for t in again.trials] == [1.0, 3.0]


def test_a_line_that_a_killed_process_left_half_written_is_cut(tmp_path: Path) -> None:
    study = optuna.create_study(storage=journal_storage(tmp_path), study_name="drive")
    study.add_trial(optuna.trial.create_trial(value=1.0))
    with (tmp_path / "study.journal").open("ab") as file:
        file.write(b'{"op_code": 4, "worker_id": "x", "st')
    study.add_trial(optuna.trial.create_trial(value=2.0))
    again = optuna.load_study(study_name="drive", storage=journal_storage(tmp_path))
    assert [t.value for t in again.trials] == [1.0, 2.0]


def test_a_study_belongs_to_one_command_at_a_time(tmp_path: Path) -> None:
    with (
        only_one(tmp_path),
        pytest.raises(InputError, match="another process is at work"),
        only_one(tmp_path, 0.1),
    ):
        pass
    with only_one(tmp_path, 0.1):
        pass


def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"), only_one(tmp_path / "file" / "x"):
        pass
    with pytest.raises(InputError, match="cannot be written"), only_one(Path("/proc/nothing/x")):
        pass
