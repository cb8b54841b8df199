"""From parameters to a score, as fast as it goes: evidence once per value of its own parameters,
many parameter sets filtered side by side, only their confusions kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.batch import confusions_many
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import Drive, belief_of, declared_parameters, evidence_of, with_parameters
from egolane_pgm.parameters import Value
from egolane_pgm.scoring import confusion as confusions
from egolane_pgm.scoring import probabilistic, stability
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import (
    TIE_TOLERANCE,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    suggestion,
)

#: Parameter sets that `confusions_many` does in the time of one, and how many are faster alone.
SIDE_BY_SIDE, FEW = 8, 4

#: Scores of a confusion matrix: (..., n + 1, n) -> (...).
CONFUSION_SCORES: Mapping[str, Callable[[IntArray], FloatArray]] = {
    "accuracy": confusions.accuracy,
    "f1": confusions.macro_f1,
    "precision": lambda m: np.asarray(confusions.precision(m).mean(axis=-1)),
    "recall": lambda m: np.asarray(confusions.recall(m).mean(axis=-1)),
    "coverage": confusions.coverage,
}

#: Scores of a belief: smaller is better.
BELIEF_SCORES = (
    "log_loss",
    "brier",
    "expected_calibration_error",
    "false_switches_per_minute",
    "delay",
    "share_missed",
)

ALIASES = {"macro_f1": "f1", "macro-f1": "f1", "log-loss": "log_loss"}

#: What a score counts as that is not defined (no lane change was followed, say).
UNDEFINED = 1e6


def check_objective(name: str, where: str = "objective") -> str:
    """The score's own name. Raises InputError for an unknown one, with a suggestion."""
    known = {*CONFUSION_SCORES, *BELIEF_SCORES, *ALIASES}
    if name not in known:
        raise InputError(f"{where}: unknown score '{name}'{suggestion(name, known)}")
    return ALIASES.get(name, name)


def is_maximised(objective: str) -> bool:
    """Whether more is better."""
    return objective in CONFUSION_SCORES


def check_filter(experiment: Experiment) -> None:
    """Raise InputError for a filter that looks ahead."""
    if not experiment.is_causal:
        raise InputError(
            f"{experiment.source}: filter: a search takes assumed_density or exact, not"
            f" {experiment.filter}; search with one of these (--set filter=exact)"
        )


@dataclass(frozen=True)
class Labels:
    """What the frames of a log are counted as: lane (T,), 1..n; is_left_out (T,): not annotated,
    crossing, or not used."""

    lane: IntArray
    is_left_out: BoolArray


def labels_of(drive: Drive, is_used: BoolArray) -> Labels:
    """The labels of the annotated frames that are used (K,)."""
    is_scored = is_used & ~drive.truth.is_crossing
    rows = drive.recorded.scored[is_scored]
    lane = np.ones(len(drive.recorded.log), dtype=np.int64)
    lane[rows] = drive.truth.lane[is_scored]
    is_left_out = np.ones(len(lane), dtype=bool)
    is_left_out[rows] = False
    return Labels(lane, is_left_out)


