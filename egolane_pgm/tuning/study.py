"""Searches from end to end: search, search anew without each part, score, write."""

from __future__ import annotations

import functools
import pickle
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import optuna

from egolane_pgm.tools.files import make_directory, write_json, write_yaml
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.tuning import study_directory as files
from egolane_pgm.tuning.nested import Nested, search_without, settings_of_part
from egolane_pgm.tuning.plan import Plan
from egolane_pgm.tuning.search import Progress, Report, best_trial, counted, search
from egolane_pgm.tuning.storage import (
    check_place,
    open_storage,
    open_study,
    storage_errors,
)
from egolane_pgm.tuning.task import Task, task_of
from egolane_pgm.views.study_trials import STUDY_FILE

#: A process's share: the number of a search, the part that is left out (None for the study on
#: everything), and which of that study's workers this is.
Share = tuple[int, int | None, int]


@dataclass
class Search:
    """A search, and how far it has come.

    - directory: of its results.
    - storage: URL of the storage; None for a journal in the directory.
    - best: the part of study.json on the best trial. trials, experiments: see `Study`.
    - nested: the studies without a part that are done, by part.
    """

    task: Task
    directory: Path
    storage: str | None = None
    best: dict[str, Any] = field(default_factory=dict)
    trials: dict[str, list[Any]] = field(default_factory=dict)
    experiments: dict[str, dict[str, Any]] = field(default_factory=dict)
    nested: dict[int, Nested] = field(default_factory=dict)

    @property
    def n_parts(self) -> int:
        """Number of studies that are run anew without a part."""
        return len(self.task.left_out)

    def label(self, part: int | None) -> str:
        """The name of the study on everything (None), or of that without a part."""
        name = self.task.plan.name
        return name if part is None else f"{name} without {self.task.part} {part + 1}"


def prepare(
    plan: Plan,
    directory: Path,
    held_out: str = "blocks",
    storage: str | None = None,
) -> Search:
    """Read what is searched on, and check everything that can be checked before anything is
    computed. held_out: see `Task`.

    Raises InputError for whatever does not fit, another study in the same place included.
    """
    made = Search(task_of(plan, held_out), directory, storage)
    check_place(storage, directory, plan.name, made.task.identity)
    return made


def open_main(made: Search) -> optuna.Study:
    """Open, or begin, the study on everything."""
    task = made.task
    with storage_errors(made.storage):
        storage = open_storage(made.storage, made.directory)
        return open_study(storage, made.label(None), task.settings, task.identity, task.starts)


def run_share(
    made: Search, part: int | None, worker: int = 0, report: Report | None = None
) -> Nested | float:
    """Run the study on everything (part: None), or this process's share of it, and return the
    seconds; or run the study without a part, in memory where no storage is given."""
    task, begun = made.task, time.perf_counter()
    score = task.scorer(part)
    with storage_errors(made.storage):
        if part is None:
            search(open_main(made), task.space, score, task.settings, worker=worker, report=report)
            return time.perf_counter() - begun
        study = None
        if made.storage is not None:
            storage = open_storage(made.storage, made.directory)
            identity = {**task.identity, **task.parts_key, "without": part}
            settings = settings_of_part(task.settings, part)
            study = open_study(storage, made.label(part), settings, identity)
        return search_without(task.space, score, task.settings, part, study=study, report=report)


@functools.lru_cache(maxsize=32)
def _loaded(plan: bytes, held_out: str) -> Task:
    """What a plan searches on, read once in each process."""
    return task_of(pickle.loads(plan), held_out)


def _elsewhere(given: Sequence[tuple[Any, ...]], share: Share) -> tuple[Share, Nested | float]:
    """Do a share in a process of its own. given: what it needs of each search."""
    plan, held_out, directory, storage = given[share[0]]
    made = Search(_loaded(plan, held_out), directory, storage)
    return share, run_share(made, *share[1:])


