"""Servers that stop, networks that are cut, workers that die, clocks that are wrong: no finished
trial lost, none counted twice, the total exactly as asked."""

from __future__ import annotations

import datetime
import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import psycopg
import pytest

from egolane_pgm.tune import _connection
from egolane_pgm.tune._claims import CLAIM, Claims, bury, enlist
from egolane_pgm.tune._connection import Link, connect
from egolane_pgm.tune._proposers import make_proposer
from egolane_pgm.tune.shared import SharedJob, run_shared
from egolane_pgm.types import InputError
from tests.kits.postgres_kit import (
    TRIALS,
    alone,
    finished,
    is_whole,
    machine,
    make_job,
    rows,
    start,
    states,
    wait_for_trials,
)
from tests.kits.postgres_server import Server, network
from tests.kits.tuning_kit import bowl

pytest_plugins = ["tests.kits.postgres_fixtures"]


MOMENTS = 20

#: Seconds without a word after which a worker of these tests is dead.
GRACE_S = 1.0


def slower(points: Any) -> Any:
    """Time enough to be killed in mid-trial."""
    time.sleep(0.005 * len(points))
    return bowl(points)


def children(pid: int) -> list[int]:
    return [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def claims_of(job: SharedJob, worker: str, link: Link | None = None) -> Claims:
    link = link or job.link()
    enlist(link, worker, job.name, "here", 1)
    task = job.tasks[0]
    proposer = make_proposer(task.space, task.settings, (), 1)
    return Claims(link, task.kept.study_id, worker, task.space, proposer)


def scored(claimed: Any) -> list[Any]:
    return [(c, list(bowl([c.point])[0])) for c in claimed]


@pytest.mark.parametrize("attempt", range(3))
def test_two_machines_that_start_the_same_study_at_once_have_one(
    attempt: int, server: Server, database: str
) -> None:
    # The tables are not there either: both make them.
    machines = [start(machine, database, "drive", trials=60, evaluate=bowl) for _ in range(2)]
    for process in machines:
        process.join(60)
    assert [process.exitcode for process in machines] == [0, 0]
    is_whole(server, database, "drive", 60)
    assert rows(server, database, "SELECT count(*) FROM studies") == [(1,)]
    assert rows(server, database, "SELECT count(*) FROM egolane_studies") == [(1,)]


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_one_of_four_workers_is_killed_in_mid_trial(
    moment: int, server: Server, shared: str, name: str
) -> None:
    rng = random.Random(moment)
    sampler = ("evolution", "random", "evolution", "tpe")[moment % 4]
    trials = TRIALS if sampler != "tpe" else 40
    options: dict[str, Any] = {"sampler": sampler, "trials": trials, "evaluate": slower}
    if moment % 2:
        # Nobody on its machine sees it die: the others hear nothing of it.
        job = make_job(shared, name, grace_s=0.7, **options)
        processes = [start(alone, job, f"{rng.getrandbits(48):012x}") for _ in range(4)]
        victims = [process.pid for process in processes]
    else:
        processes = [start(machine, shared, name, 4, **options)]
        deadline = time.monotonic() + 30
        while len(victims := children(processes[0].pid)) < 4 and time.monotonic() < deadline:
            time.sleep(0.002)
    wait_for_trials(server, shared, name, rng.randrange(1, 20))
    time.sleep(rng.uniform(0.0, 0.02))
    victim = rng.choice(victims)
    try:
        os.kill(victim, signal.SIGKILL)
    except ProcessLookupError:
        pytest.fail("the study was over before the kill")
    before = finished(server, shared, name)
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes if process.pid != victim] == [0] * (
        len(processes) - (moment % 2)
    )
    is_whole(server, shared, name, trials, sampler)
    after = finished(server, shared, name)
    assert {number: after[number] for number in before} == before


