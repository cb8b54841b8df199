"""The drives and folds of a study, from the arguments of `tune` and `learn`.

A list of experiments may be a file:

    name: italy_all
    description: one parameter set for all detectors in Italy
    experiments: [../paper/run01_italy_ml.yaml, ../paper/run02_italy_sl.yaml]
    fit: {trials: 3000, parameters: {p1: 0.9}}
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from egolane_pgm.drives import Drive
from egolane_pgm.experiment import FitSettings, Section, validated
from egolane_pgm.loading import Overrides, experiment_path, load_experiment, load_yaml
from egolane_pgm.paper import known_parameters
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.running import noting
from egolane_pgm.runs import Input, is_lines, open_input, table_inputs
from egolane_pgm.studies.study import Fold, Study, Work, block_folds, drive_folds, run_study
from egolane_pgm.tools.options import StrPath, place_of, several_of
from egolane_pgm.types import InputError


class TuningFile(Section):
    """A list of experiments: one parameter set is searched for them, each with equal weight."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="short name; the study is written to results/tuning/NAME",
        examples=["all_italy"],
    )
    description: str = Field(default="", description="one line of text")
    fit: FitSettings = Field(default=FitSettings(), description="settings of the search")
    experiments: tuple[str, ...] = Field(
        min_length=1,
        description="YAML files of experiments, relative to this one",
        examples=[["../paper/run01_italy_ml.yaml", "../paper/run02_italy_sl.yaml"]],
    )


def fit_study(
    method: str,
    experiments: Any,
    *,
    overrides: Overrides,
    graph: Any,
    ground_truth: Any,
    n_lanes: int | None,
    table: Any,
    by_tag: str | None,
    folds: int | None,
    out: StrPath | None,
    storage: str | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    **options: Any,
) -> Study:
    """Read the drives of some experiments or of a table of runs, make the folds, and fit.

    - method: learn or tune.
    - experiments, ground_truth, n_lanes: as for `open_studied`.
    - folds: number of blocks of each drive, or of groups of a table's drives; 0 for no folds; by
      default `fit.folds` of the first experiment.
    - storage, jobs, cluster: see `Work`; options: of `run_study`.
    """
    name, inputs = open_studied(experiments, overrides, graph, ground_truth, n_lanes)
    if by_tag is not None and table is None:
        raise InputError("by_tag: goes with a table of runs")
    if table is not None:
        if len(inputs) > 1:
            raise InputError("table: goes with one experiment")
        inputs = table_inputs(inputs[0].experiment, table)
    with noting() as notes:
        drives = [drive for each in inputs for drive in each.drives()]
    n_folds = inputs[0].experiment.fit.folds if folds is None else folds
    if n_folds == 1:
        raise InputError("folds: 1 leaves nothing to fit to; 0 holds out nothing")
    found: Sequence[Fold] = []
    if n_folds and table is not None and len(drives) > 1:
        found = drive_folds(drives, n_folds, by_tag)
    elif n_folds:
        found = block_folds(drives, n_folds)
    return run_study(
        drives,
        method,
        found,
        Work(place_of(out, name), storage, table is not None, jobs, cluster),
        starts=starting_points(drives),
        name=name,
        # An experiment with a road table has several drives.
        experiments=[each.experiment for each in inputs],
        notes=notes,
        **options,
    )


def open_studied(
    experiments: Any,
    overrides: Overrides,
    graph: Any,
    ground_truth: Any = None,
    n_lanes: int | None = None,
) -> tuple[str, list[Input]]:
    """The name of a study, and its experiments, which may be listed in a file.

    - ground_truth: as for `open_input`, or a list with one for each experiment.
    """
    given = several_of(experiments)
    name = None
    if not given:
        raise InputError("experiments: name at least one")
    if len(given) == 1 and isinstance(given[0], (str, os.PathLike)) and not is_lines(given[0]):
        path = experiment_path(given[0])
        content = load_yaml(path)
        if "experiments" in content:
            file = validated(TuningFile, content, str(path))
            name = file.name
            fit = file.fit.model_dump(exclude_unset=True)
            given = [load_experiment(path.parent / each, {"fit": fit}) for each in file.experiments]
    truths = ground_truth if isinstance(ground_truth, list) else [ground_truth] * len(given)
    if len(truths) != len(given):
        raise InputError(f"ground_truth: a list of {len(truths)} for {len(given)} experiments")
    inputs = [
        open_input(each, overrides=overrides, graph=graph, ground_truth=truth, n_lanes=n_lanes)
        for each, truth in zip(given, truths, strict=True)
    ]
    return name or inputs[0].experiment.name, inputs


def starting_points(drives: Sequence[Drive]) -> list[dict[str, Any]]:
    """The parameter sets that a search tries first: the paper's, then the current ones."""
    starts = []
    for drive in drives:
        model = drive.model
        specs = declared_parameters(model.rule, model.graph)
        known = {spec.name for spec in specs}
        for values in known_parameters(drive.experiment):
            kept = {name: value for name, value in values.items() if name in known}
            merged = {**drive.experiment.parameters, **kept}
            starts.append(resolve_parameters(specs, merged, model.n_lanes))
        starts.append(dict(model.parameters))
    return starts


def summary(done: Study, given: Mapping[str, Any]) -> str:
    """The path of the study."""
    return f"study: {done.directory}; run its best.yaml, or `include:` it"
