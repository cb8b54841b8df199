"""Searches from end to end: search, search anew without each part, score, write."""

from __future__ import annotations

import functools
import pickle
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import optuna

from egolane_pgm.tools.files import make_directory, write_json, write_yaml
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.tuning import study_directory as files
from egolane_pgm.tuning.identity import identity_of
from egolane_pgm.tuning.nested import (
    Nested,
    assess,
    beliefs_at,
    beliefs_held_out,
    blocks_lacking_lanes,
    difference,
    run_nested,
    settings_without,
)
from egolane_pgm.tuning.objective import all_used, notes_of_silent
from egolane_pgm.tuning.plan import (
    Plan,
    Problem,
    make_problem,
    parameters_at,
    scorer,
    starting_points,
    with_options,
)
from egolane_pgm.tuning.search import Progress, Report, best_trial, counted, search
from egolane_pgm.tuning.space import SearchSpace
from egolane_pgm.tuning.storage import (
    check_place,
    open_storage,
    open_study,
    storage_errors,
)
from egolane_pgm.types import BoolArray, InputError
from egolane_pgm.views.study_trials import STUDY_FILE

#: What a process is given to do: the number of a search, its plan, directory, held_out and storage,
#: the part that is left out (None for the study on all frames), and which of its workers this is.
Task = tuple[int, bytes, Path, str, str | None, int | None, int]


@dataclass
class Search:
    """A search, and how far it has come.

    - directory: of its results.
    - held_out: "blocks", "recordings" (whole ones, of a fleet its parts), or "none" for in-sample
      scores only.
    - storage: URL of the storage; None for a journal in the directory.
    - test: recordings that take no part in the search and are scored with what it finds.
    - notes: what a user should know, a line each.
    - best: the part of study.json on the best trial. trials, experiments: see `Study`.
    - nested: the studies without a part that are done, by part.
    """

    problem: Problem
    directory: Path
    held_out: str = "blocks"
    storage: str | None = None
    test: Problem | None = None
    notes: list[str] = field(default_factory=list)
    best: dict[str, Any] = field(default_factory=dict)
    trials: dict[str, list[Any]] = field(default_factory=dict)
    experiments: dict[str, dict[str, Any]] = field(default_factory=dict)
    nested: dict[int, Nested] = field(default_factory=dict)

    @property
    def by_recording(self) -> bool:
        """Whether whole recordings are held out."""
        return self.held_out == "recordings"

    @property
    def n_parts(self) -> int:
        """Number of studies that are run anew without a part."""
        if self.held_out == "none":
            return 0
        return len(self.problem.parts) if self.by_recording else self.problem.plan.tuning.blocks

    @property
    def spaces(self) -> list[tuple[str, SearchSpace]]:
        """The names of what is searched on, each with its search space."""
        names = [drive.experiment.name for drive in self.problem.drives]
        return list(zip(names, self.problem.spaces, strict=True))

    @property
    def key(self) -> dict[str, Any]:
        """What the nested studies depend on."""
        return files.nested_key(self.problem, self.by_recording)


def prepare(
    plan: Plan,
    directory: Path,
    held_out: str = "blocks",
    test: Plan | None = None,
    storage: str | None = None,
) -> Search:
    """Read the recordings and check everything that can be checked before anything is computed.

    Raises InputError for whatever does not fit, another study in the same place included.
    """
    problem = make_problem(plan)
    made = Search(problem, directory, held_out, storage)
    made.notes += [n for drive in problem.drives for n in drive.recorded.notes]
    made.notes += starting_points(problem)[1]
    made.notes += notes_of_silent(problem.drives, problem.settings.objectives)
    if held_out == "blocks":
        made.notes += [
            f"{drive.experiment.name}: {note}"
            for drive in problem.drives
            for note in blocks_lacking_lanes(drive, plan.tuning.blocks)
        ]
    if held_out == "recordings" and len(problem.parts) < 2:
        raise InputError(f"{plan.source}: whole recordings as blocks need at least two of them")
    if test is not None:
        same = {**plan.tuning.model_dump(), "never_fit": test.tuning.never_fit}
        made.test = make_problem(with_options(test, same))
        if made.test.space.dimensions != problem.space.dimensions:
            raise InputError(
                f"{test.source}: test_on: declares other parameters than {plan.source}"
            )
    check_place(storage, directory, plan.name, identity_of(problem))
    return made


