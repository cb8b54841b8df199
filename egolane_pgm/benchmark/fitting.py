"""Entries that look at recordings before they answer for others: parameters that are searched,
tables that are learned, and a learned answer without a model (`boosting`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from egolane_pgm.benchmark.entries import Answering, by_experiment, drive_on
from egolane_pgm.benchmark.tracks import Recording
from egolane_pgm.drive import Drive, belief_of
from egolane_pgm.experiment import Experiment
from egolane_pgm.learning.held_out import fit_pooled
from egolane_pgm.parameters import Value
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import confusion, recall

#: Trials of a search where the YAML says nothing.
TRIALS = 150

#: The recordings that are looked at, spread evenly: neighbours share a drive.
MOST_SEARCHED, MOST_LEARNED = 16, 8


def fit_of(experiment: Experiment) -> Callable[[Sequence[Recording]], Answering] | None:
    """How an experiment is fitted to recordings, as its `fit` says; None where it is not."""
    if experiment.fit == "none":
        return None
    return partial(searched if experiment.fit == "tune" else learned, experiment)


def spread(recordings: Sequence[Recording], most: int) -> list[Recording]:
    """At most so many recordings, evenly over all of them."""
    places = np.linspace(0, len(recordings) - 1, min(most, len(recordings)))
    return [recordings[k] for k in np.round(places).astype(int)]


def searched(experiment: Experiment, recordings: Sequence[Recording]) -> Answering:
    """The experiment with the best of random parameters, its own among them, by the mean recall
    over the lanes of some recordings (the accuracy of the board)."""
    drives = [
        drive_on(experiment, each, with_truth=True) for each in spread(recordings, MOST_SEARCHED)
    ]
    model = drives[0].model
    space = {
        spec.name: spec.search_range
        for spec in declared_parameters(model.rule, model.graph)
        if spec.is_searched and spec.search_range is not None
    }
    rng = np.random.default_rng(experiment.tuning.seed if experiment.tuning else 0)
    trials = experiment.tuning.trials if experiment.tuning else None
    points: list[Mapping[str, Value]] = [{}]
    for _ in range(trials or TRIALS):
        points.append({name: float(rng.uniform(*bounds)) for name, bounds in space.items()})
    scores = [_accuracy(drives, point) for point in points]
    best = {**experiment.parameters, **points[int(np.argmax(scores))]}
    return partial(by_experiment, experiment.model_copy(update={"parameters": best}))


def _accuracy(drives: Sequence[Drive], point: Mapping[str, Value]) -> float:
    recalls = []
    for drive in drives:
        truth = drive.truth
        lane = assigned_lane(belief_of(drive, {**drive.model.parameters, **point}))
        matrix = confusion(lane, truth.lane, truth.is_crossing, drive.n_lanes)
        recalls += recall(matrix)[matrix.sum(axis=0) > 0].tolist()
    return float(np.mean(recalls))


def learned(experiment: Experiment, recordings: Sequence[Recording]) -> Answering:
    """The experiment with what is learned from recordings of as many lanes; on a road of another
    number it is as it was."""
    found = {}
    for n_lanes in sorted({each.n_lanes for each in recordings}):
        alike = [each for each in recordings if each.n_lanes == n_lanes]
        drives = [drive_on(experiment, each, with_truth=True) for each in spread(alike, MOST_LEARNED)]
        found[n_lanes] = fit_pooled(drives, [np.arange(len(drive)) for drive in drives])
    return partial(by_experiment, experiment, found=found)
