"""Learning from an experiment's recording, and what that is worth on other frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from egolane_pgm.drive import Drive, evidence_on, load_drive
from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.learning.em import Training
from egolane_pgm.learning.tables import (
    check_tables,
    fit_graph,
    free_numbers,
    learning_of,
    nested_tables,
    starting,
    training_in,
    with_found,
)
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import declared_parameters, plugin_errors
from egolane_pgm.scoring.held_out import stitched
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import Beliefs, BoolArray, InputError, IntArray, LineLog

#: Parameters and tables that a fit found, by name; those that it leaves alone are not in it.
Found = Mapping[str, Value]

#: What an evidence rule learns from, see `labelled`.
Labelled = tuple[LineLog, IntArray, BoolArray]

#: What EM, or an evidence rule, learns from one drive.
TrainingData = Training | Labelled


@dataclass(frozen=True)
class Learned:
    """What was learned.

    model: the experiment's, before.
    parameters: from every frame that may be used for fitting, as in a YAML; tables by the names of
        `tables`.
    log_evidence: mean per frame of the exact filter, before learning and, each block with the
        tables of the others, after; None where no table was learned, or no frame is possible.
    """

    model: Model
    parameters: Found
    log_evidence: tuple[float, float] | None = None

    def tables(self) -> dict[str, Any]:
        """The learned tables by name, as nested lists."""
        return nested_tables(self.model, self.parameters)


def trusted_frames(drive: Drive) -> IntArray:
    """Which of the annotated frames of a drive may be learned from. Raises InputError where that
    is none."""
    trusted = np.flatnonzero(drive.may_fit)
    if not len(trusted):
        source = drive.experiment.source
        raise InputError(f"{source}: tuning.never_fit leaves no frame to learn from")
    return trusted


def scores_of(drive: Drive, beliefs: Beliefs, frames: IntArray) -> dict[str, Any] | None:
    """The scores, as `score_with_intervals` gives them, of beliefs of the annotated frames of a
    drive over some of these; None without ground truth."""
    if drive.recorded.truth is None:
        return None
    return score_with_intervals(
        beliefs.lane[frames],
        drive.truth.take(frames),
        drive.experiment.recording.frame_rate,
        drive.experiment.unassigned_below,
    )


def fit(drive: Drive, train: IntArray) -> dict[str, Value]:
    """What is learned from the annotated frames `train` of a drive (of all its frames, without
    ground truth), labels of crossing ones left out.

    It starts from the defaults, whatever the experiment has learned before; see
    `tables.seen_before`.
    """
    return fit_pooled([drive], [train])


def fit_pooled(drives: Sequence[Drive], trains: Sequence[IntArray]) -> dict[str, Value]:
    """What is learned from the annotated frames `trains` of each drive, all under one model, as
    `fit`. Raises InputError as `fit_data`."""
    data = [training_data(drive, train) for drive, train in zip(drives, trains, strict=True)]
    return fit_data(drives[0].model, drives[0].experiment, data)


def training_data(drive: Drive, train: IntArray) -> TrainingData:
    """What is learned from in the annotated frames `train` of a drive."""
    return labelled(drive, train) if _has_fit(drive.model) else training_in(drive, train)


def fit_data(
    model: Model, experiment: Experiment, data: Sequence[TrainingData]
) -> dict[str, Value]:
    """What is learned from some drives. Raises InputError for several where the evidence rule
    learns and has no `fit_pooled`."""
    if not _has_fit(model):
        return fit_graph(model, experiment, cast(Sequence[Training], data))
    parts, rule = cast(Sequence[Labelled], data), model.rule
    # What is learned starts from its defaults.
    given = {k: v for k, v in model.parameters.items() if k not in rule.LEARNED}
    specs = declared_parameters(rule, model.graph)
    guess = resolve_parameters(specs, given, model.n_lanes, f"{experiment.source}: parameters")
    if len(parts) > 1 and not hasattr(rule, "fit_pooled"):
        raise InputError(
            f"{experiment.source}: the evidence rule {experiment.evidence} learns from one"
            " recording, it has no fit_pooled"
        )
    found: dict[str, Value]
    with plugin_errors(rule, "evidence"):
        if len(parts) > 1:
            found = rule.fit_pooled(parts, experiment.n_lanes, guess)
        else:
            found = rule.fit(*parts[0], experiment.n_lanes, guess)
    for name in found:
        if name not in rule.LEARNED:
            what = "fit_pooled()" if len(parts) > 1 else "fit()"
            raise InputError(f"{rule.__file__}: {what} gave {name}, not one of LEARNED")
    return found


def labelled(drive: Drive, train: IntArray) -> Labelled:
    """What an evidence rule learns from.

    Returns the log; the lane of each of its T frames (T,), 0 where it must not be looked at; and
    (T,) which frames are learned from: those annotated ones among `train` that are not crossing.
    """
    train = train[~drive.truth.is_crossing[train]]
    lane = np.zeros(len(drive.recorded.log), dtype=np.int64)
    lane[drive.rows[train]] = drive.truth.lane[train]
    return drive.recorded.log, lane, lane > 0


def check_learnable(model: Model, experiment: Experiment) -> None:
    """Raise InputError, naming the YAML key, where nothing can be learned as it says."""
    if not _has_fit(model):
        check_tables(model, experiment)
    elif experiment.learning is not None:
        raise InputError(
            f"{experiment.source}: learning: is about the tables of a graph; the evidence rule"
            f" {experiment.evidence} learns its own parameters, from labels"
        )


def n_learned(model: Model, experiment: Experiment) -> int:
    """How many numbers are fitted to labels."""
    if not _has_fit(model):
        labels = learning_of(experiment).labels
        return free_numbers(check_tables(model, experiment)) if labels else 0
    count = 0
    for spec in declared_parameters(model.rule, model.graph):
        if spec.name in model.rule.LEARNED:
            shape = spec.shape(model.n_lanes) if spec.shape is not None else ()
            count += int(np.prod(shape, dtype=np.int64))
    return count


def load_to_learn(experiment: Experiment) -> Drive:
    """The experiment's recording and model, as `load_drive` gives them.

    Raises InputError also where nothing can be learned as the experiment says.
    """
    model = prepare_model(experiment)
    check_learnable(model, experiment)
    needs_truth = None
    if _has_fit(model):
        needs_truth = "learning needs it"
    elif learning_of(experiment).labels:
        needs_truth = "learning needs it, or learning.labels: false"
    return load_drive(experiment, needs_truth=needs_truth)


def _has_fit(model: Model) -> bool:
    return hasattr(model.rule, "fit") and hasattr(model.rule, "LEARNED")


#: The log evidence of the exact filter, summed over frames in which the evidence is possible, and
#: how many these are: with the tables that learning starts from, then with those learned elsewhere.
LogEvidence = tuple[tuple[float, int], tuple[float, int]]


def log_evidence_of(drive: Drive, found: Sequence[Found]) -> LogEvidence | None:
    """The log evidence of the annotated frames of a drive; None where no table was learned.

    found: what was learned without each block of the drive, or one that is for all frames.
    """
    model, experiment = drive.model, drive.experiment
    if _has_fit(model):
        return None
    evidence = evidence_on(drive, model).filtered

    def exact(changed: Model) -> Beliefs:
        return filter_beliefs(changed.compiled, evidence, "exact").take(drive.rows)

    def summed(beliefs: Beliefs) -> tuple[float, int]:
        kept = ~beliefs.is_impossible
        return float(beliefs.log_evidence[kept].sum()), int(np.count_nonzero(kept))

    after = [exact(with_found(model, each, experiment)) for each in found]
    return summed(exact(starting(model, experiment))), summed(stitched(after))


def mean_log_evidence(parts: Sequence[LogEvidence | None]) -> tuple[float, float] | None:
    """Mean log evidence per frame over some drives, before learning and held out; None where no
    table was learned, or where no frame is possible."""
    known = [each for each in parts if each is not None]
    sums = np.sum(known, axis=0) if known else np.zeros((2, 2))
    if not sums[:, 1].all():
        return None
    before, after = (sums[:, 0] / sums[:, 1]).tolist()
    return before, after
