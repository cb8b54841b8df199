"""Recordings as the task of a search: one, several with equal weight, or the drives of a fleet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.drive import Drive, data_entries
from egolane_pgm.experiment import Experiment, resolved
from egolane_pgm.parameters import Value
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.recordings.source import files_in_full
from egolane_pgm.scoring.held_out import stitched_rows, without_block
from egolane_pgm.tools.files import plain
from egolane_pgm.tuning.assess import assess, difference
from egolane_pgm.tuning.nested import blocks_lacking_lanes
from egolane_pgm.tuning.objective import (
    all_used,
    notes_of_silent,
    split,
    tried_belief,
    with_detector,
)
from egolane_pgm.tuning.plan import (
    Plan,
    Problem,
    make_problem,
    parameters_at,
    scorer,
    starting_points,
)
from egolane_pgm.tuning.space import Point, to_parameters
from egolane_pgm.tuning.task import Task, identity_of
from egolane_pgm.types import BoolArray, FloatArray


def recording_task(plan: Plan, held_out: str) -> Task:
    """Read the recordings of a plan; see `task.task_of`."""
    problem = make_problem(plan)
    drives, fleet, n_blocks = problem.drives, plan.fleet, plan.tuning.blocks
    names = [drive.experiment.name for drive in drives]
    if fleet is not None and held_out != "none":
        held_out = "recordings"
    whole = held_out == "recordings"
    starts, notes = starting_points(problem)
    notes = [note for drive in drives for note in drive.recorded.notes] + notes
    notes += notes_of_silent(drives, problem.settings.objectives)
    left_out: list[str | None] = []
    if whole:
        left_out += [", ".join(names[k] for k in part) for part in problem.parts]
    elif held_out == "blocks":
        left_out += [None] * n_blocks
        for name, drive in zip(names, drives, strict=True):
            notes += [f"{name}: {note}" for note in blocks_lacking_lanes(drive, n_blocks)]
    parts: Any = "recordings" if fleet is None else [list(part) for part in problem.parts]
    entries = [data_entries(drive.experiment, drive.recorded.files) for drive in drives]
    known = [_identity(drive, mine) for drive, mine in zip(drives, entries, strict=True)]
    searched_on: dict[str, Any] = {"recordings": dict(zip(names, known, strict=True))}
    if fleet is not None:
        searched_on["frames_of_all_drives_alike"] = True
    spaces = dict(zip(names, problem.spaces, strict=True))
    return Task(
        plan=plan,
        settings=problem.settings,
        spaces=spaces,
        starts=starts,
        notes=notes,
        held_out=held_out,
        part="part" if fleet is not None else "block",
        left_out=left_out,
        identity=identity_of(plan, spaces, **searched_on),
        parts_key={
            "blocks": parts if whole else n_blocks,
            "never_fit": [int((~drive.may_fit).sum()) for drive in drives],
        },
        data=[{**entry, "path": Path(entry["path"]).name} for mine in entries for entry in mine],
        document={
            "run": plan.run,
            "fleet": _fleet(plan),
            "experiments": [resolved(d.experiment, d.model.parameters) for d in drives],
        },
        scorer=lambda part: (
            scorer(problem, all_used(drives))
            if part is None
            else scorer(*without_part(problem, part))
        ),
        answers=partial(beliefs_at, problem),
        assess=partial(assess_beliefs, problem),
        parameters=lambda point: dict(zip(names, parameters_at(problem, point), strict=True)),
        experiments=partial(best_experiments, problem),
    )


def without_part(problem: Problem, part: int) -> tuple[Problem, list[BoolArray]]:
    """The problem without the labels of a part, a block of each recording or some drives of a
    fleet, and per drive the frames that may be used."""
    if problem.plan.fleet is not None:
        kept = [k for k in range(len(problem.drives)) if k not in problem.parts[part]]
        drives = tuple(problem.drives[k] for k in kept)
        spaces = tuple(problem.spaces[k] for k in kept)
        smaller = replace(problem, drives=drives, spaces=spaces)
        return smaller, [drive.may_fit for drive in drives]
    n_blocks = problem.plan.tuning.blocks
    pairs = [without_block(drive, n_blocks, part) for drive in problem.drives]
    used = [np.isin(np.arange(len(drive)), train) for drive, train in pairs]
    return replace(problem, drives=tuple(drive for drive, _ in pairs)), used


def beliefs_at(problem: Problem, points: Sequence[Point]) -> list[FloatArray]:
    """Per drive the belief (K, n): with the parameters of one point, or each part with those of its
    own."""
    if len(points) > 1 and problem.plan.fleet is not None:
        point_of = {k: points[b] for b, part in enumerate(problem.parts) for k in part}
        sets = [to_parameters(space, point_of[k]) for k, space in enumerate(problem.spaces)]
        return [tried_belief(d, p) for d, p in zip(problem.drives, sets, strict=True)]
    each = [
        [tried_belief(d, p) for d, p in zip(problem.drives, sets, strict=True)]
        for sets in (parameters_at(problem, point) for point in points)
    ]
    return [stitched_rows(beliefs) for beliefs in zip(*each, strict=True)]


def assess_beliefs(
    problem: Problem, beliefs: Sequence[FloatArray], minus: Sequence[FloatArray] | None = None
) -> dict[str, Any]:
    """The scores of beliefs, or how much more they are than those of others, of all frames and,
    where some labels are not trusted, of the others; see `Task`."""
    drives, fleet = problem.drives, problem.plan.fleet
    drive_of = None if fleet is None else fleet.drive_of
    trusted = [drive.may_fit for drive in drives]
    subsets = {"all_frames": all_used(drives), "without_never_fit": trusted}
    if all(keep.all() for keep in trusted):
        del subsets["without_never_fit"]
    if minus is None:
        return {k: assess(drives, beliefs, kept, drive_of=drive_of) for k, kept in subsets.items()}
    return {
        name: difference(drives, beliefs, minus, kept, drive_of=drive_of)
        for name, kept in subsets.items()
    }


def _identity(drive: Drive, data: Sequence[Any]) -> dict[str, Any]:
    """What makes two recordings with their models the same."""
    content = resolved(drive.experiment, {})
    kept = ("n_lanes", "evidence", "graph", "filter", "evidence_reading", "unassigned_below")
    return {
        **{key: content[key] for key in kept},
        "recording": {k: v for k, v in content["recording"].items() if k != "path"},
        "data": [entry["sha256"][:16] for entry in data],
    }


def _fleet(plan: Plan) -> dict[str, Any] | None:
    """The drives of a fleet that are held out together, and their tags and which drive each row is
    of, by name."""
    if plan.fleet is None:
        return None
    names = [experiment.name for experiment in plan.experiments]
    return {
        "parts": [[names[k] for k in part] for part in plan.fleet.parts],
        "tags": dict(zip(names, map(dict, plan.fleet.tags), strict=True)),
        "drives": dict(zip(names, plan.fleet.drive_of, strict=True)),
    }


def best_experiments(problem: Problem, point: Point) -> dict[str, dict[str, Any]]:
    """The parameters of a point as experiments that `egolane run` takes, by the name of the file:
    one per recording, one for all drives of a fleet."""
    sets, fleet = parameters_at(problem, point), problem.plan.fleet
    if fleet is not None:
        # Of a drive that it is run on nobody knows whether it is one of them.
        content = tuned_experiment(fleet.experiment, sets[0], problem)
        return {"best.yaml": {**content, "tuned_on": "unknown"}}
    one = len(problem.drives) == 1
    return {
        "best.yaml" if one else f"best_{drive.experiment.name}.yaml": tuned_experiment(
            drive.experiment, parameters, problem
        )
        for drive, parameters in zip(problem.drives, sets, strict=True)
    }


def tuned_experiment(
    experiment: Experiment, parameters: dict[str, Value], problem: Problem
) -> dict[str, Any]:
    """The experiment with other parameters, as the keys of a YAML file that may lie anywhere."""
    own, detector = split(parameters)
    if detector:
        experiment = with_detector(experiment, detector)
    content = plain(resolved(experiment, own))
    content["name"] = f"{experiment.name}_tuned"
    scores = ", ".join(problem.settings.objectives)
    what = f"parameters tuned for {scores}: {problem.settings.trials} trials"
    if len(problem.drives) > 1:
        what += f" on {len(problem.drives)} recordings, {problem.plan.name}"
    content["description"] = "; ".join(part for part in (experiment.description, what) if part)
    content["tuned_on"] = "same_frames"
    for key in ("recording", "ground_truth"):
        if content[key]:
            content[key] = files_in_full(content[key], experiment.folder)
    for key in ("evidence", "graph"):
        if str(content[key]).endswith(OWN_FILES):
            content[key] = str((experiment.folder / content[key]).absolute())
    return dict(content)
