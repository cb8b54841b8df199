"""Learning from an experiment's recording, and scoring what was learned held out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.learn.tables import (
    check_tables,
    fit_graph,
    free_numbers,
    nested_tables,
    settings,
    starting,
    with_found,
)
from egolane_pgm.loading import Recorded, load_recording, with_video_rate
from egolane_pgm.model import Model, declared_parameters, make_evidence, prepare_model
from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import plugin_errors
from egolane_pgm.run import score
from egolane_pgm.scoring.held_out import N_BLOCKS, HeldOut, held_out
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LaneTruth, LineLog


@dataclass(frozen=True)
class Learned:
    """What was learned.

    model: the experiment's, before. parameters: from every frame that may be looked at, as in a
    YAML; tables by the names of `tables`. held_out: what each block is believed with the
    parameters of the others. scores: of that belief, as `run.score` gives them, over the frames
    whose labels can be trusted; scores_all: over all annotated frames; None without ground truth.
    log_evidence: mean per frame of the exact filter, before learning and, each block with the
    tables of the others, after; None where no table was learned, or no frame is possible.
    """

    model: Model
    parameters: Mapping[str, Value]
    held_out: HeldOut[Mapping[str, Value]]
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
    """Learn an experiment's parameters or tables, and score them held out. done: is called after
    each of the n_blocks + 1 fits.

    The frames of `tuning.never_fit` are not learned from, and scored in scores_all only; labels of
    crossing ones are not looked at either. Raises InputError for an experiment without ground
    truth, unless it learns without labels, or of which nothing can be learned.
    """
    if recorded is None:
        experiment = with_video_rate(experiment)
    model, recorded = _prepare(experiment, recorded)
    frames = _blocked(recorded)
    trusted = may_fit(frames, experiment)
    if not trusted.any():
        raise InputError(f"{experiment.source}: tuning.never_fit leaves no frame to learn from")
    parameters = fit(model, recorded, np.flatnonzero(trusted), experiment)
    done()
    result = held_out_belief(experiment, recorded=recorded, n_blocks=n_blocks, done=done)
    log_evidence = None
    if not _has_fit(model):
        log_evidence = _log_evidence(model, recorded, experiment, result)
    if recorded.truth is None:
        return Learned(model, parameters, result, None, None, log_evidence)
    rate = experiment.recording.frame_rate
    belief = np.full((len(recorded.log), experiment.n_lanes), 1 / experiment.n_lanes)
    belief[recorded.scored] = result.belief
    kept = np.flatnonzero(trusted)
    only = replace(recorded, truth=recorded.truth.take(kept), scored=recorded.scored[kept])
    return Learned(
        model,
        parameters,
        result,
        score(only, belief, rate, experiment.unassigned_below),
        score(recorded, belief, rate, experiment.unassigned_below),
        log_evidence,
    )


def held_out_belief(
    experiment: Experiment,
    *,
    recorded: Recorded | None = None,
    n_blocks: int = N_BLOCKS,
    done: Callable[[], object] = int,
) -> HeldOut[Mapping[str, Value]]:
    """The belief (K, n) in each annotated frame (without ground truth: in each frame) with what
    was learned from the other blocks' frames, the filter running from the first frame of the
    recording. done: is called after each fit. Raises InputError as `learn` does."""
    model, recorded = _prepare(experiment, recorded)
    frames = _blocked(recorded)
    rows = slice(None) if recorded.truth is None else recorded.scored

    def learn_from(train: IntArray) -> Mapping[str, Value]:
        found = fit(model, recorded, train, experiment)
        done()
        return found

    def believe(parameters: Mapping[str, Value]) -> FloatArray:
        changed = with_found(model, parameters, experiment)
        evidence = make_evidence(changed, recorded.log, experiment.evidence_reading).filtered
        beliefs = infer_beliefs(changed.compiled, evidence, experiment.filter, experiment.lag)
        return beliefs.lane[rows]

    return held_out(
        len(frames), n_blocks, learn_from, believe, fit_exclude=~may_fit(frames, experiment)
    )


def fit(
    model: Model, recorded: Recorded, train: IntArray, experiment: Experiment
) -> dict[str, Value]:
    """What is learned from the annotated frames `train` (indices into the truth; into the log
    without ground truth), labels of crossing ones left out. It starts from the defaults, whatever
    the experiment has learned before; see `tables.seen_before`."""
    if not _has_fit(model):
        return fit_graph(model, recorded, train, experiment)
    truth = recorded.truth
    assert truth is not None
    train = train[~truth.is_crossing[train]]
    lane = np.zeros(len(recorded.log), dtype=np.int64)
    is_used = np.zeros(len(recorded.log), dtype=bool)
    frames = recorded.scored[train]
    lane[frames] = truth.lane[train]
    is_used[frames] = True
    given = {k: v for k, v in model.parameters.items() if k not in model.rule.LEARNED}
    start = resolve_parameters(
        declared_parameters(model.rule, model.graph),
        given,
        experiment.n_lanes,
        f"{experiment.source}: parameters",
    )
    with plugin_errors(model.rule, "evidence"):
        found: dict[str, Value] = model.rule.fit(
            recorded.log, lane, is_used, experiment.n_lanes, start
        )
    for name in found:
        if name not in model.rule.LEARNED:
            raise InputError(f"{model.rule.__file__}: fit() gave {name}, not one of LEARNED")
    return found


def may_fit(frames: LaneTruth | LineLog, experiment: Experiment) -> BoolArray:
    """(K,): frames outside of the experiment's `tuning.never_fit`."""
    ids = frames.frame_id
    keep = np.ones(len(ids), dtype=bool)
    ranges: Sequence[tuple[int, int | None]] = (
        experiment.tuning.never_fit if experiment.tuning else ()
    )
    for first, stop in ranges:
        keep &= ~((ids >= first) & (ids < (ids[-1] + 1 if stop is None else stop)))
    return keep


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
        labels = settings(experiment).labels
        return free_numbers(check_tables(model, experiment)) if labels else 0
    count = 0
    for spec in declared_parameters(model.rule, model.graph):
        if spec.name in model.rule.LEARNED:
            shape = spec.shape(model.n_lanes) if spec.shape is not None else ()
            count += int(np.prod(shape, dtype=np.int64))
    return count


