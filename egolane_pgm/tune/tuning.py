"""Studies from end to end: search, search anew without each part, score, write."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.results import write_json
from egolane_pgm.tune import output
from egolane_pgm.tune.held_out import (
    Nested,
    assess,
    beliefs_at,
    check_blocks,
    difference,
    run_nested,
    stitched,
)
from egolane_pgm.tune.objective import all_used
from egolane_pgm.tune.plan import (
    Plan,
    Problem,
    evaluator,
    make_problem,
    parameters_at,
    starting_points,
)
from egolane_pgm.tune.storage import (
    JOURNAL_NAME,
    SQLITE_NAME,
    SqliteStore,
    check_identity,
    only_one,
    stored_identity,
)
from egolane_pgm.tune.study import Report, best_trial, pareto, run_study
from egolane_pgm.tune.workers import Job, run_workers
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import optuna

#: Called now and then: what is being done, how many more trials are, the best score so far.
Progress = Callable[[str, int, float], None]

HELD_OUT = ("blocks", "recordings", "none")


@dataclass
class Study:
    """A study to do and how far it came. notes: what a user should know, a line each."""

    problem: Problem
    directory: Path
    held_out: str
    test: Problem | None = None
    notes: list[str] = field(default_factory=list)
    best: dict[str, Any] = field(default_factory=dict)
    nested: dict[int, Nested] = field(default_factory=dict)

    @property
    def n_parts(self) -> int:
        """Studies that are run anew without a part."""
        if self.held_out == "none":
            return 0
        by_blocks = self.held_out == "blocks"
        return self.problem.plan.tuning.blocks if by_blocks else len(self.problem.drives)


def prepare(
    plan: Plan, directory: Path, held_out: str = "blocks", test: Plan | None = None
) -> Study:
    """Read the recordings and check everything that can be checked before anything is computed.

    Raises InputError for whatever does not fit, another study in the directory included.
    """
    problem = make_problem(plan)
    study = Study(problem, directory, held_out)
    study.notes += [n for drive in problem.drives for n in drive.recorded.notes]
    if held_out == "blocks":
        study.notes += check_blocks(problem)
    if held_out == "recordings" and len(problem.drives) < 2:
        raise InputError(f"{plan.source}: whole recordings as blocks need at least two of them")
    if test is not None:
        study.test = make_problem(_same_tuning(test, plan))
        if study.test.space.dimensions != problem.space.dimensions:
            raise InputError(
                f"{test.source}: --test-on: declares other parameters than {plan.source}"
            )
    found = stored_identity(directory) if directory.is_dir() else None
    if found is not None:
        check_identity(found, output.identity_of(problem), directory)
    return study


def _same_tuning(test: Plan, plan: Plan) -> Plan:
    from egolane_pgm.tune.plan import with_options

    given = plan.tuning.model_dump()
    given["never_fit"] = test.tuning.never_fit
    return with_options(test, given)


def run_main(study: Study, workers: int | None, progress: Progress | None) -> optuna.Study:
    """The study on all frames, kept in its directory."""
    problem, directory = study.problem, study.directory
    starts, notes = starting_points(problem)
    study.notes += notes
    evaluate = evaluator(problem, all_used(problem.drives))
    identity = output.identity_of(problem)
    settings, name = problem.settings, problem.plan.name
    report = _counted(progress, name)
    with only_one(directory):
        if workers is not None or (directory / JOURNAL_NAME).exists():
            if (directory / SQLITE_NAME).exists():
                raise InputError(
                    f"{directory}: was begun in one process ({SQLITE_NAME}); go on without"
                    " --workers, or name another directory with --out"
                )
            # Evidence and kernels are made once, before the processes part.
            evaluate([dict(p) for p in corners(problem)])
            job = Job(directory, name, problem.space, evaluate, settings, starts)
            return run_workers(job, identity, workers or 1, report)
        with SqliteStore(directory, name, identity, settings.directions) as store:
            return run_study(
                problem.space, evaluate, settings, starts=starts, store=store, report=report
            )


def _counted(progress: Progress | None, label: str) -> Report | None:
    """A study's report of its trials so far, as progress of how many more there are."""
    if progress is None:
        return None
    before = 0

    def report(done: int, best: float) -> None:
        nonlocal before
        progress(label, done - before, best)
        before = done

    return report


