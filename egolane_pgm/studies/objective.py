"""From parameters to a score of some drives: evidence, filter, confusion matrix and others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from egolane_pgm.drives import Drive, read_drives
from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.model import make_evidence, whole_rule, with_parameters
from egolane_pgm.parameters import Parameter, Value
from egolane_pgm.scoring import confusion as confusions
from egolane_pgm.scoring import probabilistic, stability
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.types import (
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    suggestion,
)

#: Scores of a belief: smaller is better.
BELIEF_SCORES = (
    "log_loss",
    "brier",
    "expected_calibration_error",
    "false_switches_per_minute",
    "delay",
    "share_missed",
)

#: What the names of a detector's parameters begin with in a search.
DETECTOR = "detector."

#: What a score counts as that is endless: the delay where no lane change was followed, say.
UNDEFINED = 1e6

#: How many evidences of a drive a search keeps; `bonus_value`, which is searched, has 10 values.
KEPT_EVIDENCE = 12


def check_objective(name: str, where: str = "objective") -> str:
    """Return the name of a score. Raises InputError for an unknown one, with a suggestion."""
    known = {*confusions.SCORES, *BELIEF_SCORES}
    if name not in known:
        raise InputError(f"{where}: unknown score '{name}'{suggestion(name, known)}")
    return name


def check_filter(experiment: Experiment) -> None:
    """Raise InputError for a filter that looks ahead."""
    if experiment.filter not in METHODS:
        raise InputError(
            f"{experiment.source}: filter: a search takes assumed_density or exact, not"
            f" {experiment.filter}; search with one of these"
        )


def searched_of_detector(experiment: Experiment) -> tuple[list[Parameter], dict[str, Value]]:
    """The parameters of an experiment's detector, and their values, as a search names them. Raises
    InputError for a recording without one."""
    from egolane_pgm.vision.detectors.pictures import detector_of

    detector = detector_of(experiment, "fit.parameters: detector")
    specs = getattr(detector.module, "PARAMETERS", ())
    values = {DETECTOR + name: value for name, value in detector.parameters.items()}
    return [replace(spec, name=DETECTOR + spec.name) for spec in specs], values


def split(parameters: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """Separate a parameter set into that of graph and evidence rule, and that of the detector."""
    own = {k: v for k, v in parameters.items() if not k.startswith(DETECTOR)}
    detector = {k: v for k, v in parameters.items() if k.startswith(DETECTOR)}
    return own, {name.removeprefix(DETECTOR): v for name, v in detector.items()}


def with_detector(experiment: Experiment, parameters: Mapping[str, Value]) -> Experiment:
    """Return the experiment with other parameters of its detector."""
    changed = {**experiment.parameters, "detector": dict(parameters)}
    return experiment.model_copy(update={"parameters": changed})


def posterior_at(drive: Drive) -> Callable[[Mapping[str, Value]], FloatArray]:
    """A function of all parameters: the posterior over lanes in the annotated frames, (K, n).

    It caches the last evidences, since most trials change only the graph. If parameters of the
    detector are among them, the detector processes all pictures again.
    """
    names = [spec.name for spec in getattr(drive.model.rule, "PARAMETERS", ())]

    @lru_cache(maxsize=KEPT_EVIDENCE)
    def evidence(
        of_rule: tuple[Value, ...], of_detector: tuple[tuple[str, Value], ...]
    ) -> Evidence:
        here = drive
        if of_detector:
            [here] = read_drives(with_detector(drive.experiment, dict(of_detector)))
        values = {**drive.model.parameters, **dict(zip(names, of_rule, strict=True))}
        changed = replace(drive.model, parameters=values)
        return make_evidence(changed, whole_rule(changed), here.log)[0]

    def posterior(parameters: Mapping[str, Value]) -> FloatArray:
        own, detector = split(parameters)
        compiled = with_parameters(drive.model, own).compiled
        given = evidence(tuple(own[name] for name in names), tuple(sorted(detector.items())))
        return filter_beliefs(compiled, given, drive.experiment.filter).lane[drive.rows]

    return posterior


def scores_of(
    drives: Sequence[Drive],
    posteriors: Sequence[FloatArray],
    is_used: Sequence[BoolArray],
    objectives: Sequence[str],
    *,
    pooled: bool = False,
) -> list[float]:
    """Score a parameter set: per objective the mean over the drives, equal weight each.

    A drive on which a score is undefined, such as one without a lane change for the delay, does
    not count in it; a score that no drive defines is `UNDEFINED`.

    - posteriors: per drive (K, n).
    - is_used: per drive (K,), marks the annotated frames that count.
    - objectives: names of scores.
    - pooled: whether all frames count alike instead: the confusion matrices are added; of other
      scores it is the mean weighted by frames.
    """
    values = np.zeros((len(drives), len(objectives)))
    weights = np.ones_like(values)
    matrices: list[IntArray] = []
    for k, (drive, posterior, used) in enumerate(zip(drives, posteriors, is_used, strict=True)):
        rows = drive.rows
        lane, crossing = drive.true_lane[rows], drive.is_crossing[rows]
        assigned = assigned_lane(posterior, drive.experiment.min_confidence)
        counts = confusions.confusion(assigned, lane, crossing | ~used, posterior.shape[1])
        matrices.append(counts)
        for j, name in enumerate(objectives):
            if name not in BELIEF_SCORES:
                values[k, j] = confusions.SCORES[name](counts)
                continue
            value = belief_score(drive, posterior, used, name)
            # The log-loss counts crossing frames as well.
            counted = used if name == "log_loss" else used & ~crossing
            weights[k, j] = np.count_nonzero(counted) if pooled else 1
            if np.isnan(value):
                value = weights[k, j] = 0.0
            values[k, j] = value
    total = weights.sum(axis=0)
    found = (values * weights).sum(axis=0) / np.where(total > 0, total, 1)
    found[total == 0] = UNDEFINED
    if pooled:
        added = confusions.on_widest(matrices).sum(axis=0)
        for j, name in enumerate(objectives):
            if name in confusions.SCORES:
                found[j] = confusions.SCORES[name](added)
    return found.tolist()  # type: ignore[no-any-return]


def belief_score(drive: Drive, belief: FloatArray, is_used: BoolArray, name: str) -> float:
    """Compute one score of a belief (K, n) over the frames that are used (K,).

    Scores over time count the pairs of neighbouring frames, and the lane changes, whose frames
    are all used. NaN where nothing is counted; an endless score is `UNDEFINED`, a large number.
    """
    rows = drive.rows
    lane, crossing = drive.true_lane[rows], drive.is_crossing[rows]
    if name in ("log_loss", "brier", "expected_calibration_error"):
        used, lane, crossing = belief[is_used], lane[is_used], crossing[is_used]
        if name == "log_loss":
            return min(probabilistic.log_loss(used, lane), UNDEFINED)
        return min(float(getattr(probabilistic, name)(used, lane, crossing)), UNDEFINED)
    assigned = assigned_lane(belief, drive.experiment.min_confidence)
    if name == "false_switches_per_minute":
        false, counted = stability.false_switch_frames(assigned, lane, crossing)
        counted[1:] &= is_used[1:] & is_used[:-1]
        minutes = counted.sum() / (60 * drive.experiment.recording.frame_rate)
        return float((false & counted).sum() / minutes) if minutes else float("nan")
    changes = stability.lane_changes(lane, crossing)
    delay = stability.delay_after_lane_change(
        assigned, lane, crossing, drive.log.frame_id[rows]
    ).delay_frames
    spans = zip(changes.start, changes.until, strict=True)
    delay = delay[[bool(is_used[a:b].all()) for a, b in spans]] if len(delay) else delay
    if not len(delay):
        return float("nan")
    followed = delay[~np.isnan(delay)]
    if name == "share_missed":
        return 1 - len(followed) / len(delay)
    return float(np.median(followed)) if len(followed) else UNDEFINED
