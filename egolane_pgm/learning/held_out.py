"""Learning from an experiment's recording, and scoring what was learned held out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.learning.tables import (
    check_tables,
    fit_graph,
    free_numbers,
    learning_of,
    nested_tables,
    starting,
    with_found,
)
from egolane_pgm.loading import Recorded
from egolane_pgm.model import (
    Drive,
    Model,
    beliefs_of,
    evidence_on,
    load_drive,
    prepare_model,
)
from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import declared_parameters, plugin_errors
from egolane_pgm.scoring.held_out import N_BLOCKS, HeldOut, held_out, stitched
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import Beliefs, BoolArray, InputError, IntArray, LineLog

#: Parameters and tables that a fit found, by name; those that it leaves alone are not in it.
Found = Mapping[str, Value]


@dataclass(frozen=True)
class Learned:
    """What was learned.

    model: the experiment's, before.
    parameters: from every frame that may be used for fitting, as in a YAML; tables by the names of
        `tables`.
    held_out: what each block is believed with the parameters of the others.
    scores: of that belief, as `score_with_intervals` gives them, over the frames whose labels can
        be trusted; scores_all: over all annotated frames; None without ground truth.
    log_evidence: mean per frame of the exact filter, before learning and, each block with the
        tables of the others, after; None where no table was learned, or no frame is possible.
    """

    model: Model
    parameters: Found
    held_out: HeldOut[Found]
    scores: Mapping[str, Any] | None
    scores_all: Mapping[str, Any] | None
    log_evidence: tuple[float, float] | None = None

    def tables(self) -> dict[str, Any]:
        """The learned tables by name, as nested lists."""
        return nested_tables(self.model, self.parameters)


def learn(
    experiment: Experiment,
    *,
    recorded: Recorded | None = None,
    n_blocks: int = N_BLOCKS,
    done: Callable[[], object] = int,
) -> Learned:
    """Learn an experiment's parameters or tables, and score them held out.

    recorded: the recording, where it was read already.
    done: is called after each of the n_blocks + 1 fits.

    The frames of `tuning.never_fit` are not learned from, and scored in scores_all only; labels of
    crossing frames are not looked at either. Raises InputError for an experiment without ground
    truth, unless it learns without labels, or of which nothing can be learned.
    """
    drive = load_to_learn(experiment, recorded)
    trusted = np.flatnonzero(drive.may_fit)
    if not len(trusted):
        raise InputError(f"{experiment.source}: tuning.never_fit leaves no frame to learn from")
    parameters = fit(drive.only_labels_of(trusted), trusted)
    done()
    result = held_out_belief(drive, n_blocks=n_blocks, done=done)
    log_evidence = None if _has_fit(drive.model) else _log_evidence(drive, result)
    if drive.recorded.truth is None:
        return Learned(drive.model, parameters, result, None, None, log_evidence)

    def scores(frames: IntArray) -> dict[str, Any]:
        return score_with_intervals(
            result.beliefs.lane[frames],
            drive.truth.take(frames),
            drive.experiment.recording.frame_rate,
            drive.experiment.unassigned_below,
        )

    everything = np.arange(len(drive))
    return Learned(
        drive.model, parameters, result, scores(trusted), scores(everything), log_evidence
    )


def held_out_belief(
    drive: Drive, *, n_blocks: int = N_BLOCKS, done: Callable[[], object] = int
) -> HeldOut[Found]:
    """The beliefs of the annotated frames (without ground truth: of all frames) with what was
    learned from the other blocks' frames. done: is called after each fit."""

    def learn_from(others: Drive, train: IntArray, block: int) -> Found:
        found = fit(others, train)
        done()
        return found

    def beliefs_with(found: Found) -> Beliefs:
        return beliefs_of(drive, with_found(drive.model, found, drive.experiment))[0]

    return held_out(drive, learn_from, beliefs_with, n_blocks)