def test_a_whole_machine_dies_and_another_finishes(server: Server, shared: str, name: str) -> None:
    first = start(machine, shared, name, 2, grace_s=GRACE_S)
    wait_for_trials(server, shared, name, 10)
    first.kill()
    first.join()
    before = finished(server, shared, name)
    run_shared(make_job(shared, name), 2)
    is_whole(server, shared, name)
    after = finished(server, shared, name)
    assert {number: after[number] for number in before} == before


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGQUIT], ids=["in peace", "at once"])
def test_the_server_is_restarted_in_mid_study_and_the_study_goes_on(
    how: int, server: Server, shared: str, name: str
) -> None:
    running = start(machine, shared, name, 3, grace_s=GRACE_S)
    wait_for_trials(server, shared, name, 15)
    before = finished(server, shared, name)
    server.stop(how)
    time.sleep(1.5 * GRACE_S)
    server.start()
    running.join(60)
    assert running.exitcode == 0
    is_whole(server, shared, name)
    after = finished(server, shared, name)
    assert {number: after[number] for number in before} == before


def test_a_server_that_stays_away_ends_the_study_in_one_line(
    server: Server, shared: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_connection, "PATIENCE_S", 0.3)
    with network(server.port) as wire:
        away = shared.replace(f":{server.port}/", f":{wire.port}/")
        job, pid = make_job(away, name, grace_s=GRACE_S), wire.process.pid

        def cut(points: Any) -> Any:
            os.kill(pid, signal.SIGKILL)
            return bowl(points)

        broken = SharedJob(
            job.address,
            name,
            [type(job.tasks[0])(job.tasks[0].kept, job.tasks[0].space, cut, job.tasks[0].settings)],
        )
        with pytest.raises(InputError, match="finished trials are kept, repeat the command"):
            run_shared(broken, 1)
    run_shared(make_job(shared, name), 2)
    is_whole(server, shared, name)


def test_the_network_is_cut_for_longer_than_the_heartbeat(
    server: Server, shared: str, name: str
) -> None:
    with network(server.port) as wire:
        away = shared.replace(f":{server.port}/", f":{wire.port}/")
        options = {"sampler": "random", "trials": 400, "grace_s": GRACE_S}
        near = start(machine, shared, name, 1, **options)
        wait_for_trials(server, shared, name)
        far = start(machine, away, name, 2, **options)
        query = (
            "SELECT count(DISTINCT worker) FROM egolane_claims JOIN egolane_studies"
            f" USING (study_id) WHERE job = '{name}'"
        )
        deadline = time.monotonic() + 30
        while rows(server, shared, query)[0][0] < 3 and time.monotonic() < deadline:
            time.sleep(0.002)
        wire.is_cut.set()
        before = finished(server, shared, name)
        time.sleep(3 * GRACE_S)
        # Those who can reach the server are not held up by those who cannot.
        assert len(finished(server, shared, name)) > len(before) + 10
        wire.is_cut.clear()
        for process in (near, far):
            process.join(60)
            assert process.exitcode == 0
    is_whole(server, shared, name, 400, "random")
    assert states(server, shared, name)["FAIL"] > 0
    after = finished(server, shared, name)
    assert {number: after[number] for number in before} == before


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_clock_that_is_wrong_by_an_hour_changes_nothing(
    hours: int, server: Server, shared: str, name: str
) -> None:
    def wrong(*words: Any, **options: Any) -> None:
        off, real, moment = 3600 * hours, time.time, datetime.datetime

        class Wrong(moment):
            @classmethod
            def now(cls, tz: Any = None) -> Any:
                return moment.now(tz) + datetime.timedelta(seconds=off)

            @classmethod
            def utcnow(cls) -> Any:
                return moment.utcnow() + datetime.timedelta(seconds=off)

        time.time = lambda: real() + off
        datetime.datetime = Wrong  # type: ignore[misc]
        os.environ["TZ"] = "Pacific/Kiritimati"
        time.tzset()
        machine(*words, **options)

    begun = server.execute("SELECT timezone('UTC', clock_timestamp())")[0][0]
    machines = [
        start(work, shared, name, 2, grace_s=GRACE_S, trials=120) for work in (machine, wrong)
    ]
    for process in machines:
        process.join(60)
        assert process.exitcode == 0
    is_whole(server, shared, name, 120)
    assert states(server, shared, name)["FAIL"] == 0
    ended = server.execute("SELECT timezone('UTC', clock_timestamp())")[0][0]
    query = (
        "SELECT min(datetime_start), max(datetime_complete), count(DISTINCT c.worker)"
        " FROM trials JOIN egolane_claims c USING (trial_id) JOIN egolane_studies s"
        f" ON s.study_id = c.study_id WHERE job = '{name}'"
    )
    first, last, workers = rows(server, shared, query)[0]
    assert begun <= first <= last <= ended
    assert workers >= 2


