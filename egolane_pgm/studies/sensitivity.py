"""How far the scores of a result move with each number of its model."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from optuna.distributions import CategoricalDistribution, IntDistribution

from egolane_pgm.checking import single_drive
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.model import make_evidence, with_parameters
from egolane_pgm.parameters import Value
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.result import Result
from egolane_pgm.scoring.confusion import assigned_lane, log_loss_per_frame
from egolane_pgm.studies.space import coordinates, make_space, to_parameters
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError

#: The step of each number, as a share of its search range.
STEP = 0.01

#: The scores of a model, and whether they need ground truth.
SCORES = {"accuracy": True, "log_loss": True, "log_evidence": False}


def sensitivity(result: Result, step: float = STEP) -> pd.DataFrame:
    """Measure how far the scores move with each number of a model.

    Each parameter of evidence rule and graph that a search moves is changed alone, down and up by
    the same share of its search range, and the drive is filtered again: `step` 0.01 is 0.01 of a
    probability and 0.03 lanes of a sigma. A range that a search takes in logarithms is divided in
    these; whole numbers move by at least 1. Steps end at the bounds of the range.

    - step: share of the search range. With much smaller steps no frame changes its lane, and the
      accuracy, which counts frames, does not move.

    Returns a row per number: its `value`, the values tried (`value_low`, `value_high`), and how
    much each score changes at these: `accuracy_down`, `accuracy_up` (share of the frames that are
    not crossing), `log_loss_...` (nats per frame), `log_evidence_...` (nats, sum over the frames).
    The scores are those of a causal filter, the result's own or else `exact`, and in-sample if the
    result is. NaN for a number at its bound, without ground truth, and in two cases for the log
    evidence: for parameters of the evidence rule, whose likelihoods are not normalised, so that
    their scale would count; and if other frames are impossible.

    Raises InputError as `checking.single_drive`, and without any number to move.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> found = ego.sensitivity(result)
    >>> found.loc["p1", ["value", "value_low", "value_high"]].tolist()
    [0.9, 0.89, 0.91]
    """
    if not 0 < step <= 1:
        raise InputError(f"step: {step} is not a share of the search range (0 to 1)")
    model = single_drive(result).model
    specs = declared_parameters(model.rule, model.graph)
    space = make_space(specs, model.parameters, {}, model.n_lanes, "sensitivity")
    of_rule = {spec.name for spec in getattr(model.rule, "PARAMETERS", ())}
    here, score = coordinates(space, model.parameters), _scores_of(result)
    start, rows = score(model.parameters, False), {}
    for key, distribution in bar(space.distributions.items(), unit="number"):
        if isinstance(distribution, CategoricalDistribution) or isinstance(here[key], str):
            continue
        is_of_rule = key.partition("[")[0] in of_rule
        row = {"value": here[key]}
        for side, sign, end in (("down", -1, "low"), ("up", 1, "high")):
            row[f"value_{end}"] = there = _stepped(distribution, here[key], sign * step)
            if there != here[key]:
                found = score(to_parameters(space, {**here, key: there}), is_of_rule)
                for name in SCORES.keys() - ({"log_evidence"} if is_of_rule else ()):
                    row[f"{name}_{side}"] = found[name] - start[name]
        rows[key] = row
    columns = ["value", "value_low", "value_high"]
    columns += [f"{name}_{side}" for name in SCORES for side in ("down", "up")]
    return pd.DataFrame.from_dict(rows, "index", float, columns).rename_axis("number")


def _stepped(distribution: Any, value: float, share: float) -> float:
    """Return a value moved by a share of its range, not beyond the range and the value."""
    low, high = distribution.low, distribution.high
    if isinstance(distribution, IntDistribution):
        moved = value + np.sign(share) * max(1, round(abs(share) * (high - low)))
    elif distribution.log:
        moved = value * (high / low) ** share
    else:
        moved = value + share * (high - low)
    return float(np.clip(moved, min(low, value), max(high, value)))


def _scores_of(result: Result) -> Callable[[Mapping[str, Value], bool], dict[str, float]]:
    """Return the scores of a result as a function of all parameters.

    The function's second argument: whether parameters of the evidence rule differ.
    """
    model, e = result.model, result.experiment
    method = e.filter if e.filter in METHODS else "exact"
    [log] = result.lines.values()
    own, impossible = result.evidence, None
    known = result.frames["true_lane"].notna().to_numpy()
    if "is_trusted" in result.frames:
        known &= result.frames["is_trusted"].to_numpy(bool)
    labels = result.frames.loc[known, ["true_lane", "is_crossing"]].astype(int)
    lane, is_scored = labels["true_lane"].to_numpy(), labels["is_crossing"].to_numpy() == 0

    def scores(parameters: Mapping[str, Value], is_of_rule: bool) -> dict[str, float]:
        nonlocal impossible
        changed = with_parameters(model, parameters)
        with warnings.catch_warnings():
            # The notes of the rule are those of the result.
            warnings.simplefilter("ignore", UserWarning)
            evidence = make_evidence(changed, log)[0] if is_of_rule else own
        beliefs = filter_beliefs(changed.compiled, evidence, method)
        if impossible is None:
            impossible = beliefs.is_impossible
        is_same = np.array_equal(beliefs.is_impossible, impossible)
        found = dict.fromkeys(SCORES, np.nan)
        found["log_evidence"] = beliefs.log_evidence.sum() if is_same else np.nan
        if known.any():
            found["log_loss"] = log_loss_per_frame(beliefs.lane[known], lane).mean()
        if is_scored.any():
            right = assigned_lane(beliefs.lane[known], e.min_confidence) == lane
            found["accuracy"] = right[is_scored].mean()
        return found

    return scores
