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
from pydantic import TypeAdapter

from egolane_pgm.results import provenance
from egolane_pgm.tools.files import atomic, write_json, write_parquet
from egolane_pgm.tuning.nested import Nested
from egolane_pgm.tuning.search import best_trial, n_complete, pareto
from egolane_pgm.tuning.task import Task
from egolane_pgm.views.study_trials import SCHEMA_VERSION, TRIALS_FILE

NESTED_FILE = "nested.json"


def head_of(task: Task) -> dict[str, Any]:
    """The first keys of study.json: where a study's numbers come from, and how it was done."""
    settings = task.settings
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "tuning",
        **provenance(task.plan.name, task.identity, task.data),
        "description": task.plan.description,
        "tuning": {
            **task.plan.tuning.model_dump(mode="json"),
            "objective": list(settings.objectives),
            "sampler": settings.sampler,
            "trials": settings.trials,
        },
        "space": task.identity["space"],
        **task.document,
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


def held_out_entry(task: Task, nested: Sequence[Nested]) -> dict[str, Any]:
    """What study.json says of the studies without a part; the scores are not among it."""
    return {
        "tuned_on": "other_frames",
        "parts": task.held_out,
        "starts": "from scratch: known values may have been tuned on the frames held out",
        "studies": [
            {
                "part": n.part + 1,
                "left_out": name,
                "trials": n.trials,
                "in_sample_values": list(n.values),
                "point": n.point,
            }
            for n, name in zip(nested, task.left_out, strict=True)
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


def read_nested(directory: Path, key: Mapping[str, Any]) -> dict[int, Nested]:
    """Nested studies that are done already, by part; none where they were others."""
    try:
        content = json.loads((directory / NESTED_FILE).read_text(encoding="utf-8"))
        if content["key"] != key:
            return {}
        return {n.part: n for n in TypeAdapter(list[Nested]).validate_python(content["parts"])}
    # A damaged file is none: what it says can be computed again.
    except (OSError, ValueError, LookupError, TypeError):
        return {}


def write_nested(directory: Path, key: Mapping[str, Any], done: Mapping[int, Nested]) -> None:
    """Keep the nested studies that are done."""
    parts = [n for _, n in sorted(done.items())]
    write_json(directory / NESTED_FILE, {"key": key, "parts": parts})
