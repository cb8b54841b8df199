"""Shared studies while nothing goes wrong: totals, what Optuna reads, lists, exports."""

from __future__ import annotations

import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import optuna
import pytest

from egolane_pgm.tune._connection import Link
from egolane_pgm.tune.address import parse
from egolane_pgm.tune.exporting import export_study
from egolane_pgm.tune.postgres import account, list_studies, read_trials
from egolane_pgm.tune.shared import run_shared
from egolane_pgm.tune.storage import journal_storage
from egolane_pgm.tune.study import run_study
from egolane_pgm.types import InputError
from tests.kits.postgres_kit import (
    GUARDED,
    PASSWORD,
    SPACE,
    START,
    TRIALS,
    address_with_password,
    finished,
    is_whole,
    make_job,
    rows,
    start,
    twice,
    wait_for,
    wait_for_trials,
)
from tests.kits.postgres_server import Server
from tests.kits.tuning_kit import bowl, told

pytest_plugins = ["tests.kits.postgres_fixtures"]


def for_ever(points: Any) -> Any:
    """Until the machine is gone, whose child a worker is."""
    parent = os.getppid()
    while os.getppid() == parent:
        time.sleep(0.02)
    os._exit(0)


def study_of(url: str, name: str) -> optuna.Study:
    return optuna.load_study(study_name=name, storage=url)


@pytest.mark.parametrize("sampler", ["evolution", "random", "tpe", "cma-es"])
def test_two_workers_together_do_exactly_as_many_trials_as_asked_for(
    sampler: str, server: Server, shared: str, name: str
) -> None:
    trials = TRIALS if sampler in ("evolution", "random") else 30
    run_shared(make_job(shared, name, sampler, trials, bowl), 2)
    is_whole(server, shared, name, trials, sampler)
    assert finished(server, shared, name)[0][0] == list(START.values())


def test_several_objectives_are_kept(server: Server, shared: str, name: str) -> None:
    run_shared(make_job(shared, name, "nsga2", 20, twice), 2)
    study = study_of(shared, name)
    assert [d.name for d in study.directions] == ["MAXIMIZE", "MAXIMIZE"]
    assert all(t.values == list(twice([t.params])[0]) for t in study.trials)
    assert len(study.trials) == 20


def test_optuna_reads_what_was_written_and_so_do_we(server: Server, shared: str, name: str) -> None:
    job = make_job(shared, name, trials=60, evaluate=bowl)
    run_shared(job, 2)
    link = Link(job.address)
    mine = read_trials(link, job.tasks[0].kept.study_id, SPACE)
    theirs = study_of(shared, name)
    assert told(theirs.trials) == told(mine)
    for a, b in zip(theirs.trials, mine, strict=True):
        assert a.distributions == b.distributions
        assert (a.datetime_start, a.datetime_complete) == (b.datetime_start, b.datetime_complete)
        assert a.user_attrs == b.user_attrs
        assert a.number == b.number
    assert theirs.best_value == max(t.values[0] for t in mine)
    assert theirs.user_attrs["identity"] == {"seed": 0}
    link.close()


def test_one_worker_searches_as_one_process_does(server: Server, shared: str, name: str) -> None:
    run_shared(make_job(shared, name, evaluate=bowl), 1)
    job = make_job(shared, name)
    expected = run_study(SPACE, bowl, job.tasks[0].settings, starts=[START])
    assert told(study_of(shared, name).trials) == told(expected.trials)


def test_a_study_goes_on_to_a_larger_total_and_a_finished_one_is_left_as_it_is(
    server: Server, shared: str, name: str
) -> None:
    run_shared(make_job(shared, name, trials=30, evaluate=bowl), 2)
    before = finished(server, shared, name)
    run_shared(make_job(shared, name, trials=50, evaluate=bowl), 2)
    after = finished(server, shared, name)
    assert {n: after[n] for n in before} == before
    is_whole(server, shared, name, 50)
    begun = rows(server, shared, f"SELECT count(*) FROM egolane_workers WHERE job = '{name}'")
    run_shared(make_job(shared, name, trials=40, evaluate=bowl), 2)
    assert finished(server, shared, name) == after
    assert rows(server, shared, f"SELECT count(*) FROM egolane_workers WHERE job = '{name}'") == (
        begun
    )


