"""The scores of some drives as a function of parameters: evidence, filter, scores."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from egolane_pgm.drives import Drive, read_drives
from egolane_pgm.experiment import DETECTOR, Experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import make_evidence, with_parameters
from egolane_pgm.parameters import Parameter, Value
from egolane_pgm.scoring.confusion import (
    SCORES,
    assigned_lane,
    brier,
    confusion,
    expected_calibration_error,
    log_loss_per_frame,
    on_widest,
    scores_from_confusion,
)
from egolane_pgm.scoring.events import stability_scores
from egolane_pgm.types import (
    Beliefs,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    lane_truth,
    suggestion,
)

#: Means over all annotated frames, crossing ones included.
FRAME_MEANS = ("log_loss", "log_evidence")

#: Scores of a belief; of all but the log evidence smaller is better.
BELIEF_SCORES = (
    *FRAME_MEANS,
    "brier",
    "expected_calibration_error",
    "false_switches_per_minute",
)

#: The prefix of a detector's parameters in a search.
PREFIX = f"{DETECTOR}."

#: The value of an undefined score.
UNDEFINED = 1e6


def check_objective(name: str, where: str = "objective") -> str:
    """Return the name of a score. Raises InputError for an unknown one, with a suggestion."""
    known = {*SCORES, *BELIEF_SCORES}
    if name not in known:
        raise InputError(f"{where}: unknown score '{name}'{suggestion(name, known)}")
    return name


def searched_of_detector(experiment: Experiment) -> tuple[list[Parameter], dict[str, Value]]:
    """The parameters of an experiment's detector, and their values, with prefixed names.

    Raises InputError for a recording without a detector.
    """
    from egolane_pgm.vision.detectors.pictures import detector_of

    detector = detector_of(experiment, "fit.parameters: detector")
    specs = detector.plugin.parameters
    values = {PREFIX + name: value for name, value in detector.parameters.items()}
    return [replace(spec, name=PREFIX + spec.name) for spec in specs], values


def split(parameters: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """Split a parameter set: graph and evidence rule, and the detector without its prefix."""
    own = {k: v for k, v in parameters.items() if not k.startswith(PREFIX)}
    detector = {k: v for k, v in parameters.items() if k.startswith(PREFIX)}
    return own, {name.removeprefix(PREFIX): v for name, v in detector.items()}


def with_detector(experiment: Experiment, parameters: Mapping[str, Value]) -> Experiment:
    """Return the experiment with other parameters of its detector."""
    changed = {**experiment.parameters, "detector": dict(parameters)}
    return experiment.model_copy(update={"parameters": changed})


def beliefs_at(drive: Drive) -> Callable[[Mapping[str, Value]], Beliefs]:
    """A function of all parameters: the beliefs in the K annotated frames.

    The last evidences are cached, since most trials change only the graph, and `bonus_value`, which
    is searched, has 10 values. Parameters of the detector make it process all pictures again.
    """
    names = [spec.name for spec in drive.model.rule.parameters]

    @lru_cache(maxsize=12)
    def evidence(
        of_rule: tuple[Value, ...], of_detector: tuple[tuple[str, Value], ...]
    ) -> Evidence:
        here = drive
        if of_detector:
            [here] = read_drives(with_detector(drive.experiment, dict(of_detector)))
        values = {**drive.model.parameters, **dict(zip(names, of_rule, strict=True))}
        changed = replace(drive.model, parameters=values)
        return make_evidence(changed, here.log)[0]

    def beliefs(parameters: Mapping[str, Value]) -> Beliefs:
        own, detector = split(parameters)
        compiled = with_parameters(drive.model, own).compiled
        given = evidence(tuple(own[name] for name in names), tuple(sorted(detector.items())))
        return filter_beliefs(compiled, given, drive.experiment.filter).take(drive.rows)

    return beliefs


def score_of(
    drives: Sequence[Drive],
    beliefs: Sequence[Beliefs],
    is_used: Sequence[BoolArray],
    name: str,
    *,
    pooled: bool = False,
) -> float:
    """Score a parameter set: the mean over the drives, equal weight each.

    Drives with an undefined score are left out; a score that no drive defines is `UNDEFINED`.

    - beliefs: per drive, of K frames.
    - is_used: per drive (K,), marks the annotated frames that count.
    - name: of the score.
    - pooled: whether all frames count alike instead: confusion matrices are added, other scores
      are weighted by frames.
    """
    given = list(zip(drives, beliefs, is_used, strict=True))
    if pooled and name in SCORES:
        matrices = on_widest([drive_confusion(*each) for each in given])
        return float(scores_from_confusion(matrices.sum(axis=0))[name])
    scores = np.array([drive_score(*each, name) for each in given])
    weights = np.ones(len(given))
    if pooled:
        left_out = [d.is_crossing[d.rows] & (name not in FRAME_MEANS) for d in drives]
        weights = np.array([np.sum(u & ~out) for u, out in zip(is_used, left_out, strict=True)])
    known = ~np.isnan(scores)
    return float(np.average(scores[known], weights=weights[known])) if known.any() else UNDEFINED


def drive_confusion(drive: Drive, beliefs: Beliefs, is_used: BoolArray) -> IntArray:
    """The confusion matrix of the beliefs of a drive over the frames that are used (K,)."""
    lane = beliefs.lane
    assigned = assigned_lane(lane, drive.experiment.min_confidence)
    is_left_out = drive.is_crossing[drive.rows] | ~is_used
    return confusion(assigned, drive.true_lane[drive.rows], is_left_out, lane.shape[1])


def frame_values(drive: Drive, beliefs: Beliefs, name: str) -> FloatArray:
    """(K,): the values whose mean is one of FRAME_MEANS."""
    if name == "log_loss":
        return log_loss_per_frame(beliefs.lane, drive.true_lane[drive.rows])
    # A frame that the model does not allow counts, so that no search excludes frames.
    return np.where(beliefs.is_impossible, -UNDEFINED, beliefs.log_evidence)


def drive_score(drive: Drive, beliefs: Beliefs, is_used: BoolArray, name: str) -> float:
    """One score of the beliefs of a drive over the frames that are used (K,).

    False switches count the pairs of neighbouring frames that are both used. NaN without any.
    """
    rows = drive.rows
    if name in FRAME_MEANS:
        values = frame_values(drive, beliefs, name)[is_used]
        return float(values.mean()) if values.size else float("nan")
    lane, crossing, belief = drive.true_lane[rows], drive.is_crossing[rows], beliefs.lane
    is_left_out = crossing | ~is_used
    if name in ("brier", "expected_calibration_error"):
        score = brier if name == "brier" else expected_calibration_error
        return score(belief, lane, is_left_out)
    if name in SCORES:
        return float(scores_from_confusion(drive_confusion(drive, beliefs, is_used))[name])
    assigned = assigned_lane(belief, drive.experiment.min_confidence)
    truth = lane_truth(drive.log.frame_id[rows], lane, crossing)
    rate = drive.experiment.recording.frame_rate
    value = stability_scores([(assigned, truth)], rate, [is_used])[name]
    return float("nan") if value is None else float(value)