def corners(problem: Problem) -> list[Any]:
    """A few points all over the space, which make the evidence that a search needs most."""
    from egolane_pgm.tune.space import from_unit

    steps = np.linspace(0, 1, 10)
    return from_unit(problem.space, np.repeat(steps[:, None], len(problem.space), axis=1))


def finish_main(study: Study, done: optuna.Study, seconds: float) -> None:
    """Write trials and best parameters of the study on all frames."""
    problem, directory = study.problem, study.directory
    output.write_trials(directory, done, problem.settings.objectives)
    best = best_trial(done)
    output.write_best(directory, problem, best.params)
    trials = done.get_trials(deepcopy=False)
    study.best = {
        "number": best.number,
        "values": dict(zip(problem.settings.objectives, best.values, strict=True)),
        "point": dict(best.params),
        "parameters": dict(
            zip(
                (d.experiment.name for d in problem.drives),
                parameters_at(problem, best.params),
                strict=True,
            )
        ),
        "trials": sum(t.values is not None for t in trials),
        "seconds": seconds,
    }
    if len(problem.settings.objectives) > 1:
        study.best["pareto"] = pareto(done)


def finish(study: Study) -> dict[str, Any]:
    """Score the study in-sample and held out, and write study.json; returns what is in it."""
    problem, drives = study.problem, study.problem.drives
    everything = all_used(drives)
    trusted = [d.may_fit for d in drives]
    subsets = {"all_frames": everything}
    if not all(keep.all() for keep in trusted):
        subsets["without_never_fit"] = trusted
    mine = beliefs_at(problem, study.best["point"])
    content = {
        **output.provenance(problem),
        "best": study.best,
        "in_sample": {
            "tuned_on": "same_frames",
            **{key: assess(drives, mine, keep) for key, keep in subsets.items()},
        },
        "held_out": None,
        "difference": None,
        "test": None,
        "notes": study.notes,
    }
    if study.held_out != "none":
        by_recording = study.held_out == "recordings"
        nested = [study.nested[b] for b in range(study.n_parts)]
        theirs = stitched(problem, nested, by_recording)
        content["held_out"] = {
            "tuned_on": "other_frames",
            "parts": study.held_out,
            "starts": "from scratch: known values may have been tuned on the frames held out",
            "studies": [
                {
                    "part": n.part + 1,
                    "left_out": drives[n.part].experiment.name if by_recording else None,
                    "trials": n.trials,
                    "in_sample_values": list(n.values),
                    "point": n.point,
                }
                for n in nested
            ],
            **{key: assess(drives, theirs, keep) for key, keep in subsets.items()},
        }
        content["difference"] = {
            key: difference(drives, mine, theirs, keep) for key, keep in subsets.items()
        }
    if study.test is not None:
        content["test"] = _tested(study.test, study.best["point"])
    write_json(study.directory / output.STUDY_FILE, content)
    return content


def _tested(test: Problem, point: dict[str, Any]) -> dict[str, Any]:
    """Scores on recordings that had no part in the search."""
    beliefs = beliefs_at(test, point)
    keep = {"all_frames": all_used(test.drives)}
    trusted = [d.may_fit for d in test.drives]
    if not all(kept.all() for kept in trusted):
        keep["without_never_fit"] = trusted
    return {
        "tuned_on": "other_frames",
        "name": test.plan.name,
        **{key: assess(test.drives, beliefs, kept) for key, kept in keep.items()},
    }