def test_another_identity_is_refused_and_nothing_changed(
    server: Server, shared: str, name: str
) -> None:
    make_job(shared, name, trials=10)
    with pytest.raises(InputError, match=r"identity\.seed: 0, here 1"):
        make_job(shared, name, trials=20, identity={"seed": 1})
    query = f"SELECT asked FROM egolane_studies WHERE job = '{name}'"
    assert rows(server, shared, query) == [(10,)]


@pytest.mark.parametrize("grace_s", [float("inf"), float("nan"), 1e300, 86_401.0, 0.0])
def test_a_grace_period_that_would_break_the_list_of_everybody_is_refused(
    server: Server, shared: str, name: str, grace_s: float
) -> None:
    make_job(shared, f"{name}_before", trials=8, evaluate=bowl)
    with pytest.raises(InputError, match=r"--grace: .* s is not above 0 and at most 86400"):
        make_job(shared, name, trials=8, evaluate=bowl, grace_s=grace_s)
    link = Link(parse(shared))
    assert name not in [line.job for line in list_studies(link)]
    link.close()


def test_more_trials_than_the_storage_counts_are_refused(
    server: Server, shared: str, name: str
) -> None:
    with pytest.raises(InputError, match=f"{name}: trials: 2147483648 is more than"):
        make_job(shared, name, trials=2**31, evaluate=bowl)


def test_a_study_that_optuna_alone_made_is_refused(server: Server, shared: str, name: str) -> None:
    make_job(shared, f"{name}a")
    optuna.create_study(study_name=name, storage=shared)
    with pytest.raises(InputError, match=f"holds another study named {name}"):
        make_job(shared, name)


def test_optuna_may_delete_a_study(server: Server, shared: str, name: str) -> None:
    run_shared(make_job(shared, name, trials=10, evaluate=bowl), 1)
    optuna.delete_study(study_name=name, storage=shared)
    assert name not in [s.name for s in list_studies(Link(parse(shared)))]
    run_shared(make_job(shared, name, trials=12, evaluate=bowl), 1)
    is_whole(server, shared, name, 12)


def test_the_list_has_progress_rate_workers_and_the_best_score(
    server: Server, shared: str, name: str
) -> None:
    job = make_job(shared, name, trials=24, evaluate=bowl)
    link = Link(job.address)

    def line() -> Any:
        return next(s for s in list_studies(link) if s.name == name)

    assert (line().finished, line().asked, line().workers, line().best) == (0, 24, 0, None)
    run_shared(make_job(shared, name, trials=16, evaluate=bowl), 1)
    run_shared(job, 1)
    done = line()
    assert (done.finished, done.running, done.lost, done.workers) == (24, 0, 0, 0)
    assert done.rate is not None
    assert done.rate > 24 / 60
    query = f"UPDATE egolane_studies SET created = created - interval '1 h' WHERE job = '{name}'"
    rows(server, shared, query)
    assert line().rate == pytest.approx(24 / 60)
    assert done.best == max(t.values[0] for t in study_of(shared, name).trials)
    assert done.objective == "accuracy"
    waiting = start(run_shared, make_job(shared, name, trials=60, evaluate=for_ever), 2)
    wait_for(lambda: line().running >= 12)
    assert line().workers == 2
    waiting.kill()
    waiting.join()
    link.close()


