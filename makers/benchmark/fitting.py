"""Entries that look at recordings before they answer for others: parameters that are searched, and
tables that are learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

#: Trials of a search.
TRIALS = 200

#: The recordings that are looked at, spread evenly: neighbours share a drive.
MOST_SEARCHED, MOST_LEARNED = 16, 8


def spread(recordings: Sequence[Recording], most: int) -> list[Recording]:
    """At most so many recordings, evenly over all of them."""
    places = np.linspace(0, len(recordings) - 1, min(most, len(recordings)))
    return [recordings[k] for k in np.round(places).astype(int)]


def searched(experiment: Experiment, recordings: Sequence[Recording]) -> Answering:
    """The experiment with the best parameters that a search found, by the mean recall over the
    lanes of some recordings (the accuracy of the board).

    Its own parameters are tried first; half of the others are drawn from all that is allowed, half
    near the best so far.
    """
    drives = [
        drive_on(experiment, each, with_truth=True) for each in spread(recordings, MOST_SEARCHED)
    ]
    model = drives[0].model
    space = {
        spec.name: spec.search_range
        for spec in declared_parameters(model.rule, model.graph)
        if spec.is_searched and spec.search_range is not None
    }
    rng = np.random.default_rng(0)
    low, high = np.array([*space.values()]).T
    # The bounds themselves, such as a sigma of 0, are no values.
    low, high = low + (high - low) / 1000, high - (high - low) / 1000
    best: Mapping[str, Value] = {}
    near = np.array([float(model.parameters[name]) for name in space])  # type: ignore[arg-type]
    most = _accuracy(drives, best)
    for trial in range(TRIALS):
        drawn = rng.uniform(low, high)
        if trial % 2:
            drawn = np.clip(rng.normal(near, (high - low) / 10), low, high)
        point = dict(zip(space, drawn.tolist(), strict=True))
        if (found := _accuracy(drives, point)) > most:
            best, most, near = point, found, drawn
    chosen = {**experiment.parameters, **best}
    return partial(by_experiment, experiment.model_copy(update={"parameters": chosen}))


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
        drives = [
            drive_on(experiment, each, with_truth=True) for each in spread(alike, MOST_LEARNED)
        ]
        found[n_lanes] = fit_pooled(drives, [np.arange(len(drive)) for drive in drives])
    return partial(by_experiment, experiment, found=found)