def _prepare(experiment: Experiment, recorded: Recorded | None) -> tuple[Model, Recorded]:
    model = prepare_model(experiment)
    check_learnable(model, experiment)
    if recorded is None:
        recorded = load_recording(experiment, model.parameters)
    if recorded.truth is None and (_has_fit(model) or settings(experiment).labels):
        hint = "" if _has_fit(model) else ", or learning.labels: false (--unlabelled)"
        raise InputError(f"{experiment.source}: learning needs ground_truth{hint}")
    return model, recorded


def _has_fit(model: Model) -> bool:
    return hasattr(model.rule, "fit") and hasattr(model.rule, "LEARNED")


def _blocked(recorded: Recorded) -> LaneTruth | LineLog:
    """What blocks are made of: the annotated frames, or all where none is."""
    return recorded.log if recorded.truth is None else recorded.truth


def _log_evidence(
    model: Model,
    recorded: Recorded,
    experiment: Experiment,
    result: HeldOut[Mapping[str, Value]],
) -> tuple[float, float] | None:
    """Mean per frame in which the evidence is possible, before learning and held out; None where
    there is no such frame."""
    evidence = make_evidence(model, recorded.log, experiment.evidence_reading).filtered
    rows = np.arange(len(recorded.log)) if recorded.truth is None else recorded.scored

    def per_frame(changed: Model) -> tuple[FloatArray, BoolArray]:
        beliefs = filter_beliefs(changed.compiled, evidence, "exact")
        return beliefs.log_evidence[rows], ~beliefs.is_impossible[rows]

    before, counts = per_frame(starting(model, experiment))
    after, counts_after = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    for block, found in enumerate(result.parameters):
        inside = result.block == block
        values, possible = per_frame(with_found(model, found, experiment))
        after[inside], counts_after[inside] = values[inside], possible[inside]
    if not counts.any() or not counts_after.any():
        return None
    return float(before[counts].mean()), float(after[counts_after].mean())
