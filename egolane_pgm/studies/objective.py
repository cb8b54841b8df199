"""The scores of some drives as a function of parameters: evidence, filter, scores."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.drives import Drive, read_drives
from egolane_pgm.experiment import DETECTOR, Experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import make_evidence, with_parameters
from egolane_pgm.parameters import Parameter, Value
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.scoring.scores import SCORES, Answers
from egolane_pgm.types import Beliefs, BoolArray, Evidence, InputError, suggestion

#: The prefix of a detector's parameters in a search.
PREFIX = f"{DETECTOR}."

#: The value of an undefined score.
UNDEFINED = 1e6


def check_objective(name: str, where: str = "objective", known: Collection[str] = SCORES) -> str:
    """Return the name of a score. Raises InputError for an unknown one, with a suggestion."""
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


def drive_answers(
    drive: Drive, beliefs: Beliefs, is_used: BoolArray | bool = True, n_lanes: int = 0
) -> Answers:
    """Return the answers of a drive in its K annotated frames.

    - beliefs: of these frames.
    - is_used, n_lanes: see `Answers`.
    """
    rows = drive.rows
    e = drive.experiment
    return Answers(
        beliefs.lane,
        drive.true_lane[rows],
        drive.is_crossing[rows],
        assigned_lane(beliefs.lane, e.min_confidence),
        is_used,
        e.recording.frame_rate,
        # A frame that the model does not allow counts, so that no search excludes frames.
        np.where(beliefs.is_impossible, -UNDEFINED, beliefs.log_evidence),
        n_lanes,
    )


def drive_summands(
    drives: Sequence[Drive],
    beliefs: Sequence[Beliefs],
    is_used: Sequence[BoolArray | bool],
    name: str,
    *,
    pooled: bool = False,
) -> list[NDArray[Any]]:
    """Return the summands of a score, (K, C) per drive, or of all drives one after the other.

    - beliefs: per drive, of K frames.
    - is_used: per drive (K,), marks the annotated frames that count; True for all.
    - pooled: whether all frames count alike.
    """
    n_lanes = max(each.lane.shape[1] for each in beliefs) if pooled else 0
    given = zip(drives, beliefs, is_used, strict=True)
    found = [SCORES[name].summands(drive_answers(*each, n_lanes)) for each in given]
    return [np.concatenate(found)] if pooled else found


def score_of(
    drives: Sequence[Drive],
    beliefs: Sequence[Beliefs],
    is_used: Sequence[BoolArray],
    name: str,
    *,
    pooled: bool = False,
) -> float:
    """Score a parameter set: the mean over the drives, equal weight each, or over all frames.

    Drives with an undefined score are left out; a score that no drive defines is `UNDEFINED`.
    Arguments as `drive_summands`.
    """
    found = drive_summands(drives, beliefs, is_used, name, pooled=pooled)
    scores = np.array([SCORES[name].statistic(each.sum(axis=0)) for each in found])
    known = scores[~np.isnan(scores)]
    return float(known.mean()) if known.size else UNDEFINED