def tune(
    studies: Sequence[Study],
    *,
    jobs: int = 1,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Iterator[dict[str, Any]]:
    """Do studies, and yield each one's study.json when it is finished (in their order).

    jobs: processes that share the studies, those without a part included. workers: processes that
    share the trials of one study. Nested studies that a repeated command finds done are kept.
    """
    for study in studies:
        study.nested = output.read_nested(study.directory, _key(study))
    if jobs > 1 and "fork" in multiprocessing.get_all_start_methods():
        _in_processes(studies, jobs, progress)
        for study in studies:
            yield finish(study)
        return
    for k, study in enumerate(studies):
        _do_main(k, studies, workers, progress)
        for part in range(study.n_parts):
            if part not in study.nested:
                _keep(study, _nested_task(k, part, studies, progress))
        yield finish(study)


def _key(study: Study) -> dict[str, Any]:
    return output.nested_key(study.problem, study.held_out == "recordings")


def _keep(study: Study, nested: Nested) -> None:
    study.nested[nested.part] = nested
    output.write_nested(study.directory, _key(study), study.nested)


def _do_main(
    k: int, studies: Sequence[Study], workers: int | None, progress: Progress | None
) -> None:
    study = studies[k]
    begun = time.perf_counter()
    done = run_main(study, workers, progress)
    finish_main(study, done, time.perf_counter() - begun)


def _nested_task(k: int, part: int, studies: Sequence[Study], progress: Progress | None) -> Nested:
    study = studies[k]
    by_recording = study.held_out == "recordings"
    what = "recording" if by_recording else "block"
    report = _counted(progress, f"{study.problem.plan.name} without {what} {part + 1}")
    return run_nested(study.problem, part, by_recording, report)


@dataclass
class _Shared:
    """What forked processes find: the studies with their recordings, read before the processes
    part, and per task (trials so far, best score so far), written by the one that does it."""

    studies: Sequence[Study] = ()
    state: Any = ()

    def progress(self, task: int) -> Progress:
        """Progress of a task, for the parent to see."""

        def note(_: str, more: int, best: float) -> None:
            self.state[2 * task] += more
            self.state[2 * task + 1] = best

        return note


_shared = _Shared()


def _main_task(task: int, k: int) -> tuple[dict[str, Any], list[str]]:
    _do_main(k, _shared.studies, None, _shared.progress(task))
    return _shared.studies[k].best, _shared.studies[k].notes


def _part_task(task: int, k: int, part: int) -> Nested:
    return _nested_task(k, part, _shared.studies, _shared.progress(task))


def _die_with_parent(parent: int) -> None:
    """Have the kernel end this process when its parent is killed; it would wait for ever."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG, Linux only
    if os.getppid() != parent:
        os._exit(1)


def _in_processes(studies: Sequence[Study], jobs: int, progress: Progress | None) -> None:
    """The studies and their nested ones, shared out to processes."""
    tasks = [(k, -1) for k in range(len(studies))]
    for k, study in enumerate(studies):
        # Kernels are compiled, or loaded from their cache, before the processes part.
        evaluator(study.problem, all_used(study.problem.drives))(corners(study.problem)[:1])
        tasks += [(k, part) for part in range(study.n_parts) if part not in study.nested]
    context = multiprocessing.get_context("fork")
    _shared.studies = studies
    _shared.state = context.RawArray("d", 2 * len(tasks))
    seen = 0
    with ProcessPoolExecutor(
        jobs, mp_context=context, initializer=_die_with_parent, initargs=(os.getpid(),)
    ) as pool:
        waiting: dict[Future[Any], int] = {}
        for task, (k, part) in enumerate(tasks):
            given = (_main_task, task, k) if part < 0 else (_part_task, task, k, part)
            waiting[pool.submit(*given)] = task
        try:
            while waiting:
                finished, _ = wait_for(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
                for future in finished:
                    k, part = tasks[waiting.pop(future)]
                    if part < 0:
                        studies[k].best, studies[k].notes = future.result()
                    else:
                        _keep(studies[k], future.result())
                done = int(sum(_shared.state[::2]))
                if progress is not None and done > seen:
                    busy = max(t for t in range(len(tasks)) if _shared.state[2 * t])
                    label = studies[tasks[busy][0]].problem.plan.name
                    progress(label, done - seen, _shared.state[2 * busy + 1])
                    seen = done
        except BrokenProcessPool as error:
            raise InputError(
                "a process died while it worked on a study; repeat the command, what is finished"
                " is kept"
            ) from error
        finally:
            for future in waiting:
                future.cancel()


def n_trials(studies: Sequence[Study]) -> int:
    """How many trials there are to do, those of nested studies included."""
    return sum((1 + study.n_parts) * study.problem.settings.trials for study in studies)