def test_a_trial_that_takes_longer_than_the_grace_period_is_not_taken_away(
    server: Server, shared: str, name: str
) -> None:
    def long(points: Any) -> Any:
        time.sleep(2 * GRACE_S)
        return bowl(points)

    slow = make_job(shared, name, trials=24, evaluate=long, grace_s=GRACE_S)
    one = start(alone, slow, "a" * 12)
    time.sleep(0.5)
    run_shared(make_job(shared, name, trials=24, evaluate=bowl), 1)
    one.join(30)
    assert one.exitcode == 0
    is_whole(server, shared, name, 24)
    assert states(server, shared, name)["FAIL"] == 0


def test_an_answer_that_was_lost_on_its_way_back_is_not_written_twice(
    server: Server, shared: str, name: str
) -> None:
    job = make_job(shared, name, trials=3 * CLAIM)
    claims = claims_of(job, "b" * 12)

    class Lossy:
        """Commits, and loses the connection before anybody hears of it."""

        def __init__(self, connection: Any) -> None:
            self.connection, self.n = connection, 0

        def __getattr__(self, key: str) -> Any:
            return getattr(self.connection, key)

        def pipeline(self) -> Any:
            self.n += 1
            if self.n == 2:
                return self
            return self.connection.pipeline()

        def __enter__(self) -> Any:
            self.inner = self.connection.pipeline()
            return self.inner.__enter__()

        def __exit__(self, *words: Any) -> None:
            self.inner.__exit__(*words)
            raise psycopg.OperationalError("server closed the connection unexpectedly")

    first = claims.exchange([]).claimed
    assert len(first) == CLAIM
    claims.link._connection = Lossy(claims.link._connection)  # type: ignore[assignment]
    second = claims.exchange(scored(first))
    assert second.finished == CLAIM
    assert [c.number for c in second.claimed] == list(range(CLAIM, 2 * CLAIM))
    third = claims.exchange(scored(second.claimed))
    assert claims.exchange(scored(third.claimed)).is_done
    is_whole(server, shared, name, 3 * CLAIM)


def test_results_that_come_too_late_are_dropped(server: Server, shared: str, name: str) -> None:
    job = make_job(shared, name, trials=CLAIM)
    late, other = claims_of(job, "c" * 12), claims_of(job, "d" * 12)
    taken = late.exchange([]).claimed
    assert len(taken) == CLAIM
    assert other.exchange([]).claimed == []
    bury(other.link, ["c" * 12])
    again = other.exchange([]).claimed
    assert [c.point for c in again] == [c.point for c in taken]
    answer = late.exchange(scored(taken))
    assert (answer.kept, answer.finished, answer.claimed) == (0, 0, [])
    assert other.exchange(scored(again)).is_done
    is_whole(server, shared, name, CLAIM)


def test_a_worker_that_stops_inside_of_a_claim_does_not_hold_up_the_others(
    server: Server, shared: str, name: str
) -> None:
    job = make_job(shared, name, trials=30, evaluate=bowl, grace_s=GRACE_S)
    stuck = connect(job.address, 0.5)
    with stuck.pipeline():
        stuck.execute("BEGIN")
        stuck.execute("SELECT 1 FROM egolane_studies FOR UPDATE")
    begun = time.monotonic()
    run_shared(job, 1)
    assert time.monotonic() - begun < 10
    stuck.close()
    is_whole(server, shared, name, 30)
