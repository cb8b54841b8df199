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
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from egolane_pgm.drives import Drive
from egolane_pgm.experiment import Experiment, FitSettings, Section, validated
from egolane_pgm.loading import experiment_path, load_experiment, load_yaml
from egolane_pgm.running import noting
from egolane_pgm.runs import is_lines, open_input, table_inputs
from egolane_pgm.studies.study import Fold, Study, block_folds, drive_folds
from egolane_pgm.types import InputError
from egolane_pgm.verbs.options import several_of


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


class Studied(NamedTuple):
    """Drives to fit to, and the folds.

    - experiments: as given; one with a road table has several drives.
    - notes: warnings of reading the drives.
    """

    name: str
    experiments: Sequence[Experiment]
    drives: Sequence[Drive]
    folds: Sequence[Fold]
    notes: Sequence[str]


def open_studied(
    experiments: Any, *, table: Any, by_tag: str | None, folds: int | None, **options: Any
) -> Studied:
    """Read the drives of some experiments, or of a table of runs, and make the folds.

    - folds: number of blocks of each drive, or of groups of a table's drives; 0 for no folds; by
      default `fit.folds` of the first experiment.
    - options: as `runs.open_input` takes them.
    """
    given = several_of(experiments)
    if not given:
        raise InputError("experiments: name at least one")
    listed = _list_of(given[0]) if len(given) == 1 else None
    if listed is not None:
        file, folder = listed
        fit = file.fit.model_dump(exclude_unset=True)
        given = [load_experiment(folder / name, {"fit": fit}) for name in file.experiments]
    inputs = [open_input(each, **options) for each in given]
    name = inputs[0].experiment.name if listed is None else listed[0].name
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
    return Studied(name, [each.experiment for each in inputs], drives, found, notes)


def _list_of(given: Any) -> tuple[TuningFile, Path] | None:
    """The list of experiments in a file, and its folder; None for anything else."""
    if not isinstance(given, (str, os.PathLike)) or is_lines(given):
        return None
    path = experiment_path(given)
    content = load_yaml(path)
    if "experiments" not in content:
        return None
    return validated(TuningFile, content, str(path)), path.parent


def summary(done: Study, given: Mapping[str, Any]) -> str:
    """The path of the study."""
    return f"study: {done.directory}; run its best.yaml, or `include:` it"
