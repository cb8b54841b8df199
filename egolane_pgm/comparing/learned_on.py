"""`learned_on`: parameters are learned on other recordings than the one that is scored: on one, or
on several pooled. Where they are of the same drive, the stretch of road that is scored is left
out."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from egolane_pgm.comparing.placing import (
    load_for_scoring,
    on_recordings,
    on_stretch,
    recording_key,
    stretch,
)
from egolane_pgm.drive import Drive, drive_key
from egolane_pgm.experiment import Experiment
from egolane_pgm.learning import Found, fit_pooled
from egolane_pgm.paper import paper_experiment, parse_runs
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.types import InputError, IntArray


def learned_elsewhere(
    models: Sequence[Experiment], sources: Sequence[str], on_runs: bool
) -> list[Experiment]:
    """Each model once for each source, to be learned there.

    sources: runs of the paper (`1-4`), or YAML files of experiments with commas between them.
    on_runs: whether every model is put on every recording.

    The new experiments are named after the source, and after the model where several models share
    a recording. Raises InputError for a file that is not there.
    """
    keys = [recording_key(model) for model in models]
    is_shared = len(models) > 1 if on_runs else len(set(keys)) < len(keys)
    found = []
    for model, source in itertools.product(models, sources):
        words = [word.strip() for word in source.split(",") if word.strip()]
        if words and all(re.fullmatch(r"\d+(-\d+)?", word) for word in words):
            paths = [paper_experiment(number) for number in parse_runs(source)]
            label = f"run_{'_'.join(words)}"
        else:
            paths = [Path(word) for word in words]
            label = "_".join(path.stem for path in paths)
        for path in paths:
            if not path.is_file():
                raise InputError(f"--learned-on: {path}: no such file")
        if not paths:
            raise InputError("--learned-on: names nothing; write runs, 1-4, or YAML files")
        name = f"{model.name}_on_{label}" if is_shared else f"on_{label}"
        learned_on = tuple(str(path.absolute()) for path in paths)
        changes = {"name": name, "fit": "learn", "learned_on": learned_on}
        found.append(model.model_copy(update=changes))
    return found


def learner_elsewhere(drive: Drive, n_blocks: int) -> Callable[[Drive, IntArray, int], Found]:
    """A fit for `held_out` that learns from the recordings of `learned_on`.

    Raises InputError for recordings that cannot be read, of another number of lanes, or without a
    frame to learn from.
    """
    experiment = drive.experiment
    others = [
        load_for_scoring(other)
        for other in on_recordings(experiment, experiment.learned_on, "learned_on")
    ]
    for other in others:
        if other.n_lanes != drive.n_lanes:
            raise InputError(
                f"{experiment.source}: learned_on: {other.recorded.log.source} has"
                f" {other.n_lanes} lanes, what is scored has {drive.n_lanes}"
            )
    parts = blocks(len(drive), n_blocks)

    def fit(_drive: Drive, _train: IntArray, block: int) -> Found:
        ends = stretch(drive, parts[block])
        trains = []
        for other in others:
            is_used = other.may_fit
            if drive_key(other.experiment) == drive_key(experiment):
                is_used &= ~on_stretch(other, ends)
            trains.append(np.flatnonzero(is_used))
        if not any(len(frames) for frames in trains):
            raise InputError(f"{experiment.source}: learned_on: no frame is left to learn from")
        seen = [o.only_labels_of(train) for o, train in zip(others, trains, strict=True)]
        return fit_pooled(seen, trains)

    return fit
