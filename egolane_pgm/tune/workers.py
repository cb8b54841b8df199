"""One study, several processes on one host, through Optuna's journal.

A trial is claimed under a lock before it starts, so that together the workers do exactly as many
as asked for. The journal has no heartbeat: the parent notices a worker that died, marks the trials
that it was at as failed and has them tried again.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.tune.objective import is_maximised
from egolane_pgm.tune.space import Point, SearchSpace, distributions
from egolane_pgm.tune.storage import check_identity, journal_storage, locked
from egolane_pgm.tune.study import (
    BATCHED,
    Evaluate,
    Proposals,
    Report,
    Settings,
    make_sampler,
    new_study,
)
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import optuna

CLAIM_LOCK = ".claim"

#: Trials that a worker claims at once: cheap trials are scored side by side.
CLAIM = 8

#: Workers that may die, killed from outside, before the study is given up; it can be resumed.
MAX_DEATHS = 200

#: Seconds between two looks at the workers.
LOOK_S = 0.1


@dataclass(frozen=True)
class Job:
    """What every worker of a study is given."""

    directory: Path
    name: str
    space: SearchSpace
    evaluate: Evaluate
    settings: Settings
    starts: Sequence[Point]


def run_workers(
    job: Job, identity: Mapping[str, Any], n_workers: int, report: Report | None = None
) -> optuna.Study:
    """Run a study to its number of trials with several processes, or go on with it.

    The caller holds the study (`storage.only_one`). Returns the study in memory, finished trials
    only. Raises InputError for another study of this name, a journal that cannot be written, and
    where a worker raised it.
    """
    if "fork" not in multiprocessing.get_all_start_methods():
        raise InputError("--workers: needs an operating system that can fork; use one process")
    study = _open(job, identity)
    bury(job, study, None)
    context = multiprocessing.get_context("fork")
    said: Any = context.SimpleQueue()
    alive: dict[Any, str] = {}
    deaths = 0

    def start(count: int) -> None:
        for _ in range(count):
            worker = uuid.uuid4().hex[:12]
            process = context.Process(
                target=_work, args=(job, worker, os.getpid(), said), daemon=True
            )
            process.start()
            alive[process] = worker

    try:
        start(min(n_workers, max(0, job.settings.trials - _complete(study))))
        while alive:
            wait([process.sentinel for process in alive], timeout=LOOK_S)
            for process in [p for p in alive if not p.is_alive()]:
                process.join()
                worker = alive.pop(process)
                if process.exitcode == 0:
                    continue
                bury(job, study, worker)
                if process.exitcode is not None and process.exitcode > 0:
                    text = "a worker failed, its error is above" if said.empty() else said.get()
                    raise InputError(text)
                deaths += 1
                if deaths > MAX_DEATHS:
                    raise InputError(f"{job.directory}: {deaths} workers died; try fewer workers")
                start(1)
            if report is not None:
                _report(study, job.settings, report)
            if not alive and _complete(study) < job.settings.trials:
                start(1)
    finally:
        for process in alive:
            process.kill()
        for process, worker in alive.items():
            process.join()
            bury(job, study, worker)
    finished = [t for t in study.get_trials(deepcopy=False) if t.state.is_finished()]
    return new_study(job.settings, finished)


def _open(job: Job, identity: Mapping[str, Any]) -> optuna.Study:
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    storage = journal_storage(job.directory)
    if job.name in [study.study_name for study in storage.get_all_studies()]:
        study = optuna.load_study(study_name=job.name, storage=storage)
    else:
        study = optuna.create_study(
            study_name=job.name, storage=storage, directions=job.settings.directions
        )
    found = study.user_attrs.get("identity")
    if found is None:
        study.set_user_attr("identity", dict(identity))
    else:
        check_identity(found, identity, job.directory)
    return study


def _complete(study: optuna.Study) -> int:
    return sum(t.values is not None for t in study.get_trials(deepcopy=False))


def _report(study: optuna.Study, settings: Settings, report: Report) -> None:
    values = [t.values[0] for t in study.get_trials(deepcopy=False) if t.values is not None]
    if values:
        best = max(values) if is_maximised(settings.objectives[0]) else min(values)
        report(len(values), best)


def bury(job: Job, study: optuna.Study, worker: str | None) -> None:
    """Mark what a dead worker (None: every worker there was) was at as failed, to be tried again.

    A running trial without a worker's name is of one that died while it claimed it.
    """
    from optuna.trial import TrialState

    with locked(job.directory / CLAIM_LOCK):
        for trial in study.get_trials(deepcopy=False, states=[TrialState.RUNNING]):
            owner = trial.user_attrs.get("worker")
            if worker is not None and owner not in (worker, None):
                continue
            study.tell(trial.number, state=TrialState.FAIL)
            if set(trial.params) == set(job.space.keys):
                study.enqueue_trial(dict(trial.params), user_attrs={"retry_of": trial.number})


def _work(job: Job, worker: str, parent: int, said: Any) -> None:
    """A worker: claim, score, tell, until nothing is left to claim or the parent is gone."""
    import optuna
    from optuna.trial import TrialState

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        storage = journal_storage(job.directory)
        study = optuna.load_study(
            study_name=job.name,
            storage=storage,
            sampler=make_sampler(job.settings, os.getpid()),
        )
        claim = _claimer(job, study, storage, worker)
        while os.getppid() == parent:
            with locked(job.directory / CLAIM_LOCK):
                claimed = claim()
            if not claimed:
                return
            scores = job.evaluate([point for _, point in claimed])
            for (trial, _), row in zip(claimed, scores, strict=True):
                values = [float(v) for v in row]
                if isinstance(trial, int):
                    storage.set_trial_state_values(trial, TrialState.COMPLETE, values)
                else:
                    study.tell(trial, values)
    except InputError as error:
        said.put(str(error))
        os._exit(3)


def _claimer(
    job: Job, study: optuna.Study, storage: Any, worker: str
) -> Callable[[], list[tuple[Any, Point]]]:
    """A function that claims the next trials, none when there are enough, each with its point.

    A trial that was asked for is told; one of our own samplers, an id, is written straight to the
    storage, which spares the copies that Optuna makes.
    """
    from optuna.trial import TrialState, create_trial

    ranges = distributions(job.space)
    proposals = Proposals(job.space, job.settings, job.starts)
    learned: set[int] = set()
    study_id = storage.get_study_id_from_name(job.name)

    def claim() -> list[tuple[Any, Point]]:
        trials = study.get_trials(deepcopy=False)
        taken = sum(t.state in (TrialState.COMPLETE, TrialState.RUNNING) for t in trials)
        left = job.settings.trials - taken
        if left <= 0:
            return []
        is_retry = any(t.state == TrialState.WAITING for t in trials)
        if is_retry or job.settings.sampler not in BATCHED:
            if not trials:
                for start in job.starts:
                    study.enqueue_trial(dict(start))
            trial = study.ask(ranges)
            trial.set_user_attr("worker", worker)
            return [(trial, trial.params)]
        new = [t for t in trials if t.values is not None and t.number not in learned]
        proposals.learn(new)
        learned.update(t.number for t in new)
        number = len(trials)
        proposals.advance_to(number)
        points = proposals.points(number, min(left, CLAIM))
        claimed: list[tuple[Any, Point]] = []
        for point in points:
            template = create_trial(
                state=TrialState.RUNNING,
                params=dict(point),
                distributions=ranges,
                user_attrs={"worker": worker},
            )
            claimed.append((storage.create_new_trial(study_id, template), point))
        return claimed

    return claim
