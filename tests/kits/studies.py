"""What the tests of studies share: drives with other labels, and cheap objectives."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from egolane_pgm.drives import Drive
from egolane_pgm.experiment import Experiment, FitSettings
from egolane_pgm.loading import experiments_folder, load_experiment
from egolane_pgm.parameters import Parameter
from egolane_pgm.runs import open_input
from egolane_pgm.studies.sampler import from_unit
from egolane_pgm.studies.search import new_study, search
from egolane_pgm.studies.space import Point, SearchSpace, make_space
from egolane_pgm.types import FloatArray, IntArray
from tests.kits.drives import simulated

EXPERIMENTS = experiments_folder()
QUICKSTART = EXPERIMENTS / "quickstart.yaml"


@functools.cache
def drive_of(experiment: Experiment) -> Drive:
    """The one drive of an experiment; its labels and lines are read once."""
    [drive] = open_input(experiment).drives()
    return drive


def fitting(drive: Drive, **fit: Any) -> Drive:
    """The drive with other settings in its section `fit`."""
    own = drive.experiment.fit.model_dump(exclude_unset=True)
    experiment = drive.experiment.model_copy(update={"fit": FitSettings(**{**own, **fit})})
    return replace(drive, model=replace(drive.model, experiment=experiment))


def two_drives(**keys: Any) -> list[Drive]:
    """Two simulated drives."""
    named = [simulated(f"d{seed}", recording=quickstart(seed), **keys) for seed in (0, 1)]
    return [drive_of(load_experiment(each)) for each in named]


def quickstart(seed: int) -> dict[str, Any]:
    return {"simulate": "quickstart", "seed": seed}


def with_labels(drive: Drive, frames: IntArray, lane: Any) -> Drive:
    """The drive with other lanes in some annotated frames (indices into its rows)."""
    changed = drive.true_lane.copy()
    changed[drive.rows[frames]] = lane
    return replace(drive, true_lane=changed)


def scrambled(drive: Drive, frames: IntArray, seed: int = 0) -> Drive:
    """The drive with random lanes in some annotated frames."""
    lane = np.random.default_rng(seed).integers(1, drive.model.n_lanes + 1, size=len(frames))
    return with_labels(drive, frames, lane)


def plain_space(n: int = 3) -> SearchSpace:
    """A space without a recording: x0, x1, ... in (0, 1)."""
    specs = [Parameter(f"x{k}", "probability", 0.5, "", search=(0.0, 1.0)) for k in range(n)]
    return make_space(specs, {s.name: s.default for s in specs}, {}, 1, "plain")


def bowl(point: Point) -> float:
    """Best, 1, where all are 0.3; in steps, as accuracy is."""
    values = np.array([float(v) for v in point.values()])
    return float(np.round(1 - np.abs(values - 0.3).mean(), 3))


def search_in_memory(space: SearchSpace, score: Any, settings: FitSettings) -> Any:
    """A study in memory with all its trials."""
    study = new_study(settings)
    search(study, space, score, settings)
    return study


def points_at(space: SearchSpace, units: FloatArray) -> list[dict[str, Any]]:
    """Points of the space from rows of the unit cube."""
    return [
        {key: from_unit(d, u) for (key, d), u in zip(space.distributions.items(), row, strict=True)}
        for row in units.tolist()
    ]


def tried(trials: Sequence[Any]) -> list[tuple[Mapping[str, Any], Any]]:
    """The points and values of trials, in order."""
    return [(t.params, t.values) for t in trials]
