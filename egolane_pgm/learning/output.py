"""Files of what was learned: a new experiment, and its graph where tables were learned."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment, load_experiment, resolved
from egolane_pgm.learning.graph_file import graph_yaml
from egolane_pgm.learning.held_out import Found
from egolane_pgm.learning.tables import PREFIX, learning_of, with_found
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.plugins import OWN_FILES, declared_parameters
from egolane_pgm.recordings.source import files_in_full
from egolane_pgm.tools.files import check_place, write_yaml
from egolane_pgm.types import InputError


def output_files(experiment: Experiment, target: Path) -> list[Path]:
    """The files that `write_learned` may write: the experiment, and a graph. Raises InputError
    where they cannot be written, or where the experiment reads one of them."""
    files = [target, target.with_name(f"{target.stem}.graph.yaml")]
    for file in files:
        check_place(file)
    if target.resolve() == Path(experiment.source).resolve():
        raise InputError(f"{target}: is the experiment itself; name another file")
    recording, truth = experiment.recording, experiment.ground_truth
    named = [experiment.graph, recording.path, recording.camera, truth and truth.path]
    read = {(experiment.folder / name).resolve() for name in named if name}
    for file in files:
        if file.resolve() in read:
            raise InputError(f"{file}: is read by {experiment.source}; name another file")
    return files


def write_learned(
    experiment: Experiment, model: Model, parameters: Found, target: Path, drives: str | None = None
) -> list[Path]:
    """Write the experiment with what was learned to `target`, and, where tables were learned, the
    graph to `<its name>.graph.yaml` in the same folder; returns the files that were written.

    parameters: those that were learned, tables by the names of `tables`.
    drives: what was learned from, in words; None for the experiment's recording.

    The new experiment's `tuned_on` is same_frames, or unknown after learning from drives. Raises
    InputError where a file cannot be written.
    """
    tables = {k: v for k, v in parameters.items() if k.startswith(PREFIX)}
    files = output_files(experiment, target)[: 2 if tables else 1]
    tuned_on = "same_frames" if drives is None else "unknown"
    content = _experiment_yaml(experiment, model, parameters, target, bool(tables), tuned_on)
    source = Path(experiment.source).name
    heading = f"# Learned by `egolane learn {source}` from"
    place = drives or "its recording"
    left_out = "# (labels of crossing ones and the frames of tuning.never_fit left out).\n"
    if not tables or learning_of(experiment).labels:
        heading += f" all labelled frames of {place}\n"
    else:
        heading += f" {place}, no label looked at\n"
        left_out = "# (the frames of tuning.never_fit left out).\n"
    if tables:
        how = "lines and labels" if learning_of(experiment).labels else "lines alone, no labels"
        say = f"tables of {experiment.graph}, learned from {how}, of"
        recording = experiment.recording
        say += f" {drives or Path(recording.path or str(recording.simulate)).name}"
        graph = graph_yaml(with_found(model, tables, experiment), say)
        write_yaml(files[1], graph, f"# Learned by `egolane learn {source}`.\n")
        content["graph"] = f"./{files[1].name}"
        content["description"] = f"{experiment.description}; tables learned from {how}".lstrip("; ")
    write_yaml(target, content, heading + left_out)
    # It must be an experiment that can be run.
    prepare_model(load_experiment(target))
    return files


def _experiment_yaml(
    experiment: Experiment,
    model: Model,
    parameters: Found,
    target: Path,
    has_tables: bool,
    tuned_on: str,
) -> dict[str, Any]:
    of_rule = {p.name for p in getattr(model.rule, "PARAMETERS", ())}
    found = {k: v for k, v in parameters.items() if not k.startswith(PREFIX)}
    given = (
        {k: v for k, v in model.parameters.items() if k in of_rule}
        if has_tables
        else (experiment.parameters)
    )
    content = resolved(experiment, {**given, **found})
    for section in ("recording", "ground_truth"):
        if content[section] is not None:
            content[section] = {k: v for k, v in content[section].items() if v not in (None, [])}
    content["name"] = target.stem
    content["description"] = experiment.description.replace(
        "generic constants", "learned from its labels"
    )
    content["tuned_on"] = tuned_on
    if experiment.tuning is not None:
        content["tuning"] = experiment.tuning.model_dump(mode="json", exclude_defaults=True)
    for spec in declared_parameters(model.rule, model.graph):
        value = content["parameters"].get(spec.name)
        if spec.shape is not None and isinstance(value, list):
            rows = np.array([float(f"{v:.4g}") for v in value])
            content["parameters"][spec.name] = rows.reshape(spec.shape(experiment.n_lanes)).tolist()
    old, new = experiment.folder.resolve(), target.parent.resolve()
    if old == new:
        return content
    for section in ("recording", "ground_truth"):
        named = content[section] or {}
        for key, full in files_in_full(named, old).items():
            if full != named[key]:
                named[key] = os.path.relpath(full, new)
    for key in ("evidence", "graph"):
        if content[key].endswith(OWN_FILES):
            content[key] = os.path.relpath((old / content[key]).resolve(), new)
    return content