def open_main(made: Search) -> optuna.Study:
    """Open, or begin, the study on all frames."""
    problem = made.problem
    storage = open_storage(made.storage, made.directory)
    starts, _ = starting_points(problem)
    name, identity = problem.plan.name, identity_of(problem)
    with storage_errors(made.storage):
        return open_study(storage, name, problem.settings, identity, starts)


def _search_all(made: Search, worker: int = 0, report: Report | None = None) -> float:
    """Run the study on all frames, or this process's share of it; returns seconds."""
    begun = time.perf_counter()
    problem = made.problem
    with storage_errors(made.storage):
        study = open_main(made)
        score = scorer(problem, all_used(problem.drives))
        search(study, problem.space, score, problem.settings, worker=worker, report=report)
    return time.perf_counter() - begun


def _search_without(
    made: Search, part: int, worker: int = 0, report: Report | None = None
) -> Nested:
    """Run the study without one part: in memory, or in the storage where one is given."""
    study = None
    problem = made.problem
    with storage_errors(made.storage):
        if made.storage is not None:
            settings = settings_without(problem, part)
            study = open_study(
                open_storage(made.storage, made.directory),
                f"{problem.plan.name} without {_what(made)} {part + 1}",
                settings,
                {**made.key, "without": part},
            )
        return run_nested(
            problem, part, made.by_recording, study=study, worker=worker, report=report
        )


def _what(made: Search) -> str:
    if made.problem.plan.fleet is not None:
        return "part"
    return "recording" if made.by_recording else "block"


@functools.lru_cache(maxsize=32)
def _loaded(plan: bytes) -> Problem:
    """The recordings of a plan, read once in each process."""
    return make_problem(pickle.loads(plan))


def _do(task: Task) -> tuple[int, int | None, Any]:
    """Do a task; returns the search, the part, and what `_search_all` or `_search_without` does."""
    k, plan, directory, held_out, storage, part, worker = task
    made = Search(_loaded(plan), directory, held_out, storage)
    if part is None:
        return k, part, _search_all(made, worker)
    return k, part, _search_without(made, part, worker)


