"""The files of a study's directory:

study.json     schema_version, name, what was searched and how, data (path, sha256, bytes),
               versions, git, best, pareto, in_sample, held_out, difference
trials.csv     number, state, a column per score (in-sample) and per parameter; also .parquet
best.yaml      the best parameters as an experiment for `egolane run`; best_<name>.yaml for
               each of several recordings, but not of a fleet's drives
nested.json    the result of each study without one part, so that a repeated command goes on
study.journal  the study itself, as Optuna keeps it (not with --storage)
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import optuna
import pyarrow as pa
from pyarrow import csv

from egolane_pgm.drive import data_entries
from egolane_pgm.experiment import Experiment, resolved
from egolane_pgm.parameters import Value
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.recordings.source import files_in_full
from egolane_pgm.results import provenance
from egolane_pgm.tools.files import atomic, plain, write_json, write_parquet
from egolane_pgm.tuning.identity import identity_of
from egolane_pgm.tuning.nested import Nested
from egolane_pgm.tuning.objective import split, with_detector
from egolane_pgm.tuning.plan import Problem, parameters_at
from egolane_pgm.tuning.search import best_trial, n_complete, pareto
from egolane_pgm.views.study_trials import SCHEMA_VERSION, TRIALS_FILE

NESTED_FILE = "nested.json"


def provenance_of(problem: Problem) -> dict[str, Any]:
    """Where a study's numbers come from, and how it was done."""
    identity = identity_of(problem)
    data = [
        {**entry, "path": Path(entry["path"]).name}
        for drive in problem.drives
        for entry in data_entries(drive.experiment, drive.recorded.files)
    ]
    return {
        **head_of(problem, identity, data),
        "run": problem.plan.run,
        "fleet": _fleet(problem),
        "experiments": [resolved(d.experiment, d.model.parameters) for d in problem.drives],
    }


def head_of(
    problem: Any, identity: Mapping[str, Any], data: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The first keys of study.json, the same for recordings and pictures.

    - problem: with its `plan` and `settings`. identity: as `search_identity`.
    - data: a `file_entry` for each file.
    """
    settings = problem.settings
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "tuning",
        **provenance(problem.plan.name, identity, data),
        "description": problem.plan.description,
        "tuning": {
            **problem.plan.tuning.model_dump(mode="json"),
            "objective": list(settings.objectives),
            "sampler": settings.sampler,
            "trials": settings.trials,
        },
        "space": identity["space"],
    }


def _fleet(problem: Problem) -> dict[str, Any] | None:
    """The drives of a fleet that are held out together, and their tags and which drive each row is
    of, by name."""
    fleet = problem.plan.fleet
    if fleet is None:
        return None
    names = [experiment.name for experiment in problem.plan.experiments]
    return {
        "parts": [[names[k] for k in part] for part in fleet.parts],
        "tags": dict(zip(names, map(dict, fleet.tags), strict=True)),
        "drives": dict(zip(names, fleet.drive_of, strict=True)),
    }


def best_entry(
    study: optuna.Study, objectives: Sequence[str], parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """What study.json says of the best trial. parameters: what its point means, by experiment."""
    best = best_trial(study)
    front = {"pareto": pareto(study)} if len(objectives) > 1 else {}
    return {
        "number": best.number,
        "values": dict(zip(objectives, best.values, strict=True)),
        "point": dict(best.params),
        "parameters": dict(parameters),
        "trials": n_complete(study),
        **front,
    }


def held_out_entry(
    nested: Sequence[Nested], parts: str, left_out: Sequence[str | None]
) -> dict[str, Any]:
    """What study.json says of the studies without a part; the scores are not among it.

    - parts: what was held out, "blocks" or "recordings". left_out: of each study its name, if any.
    """
    return {
        "tuned_on": "other_frames",
        "parts": parts,
        "starts": "from scratch: known values may have been tuned on the frames held out",
        "studies": [
            {
                "part": n.part + 1,
                "left_out": name,
                "trials": n.trials,
                "in_sample_values": list(n.values),
                "point": n.point,
            }
            for n, name in zip(nested, left_out, strict=True)
        ],
    }


def trials_columns(study: optuna.Study, objectives: Sequence[str]) -> dict[str, list[Any]]:
    """A row per trial: `number`, `state`, `<score>_in_sample`, and each number searched."""
    trials = study.get_trials(deepcopy=False)
    columns: dict[str, list[Any]] = {
        "number": [t.number for t in trials],
        "state": [t.state.name for t in trials],
    }
    for k, name in enumerate(objectives):
        columns[f"{name}_in_sample"] = [None if t.values is None else t.values[k] for t in trials]
    keys = dict.fromkeys(key for t in trials for key in t.params)
    for key in keys:
        columns[key] = [t.params.get(key) for t in trials]
    return columns


def write_trials(directory: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """trials.csv and trials.parquet; raises InputError where they cannot be written."""
    table = pa.table(dict(columns))
    # A file handle of its own: paths with odd characters are URIs to pyarrow.
    with atomic(directory / "trials.csv") as path, path.open("wb") as file:
        csv.write_csv(table, file)
    write_parquet(directory / TRIALS_FILE, table)


def best_experiments(problem: Problem, point: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The best parameters as experiments that `egolane run` takes, by the name of the file: one
    per recording, one for all drives of a fleet."""
    if problem.plan.fleet is not None:
        # Of a drive that it is run on nobody knows whether it is one of them.
        parameters = parameters_at(problem, point)[0]
        content = tuned_experiment(problem.plan.fleet.experiment, parameters, problem)
        return {"best.yaml": {**content, "tuned_on": "unknown"}}
    one = len(problem.drives) == 1
    return {
        "best.yaml" if one else f"best_{drive.experiment.name}.yaml": tuned_experiment(
            drive.experiment, parameters, problem
        )
        for drive, parameters in zip(problem.drives, parameters_at(problem, point), strict=True)
    }


def tuned_experiment(
    experiment: Experiment, parameters: Mapping[str, Value], problem: Problem
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


def nested_key(problem: Problem, by_recording: bool) -> dict[str, Any]:
    """What the results of the nested studies depend on."""
    return {
        **identity_of(problem),
        "trials": problem.settings.trials,
        "blocks": _parts(problem) if by_recording else problem.plan.tuning.blocks,
        "never_fit": [int((~drive.may_fit).sum()) for drive in problem.drives],
    }


def _parts(problem: Problem) -> str | list[list[int]]:
    if problem.plan.fleet is None:
        return "recordings"
    return [list(part) for part in problem.parts]


def read_nested(directory: Path, key: Mapping[str, Any]) -> dict[int, Nested]:
    """Nested studies that are done already, by part; none where they were others."""
    try:
        content = json.loads((directory / NESTED_FILE).read_text(encoding="utf-8"))
        if content["key"] != key:
            return {}
        return {
            int(entry["part"]): Nested(
                int(entry["part"]),
                dict(entry["point"]),
                tuple(map(float, entry["values"])),
                int(entry["trials"]),
            )
            for entry in content["parts"]
        }
    # A damaged file is none: what it says can be computed again.
    except (OSError, ValueError, LookupError, TypeError):
        return {}


def write_nested(directory: Path, key: Mapping[str, Any], done: Mapping[int, Nested]) -> None:
    """Keep the nested studies that are done."""
    parts = [
        {"part": n.part, "point": n.point, "values": list(n.values), "trials": n.trials}
        for _, n in sorted(done.items())
    ]
    write_json(directory / NESTED_FILE, {"key": key, "parts": parts})