def tune(
    searches: Sequence[Search],
    *,
    jobs: Jobs = 1,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Do searches, and return each one's study.json.

    - jobs: processes that share the studies, those without a part included; or a cluster.
    - workers: processes that share the trials of each study on everything, and the studies without
      a part: those of the cluster, or else as many of this machine.
    - progress: is called as trials are done; for other processes, when their study is.

    Studies without a part that an earlier command finished are not run again.
    """
    shares: list[Share] = []
    for k, made in enumerate(searches):
        make_directory(made.directory)
        made.nested = files.read_nested(made.directory, made.task.key)
        shares += [(k, None, worker) for worker in range(workers or 1)]
        shares += [(k, part, 0) for part in range(made.n_parts) if part not in made.nested]
    if isinstance(jobs, int):
        jobs = workers or min(jobs, len(shares))
    here = jobs == 1
    results: Iterable[tuple[Share, Any]]
    if here:
        results = map(partial(_here, searches, progress), shares)
    else:
        # Those on everything take longest, and are begun once before processes share them.
        shares.sort(key=lambda share: share[1] is not None)
        given = []
        for made in searches:
            open_main(made)
            plan = pickle.dumps(made.task.plan)
            given.append((plan, made.task.held_out, made.directory, made.storage))
        results = in_order(partial(_elsewhere, given), shares, jobs, ordered=False)
    left, at_work = Counter(k for k, _, _ in shares), Counter(k for k, p, _ in shares if p is None)
    seconds = [0.0] * len(searches)
    documents: list[dict[str, Any]] = [{} for _ in searches]
    for (k, part, _), found in results:
        made = searches[k]
        left[k] -= 1
        if part is not None:
            made.nested[part] = found
            files.write_nested(made.directory, made.task.key, made.nested)
            best = found.values[0]
        else:
            seconds[k] = max(seconds[k], found)
            at_work[k] -= 1
            if at_work[k]:
                continue
            finish_main(made, seconds[k])
            best = next(iter(made.best["values"].values()))
        if progress is not None and not here:
            progress(made.label(part), made.task.settings.trials, best)
        if not left[k]:
            documents[k] = finish(made)
    return documents


def _here(
    searches: Sequence[Search], progress: Progress | None, share: Share
) -> tuple[Share, Nested | float]:
    """Do a share in this process."""
    k, part, worker = share
    made = searches[k]
    report = counted(progress, made.task.settings, made.label(part))
    return share, run_share(made, part, worker, report)


def finish_main(made: Search, seconds: float) -> None:
    """Write trials and best parameters of the study on everything."""
    task, study = made.task, open_main(made)
    made.trials = files.trials_columns(study, task.settings.objectives)
    files.write_trials(made.directory, made.trials)
    point = best_trial(study).params
    made.experiments = task.experiments(point)
    for file, content in made.experiments.items():
        write_yaml(made.directory / file, content)
    best = files.best_entry(study, task.settings.objectives, task.parameters(point))
    made.best = {**best, "seconds": seconds}


def finish(made: Search) -> dict[str, Any]:
    """Score a search in-sample and held out, write its study.json and return what is in that."""
    task, best = made.task, [made.best["point"]]
    answers = task.answers(best)
    content = {
        **files.head_of(task),
        "best": made.best,
        "in_sample": {"tuned_on": "same_frames", **task.assess(answers)},
        "held_out": None,
        "difference": None,
        "notes": list(task.notes),
    }
    if made.n_parts:
        nested = [made.nested[b] for b in range(made.n_parts)]
        held_out = task.answers([each.point for each in nested])
        content["held_out"] = {**files.held_out_entry(task, nested), **task.assess(held_out)}
        content["difference"] = task.assess(answers, held_out)
    write_json(made.directory / STUDY_FILE, content)
    return content


def n_trials(searches: Sequence[Search]) -> int:
    """How many trials there are to do, those of nested studies included."""
    return sum((1 + made.n_parts) * made.task.settings.trials for made in searches)
