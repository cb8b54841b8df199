"""The processes of one machine that work on a shared study, beside those of others.

A worker claims, scores and tells until every study of the job has as many trials as asked for; it
waits for the trials of others, since one of those may die. Who dies here is noticed at once, who
dies elsewhere when nothing was heard of it for the grace period.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import socket
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from typing import Any

from egolane_pgm.tune._claims import CLAIM, Claimed, Claims, beat, bury, enlist
from egolane_pgm.tune._connection import Link
from egolane_pgm.tune._proposers import make_proposer
from egolane_pgm.tune.address import Address
from egolane_pgm.tune.objective import is_maximised
from egolane_pgm.tune.postgres import Kept, progress_of
from egolane_pgm.tune.space import Point, SearchSpace
from egolane_pgm.tune.study import BATCHED, Evaluate, Settings
from egolane_pgm.tune.workers import MAX_DEATHS
from egolane_pgm.types import InputError

#: Called now and then: the study, how many more trials are finished, the best score so far.
Watch = Callable[[str, int, float], None]

#: Seconds between two looks at the workers, and between two at the storage.
LOOK_S, ASK_S = 0.1, 1.0

#: Heartbeats per grace period.
BEATS = 5


@dataclass(frozen=True)
class Task:
    """A study of the job, and what it takes to do a trial of it here."""

    kept: Kept
    space: SearchSpace
    evaluate: Evaluate
    settings: Settings
    starts: Sequence[Point] = ()


@dataclass(frozen=True)
class SharedJob:
    """Studies that belong together. best: the best first score so far, per study."""

    address: Address
    name: str
    tasks: Sequence[Task]
    best: dict[int, float] = field(default_factory=dict)

    @property
    def grace_s(self) -> float:
        """After how long without a word a worker is dead."""
        return min(task.kept.grace_s for task in self.tasks)

    def link(self) -> Link:
        """A connection for one process; answers come well within the grace period."""
        return Link(self.address, max(0.5, self.grace_s / 2))


def run_shared(job: SharedJob, n_workers: int, watch: Watch | None = None) -> None:
    """Work on a job with several processes until all its trials are finished, by whomever.

    Raises InputError where a worker raised it, or the storage stays away: finished trials are
    kept, and others go on.
    """
    if "fork" not in multiprocessing.get_all_start_methods():
        raise InputError("--storage: needs an operating system that can fork")
    link = job.link()
    seen: dict[int, int] = {}
    if _look(job, link, seen, watch):
        link.close()
        return
    context = multiprocessing.get_context("fork")
    said: Any = context.SimpleQueue()
    alive: dict[Any, str] = {}
    gone: list[str] = []
    deaths = 0

    def start(count: int) -> None:
        for _ in range(count):
            worker = uuid.uuid4().hex[:12]
            process = context.Process(target=_work, args=(job, worker, os.getpid(), said))
            process.daemon = True
            process.start()
            alive[process] = worker

    asked_at = time.monotonic()
    try:
        start(n_workers)
        while alive:
            wait([process.sentinel for process in alive], timeout=LOOK_S)
            for process in [p for p in alive if not p.is_alive()]:
                process.join()
                worker = alive.pop(process)
                if process.exitcode == 0:
                    continue
                if process.exitcode is not None and process.exitcode > 0:
                    gone.append(worker)
                    text = "a worker failed, its error is above" if said.empty() else said.get()
                    raise InputError(text)
                bury(link, [worker])
                deaths += 1
                if deaths > MAX_DEATHS:
                    raise InputError(f"{job.name}: {deaths} workers died; try fewer workers")
                start(1)
            if time.monotonic() - asked_at > ASK_S:
                _look(job, link, seen, watch)
                asked_at = time.monotonic()
        _look(job, link, seen, watch)
    finally:
        for process in alive:
            process.kill()
        for process in alive:
            process.join()
        gone += alive.values()
        if gone:
            # Not for long: the grace period does the same where the storage is away.
            link.patience_s = 0.0
            with contextlib.suppress(InputError):
                bury(link, gone)
        link.close()


def _look(job: SharedJob, link: Link, seen: dict[int, int], watch: Watch | None) -> bool:
    """Tell what was finished since the last look; whether all is."""
    ids = [task.kept.study_id for task in job.tasks]
    found: Mapping[int, Any] = progress_of(link, ids, seen)
    for task in job.tasks:
        study = task.kept.study_id
        if study not in found:
            raise InputError(
                f"storage {job.address.shown}: study {task.kept.name} was removed meanwhile"
            )
        finished, _, low, high = found[study]
        new = finished - seen.get(study, 0)
        if not new:
            continue
        seen[study] = finished
        maximised = is_maximised(task.settings.objectives[0])
        value = high if maximised else low
        best = job.best.get(study, value)
        job.best[study] = max(best, value) if maximised else min(best, value)
        if watch is not None:
            watch(task.kept.name, new, job.best[study])
    return all(finished >= asked for finished, asked, *_ in found.values())


def _work(job: SharedJob, worker: str, parent: int, said: Any) -> None:
    """A worker, until all is finished or the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        work(job, worker, lambda: os.getppid() == parent)
    except InputError as error:
        said.put(str(error))
        os._exit(3)


def work(job: SharedJob, worker: str, goes_on: Callable[[], bool]) -> None:
    """Claim, score, tell, until every trial of the job is finished or it shall not go on. Raises
    InputError as scoring and storage do."""
    link = job.link()
    link.goes_on = goes_on
    enlist(link, worker, job.name, socket.gethostname(), os.getpid())
    stop = threading.Event()
    threading.Thread(target=_beats, args=(job, link, worker, stop), daemon=True).start()
    open_tasks = [(task, _claims(task, link, worker)) for task in job.tasks]
    pause = LOOK_S
    try:
        while open_tasks and goes_on():
            is_idle = True
            for entry in list(open_tasks):
                n_claimed, is_done = _work_on(*entry, goes_on)
                is_idle &= not n_claimed
                if is_done:
                    open_tasks.remove(entry)
            if is_idle and open_tasks:
                time.sleep(pause)
                pause = min(2 * pause, 1.0, job.grace_s / BEATS)
            else:
                pause = LOOK_S
        bury(link, [worker])
    finally:
        stop.set()
        link.close()


def _claims(task: Task, link: Link, worker: str) -> Claims:
    entropy = int(worker[:8], 16) + 1
    proposer = make_proposer(task.space, task.settings, task.starts, entropy)
    return Claims(link, task.kept.study_id, worker, task.space, proposer)


def _work_on(task: Task, claims: Claims, goes_on: Callable[[], bool]) -> tuple[int, bool]:
    """Trials of one study while there are any to claim: how many, and whether all are finished."""
    at_once = CLAIM if task.settings.sampler in BATCHED else 1
    results: list[tuple[Claimed, Sequence[float]]] = []
    count = 0
    while True:
        answer = claims.exchange(results, at_once if goes_on() else 0)
        if not answer.claimed or not goes_on():
            return count, answer.is_done
        count += len(answer.claimed)
        scores = task.evaluate([claimed.point for claimed in answer.claimed])
        rows = [[float(v) for v in row] for row in scores]
        results = list(zip(answer.claimed, rows, strict=True))


def _beats(job: SharedJob, link: Link, worker: str, stop: threading.Event) -> None:
    """Heartbeats while a trial takes long; where trials are short, each claim is one."""
    interval = job.grace_s / BEATS
    while not stop.wait(interval):
        if time.monotonic() - link.last_used > interval:
            beat(link, worker)
