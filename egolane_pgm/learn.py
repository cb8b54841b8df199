"""Parameters learned from labelled frames, and what they are worth on frames not looked at.

An evidence rule that can be learned defines `LEARNED`, the names of the parameters that it learns,
and `fit(log, lane, is_used, n_lanes, parameters) -> parameters`, which may look at the lanes of the
used frames only. Everything else is the same for all rules.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment, make_experiment, resolved
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.loading import Recorded, load_recording
from egolane_pgm.model import Model, declared_parameters, make_evidence, prepare_model
from egolane_pgm.plugins import plugin_errors
from egolane_pgm.run import score
from egolane_pgm.types import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    LaneTruth,
    Value,
    resolve_parameters,
)
from egolane_pgm.validation import N_BLOCKS, HeldOut, held_out


@dataclass(frozen=True)
class Learned:
    """What was learned. parameters: from every frame that may be looked at, as in a YAML.
    held_out: what each block is believed with the parameters of the others. scores: of that
    belief, as `run.score` gives them, over the frames whose labels can be trusted; scores_all: over
    all annotated frames."""

    parameters: Mapping[str, Value]
    held_out: HeldOut[Mapping[str, Value]]
    scores: Mapping[str, Any]
    scores_all: Mapping[str, Any]


def learn(
    experiment: Experiment, *, recorded: Recorded | None = None, n_blocks: int = N_BLOCKS
) -> Learned:
    """Learn an experiment's parameters, and score them held out.

    The frames of `tuning.never_fit` are not learned from, and scored in scores_all only; crossing
    ones are not learned from either. Raises InputError for an experiment without ground truth, or
    whose evidence rule cannot be learned.
    """
    model, recorded = _prepare(experiment, recorded)
    truth = recorded.truth
    assert truth is not None
    trusted = may_fit(truth, experiment)
    if not trusted.any():
        raise InputError(f"{experiment.source}: tuning.never_fit leaves no frame to learn from")
    parameters = fit(model, recorded, np.flatnonzero(trusted), experiment)
    result = held_out_belief(experiment, recorded=recorded, n_blocks=n_blocks)
    rate = experiment.recording.frame_rate
    belief = np.full((len(recorded.log), experiment.n_lanes), 1 / experiment.n_lanes)
    belief[recorded.scored] = result.belief
    kept = np.flatnonzero(trusted)
    only = replace(recorded, truth=truth.take(kept), scored=recorded.scored[kept])
    return Learned(parameters, result, score(only, belief, rate), score(recorded, belief, rate))


def held_out_belief(
    experiment: Experiment, *, recorded: Recorded | None = None, n_blocks: int = N_BLOCKS
) -> HeldOut[Mapping[str, Value]]:
    """The belief (K, n) in each annotated frame with what was learned from the other blocks, the
    filter running from the first frame of the recording. Raises InputError as `learn` does."""
    model, recorded = _prepare(experiment, recorded)
    truth = recorded.truth
    assert truth is not None

    def learn_from(train: IntArray) -> Mapping[str, Value]:
        return fit(model, recorded, train, experiment)

    def believe(parameters: Mapping[str, Value]) -> FloatArray:
        values = _resolve(model, {**model.parameters, **parameters}, experiment)
        changed = replace(model, parameters=values)
        evidence = make_evidence(changed, recorded.log, experiment.evidence_reading).filtered
        beliefs = filter_beliefs(model.compiled, evidence, experiment.filter)
        return beliefs.lane[recorded.scored]

    return held_out(
        len(truth), n_blocks, learn_from, believe, fit_exclude=~may_fit(truth, experiment)
    )


def fit(
    model: Model, recorded: Recorded, train: IntArray, experiment: Experiment
) -> dict[str, Value]:
    """The parameters learned from the annotated frames `train` (indices into the truth), crossing
    ones left out. It starts from the defaults, whatever the experiment has learned before."""
    truth = recorded.truth
    assert truth is not None
    train = train[~truth.is_crossing[train]]
    lane = np.zeros(len(recorded.log), dtype=np.int64)
    is_used = np.zeros(len(recorded.log), dtype=bool)
    frames = recorded.scored[train]
    lane[frames] = truth.lane[train]
    is_used[frames] = True
    given = {k: v for k, v in model.parameters.items() if k not in model.rule.LEARNED}
    start = _resolve(model, given, experiment)
    with plugin_errors(model.rule, "evidence"):
        found: dict[str, Value] = model.rule.fit(
            recorded.log, lane, is_used, experiment.n_lanes, start
        )
    for name in found:
        if name not in model.rule.LEARNED:
            raise InputError(f"{model.rule.__file__}: fit() gave {name}, not one of LEARNED")
    return found


def may_fit(truth: LaneTruth, experiment: Experiment) -> BoolArray:
    """(K,): annotated frames outside of the experiment's `tuning.never_fit`."""
    ids = truth.frame_id
    keep = np.ones(len(ids), dtype=bool)
    ranges: Sequence[tuple[int, int | None]] = (
        experiment.tuning.never_fit if experiment.tuning else ()
    )
    for first, stop in ranges:
        keep &= ~((ids >= first) & (ids < (ids[-1] + 1 if stop is None else stop)))
    return keep


def learned_yaml(experiment: Experiment, learned: Learned, name: str) -> dict[str, Any]:
    """The keys of a new experiment with the learned parameters: what it says of its scores is that
    they are in-sample where it is run on the same recording."""
    content = resolved(experiment, {**experiment.parameters, **learned.parameters})
    for section in ("recording", "ground_truth"):
        content[section] = {k: v for k, v in content[section].items() if v not in (None, [])}
    content["name"] = name
    content["description"] = experiment.description.replace(
        "generic constants", "learned from its labels"
    )
    content["tuned_on"] = "same_frames"
    if experiment.tuning is not None:
        content["tuning"] = experiment.tuning.model_dump(mode="json", exclude_defaults=True)
    model = prepare_model(experiment)
    for spec in declared_parameters(model.rule, model.graph):
        value = content["parameters"].get(spec.name)
        if spec.shape is not None and isinstance(value, list):
            rows = np.array([float(f"{v:.4g}") for v in value])
            content["parameters"][spec.name] = rows.reshape(spec.shape(experiment.n_lanes)).tolist()
    # It must be an experiment that can be run.
    prepare_model(make_experiment(content, experiment.folder, name))
    return content


def _prepare(experiment: Experiment, recorded: Recorded | None) -> tuple[Model, Recorded]:
    model = prepare_model(experiment)
    if not (hasattr(model.rule, "fit") and hasattr(model.rule, "LEARNED")):
        raise InputError(
            f"{experiment.source}: the evidence rule {experiment.evidence} cannot be learned;"
            " search its parameters with `egolane tune`"
        )
    if recorded is None:
        recorded = load_recording(experiment, model.parameters)
    if recorded.truth is None:
        raise InputError(f"{experiment.source}: learning needs ground_truth")
    return model, recorded


def _resolve(model: Model, given: Mapping[str, Value], experiment: Experiment) -> dict[str, Value]:
    specs = declared_parameters(model.rule, model.graph)
    where = f"{experiment.source}: parameters"
    return resolve_parameters(specs, given, experiment.n_lanes, where)
