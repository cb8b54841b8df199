"""The verb `learn`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, overload

from egolane_pgm.comparing.placing import parts_of_fleet
from egolane_pgm.drive import with_own_rate
from egolane_pgm.drive_table import DriveTable
from egolane_pgm.experiment import Experiment, Given, Overrides, load_experiment
from egolane_pgm.fleet import drive_row, drives_of, experiments_of, pooled
from egolane_pgm.held_out import held_out_result
from egolane_pgm.learning import Learned, fit, output_files, write_learned
from egolane_pgm.learning.fleet import SHARED, LearnedFleet
from egolane_pgm.learning.fleet import learn_fleet as learn_together
from egolane_pgm.learning.held_out import (
    load_to_learn,
    log_evidence_of,
    mean_log_evidence,
    trusted_frames,
)
from egolane_pgm.learning.tables import PREFIX
from egolane_pgm.results import SCHEMA_VERSION, Result
from egolane_pgm.tools.files import check_not_read, plain
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Blocks, ByTag, Fleet, Jobs, Option, Progress, StrPath, path_of
from egolane_pgm.views.fleet_table import fleet_table_rows
from egolane_pgm.views.shown import evidence_words
from egolane_pgm.views.tables import Table, with_interval

EXAMPLES = (
    "egolane learn drive/experiment.yaml --out learned.yaml",
    "egolane learn experiments/quickstart.yaml --fleet drives.csv --by-tag weather",
)


@overload
def learn(experiment: Given, *, fleet: StrPath, **options: Any) -> DriveTable: ...


@overload
def learn(experiment: Given, **options: Any) -> Result: ...


# The overloads leave the options to this one, where they stand once.
def learn(  # type: ignore[misc]
    experiment: Given,
    *,
    overrides: Overrides = (),
    out: Annotated[StrPath | None, Option("FILE", default="learned_*.yaml")] = None,
    blocks: Blocks = 5,
    fleet: Fleet = None,
    by_tag: ByTag = None,
    jobs: Jobs = 1,
    progress: Progress = None,
) -> Result | DriveTable:
    """Learn an experiment from its recording: a new experiment, and what it is worth held out.

    An evidence rule that can learn (line_geometry) learns its parameters from the labels; with any
    other the tables of the graph are learned by EM, from lines and labels, or from lines alone.
    They are written in numbers, as a YAML graph beside the new experiment. Each block is scored
    with what was learned from the frames of the other blocks.

    With a fleet it is learned from all drives of a table together, and each part of the drives is
    scored with what was learned from the others.

    - experiment: an experiment, or its YAML file.
    - overrides: override a key of the YAML, e.g. learning.labels=false, which looks at no label.
    - out: the new experiment. A `*` in it is the name of the old one.
    - blocks: blocks held out in turn; of a fleet parts of its drives.
    - fleet: a table with a row per drive (.csv, .parquet, .yaml): recording, n_lanes, tag.X, ...
    - by_tag: with a fleet: hold out the drives with each value of tag.NAME in turn.
    - jobs: processes that share the fits of a fleet.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns the result of what was believed held out, or a `DriveTable` of a fleet; `learned` is
    what was learned from everything. Without `out` nothing is written. Raises InputError where
    nothing can be learned as the experiment says.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 600]})
    >>> held_out = ego.learn(experiment, overrides={"learning.labels": False}, blocks=2)
    >>> held_out
    Result('quickstart': 600 frames, accuracy 0.880 ...; held out, causal)
    >>> sorted(held_out.learned.parameters)[:1]
    ['tables.DetectorOutput']
    """
    if isinstance(experiment, (list, tuple)):
        raise InputError("experiment: takes one; fleet takes a table of drives")
    given = load_experiment(experiment, overrides)
    target = None if out is None else _target(path_of(out, "out"), given.name)
    for file in () if target is None else output_files(given, target):
        check_not_read(file, [] if fleet is None else [Path(fleet)])
    if fleet is None:
        given = with_own_rate(given)
        if by_tag is not None or jobs != 1:
            raise InputError("by_tag: goes with a fleet, as jobs do")
        found: Result | DriveTable = _learn_drive(given, blocks, progress)
        source = None
    else:
        given, found = _learn_fleet(given, fleet, overrides, blocks, by_tag, jobs, progress)
        source = str(found.document["fleet"])
    if target is not None:
        write_learned(given, found.learned.model, found.learned.parameters, target, source)
    return found


def says(done: Result | DriveTable, given: Mapping[str, Any]) -> str:
    """Where the new experiment is."""
    name = done.experiment.name if isinstance(done, Result) else str(done.document["name"])
    target = _target(given["out"], name)
    has_tables = any(key.startswith(PREFIX) for key in done.learned.parameters)
    graph = f" and {target.with_name(f'{target.stem}.graph.yaml')}" if has_tables else ""
    return f"written to {target}{graph}"


def _target(out: str, name: str) -> Path:
    return Path(out.replace("*", name.removeprefix("learned_")))


def _learn_drive(given: Experiment, blocks: int, progress: bool | None) -> Result:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        drive = load_to_learn(given.model_copy(update={"fit": "learn"}))
        trusted = trusted_frames(drive)
        with bar(None, progress, total=blocks + 1, unit="fit") as shows:
            parameters = fit(drive.only_labels_of(trusted), trusted)
            shows.update()
            found = held_out_result(drive, n_blocks=blocks, done=shows.update)
    evidence = log_evidence_of(drive, found.run["parameters_per_block"])
    learned = Learned(drive.model, parameters, mean_log_evidence([evidence]))
    # Several blocks may give the same warning.
    notes = dict.fromkeys([*found.notes, *(str(w.message) for w in caught)])
    scores = {
        **found.scores,
        "fit": "learn",
        "blocks": blocks,
        "log_evidence": _evidence(learned),
        "parameters": {**parameters, **learned.tables()},
    }
    run = {**found.run, "warnings": list(notes)}
    return replace(found, run=run, scores=plain(scores), learned=learned)


def _of_one(result: Result) -> LearnedFleet:
    """What was learned from a fleet of one drive."""
    alone = result.learned
    evidence = alone.log_evidence
    scores = (result.scores.get("model"),)
    return LearnedFleet(alone.model, alone.parameters, scores, (evidence,), evidence)


def _evidence(learned: Learned | LearnedFleet) -> dict[str, float] | None:
    if learned.log_evidence is None:
        return None
    before, after = learned.log_evidence
    return {"before": before, "held_out": after}


def _learn_fleet(
    base: Experiment,
    fleet: StrPath,
    overrides: Overrides,
    blocks: int,
    by_tag: str | None,
    jobs: Jobs,
    progress: bool | None,
) -> tuple[Experiment, DriveTable]:
    """The experiment that is learned, on the drives' road, and the table of the drives. By EM the
    expected counts of the drives are added."""
    drives, experiments = experiments_of(base, fleet, overrides)
    of = drives_of(drives, experiments)
    parts = parts_of_fleet(drives, of, blocks, by_tag)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        if parts:
            with bar(None, progress, total=1 + len(parts), unit="fit") as shows:
                learned = learn_together(experiments, parts, jobs=jobs, done=shows.update)
        else:
            learned = _of_one(_learn_drive(experiments[0], blocks, progress))
    part_of = {k: number for number, part in enumerate(parts, 1) for k in part}
    rows = []
    for k, drive in enumerate(drives):
        scores = learned.scores[k]
        before, after = learned.log_evidence_of[k] or (None, None)
        frames = 0 if scores is None else scores["frames_scored"]
        first = {"drive": of[k], "error": None, "part": part_of.get(k), "frames_scored": frames}
        found = {"model": scores or {}, "log_evidence": {"before": before, "held_out": after}}
        rows.append(drive_row(drive, first, found))
    held_out = f"{blocks} blocks of the one drive"
    if parts:
        held_out = f"{len(parts)} parts of the drives"
        held_out += f", by tag.{by_tag}" if by_tag is not None else ""
    source = f"{len(drives)} drives of {Path(fleet).name}"
    title = f"{base.name}: learned from {source}; held out: {held_out}"
    everything = pooled(rows)[0]
    if everything.accuracy is None:
        shown: list[str | Table] = [f"{title}\nno ground truth, so nothing is scored"]
    else:
        accuracy = with_interval(everything.accuracy, everything.interval)
        shown = [f"{title}; accuracy {accuracy}", Table(*fleet_table_rows(rows))]
    log_evidence = _evidence(learned)
    if log_evidence is not None:
        shown.append(evidence_words(log_evidence))
    table = DriveTable(
        title,
        rows,
        shown,
        {
            "schema_version": SCHEMA_VERSION,
            "name": base.name,
            "fleet": source,
            "held_out": held_out,
            "drives": rows,
            "log_evidence": log_evidence,
            "parameters": {**learned.parameters, **learned.tables()},
        },
        notes=tuple(dict.fromkeys(str(w.message) for w in caught)),
        learned=learned,
    )
    changed = {key: getattr(experiments[0], key) for key in SHARED}
    return base.model_copy(update=changed), table
