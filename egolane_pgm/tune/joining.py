"""Studies that several machines share: begun with an experiment, joined with their name alone.

Whoever begins a study leaves in the database what it is (the experiments, without their folders)
and what its scores depend on: checksums of the recordings, search space, code of graph and
evidence rule, version of the package. Nobody takes a trial before all of that is the same.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import egolane_pgm
from egolane_pgm.experiment import Experiment, Tuning, make_experiment, validated
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.results import file_sha256, plain
from egolane_pgm.tune import output
from egolane_pgm.tune._connection import Link
from egolane_pgm.tune.address import Address
from egolane_pgm.tune.held_out import Nested, settings_without, without_part
from egolane_pgm.tune.objective import all_used
from egolane_pgm.tune.plan import Plan, Problem, evaluator, make_problem, starting_points
from egolane_pgm.tune.postgres import (
    Account,
    Kept,
    Part,
    account,
    begin_job,
    check_same,
    find_job,
    read_trials,
)
from egolane_pgm.tune.shared import SharedJob, Task, run_shared
from egolane_pgm.tune.storage import JOURNAL_NAME, SQLITE_NAME, only_one
from egolane_pgm.tune.study import best_trial, new_study
from egolane_pgm.tune.tuning import Progress, Study, corners, finish, finish_main
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

#: Of the document that says what a study is.
DOCUMENT_VERSION = 1

#: What of the package a score depends on; the plugins themselves are told apart by name.
SCORED_BY = (
    *("types.py", "cpds.py", "camera.py", "model.py", "loading.py", "plugins.py", "validation.py"),
    *("graphs", "evidence", "inference", "scoring"),
    *("recordings", "detectors", "calibration", "simulation"),
    *("tune/space.py", "tune/objective.py", "tune/held_out.py", "tune/evolution.py"),
)


def code_of(problem: Problem) -> dict[str, str]:
    """What scores depend on beside recordings and parameters: the package's version, and the
    beginning of a sha256 of each graph, evidence rule, format and detector of one's own, and of
    what they stand on."""
    folder = Path(egolane_pgm.__file__).parent
    files = []
    for name in SCORED_BY:
        place = folder / name
        files += sorted(place.rglob("*.py")) if place.is_dir() else [place] * place.is_file()
    whole = hashlib.sha256()
    for file in files:
        whole.update(f"{file.relative_to(folder).as_posix()}\n".encode() + file.read_bytes())
    found = {"egolane": egolane_pgm.__version__, "package": whole.hexdigest()[:16]}
    for drive in problem.drives:
        experiment, model = drive.experiment, drive.model
        for kind, name, module in (
            ("graph", experiment.graph, model.graph),
            ("evidence", experiment.evidence, model.rule),
        ):
            own = experiment.folder / name
            path = own if name.endswith(OWN_FILES) else Path(str(module.__file__))
            found[f"{kind} {name}"] = file_sha256(path)[:16]
        recording = experiment.recording
        for kind, own_file in (("format", recording.format), ("detector", recording.detector)):
            if own_file is not None and own_file.endswith(OWN_FILES):
                found[f"{kind} {own_file}"] = file_sha256(experiment.folder / own_file)[:16]
    return found


def document_of(plan: Plan) -> dict[str, Any]:
    """A plan as JSON, for machines that have no YAML of it."""
    document: dict[str, Any] = {
        "version": DOCUMENT_VERSION,
        "name": plan.name,
        "description": plan.description,
        "tuning": plain(plan.tuning.model_dump(mode="json")),
        "experiments": [plain(e.model_dump(mode="json")) for e in plan.experiments],
    }
    return document


def plan_from(kept: Kept, address: Address) -> Plan:
    """The plan of a study in the database, its recordings found on this machine: as the plan names
    them, or by the name of the file and its checksum below $EGOLANE_DATA and the working directory.

    Raises InputError for a document of another version and for recordings that are not here.
    """
    where = f"storage {address.shown}: study {kept.job}"
    document = kept.attributes.get("plan", {})
    if document.get("version") != DOCUMENT_VERSION:
        raise InputError(
            f"{where}: is described in version {document.get('version')}, this egolane reads"
            f" {DOCUMENT_VERSION}; take the egolane that began it"
        )
    known = kept.attributes.get("identity", {}).get("recordings", {})
    experiments = []
    for content in document["experiments"]:
        sums = known.get(content["name"], {}).get("data", [])
        experiments.append(_experiment_here(content, sums, where))
    return Plan(
        document["name"],
        document["description"],
        tuple(experiments),
        validated(Tuning, document["tuning"], where),
        where,
    )


def _experiment_here(content: dict[str, Any], sums: Sequence[str], where: str) -> Experiment:
    for section in ("recording", "ground_truth"):
        part = content.get(section)
        # Pictures may be a pattern or a folder: they are found as the experiment names them.
        if part and part.get("path") and not part.get("detector"):
            part["path"] = str(_find(part["path"], sums, f"{where}: {section}"))
    return make_experiment(content, Path.cwd(), where)


def _find(path: str, sums: Sequence[str], where: str) -> Path:
    """The file that has one of the checksums (their beginnings), else one of that name."""
    try:
        return find_file(path, Path.cwd(), folders=True)
    except InputError:
        name = Path(path).name
        data = os.environ.get("EGOLANE_DATA", "")
        places = list(Path.cwd().glob(name))
        places += sorted(Path(data).expanduser().rglob(name)) if data else []
        places = [place for place in places if place.is_file()]
        for place in places:
            if any(file_sha256(place).startswith(beginning) for beginning in sums):
                return place
        if places:
            return places[0]
    raise InputError(
        f"{where}: {Path(path).name} is not on this machine; set EGOLANE_DATA to the folder that"
        " has it, or go there"
    )


def tune_shared(
    studies: Sequence[Study],
    address: Address,
    *,
    workers: int = 1,
    grace_s: float,
    progress: Progress | None = None,
) -> Iterator[dict[str, Any]]:
    """Do studies together with whoever else joins them, and yield each one's study.json. Nested
    studies belong to the same job. Raises InputError as `tune` and the storage do."""
    for study in studies:
        with only_one(study.directory):
            yield _tune_one(study, address, workers, grace_s, progress)


def _tune_one(
    study: Study, address: Address, workers: int, grace_s: float, progress: Progress | None
) -> dict[str, Any]:
    problem, directory = study.problem, study.directory
    if any((directory / name).exists() for name in (SQLITE_NAME, JOURNAL_NAME)):
        raise InputError(
            f"{directory}: was begun without --storage; go on without it, or name another"
            " directory with --out"
        )
    _, notes = starting_points(problem)
    study.notes += notes
    parts = _parts(study)
    begun = time.perf_counter()
    link = Link(address)
    kept = begin_job(link, problem.plan.name, parts, grace_s)
    if kept[0].asked > problem.settings.trials:
        study.notes.append(f"the storage asks for {kept[0].asked} trials, more than this command")
    job = SharedJob(address, problem.plan.name, [_task(problem, k) for k in kept])
    _warm(job, problem)
    link.close()
    run_shared(job, workers, progress)
    for task in job.tasks:
        finished = read_trials(link, task.kept.study_id, problem.space)
        done = new_study(problem.settings, finished)
        if task.kept.kind == "all":
            finish_main(study, done, time.perf_counter() - begun)
        else:
            best = best_trial(done)
            study.nested[task.kept.part] = Nested(
                task.kept.part, dict(best.params), tuple(best.values), _complete(finished)
            )
    link.close()
    return finish(study)


def _complete(trials: Sequence[FrozenTrial]) -> int:
    return sum(trial.values is not None for trial in trials)


def _parts(study: Study) -> list[Part]:
    """The study on all frames, and those without a part."""
    problem = study.problem
    name, settings, space = problem.plan.name, problem.settings, problem.space
    attributes = {
        "identity": output.identity_of(problem),
        "code": code_of(problem),
        "plan": document_of(problem.plan),
    }
    parts = [Part(name, "all", 0, 1, space, settings, _as_json(attributes))]
    by_recording = study.held_out == "recordings"
    for k in range(study.n_parts):
        what = (
            f"recording {problem.drives[k].experiment.name}"
            if by_recording
            else f"block {k + 1} of {study.n_parts}"
        )
        own = settings_without(problem, k)
        key = output.nested_key(problem, by_recording)
        key.pop("trials")
        parts.append(
            Part(
                f"{name} without {what}",
                "recording" if by_recording else "block",
                k,
                study.n_parts,
                space,
                own,
                _as_json({"identity": key, "code": attributes["code"]}),
            )
        )
    return parts


def _as_json(content: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(plain(content)))


def _task(problem: Problem, kept: Kept) -> Task:
    """A study of the database, with what it takes to score its trials here."""
    if kept.kind == "all":
        evaluate = evaluator(problem, all_used(problem.drives))
        starts, _ = starting_points(problem)
        return Task(kept, problem.space, evaluate, problem.settings, starts)
    if kept.kind == "block" and problem.plan.tuning.blocks != kept.n_parts:
        tuning = problem.plan.tuning.model_copy(update={"blocks": kept.n_parts})
        problem = replace(problem, plan=replace(problem.plan, tuning=tuning))
    smaller, used = without_part(problem, kept.part, kept.kind == "recording")
    settings = settings_without(problem, kept.part)
    return Task(kept, problem.space, evaluator(smaller, used), settings)


def _warm(job: SharedJob, problem: Problem) -> None:
    """Make evidence and kernels once, before the processes part."""
    job.tasks[0].evaluate([dict(point) for point in corners(problem)])


def join(name: str, address: Address, workers: int, progress: Progress | None = None) -> Account:
    """Work on a study that another machine began, until it is finished. Returns what became of all
    its trials.

    Raises InputError, before a trial is taken, where recordings, search space or code differ from
    those of whoever began it; and as the storage does.
    """
    link = Link(address)
    kept = find_job(link, name)
    if kept[0].kind != "all":
        raise InputError(f"storage {address.shown}: study {name} has lost its first part")
    problem = make_problem(plan_from(kept[0], address))
    mine = _as_json({"identity": output.identity_of(problem), "code": code_of(problem)})
    for part in kept:
        # What a nested study is follows from the study on all frames.
        found = {**part.attributes, "identity": kept[0].attributes.get("identity", {})}
        check_same(address, part.name, found, mine)
    job = SharedJob(address, name, [_task(problem, k) for k in kept])
    _warm(job, problem)
    link.close()
    run_shared(job, workers, progress)
    result = account(link, name)
    link.close()
    return result