def confusions_of(drive: Drive, sets: Sequence[Mapping[str, Value]], labels: Labels) -> IntArray:
    """The confusion matrices (P, n + 1, n) of P parameter sets over the frames that are not left
    out; the filter sees every frame."""
    groups: dict[int, tuple[Evidence, list[int]]] = {}
    for p, parameters in enumerate(sets):
        evidence = evidence_of(drive, parameters)
        groups.setdefault(id(evidence), (evidence, []))[1].append(p)
    counts = np.empty((len(sets), drive.n_lanes + 1, drive.n_lanes), dtype=np.int64)
    for evidence, members in groups.values():
        compiled = [with_parameters(drive.model, sets[p]).compiled for p in members]
        # The kernel for many sets does eight at a time: a few are faster one by one.
        n_many = (
            len(members)
            if len(members) % SIDE_BY_SIDE > FEW
            else (len(members) // SIDE_BY_SIDE * SIDE_BY_SIDE)
        )
        method, below = drive.experiment.filter, drive.experiment.unassigned_below
        if below:
            # The kernel for many sets knows no reject option.
            n_many = 0
        if n_many:
            counts[members[:n_many]] = confusions_many(
                compiled[:n_many], evidence, labels.lane, labels.is_left_out, method
            )
        for p, network in zip(members[n_many:], compiled[n_many:], strict=True):
            belief = filter_beliefs(network, evidence, method).lane
            counts[p] = _counted(belief, labels, below)
    return counts


def _counted(belief: FloatArray, labels: Labels, below: float) -> IntArray:
    from egolane_pgm.scoring.confusion import count_confusion

    n_lanes = belief.shape[1]
    if below:
        assigned = assigned_lane(belief, below)
        return confusions.confusion(assigned, labels.lane, labels.is_left_out, n_lanes)
    counts = np.zeros((n_lanes + 1, n_lanes), dtype=np.int64)
    count_confusion(belief, labels.lane, labels.is_left_out, TIE_TOLERANCE, counts)
    return counts


def scores_of(
    drives: Sequence[Drive],
    sets: Sequence[Sequence[Mapping[str, Value]]],
    is_used: Sequence[BoolArray],
    objectives: Sequence[str],
    labels: Sequence[Labels] | None = None,
) -> FloatArray:
    """(P, O): each objective of P parameter sets, the mean over the drives (equal weight each).

    sets: per drive its P sets. is_used: per drive (K,), the frames that count. labels: of these,
    where they are at hand.
    """
    if labels is None:
        labels = [labels_of(d, used) for d, used in zip(drives, is_used, strict=True)]
    total = np.zeros((len(sets[0]), len(objectives)))
    for drive, mine, used, label in zip(drives, sets, is_used, labels, strict=True):
        if any(name in CONFUSION_SCORES for name in objectives):
            matrices = confusions_of(drive, mine, label)
            for k, name in enumerate(objectives):
                if name in CONFUSION_SCORES:
                    total[:, k] += CONFUSION_SCORES[name](matrices)
        others = [(k, name) for k, name in enumerate(objectives) if name in BELIEF_SCORES]
        for p, parameters in enumerate(mine if others else ()):
            belief = belief_of(drive, parameters)
            for k, name in others:
                total[p, k] += belief_score(drive, belief, used, name)
    return total / len(drives)


def belief_score(drive: Drive, belief: FloatArray, is_used: BoolArray, name: str) -> float:
    """One score of a belief (K, n) over the frames that are used (K,).

    Scores over time count the pairs of neighbouring frames, and the lane changes, whose frames
    are all used.
    """
    truth = drive.truth
    if name in ("log_loss", "brier", "expected_calibration_error"):
        rows, lane, crossing = belief[is_used], truth.lane[is_used], truth.is_crossing[is_used]
        if name == "log_loss":
            value = probabilistic.log_loss(rows, lane)
        elif name == "brier":
            value = probabilistic.brier(rows, lane, crossing)
        else:
            value = probabilistic.expected_calibration_error(rows, lane, crossing)
        return _defined(value)
    assigned = assigned_lane(belief, drive.experiment.unassigned_below)
    if name == "false_switches_per_minute":
        false, counted = stability.false_switch_frames(assigned, truth.lane, truth.is_crossing)
        counted[1:] &= is_used[1:] & is_used[:-1]
        minutes = counted.sum() / (60 * drive.experiment.recording.frame_rate)
        return _defined(float((false & counted).sum() / minutes) if minutes else float("nan"))
    changes = stability.lane_changes(truth.lane, truth.is_crossing)
    delay = stability.delay_after_lane_change(
        assigned, truth.lane, truth.is_crossing, truth.frame_id
    ).delay_frames
    spans = zip(changes.start, changes.until, strict=True)
    delay = delay[[bool(is_used[a:b].all()) for a, b in spans]] if len(delay) else delay
    followed = delay[~np.isnan(delay)]
    if name == "share_missed":
        return _defined(1 - len(followed) / len(delay) if len(delay) else float("nan"))
    return _defined(float(np.median(followed)) if len(followed) else float("nan"))


def _defined(value: float) -> float:
    return value if np.isfinite(value) else UNDEFINED


def all_used(drives: Sequence[Drive]) -> list[BoolArray]:
    """Every frame of every drive."""
    return [np.ones(len(drive), dtype=bool) for drive in drives]


def shared_specs(drives: Sequence[Drive]) -> list[Any]:
    """The parameters that all drives' plugins declare. Raises InputError where they differ."""
    first = declared_parameters(drives[0].model.rule, drives[0].model.graph)
    for drive in drives[1:]:
        if declared_parameters(drive.model.rule, drive.model.graph) != first:
            raise InputError(
                f"{drive.experiment.source}: declares other parameters than"
                f" {drives[0].experiment.source}; one set for both needs the same plugins"
            )
    return first
