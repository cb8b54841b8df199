"""Learning from all drives of a fleet, and what that is worth on drives that were left out.

By EM the expected counts of the drives are added, in their order: exactly what one recording would
teach in which all of them stand one behind the other, each with its own beginning.
"""

from __future__ import annotations

import functools
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from egolane_pgm.drive import beliefs_of
from egolane_pgm.experiment import Experiment
from egolane_pgm.learning.held_out import (
    Found,
    LogEvidence,
    TrainingData,
    fit_data,
    load_to_learn,
    log_evidence_of,
    mean_log_evidence,
    scores_of,
    training_data,
    trusted_frames,
)
from egolane_pgm.learning.tables import nested_tables, with_found
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.types import InputError, problems_in

#: What drives that are learned from together have in common.
SHARED = ("n_lanes", "evidence", "graph", "parameters", "filter", "evidence_reading", "learning")


@dataclass(frozen=True)
class LearnedFleet:
    """What was learned from D drives.

    model: the experiment's, before.
    parameters: from all drives; tables by the names of `tables`.
    scores: of each drive, believed with what was learned without its part, over the frames whose
        labels can be trusted; None for one without ground truth.
    log_evidence_of: of each drive, as in `Learned`.
    log_evidence: the same over the frames of all drives.
    """

    model: Model
    parameters: Found
    scores: tuple[Mapping[str, Any] | None, ...]
    log_evidence_of: tuple[tuple[float, float] | None, ...]
    log_evidence: tuple[float, float] | None

    def tables(self) -> dict[str, Any]:
        """The learned tables by name, as nested lists."""
        return nested_tables(self.model, self.parameters)


def learn_fleet(
    experiments: Sequence[Experiment],
    parts: Sequence[Sequence[int]],
    *,
    jobs: Jobs = 1,
    done: Callable[[], object] = int,
) -> LearnedFleet:
    """Learn from all drives, and once more without each part of them, which is then scored.

    experiments: one on each of two drives or more; they differ in what is recorded only.
    parts: the numbers of the drives that are left out together; each drive is in one.
    jobs: where the fits, one more than there are parts, are shared out to.
    done: is called after each fit.

    A process reads each drive once to learn and keeps what it learns from: for tables the evidence
    of each frame. Raises InputError as `learn`, naming the drive.
    """
    _check_alike(experiments)
    work = partial(_without, pickle.dumps(tuple(experiments)))
    found: list[Found] = []
    assessed: dict[int, _Assessed] = {}
    try:
        for parameters, of_drives in in_order(work, [(), *parts], jobs):
            found.append(parameters)
            assessed |= of_drives
            done()
    finally:
        _training.cache_clear()
    scores, each = zip(*(assessed[k] for k in range(len(experiments))), strict=True)
    return LearnedFleet(
        prepare_model(experiments[0]),
        found[0],
        scores,
        tuple(mean_log_evidence([one]) for one in each),
        mean_log_evidence(each),
    )


def _check_alike(experiments: Sequence[Experiment]) -> None:
    first = experiments[0]
    for experiment in experiments[1:]:
        for key in SHARED:
            if getattr(experiment, key) != getattr(first, key):
                raise InputError(
                    f"{experiment.name}: {key} is not that of {first.name}; what is learned"
                    " together differs in what was recorded only"
                )


#: The scores and the log evidence of a drive that was left out.
_Assessed = tuple[Mapping[str, Any] | None, LogEvidence | None]


def _without(given: bytes, part: Sequence[int]) -> tuple[Found, dict[int, _Assessed]]:
    """What is learned without a part of the drives, and how well it does on that part."""
    experiments, data = _training(given)
    first = experiments[0]
    kept = [each for k, each in enumerate(data) if k not in part]
    found = fit_data(prepare_model(first), first, kept)
    return found, {k: _assess(experiments[k], found) for k in part}


def _assess(experiment: Experiment, found: Found) -> _Assessed:
    drive = load_to_learn(experiment)
    beliefs, _ = beliefs_of(drive, with_found(drive.model, found, experiment))
    return scores_of(drive, beliefs, trusted_frames(drive)), log_evidence_of(drive, [found])


@functools.lru_cache(maxsize=1)
def _training(given: bytes) -> tuple[Sequence[Experiment], list[TrainingData]]:
    """What is learned from each drive, read once in each process."""
    experiments = pickle.loads(given)
    data = []
    for experiment in experiments:
        with problems_in(experiment.name):
            drive = load_to_learn(experiment)
            trusted = trusted_frames(drive)
            data.append(training_data(drive.only_labels_of(trusted), trusted))
    return experiments, data
