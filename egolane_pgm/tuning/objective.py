"""From parameters to a score: evidence, filter, confusion matrix or another score of the belief."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from egolane_pgm.drive import Drive, belief_of, load_recording
from egolane_pgm.experiment import Experiment
from egolane_pgm.parameters import Parameter, Value
from egolane_pgm.scoring import confusion as confusions
from egolane_pgm.scoring import probabilistic, stability
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import (
    BoolArray,
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

#: Those that lane changes have.
OF_CHANGES = ("delay", "share_missed")

#: What the names of a detector's parameters begin with in a search.
DETECTOR = "detector."

#: What a score counts as that is endless: the delay where no lane change was followed, say.
UNDEFINED = 1e6


def check_objective(name: str, where: str = "objective") -> str:
    """Return the name of a score. Raises InputError for an unknown one, with a suggestion."""
    known = {*confusions.SCORES, *BELIEF_SCORES}
    if name not in known:
        raise InputError(f"{where}: unknown score '{name}'{suggestion(name, known)}")
    return name


def check_filter(experiment: Experiment) -> None:
    """Raise InputError for a filter that looks ahead."""
    if not experiment.has_causal_filter:
        raise InputError(
            f"{experiment.source}: filter: a search takes assumed_density or exact, not"
            f" {experiment.filter}; search with one of these"
        )


def searched_of_detector(experiment: Experiment) -> tuple[list[Parameter], dict[str, Value]]:
    """The parameters of an experiment's detector, and their values, as a search names them. Raises
    InputError for a recording without one."""
    from egolane_pgm.vision.detectors.pictures import detector_of

    detector = detector_of(experiment, "tuning.search: detector")
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
    recording = experiment.recording.model_copy(update={"detector_parameters": dict(parameters)})
    return experiment.model_copy(update={"recording": recording})


def tried_belief(drive: Drive, parameters: Mapping[str, Value]) -> FloatArray:
    """Filter a drive with the parameters of a trial: (K, n), the belief in the annotated frames.

    If parameters of the detector are among them, the detector first looks at all pictures anew.
    """
    own, detector = split(parameters)
    if detector:
        log = load_recording(with_detector(drive.experiment, detector), own).log
        recorded = replace(drive.recorded, log=log)
        drive = replace(drive, recorded=recorded, evidence=OrderedDict())
    return belief_of(drive, own)


def scores_of(
    drives: Sequence[Drive],
    sets: Sequence[Mapping[str, Value]],
    is_used: Sequence[BoolArray],
    objectives: Sequence[str],
    *,
    together: bool = False,
) -> list[float]:
    """Score one parameter set: per objective the mean over the drives, equal weight each. A drive
    that says nothing of an objective does not count in it, such as one without a lane change in its
    delay; where none says anything it is `UNDEFINED`.

    - sets: per drive every declared parameter's value.
    - is_used: per drive (K,), marks the annotated frames that count; the filter sees every frame.
    - objectives: names of scores.
    - together: whether the frames of all drives count alike instead: the confusion matrices are
      added; of other scores it is the mean over the drives, weighted by their frames.
    """
    values = np.zeros((len(drives), len(objectives)))
    weights = np.ones_like(values)
    matrices: list[IntArray] = []
    for k, (drive, parameters, used) in enumerate(zip(drives, sets, is_used, strict=True)):
        belief = tried_belief(drive, parameters)
        counts = None
        for j, name in enumerate(objectives):
            if name in BELIEF_SCORES:
                value = belief_score(drive, belief, used, name)
                # The log-loss is about crossing frames as well.
                counted = used if name == "log_loss" else used & ~drive.truth.is_crossing
                weights[k, j] = np.count_nonzero(counted) if together else 1
                if np.isnan(value):
                    value = weights[k, j] = 0.0
                values[k, j] = value
                continue
            if counts is None:
                counts = _counted(drive, belief, used)
                matrices.append(counts)
            values[k, j] = confusions.SCORES[name](counts)
    total = weights.sum(axis=0)
    found = (values * weights).sum(axis=0) / np.where(total > 0, total, 1)
    found[total == 0] = UNDEFINED
    if together and matrices:
        added = confusions.on_widest(matrices).sum(axis=0)
        for j, name in enumerate(objectives):
            if name in confusions.SCORES:
                found[j] = confusions.SCORES[name](added)
    return found.tolist()  # type: ignore[no-any-return]


def _counted(drive: Drive, belief: FloatArray, is_used: BoolArray) -> IntArray:
    """The confusion matrix (n + 1, n) of a belief (K, n) over the frames that are used (K,)."""
    lane, is_left_out = drive.truth.lane, drive.truth.is_crossing | ~is_used
    assigned = assigned_lane(belief, drive.experiment.unassigned_below)
    return confusions.confusion(assigned, lane, is_left_out, drive.n_lanes)


def belief_score(drive: Drive, belief: FloatArray, is_used: BoolArray, name: str) -> float:
    """Compute one score of a belief (K, n) over the frames that are used (K,).

    Scores over time count the pairs of neighbouring frames, and the lane changes, whose frames
    are all used. NaN where nothing is counted; an endless score is `UNDEFINED`, a large number.
    """
    truth = drive.truth
    if name in ("log_loss", "brier", "expected_calibration_error"):
        rows, lane, crossing = belief[is_used], truth.lane[is_used], truth.is_crossing[is_used]
        if name == "log_loss":
            return min(probabilistic.log_loss(rows, lane), UNDEFINED)
        return min(float(getattr(probabilistic, name)(rows, lane, crossing)), UNDEFINED)
    assigned = assigned_lane(belief, drive.experiment.unassigned_below)
    if name == "false_switches_per_minute":
        false, counted = stability.false_switch_frames(assigned, truth.lane, truth.is_crossing)
        counted[1:] &= is_used[1:] & is_used[:-1]
        minutes = counted.sum() / (60 * drive.experiment.recording.frame_rate)
        return float((false & counted).sum() / minutes) if minutes else float("nan")
    changes = stability.lane_changes(truth.lane, truth.is_crossing)
    delay = stability.delay_after_lane_change(
        assigned, truth.lane, truth.is_crossing, truth.frame_id
    ).delay_frames
    spans = zip(changes.start, changes.until, strict=True)
    delay = delay[[bool(is_used[a:b].all()) for a, b in spans]] if len(delay) else delay
    if not len(delay):
        return float("nan")
    followed = delay[~np.isnan(delay)]
    if name == "share_missed":
        return 1 - len(followed) / len(delay)
    return float(np.median(followed)) if len(followed) else UNDEFINED


def notes_of_silent(drives: Sequence[Drive], objectives: Sequence[str]) -> list[str]:
    """What is noted of drives that do not count in an objective because they have no lane change,
    if there are any."""
    changes = [stability.lane_changes(d.truth.lane, d.truth.is_crossing) for d in drives]
    n_silent = sum(not len(each) for each in changes)
    said = f"{n_silent} of {len(drives)} drives have no lane change and do not count in it"
    return [f"{name}: {said}" for name in objectives if n_silent and name in OF_CHANGES]


def all_used(drives: Sequence[Drive]) -> list[BoolArray]:
    """Per drive (K,): marks every frame."""
    return [np.ones(len(drive), dtype=bool) for drive in drives]