def fit(drive: Drive, train: IntArray) -> dict[str, Value]:
    """What is learned from the annotated frames `train` of a drive (of all its frames, without
    ground truth), labels of crossing ones left out.

    It starts from the defaults, whatever the experiment has learned before; see
    `tables.seen_before`.
    """
    model, experiment = drive.model, drive.experiment
    if not _has_fit(model):
        return fit_graph(drive, train)
    log, lane, is_used = labelled(drive, train)
    with plugin_errors(model.rule, "evidence"):
        found: dict[str, Value] = model.rule.fit(
            log, lane, is_used, experiment.n_lanes, _first_guess(drive)
        )
    return _checked(model, found, "fit()")


def fit_pooled(drives: Sequence[Drive], trains: Sequence[IntArray]) -> dict[str, Value]:
    """What is learned from the annotated frames `trains` of each drive, all under one model.

    Raises InputError for several drives where the evidence rule has no `fit_pooled`.
    """
    first = drives[0]
    if len(drives) == 1:
        return fit(first, trains[0])
    model, experiment = first.model, first.experiment
    if not hasattr(model.rule, "fit_pooled"):
        raise InputError(
            f"{experiment.source}: learned_on: the evidence rule {experiment.evidence} learns from"
            " one recording, it has no fit_pooled"
        )
    parts = [labelled(drive, train) for drive, train in zip(drives, trains, strict=True)]
    with plugin_errors(model.rule, "evidence"):
        found: dict[str, Value] = model.rule.fit_pooled(parts, first.n_lanes, _first_guess(first))
    return _checked(model, found, "fit_pooled()")


def labelled(drive: Drive, train: IntArray) -> tuple[LineLog, IntArray, BoolArray]:
    """What an evidence rule learns from.

    Returns the log; the lane of each of its T frames (T,), 0 where it must not be looked at; and
    (T,) which frames are learned from: those annotated ones among `train` that are not crossing.
    """
    train = train[~drive.truth.is_crossing[train]]
    lane = np.zeros(len(drive.recorded.log), dtype=np.int64)
    lane[drive.rows[train]] = drive.truth.lane[train]
    return drive.recorded.log, lane, lane > 0


def _first_guess(drive: Drive) -> dict[str, Value]:
    """The parameters that learning starts from: those that are learned have their defaults."""
    model, experiment = drive.model, drive.experiment
    given = {k: v for k, v in model.parameters.items() if k not in model.rule.LEARNED}
    specs = declared_parameters(model.rule, model.graph)
    return resolve_parameters(specs, given, model.n_lanes, f"{experiment.source}: parameters")


def _checked(model: Model, found: dict[str, Value], what: str) -> dict[str, Value]:
    for name in found:
        if name not in model.rule.LEARNED:
            raise InputError(f"{model.rule.__file__}: {what} gave {name}, not one of LEARNED")
    return found


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


def load_to_learn(experiment: Experiment, recorded: Recorded | None = None) -> Drive:
    """The experiment's recording and model, as `load_drive` gives them.

    Raises InputError also where nothing can be learned as the experiment says.
    """
    model = prepare_model(experiment)
    check_learnable(model, experiment)
    needs_truth = None
    if _has_fit(model):
        needs_truth = "learning needs it"
    elif learning_of(experiment).labels:
        needs_truth = "learning needs it, or learning.labels: false (--unlabelled)"
    return load_drive(experiment, needs_truth=needs_truth, recorded=recorded)


def _has_fit(model: Model) -> bool:
    return hasattr(model.rule, "fit") and hasattr(model.rule, "LEARNED")


def _log_evidence(drive: Drive, result: HeldOut[Found]) -> tuple[float, float] | None:
    """Mean log evidence per frame in which the evidence is possible, before learning and held out;
    None where there is no such frame."""
    model, experiment = drive.model, drive.experiment
    evidence = evidence_on(drive, model).filtered

    def exact(changed: Model) -> Beliefs:
        return filter_beliefs(changed.compiled, evidence, "exact").take(drive.rows)

    before = exact(starting(model, experiment))
    after = stitched([exact(with_found(model, p, experiment)) for p in result.parameters])
    if before.is_impossible.all() or after.is_impossible.all():
        return None
    return before.mean_log_evidence, after.mean_log_evidence
