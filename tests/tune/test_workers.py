"""kill -9 at random moments: no finished trial lost, none counted twice, the total exact."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import optuna
import pytest

from egolane_pgm.tune.storage import SqliteStore, journal_storage, only_one
from egolane_pgm.tune.study import Settings, run_study
from egolane_pgm.tune.workers import Job, run_workers
from egolane_pgm.types import InputError
from tests.kits.tuning_kit import bowl, plain_space, slow_bowl, told

SPACE = plain_space()
TRIALS = 90
SETTINGS = Settings(("accuracy",), "evolution", TRIALS, 0)
MOMENTS = 20
FORK = multiprocessing.get_context("fork")


def job(folder: Path, sampler: str = "evolution", evaluate: Any = slow_bowl) -> Job:
    chosen = Settings(("accuracy",), sampler, TRIALS, 0)
    return Job(folder, "drive", SPACE, evaluate, chosen, [{"x0": 0.5, "x1": 0.5, "x2": 0.5}])


def with_workers(folder: Path, n: int = 4, sampler: str = "evolution") -> None:
    with only_one(folder, 30):
        run_workers(job(folder, sampler), {"seed": 0}, n)


def alone(folder: Path) -> None:
    with only_one(folder, 30), SqliteStore(folder, "drive", {"seed": 0}, ["maximize"]) as store:
        run_study(SPACE, slow_bowl, SETTINGS, store=store)


def start(work: Callable[[Path], None], folder: Path) -> Any:
    process = FORK.Process(target=work, args=(folder,))
    process.start()
    return process


def journal(folder: Path) -> list[Any]:
    study = optuna.load_study(study_name="drive", storage=journal_storage(folder))
    return list(study.get_trials(deepcopy=False))


def children(pid: int) -> list[int]:
    return [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_whole(trials: list[Any]) -> None:
    states = Counter(t.state.name for t in trials)
    assert states["COMPLETE"] == TRIALS
    assert set(states) <= {"COMPLETE", "FAIL"}
    assert [t.number for t in trials] == list(range(len(trials)))
    done = [t for t in trials if t.state.name == "COMPLETE"]
    points = Counter(tuple(t.params.values()) for t in done)
    assert max(points.values()) == 1
    assert all(t.values == list(bowl([t.params])[0]) for t in done)


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_the_only_process_is_killed_in_mid_trial(moment: int, tmp_path: Path) -> None:
    process = start(alone, tmp_path)
    deadline = time.monotonic() + 30
    while not (tmp_path / "study.db").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(random.Random(moment).uniform(0.0, 0.3))
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    with only_one(tmp_path, 5), SqliteStore(tmp_path, "drive", {"seed": 0}, ["maximize"]) as store:
        before = told(store.finished())
        done = run_study(SPACE, bowl, SETTINGS, store=store)
        after = store.finished()
    assert len(before) <= TRIALS
    assert told(after)[: len(before)] == before
    is_whole(after)
    assert told(done.trials) == told(after) == told(run_study(SPACE, bowl, SETTINGS).trials)


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_one_of_four_workers_is_killed_in_mid_trial(moment: int, tmp_path: Path) -> None:
    rng = random.Random(moment)
    sampler = ("evolution", "random", "evolution", "tpe")[moment % 4]
    process = start(lambda folder: with_workers(folder, 4, sampler), tmp_path)
    deadline = time.monotonic() + 30
    while len(children(process.pid)) < 4 and time.monotonic() < deadline:
        time.sleep(0.002)
    time.sleep(rng.uniform(0.0, 0.2))
    victims = children(process.pid)
    before = []
    if victims:
        os.kill(rng.choice(victims), signal.SIGKILL)
        before = [t for t in journal(tmp_path) if t.state.name == "COMPLETE"]
    process.join(60)
    assert process.exitcode == 0
    trials = journal(tmp_path)
    is_whole(trials)
    by_number = {t.number: t for t in trials}
    assert told(before) == told([by_number[t.number] for t in before])
    retried = {t.user_attrs.get("retry_of") for t in trials}
    lost = [t for t in trials if t.state.name == "FAIL" and len(t.params) == len(SPACE)]
    assert {t.number for t in lost} <= retried


@pytest.mark.parametrize("moment", range(5))
def test_a_parent_with_its_workers_is_killed_and_the_same_command_goes_on(
    moment: int, tmp_path: Path
) -> None:
    process = start(with_workers, tmp_path)
    deadline = time.monotonic() + 30
    while len(children(process.pid)) < 4 and time.monotonic() < deadline:
        time.sleep(0.002)
    time.sleep(random.Random(moment).uniform(0.0, 0.15))
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    before = [t for t in journal(tmp_path) if t.state.name == "COMPLETE"]
    with_workers(tmp_path)
    trials = journal(tmp_path)
    is_whole(trials)
    by_number = {t.number: t for t in trials}
    assert told(before) == told([by_number[t.number] for t in before])


@pytest.mark.parametrize("sampler", ["evolution", "random", "tpe"])
def test_workers_together_do_exactly_as_many_trials_as_asked_for(
    sampler: str, tmp_path: Path
) -> None:
    with only_one(tmp_path):
        done = run_workers(job(tmp_path, sampler, bowl), {"seed": 0}, 3)
    is_whole(journal(tmp_path))
    assert len(done.trials) == TRIALS
    assert done.trials[0].params == {"x0": 0.5, "x1": 0.5, "x2": 0.5}


def test_a_finished_study_is_left_as_it_is(tmp_path: Path) -> None:
    with_workers(tmp_path)
    size = (tmp_path / "study.journal").stat().st_size
    with_workers(tmp_path)
    assert (tmp_path / "study.journal").stat().st_size == size


def test_another_identity_is_refused(tmp_path: Path) -> None:
    with_workers(tmp_path)
    with pytest.raises(InputError, match="seed: 0, now 1"), only_one(tmp_path):
        run_workers(job(tmp_path), {"seed": 1}, 2)


def test_what_a_worker_refuses_is_said_once_and_ends_the_study(tmp_path: Path) -> None:
    def refuse(points: Any) -> Any:
        raise InputError("evidence: frame 3 has a negative or NaN value")

    with pytest.raises(InputError, match="frame 3 has a negative"), only_one(tmp_path):
        run_workers(job(tmp_path, "evolution", refuse), {"seed": 0}, 3)
    assert not multiprocessing.active_children()