@pytest.mark.parametrize("end", ["db", "journal"])
def test_an_export_has_the_same_trials(
    end: str, server: Server, shared: str, name: str, tmp_path: Path
) -> None:
    run_shared(make_job(shared, name, trials=30, evaluate=bowl), 2)
    link, path = Link(parse(shared)), tmp_path / f"out.{end}"
    assert export_study(link, name, path) == 30
    assert [p.name for p in tmp_path.iterdir() if not p.name.endswith(".lock")] == [path.name]
    path.rename(tmp_path / f"study.{end}")
    storage = journal_storage(tmp_path) if end == "journal" else f"sqlite:///{tmp_path}/study.db"
    study = optuna.load_study(study_name=name, storage=storage)
    theirs = study_of(shared, name)
    assert told(study.trials) == told(theirs.trials)
    for a, b in zip(study.trials, theirs.trials, strict=True):
        assert a.user_attrs == b.user_attrs
        assert a.datetime_complete == b.datetime_complete
    assert study.user_attrs == theirs.user_attrs
    with pytest.raises(InputError, match=r"no study .*did you mean"):
        export_study(link, f"{name}x", tmp_path / "b.db")
    with pytest.raises(InputError, match=r"ends in \.db"):
        export_study(link, name, tmp_path / "b.txt")
    with pytest.raises(InputError, match="is there already"):
        export_study(link, name, tmp_path / f"study.{end}")
    with pytest.raises(InputError, match="no folder"):
        export_study(link, name, tmp_path / "nowhere" / "b.db")
    if Path("/proc/self").is_dir():
        with pytest.raises(InputError, match=r"/proc/b\.db: cannot be written"):
            export_study(link, name, Path("/proc/b.db"))
    link.close()


def test_a_short_trial_costs_a_small_part_of_a_transaction(server: Server, database: str) -> None:
    make_job(database, "drive", trials=1, evaluate=bowl)
    base = database.rpartition("/")[2]
    query = f"SELECT xact_commit + xact_rollback FROM pg_stat_database WHERE datname = '{base}'"

    def count() -> int:
        # A session reports what it did when it ends.
        wait_for(
            lambda: not server.execute(f"SELECT 1 FROM pg_stat_activity WHERE datname = '{base}'")
        )
        return int(server.execute(query)[0][0])

    before = count()
    run_shared(make_job(database, "drive", trials=800, evaluate=bowl), 1)
    assert (count() - before) / 800 < 0.2


def test_what_a_worker_refuses_is_said_once_and_its_trials_go_to_others(
    server: Server, shared: str, name: str
) -> None:
    def refuse(points: Any) -> Any:
        raise InputError("evidence: frame 3 has a negative or NaN value")

    with pytest.raises(InputError, match="frame 3 has a negative"):
        run_shared(make_job(shared, name, trials=20, evaluate=refuse), 2)
    run_shared(make_job(shared, name, trials=20, evaluate=bowl), 2)
    is_whole(server, shared, name, 20)


def test_a_password_in_the_address_is_taken_and_never_shown(
    server: Server, shared: str, name: str
) -> None:
    url = address_with_password(shared)
    job = make_job(url, name, trials=10, evaluate=bowl)
    run_shared(job, 1)
    is_whole(server, shared, name, 10)
    assert PASSWORD not in repr(job)
    assert job.address.shown == shared.replace("egolane@", f"{GUARDED}:***@")
    wrong = url.replace("s3cret", "s4cret")
    with pytest.raises(InputError) as caught:
        make_job(wrong, name)
    assert "s4cret" not in str(caught.value)
    assert "password authentication failed" in str(caught.value)
    assert caught.value.__cause__ is None


def test_the_account_tells_retries_from_double_counts(
    server: Server, shared: str, name: str
) -> None:
    process = start(run_shared, make_job(shared, name, trials=40), 2)
    wait_for_trials(server, shared, name)
    process.kill()
    process.join()
    rows(server, shared, f"UPDATE egolane_workers SET seen = '-infinity' WHERE job = '{name}'")
    run_shared(make_job(shared, name, trials=40, evaluate=bowl), 2)
    link = Link(parse(shared))
    found = account(link, name)
    assert (found.finished, found.running, found.counted_twice) == (40, 0, 0)
    assert found.lost == found.retried
    attrs = [t.user_attrs.get("retry_of") for t in study_of(shared, name).trials]
    lost = [t.number for t in study_of(shared, name).trials if t.state.name == "FAIL"]
    assert Counter(a for a in attrs if a is not None) == Counter(lost)
    query = f"UPDATE trials SET state = 'COMPLETE' WHERE state = 'FAIL' AND study_id = ({_ID})"
    rows(server, shared, query.format(name=name))
    assert account(link, name).counted_twice == len(lost)
    link.close()


_ID = "SELECT study_id FROM studies WHERE study_name = '{name}'"
