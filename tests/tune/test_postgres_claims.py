"""What a worker hears of the others' results, what it takes of their trials, and what whoever looks
after it makes of both."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import optuna
import pytest

from egolane_pgm.tune._claims import CLAIM, Claims, bury, enlist
from egolane_pgm.tune._connection import Link
from egolane_pgm.tune._proposers import make_proposer
from egolane_pgm.tune.address import parse
from egolane_pgm.tune.exporting import export_study
from egolane_pgm.tune.postgres import Part, begin_job
from egolane_pgm.tune.shared import SharedJob, Task, _look, run_shared
from egolane_pgm.tune.storage import journal_storage
from egolane_pgm.tune.study import Settings
from egolane_pgm.types import InputError
from tests.kits.postgres_kit import (
    SPACE,
    finished,
    is_whole,
    machine,
    make_job,
    rows,
    start,
    twice,
    wait_for_trials,
)
from tests.kits.postgres_server import Server
from tests.kits.tuning_kit import bowl

pytest_plugins = ["tests.kits.postgres_fixtures"]


def claims_of(job: SharedJob, worker: str) -> Claims:
    """A worker of the only study of a job."""
    link = job.link()
    enlist(link, worker, job.name, "here", 1)
    task = job.tasks[0]
    proposer = make_proposer(task.space, task.settings, task.starts, 1)
    return Claims(link, task.kept.study_id, worker, task.space, proposer)


def searching_for(objective: str, url: str, name: str, trials: int) -> SharedJob:
    """A random search for the most, or the least, of a score, or of several with blanks between."""
    chosen = Settings(tuple(objective.split()), "random", trials, 0)
    link = Link(parse(url))
    part = Part(name, "all", 0, 1, SPACE, chosen, {"identity": {}})
    [kept] = begin_job(link, name, [part], 30.0)
    link.close()
    return SharedJob(parse(url), name, [Task(kept, SPACE, bowl, chosen)])


def scored(claimed: Any, evaluate: Any = bowl) -> Any:
    rows = evaluate([c.point for c in claimed]).tolist()
    return list(zip(claimed, rows, strict=True))


def test_several_scores_of_others_are_heard_in_their_order_and_once(
    shared: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = make_job(shared, name, sampler="nsga2", trials=3 * CLAIM, evaluate=twice)
    first, second = claims_of(job, "a" * 12), claims_of(job, "b" * 12)
    heard: list[Any] = []
    monkeypatch.setattr(second.proposer, "learn", heard.extend)
    results = scored(first.exchange([]).claimed, twice)
    first.exchange(results)
    own = second.exchange([])
    right = {claimed.number: (dict(claimed.point), values) for claimed, values in results}
    assert {t.number: (dict(t.params), list(t.values)) for t in heard} == right
    assert len(heard) == len(results)
    heard.clear()
    results = scored(own.claimed, twice)
    second.exchange(results)
    # Its own results it has from itself, and those of the first worker it knows.
    assert sorted(t.number for t in heard) == sorted(c.number for c, _ in results)
    for claims in (first, second):
        claims.link.close()


def test_a_worker_that_leaves_takes_no_trial_of_one_that_died(
    server: Server, shared: str, name: str
) -> None:
    job = make_job(shared, name, trials=CLAIM)
    dead, leaving, other = (claims_of(job, letter * 12) for letter in "abc")
    taken = dead.exchange([]).claimed
    bury(other.link, ["a" * 12])
    assert leaving.exchange([], 0).claimed == []
    again = other.exchange([]).claimed
    assert [c.point for c in again] == [c.point for c in taken]
    # One trial is lost once, not once for each who looked at it.
    assert {c.number for c in again} == set(range(CLAIM, 2 * CLAIM))
    assert other.exchange(scored(again)).is_done
    is_whole(server, shared, name, CLAIM)
    for claims in (dead, leaving, other):
        claims.link.close()


@pytest.mark.parametrize("ending", ["db", "journal"])
def test_an_export_in_mid_study_is_a_whole_study_in_optunas_eyes(
    ending: str, shared: str, name: str, tmp_path: Path
) -> None:
    """Two scores of which one is to be small; the first trials are running still."""
    job = searching_for("accuracy log_loss", shared, name, trials=40)
    busy, done = claims_of(job, "a" * 12), claims_of(job, "b" * 12)
    busy.exchange([])
    results = scored(done.exchange([]).claimed, twice)
    done.exchange(results)
    link = job.link()
    path = tmp_path / f"study.{ending}"
    assert export_study(link, name, path) == len(results) == CLAIM
    storage = f"sqlite:///{path}" if ending == "db" else journal_storage(tmp_path)
    study = optuna.load_study(study_name=name, storage=storage)
    assert [direction.name for direction in study.directions] == ["MAXIMIZE", "MINIMIZE"]
    assert [trial.number for trial in study.trials] == list(range(CLAIM))
    assert [(t.params, t.values) for t in study.trials] == [(c.point, v) for c, v in results]
    assert list(study.user_attrs["space"]) == list(SPACE.keys)
    for one in (busy.link, done.link, link):
        one.close()


def slower(points: Any) -> Any:
    """Time enough to be killed in mid-trial."""
    time.sleep(0.02 * len(points))
    return bowl(points)


@pytest.mark.parametrize("n_workers", [1, 2])
def test_who_dies_here_is_noticed_and_replaced_long_before_the_grace_period(
    n_workers: int, server: Server, shared: str, name: str
) -> None:
    machine_ = start(machine, shared, name, n_workers, trials=40, evaluate=slower, grace_s=600)
    wait_for_trials(server, shared, name, 1)
    victim = int(Path(f"/proc/{machine_.pid}/task/{machine_.pid}/children").read_text().split()[0])
    os.kill(victim, signal.SIGKILL)
    machine_.join(40)
    assert machine_.exitcode == 0
    is_whole(server, shared, name, 40)


@pytest.mark.parametrize(("objective", "scores"), [("accuracy", (0.9, 0.5)), ("log_loss", (1, 3))])
def test_the_best_score_so_far_stays_when_worse_ones_come_later(
    objective: str, scores: tuple[float, float], shared: str, name: str
) -> None:
    job = searching_for(objective, shared, name, trials=2 * CLAIM)
    claims, link = claims_of(job, "a" * 12), job.link()
    seen: dict[int, int] = {}
    news: list[tuple[str, int, float]] = []
    claimed = claims.exchange([]).claimed
    for score in scores:
        answer = claims.exchange([(c, [float(score)]) for c in claimed])
        is_done = _look(job, link, seen, lambda *said: news.append(said))
        claimed = answer.claimed
        assert is_done == (not claimed)
    assert news == [(name, CLAIM, scores[0])] * 2
    for one in (claims.link, link):
        one.close()


@pytest.mark.parametrize("objective", ["accuracy", "log_loss"])
def test_progress_counts_every_trial_once_and_has_the_best_score(
    objective: str, server: Server, shared: str, name: str
) -> None:
    job = searching_for(objective, shared, name, trials=30)
    seen: list[tuple[str, int, float]] = []
    run_shared(job, 1, lambda *news: seen.append(news))
    assert {of for of, _, _ in seen} == {name}
    assert sum(count for _, count, _ in seen) == 30
    scores = [score for _, (score,) in finished(server, shared, name).values()]
    best = max(scores) if objective == "accuracy" else min(scores)
    assert min(scores) < max(scores)
    assert seen[-1][2] == best == job.best[job.tasks[0].kept.study_id]


def test_nobody_is_dead_for_what_was_not_heard_while_the_server_was_away(
    server: Server, shared: str, name: str
) -> None:
    """The server of the tests is younger than the grace period, the last word is older."""
    job = make_job(shared, name, trials=CLAIM, grace_s=24 * 3600.0)
    silent, other = claims_of(job, "e" * 12), claims_of(job, "f" * 12)
    taken = silent.exchange([]).claimed

    def last_heard(where: str) -> None:
        found = rows(
            server,
            shared,
            f"UPDATE egolane_workers SET seen = {where} WHERE worker = '{'e' * 12}' RETURNING 1",
        )
        assert found == [(1,)]

    last_heard("clock_timestamp() - interval '3 days'")
    assert other.exchange([]).claimed == []
    last_heard("'-infinity'")
    assert len(other.exchange([]).claimed) == len(taken)
    for one in (silent, other):
        one.link.close()


def test_a_study_that_was_removed_meanwhile_is_said_in_one_line(shared: str, name: str) -> None:
    claims = claims_of(make_job(shared, name), "a" * 12)
    claimed = claims.exchange([]).claimed
    optuna.delete_study(study_name=name, storage=shared)
    with pytest.raises(InputError, match="the study was removed meanwhile"):
        claims.exchange(scored(claimed))
    claims.link.close()
