"""Many experiments in several processes: each writes its own result directory, one that fails does
not stop the others."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from egolane_pgm.experiment import Experiment
from egolane_pgm.parallel import in_processes
from egolane_pgm.results import check_writable
from egolane_pgm.run import run_experiment, save_run, summary
from egolane_pgm.types import InputError

Draw = Callable[[Path], None]


@dataclass(frozen=True)
class Task:
    """One of several runs. title: for messages. directory: of its result. experiment: None where
    it could not be used, `error` says why."""

    title: str
    directory: Path
    experiment: Experiment | None
    error: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of a task: the summary (as `run.summary`), or why it failed, in one line."""

    title: str
    directory: Path
    summary: Mapping[str, Any] | None
    error: str | None


def plan_runs(sources: Sequence[tuple[str, Callable[[], Experiment]]], folder: Path) -> list[Task]:
    """A task per source (title, loader), its result in `folder`/<name of the experiment>. What
    cannot be loaded becomes a task that fails.

    Raises InputError where two would write the same directory, or `folder` cannot be written.
    """
    tasks: list[Task] = []
    taken: dict[Path, str] = {}
    for title, load in sources:
        try:
            experiment = load()
        except InputError as error:
            tasks.append(Task(title, folder, None, str(error)))
            continue
        directory = folder / experiment.name
        if taken.get(directory) == title:
            raise InputError(f"{title}: is named twice")
        if directory in taken:
            raise InputError(
                f"{title}: would write {directory}, as {taken[directory]} does; give one of them"
                " another `name`"
            )
        check_writable(directory)
        taken[directory] = title
        tasks.append(Task(experiment.name, directory, experiment))
    return tasks


def run_all(
    tasks: Sequence[Task], *, jobs: int = 1, draw: Draw | None = None, kernel: bool = True
) -> Iterator[Outcome]:
    """Run the tasks and write their results; what became of each, in order, as soon as those
    before it are done. jobs: processes that share them. draw, kernel: as in `save_run`,
    `run_experiment`."""
    work = partial(run_task, draw=draw, kernel=kernel)
    yield from in_processes(work, tasks, jobs, died=_failed)


def _failed(task: Task, error: str) -> Outcome:
    return Outcome(task.title, task.directory, None, " ".join(error.split()))


def run_task(task: Task, draw: Draw | None = None, kernel: bool = True) -> Outcome:
    """Run one task and write its result; a failure is in the outcome."""
    if task.experiment is None:
        return _failed(task, task.error or "")
    try:
        done = run_experiment(task.experiment, kernel=kernel)
        save_run(done, task.directory, draw)
    except InputError as error:
        return _failed(task, str(error))
    except Exception as error:
        # A fault of ours in one run must not cost the others what they computed.
        return _failed(task, f"{type(error).__name__}: {error}")
    return Outcome(task.title, task.directory, summary(done), None)