def tune(
    searches: Sequence[Search],
    *,
    jobs: Jobs = 1,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Iterator[dict[str, Any]]:
    """Do searches, and yield each one's study.json when it is finished, in their order.

    - jobs: processes that share the studies, those without a part included; or a cluster.
    - workers: processes that share the trials of each study on all frames, and the studies without
      a part: those of the cluster, or else as many of this machine.
    - progress: is called as trials are done; for other processes, when their study is.

    Studies without a part that an earlier command finished are not run again.
    """
    for made in searches:
        make_directory(made.directory)
        made.nested = files.read_nested(made.directory, made.key)
    n_tasks = sum(1 + made.n_parts - len(made.nested) for made in searches)
    if isinstance(jobs, int):
        jobs = workers or min(jobs, n_tasks)
    if isinstance(jobs, str) or jobs > 1:
        _in_processes(searches, jobs, workers or 1, progress)
        for made in searches:
            yield finish(made)
        return
    for made in searches:
        name = made.problem.plan.name
        seconds = _search_all(made, report=counted(progress, made.problem.settings, name))
        finish_main(made, seconds)
        for part in range(made.n_parts):
            if part not in made.nested:
                label = f"{name} without {_what(made)} {part + 1}"
                report = counted(progress, made.problem.settings, label)
                _keep(made, _search_without(made, part, report=report))
        yield finish(made)


def _keep(made: Search, nested: Nested) -> None:
    made.nested[nested.part] = nested
    files.write_nested(made.directory, made.key, made.nested)


def _in_processes(
    searches: Sequence[Search], jobs: Jobs, workers: int, progress: Progress | None
) -> None:
    """Share the studies and their nested ones out to processes."""
    mains: list[Task] = []
    nested: list[Task] = []
    for k, made in enumerate(searches):
        # Begun once, before processes share it.
        open_main(made)
        given = (k, pickle.dumps(made.problem.plan), made.directory, made.held_out, made.storage)
        mains += [(*given, None, worker) for worker in range(workers)]
        nested += [(*given, part, 0) for part in range(made.n_parts) if part not in made.nested]
    seconds = [0.0] * len(searches)
    at_work = [workers] * len(searches)
    for k, part, found in in_order(_do, [*mains, *nested], jobs, ordered=False):
        made, label = searches[k], searches[k].problem.plan.name
        if part is not None:
            _keep(made, found)
            best = found.values[0]
        else:
            seconds[k] = max(seconds[k], found)
            at_work[k] -= 1
            if at_work[k]:
                continue
            finish_main(made, seconds[k])
            best = next(iter(made.best["values"].values()))
        if progress is not None:
            progress(label, made.problem.settings.trials, best)


def finish_main(made: Search, seconds: float) -> None:
    """Write trials and best parameters of the study on all frames."""
    problem = made.problem
    study = open_main(made)
    made.trials = files.trials_columns(study, problem.settings.objectives)
    files.write_trials(made.directory, made.trials)
    point = best_trial(study).params
    made.experiments = files.best_experiments(problem, point)
    for file, content in made.experiments.items():
        write_yaml(made.directory / file, content)
    names = [drive.experiment.name for drive in problem.drives]
    sets = dict(zip(names, parameters_at(problem, point), strict=True))
    best = files.best_entry(study, problem.settings.objectives, sets)
    made.best = {**best, "seconds": seconds}


def finish(made: Search) -> dict[str, Any]:
    """Score a search in-sample and held out, write its study.json and return what is in that."""
    problem, drives = made.problem, made.problem.drives
    fleet, subsets = problem.plan.fleet, _subsets(problem)
    drive_of = None if fleet is None else fleet.drive_of
    scores = partial(assess, drives, drive_of=drive_of)
    in_sample = beliefs_at(problem, made.best["point"])
    content = {
        **files.provenance_of(problem),
        "best": made.best,
        "in_sample": {
            "tuned_on": "same_frames",
            **{key: scores(in_sample, keep) for key, keep in subsets.items()},
        },
        "held_out": None,
        "difference": None,
        "test": None,
        "notes": made.notes,
    }
    if made.held_out != "none":
        by_recording = made.by_recording
        nested = [made.nested[b] for b in range(made.n_parts)]
        held_out = beliefs_held_out(problem, nested, by_recording)
        left_out = [_names(problem, n.part) if by_recording else None for n in nested]
        content["held_out"] = {
            **files.held_out_entry(nested, made.held_out, left_out),
            **{key: scores(held_out, keep) for key, keep in subsets.items()},
        }
        content["difference"] = {
            key: difference(drives, in_sample, held_out, keep, drive_of=drive_of)
            for key, keep in subsets.items()
        }
    if made.test is not None:
        content["test"] = _tested(made.test, made.best["point"])
    write_json(made.directory / STUDY_FILE, content)
    return content


def _names(problem: Problem, part: int) -> str:
    return ", ".join(problem.drives[k].experiment.name for k in problem.parts[part])


def _tested(test: Problem, point: dict[str, Any]) -> dict[str, Any]:
    """Scores on recordings that had no part in the search."""
    beliefs = beliefs_at(test, point)
    scores = {key: assess(test.drives, beliefs, kept) for key, kept in _subsets(test).items()}
    return {"tuned_on": "other_frames", "name": test.plan.name, **scores}


def _subsets(problem: Problem) -> dict[str, list[BoolArray]]:
    """The frames that are scored, per drive: all, and, where some labels are not trusted, the
    others."""
    trusted = [drive.may_fit for drive in problem.drives]
    everything = {"all_frames": all_used(problem.drives)}
    if all(keep.all() for keep in trusted):
        return everything
    return {**everything, "without_never_fit": trusted}


def n_trials(searches: Sequence[Any]) -> int:
    """How many trials there are to do, those of nested studies included."""
    return sum((1 + made.n_parts) * made.problem.settings.trials for made in searches)
