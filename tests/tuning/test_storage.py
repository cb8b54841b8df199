"""Where studies are kept: what survives, what is refused, and that Optuna reads it."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from egolane_pgm.tuning import storage as module
from egolane_pgm.tuning.search import Settings, n_complete, search, search_in_memory
from egolane_pgm.tuning.storage import (
    JOURNAL_NAME,
    check_study,
    open_storage,
    open_study,
    storage_errors,
)
from egolane_pgm.types import InputError
from tests.kits.tuning_kit import bowl, plain_space, told

SPACE = plain_space()
IDENTITY = {"space": {"searched": {"x0": [0.0, 1.0]}}, "seed": 0}


def settings(trials: int) -> Settings:
    return Settings(("accuracy",), "evolution", trials, 0)


def study_in(place: Path | str, trials: int = 30, identity: Any = IDENTITY) -> optuna.Study:
    """A study in a journal below a folder, or in a database."""
    url, folder = (place, Path()) if isinstance(place, str) else (None, place)
    return open_study(open_storage(url, folder), "drive", settings(trials), identity)


@pytest.fixture(params=["journal", "sqlite"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    return tmp_path if request.param == "journal" else f"sqlite:///{tmp_path}/study.db"


def test_a_study_goes_on_to_a_larger_total_as_if_it_had_not_stopped(place: Path | str) -> None:
    whole = told(search_in_memory(SPACE, bowl, settings(65)).trials)
    for trials in (33, 65):
        search(study_in(place), SPACE, bowl, settings(trials))
    assert told(study_in(place).trials) == whole


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("step", ["create_new_trial", "set_trial_param", "set_trial_state_values"])
def test_an_interruption_comes_out_as_itself_wherever_it_meets_the_storage(
    place: Path | str, step: str, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = told(search_in_memory(SPACE, bowl, settings(15)).trials)
    study = study_in(place)
    original = getattr(study._storage, step)
    calls = itertools.count()

    def interrupted(*given: Any, **named: Any) -> Any:
        if next(calls) == 7:
            raise error
        return original(*given, **named)

    monkeypatch.setattr(study._storage, step, interrupted)
    with pytest.raises(error):
        search(study, SPACE, bowl, settings(15))
    again = study_in(place)
    search(again, SPACE, bowl, settings(15))
    assert told(again.get_trials(states=(TrialState.COMPLETE,))) == whole


def test_an_interruption_at_the_lock_of_a_journal_comes_out_as_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = study_in(tmp_path)
    original = os.open
    calls = itertools.count()

    def interrupted(path: Any, *given: Any, **named: Any) -> int:
        if str(path).endswith(".lock") and next(calls) == 50:
            raise KeyboardInterrupt
        return original(path, *given, **named)

    monkeypatch.setattr(os, "open", interrupted)
    with pytest.raises(KeyboardInterrupt):
        search(study, SPACE, bowl, settings(15))
    assert next(calls) > 50


@pytest.mark.parametrize("step", ["acquire", "release"])
def test_ctrl_c_at_the_lock_of_a_journal_leaves_no_lock_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    monkeypatch.setattr(module, "LOCK_GRACE_S", 60)
    study = study_in(tmp_path)
    original = getattr(module._Lock, step)
    calls = itertools.count()

    def interrupted(lock: module._Lock) -> Any:
        if step == "release" and next(calls) == 50:
            signal.raise_signal(signal.SIGINT)
        found = original(lock)
        if step == "acquire" and next(calls) == 50:
            signal.raise_signal(signal.SIGINT)
        return found

    monkeypatch.setattr(module._Lock, step, interrupted)
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        search(study, SPACE, bowl, settings(15))
    assert time.monotonic() - begun < 30
    assert next(calls) > 50
    assert sorted(path.name for path in tmp_path.iterdir()) == [JOURNAL_NAME]


def test_the_lock_of_a_journal_has_no_second_name_that_a_kill_would_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rename(*given: Any) -> None:
        raise AssertionError(given)

    study = study_in(tmp_path)
    monkeypatch.setattr(os, "rename", rename)
    search(study, SPACE, bowl, settings(3))
    assert [path.name for path in tmp_path.iterdir()] == [JOURNAL_NAME]


def test_optuna_reads_the_journal_and_copies_it_to_a_database(tmp_path: Path) -> None:
    search(study_in(tmp_path), SPACE, bowl, settings(20))
    journal = JournalStorage(JournalFileBackend(str(tmp_path / JOURNAL_NAME)))
    study = optuna.load_study(study_name=None, storage=journal)
    assert study.study_name == "drive"
    assert study.metric_names == ["accuracy"]
    assert study.user_attrs["identity"] == IDENTITY
    base = f"sqlite:///{tmp_path}/study.db"
    optuna.copy_study(from_study_name="drive", from_storage=journal, to_storage=base)
    copy = optuna.load_study(study_name="drive", storage=base)
    assert told(copy.trials) == told(study.trials)
    assert copy.trials[3].datetime_start == study.trials[3].datetime_start


def test_known_points_are_tried_once_however_often_a_study_is_opened(tmp_path: Path) -> None:
    start = {"x0": 0.3, "x1": 0.3, "x2": 0.3}
    for _ in range(3):
        made = open_study(open_storage(None, tmp_path), "drive", settings(9), IDENTITY, [start])
    search(made, SPACE, bowl, settings(9))
    assert [t.params for t in made.trials].count(start) == 1
    assert made.best_trial.number == 0


def test_another_search_space_under_the_same_name_is_refused_and_nothing_changed(
    tmp_path: Path,
) -> None:
    search(study_in(tmp_path), SPACE, bowl, settings(5))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    other = {"space": {"searched": {"x0": [0.0, 0.5]}}, "seed": 0}
    with pytest.raises(InputError) as caught:
        study_in(tmp_path, identity=other)
    assert "space.searched.x0: [0.0, 1.0], now [0.0, 0.5]" in str(caught.value)
    assert "seed" not in str(caught.value)
    with pytest.raises(InputError, match="holds another study"):
        check_study(open_storage(None, tmp_path), "drive", other)
    check_study(open_storage(None, tmp_path), "drive", IDENTITY)
    check_study(open_storage(None, tmp_path), "another name", other)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def share(place: Path | str, worker: int, trials: int) -> None:
    def slow(point: Any) -> list[float]:
        time.sleep(0.01)
        return bowl(point)

    search(study_in(place), SPACE, slow, settings(trials), worker=worker)


def test_processes_share_a_study(place: Path | str) -> None:
    study_in(place)
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=share, args=(place, k, 40)) for k in range(2)]
    for process in workers:
        process.start()
    for process in workers:
        process.join()
        assert process.exitcode == 0
    trials = study_in(place).trials
    assert 40 <= len(trials) <= 41
    assert all(t.state == TrialState.COMPLETE for t in trials)
    points = [tuple(t.params.values()) for t in trials]
    assert len(points) == len(set(points))
    # Both were at work at the same time.
    starts = sorted((t.datetime_start, t.datetime_complete) for t in trials)
    assert any(b[0] < a[1] for a, b in itertools.pairwise(starts))


def test_what_a_killed_worker_was_at_is_tried_again_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = f"sqlite:///{tmp_path}/study.db"
    code = (
        "import time\n"
        "from tests.tuning.test_storage import *\n"
        "module.HEARTBEAT_S = 1\n"
        "search(study_in({!r}), SPACE, lambda p: time.sleep(60) or [0.0], settings(9))\n"
    )
    study = study_in(place)
    with subprocess.Popen([sys.executable, "-c", code.format(place)]) as worker:
        deadline = time.monotonic() + 60
        while not any(len(t.params) == 3 for t in study.trials) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.5)
        worker.kill()
    time.sleep(2.5)
    monkeypatch.setattr(module, "HEARTBEAT_S", 1)
    monkeypatch.setattr(module, "GRACE_S", 2)
    search(study_in(place), SPACE, bowl, settings(9))
    first, *others = study_in(place).trials
    assert first.state == TrialState.FAIL
    assert [t.params for t in others].count(first.params) == 1
    assert n_complete(study) == 9


def test_a_file_that_is_no_journal_or_database_is_one_clear_line(tmp_path: Path) -> None:
    for name in (JOURNAL_NAME, "study.db"):
        (tmp_path / name).write_text("this is no database\n" * 100)
    with pytest.raises(InputError, match=r"study\.journal: line 1: is damaged, or no journal of"):
        open_storage(None, tmp_path)
    with pytest.raises(InputError, match="file is not a database"):
        open_storage(f"sqlite:///{tmp_path}/study.db", tmp_path)


def test_memory_that_ends_is_no_damage_of_a_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(module, "JournalStorage", fails)
    with pytest.raises(MemoryError):
        open_storage(None, tmp_path)


NOT_JSON, UNKNOWN, NO_TRIAL = b"{half\n", b'{"op_code":5}\n', b"[]\n"


@pytest.mark.parametrize("damage", [NOT_JSON, UNKNOWN, NO_TRIAL, b"\xff\n"])
@pytest.mark.parametrize("line", [1, 20, -1])
def test_a_damaged_line_of_a_journal_is_named_and_what_is_before_it_is_gone_on_with(
    tmp_path: Path, damage: bytes, line: int
) -> None:
    search(study_in(tmp_path), SPACE, bowl, settings(5))
    journal = tmp_path / JOURNAL_NAME
    lines = journal.read_bytes().splitlines(keepends=True)
    number = line if line > 0 else len(lines)
    lines[number - 1] = damage
    journal.write_bytes(b"".join(lines))
    with pytest.raises(InputError, match=rf"study\.journal: line {number}: is damaged") as caught:
        study_in(tmp_path)
    (said,) = caught.value.lines
    assert journal.read_bytes() == b"".join(lines)
    subprocess.run(said.partition("before that line: ")[2], shell=True, check=True)
    assert journal.read_bytes() == b"".join(lines[: number - 1])
    search(study_in(tmp_path), SPACE, bowl, settings(5))
    assert n_complete(study_in(tmp_path)) == 5


def test_the_half_line_of_a_process_that_was_killed_is_cut_off(tmp_path: Path) -> None:
    search(study_in(tmp_path), SPACE, bowl, settings(5))
    journal = tmp_path / JOURNAL_NAME
    whole = journal.read_bytes()
    journal.write_bytes(whole + whole[:40])
    search(study_in(tmp_path), SPACE, bowl, settings(7))
    assert journal.read_bytes().startswith(whole + b'{"op_code":')
    assert n_complete(study_in(tmp_path)) == 7


def test_a_trial_that_no_search_has_made_is_one_clear_line(tmp_path: Path) -> None:
    study = study_in(tmp_path)
    study.add_trial(optuna.trial.create_trial(value=0.5))
    with pytest.raises(InputError, match="trial 0 is complete without its scores or parameters"):
        study_in(tmp_path)


def test_a_database_is_made_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(*_: Any) -> None:
        assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".")] == []
        raise KeyboardInterrupt

    place = f"sqlite:///{tmp_path}/study.db"
    with monkeypatch.context() as patched:
        patched.setattr("optuna.storages._rdb.models.BaseModel.metadata.create_all", half)
        with pytest.raises(KeyboardInterrupt):
            study_in(place)
    assert list(tmp_path.iterdir()) == []
    study_in(place)
    assert [p.name for p in tmp_path.iterdir()] == ["study.db"]


@pytest.mark.skipif(sys.platform == "win32", reason="folders have no locks")
def test_a_kill_after_a_database_is_made_leaves_nothing_once_it_is_opened(tmp_path: Path) -> None:
    place = f"sqlite:///{tmp_path}/study.db"
    code = (
        "import os, signal\n"
        "from tests.tuning.test_storage import *\n"
        "link = os.link\n"
        "os.link = lambda *given: (link(*given), os.kill(os.getpid(), signal.SIGKILL))\n"
        "study_in({!r})\n"
    )
    killed = subprocess.run([sys.executable, "-c", code.format(place)])
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2
    study_in(place)
    assert [p.name for p in tmp_path.iterdir()] == ["study.db"]


@pytest.mark.parametrize("name", ["a?b", "a#b", "a%41b", "a b", "a:b"])
def test_a_study_lies_where_it_is_said_whatever_the_name(tmp_path: Path, name: str) -> None:
    search(study_in(tmp_path / name), SPACE, bowl, settings(2))
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert [p.name for p in (tmp_path / name).iterdir()] == [JOURNAL_NAME]


@pytest.mark.parametrize("address", ["nonsense", "nosuch://h/d", "sqlite:////no/such/place/x.db"])
def test_a_storage_that_cannot_be_opened_is_one_clear_line(address: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"--storage {address}: ") as caught:
        open_storage(address, tmp_path)
    assert "\n" not in str(caught.value)


def test_a_database_without_its_driver_says_what_to_install(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"needs the package \w+: pip install \w+"):
        open_storage("oracle+oracledb://h/d", tmp_path)


def test_a_database_that_is_locked_is_one_clear_line(tmp_path: Path) -> None:
    place = f"sqlite:///{tmp_path}/study.db?timeout=0.1"
    study = study_in(place)
    other = sqlite3.connect(tmp_path / "study.db", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InputError, match="database is locked"), storage_errors(place):
        search(study, SPACE, bowl, settings(9))
    other.execute("ROLLBACK")
    other.close()
    search(study_in(place), SPACE, bowl, settings(9))
    assert n_complete(study) == 9


@contextmanager
def disk_with(n_bytes: int) -> Iterator[None]:
    """Files that may grow to a size only."""
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, limit[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_one_clear_line_and_what_was_finished_stays(tmp_path: Path) -> None:
    whole = told(search_in_memory(SPACE, bowl, settings(40)).trials)
    search(study_in(tmp_path), SPACE, bowl, settings(10))
    size = (tmp_path / JOURNAL_NAME).stat().st_size
    with (
        disk_with(size + 2020),
        pytest.raises(InputError, match=r"study\.journal: cannot be written: No space left"),
    ):
        search(study_in(tmp_path), SPACE, bowl, settings(40))
    assert not list(tmp_path.glob("*.lock"))
    search(study_in(tmp_path), SPACE, bowl, settings(40))
    done = study_in(tmp_path).get_trials(states=(TrialState.COMPLETE,))
    assert told(done)[:10] == whole[:10]
    assert len(done) == 40


def test_a_killed_process_leaves_a_journal_to_go_on_with(tmp_path: Path) -> None:
    code = (
        "from tests.tuning.test_storage import *\n"
        "search(study_in(Path({!r})), SPACE, bowl, settings(100000))\n"
    )
    with subprocess.Popen([sys.executable, "-c", code.format(str(tmp_path))]) as first:
        journal, deadline = tmp_path / JOURNAL_NAME, time.monotonic() + 60
        while time.monotonic() < deadline:
            if journal.exists() and journal.stat().st_size > 50_000:
                break
            time.sleep(0.01)
        first.kill()
    before = n_complete(study_in(tmp_path))
    assert before > 10
    search(study_in(tmp_path), SPACE, bowl, settings(before + 10))
    assert n_complete(study_in(tmp_path)) == before + 10


def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created: Not a directory"):
        open_storage(None, tmp_path / "file" / "x")
