"""How far the scores of a result move with each number of its model."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pandas as pd
from optuna.distributions import CategoricalDistribution, IntDistribution

from egolane_pgm.checking import single_drive
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.model import Model, make_evidence, with_parameters
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.result import Result
from egolane_pgm.scoring.confusion import assigned_lane, log_loss_per_frame
from egolane_pgm.studies.space import coordinates, make_space, to_parameters
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import Evidence, InputError, LineLog

#: The step of each number, as a share of its search range.
STEP = 0.01

#: The scores of a model.
SCORES = ("accuracy", "log_loss", "log_evidence")


def sensitivity(result: Result, step: float = STEP) -> pd.DataFrame:
    """Measure how far the scores move with each number of a model.

    Each parameter of evidence rule and graph that a search moves is changed alone, down and up by
    the same share of its search range, and the drive is filtered again: 0.01 is 0.01 of a
    probability and 0.03 lanes of a sigma. A range that a search takes in logarithms is divided in
    these, whole numbers move by at least 1, and steps end at the bounds of the range.

    - step: share of the search range. The accuracy counts frames and does not move with steps that
      are too small to change the lane of one.

    Returns a row per number: its `value`, the values tried (`value_low`, `value_high`), and how
    much each score changes at these: `accuracy_down`, `accuracy_up` (share of the frames that are
    not crossing), `log_loss_...` (nats per frame), `log_evidence_...` (nats, sum over the frames).
    The scores are those of a causal filter, the result's own or else `exact`, and in-sample if the
    result is. NaN for a number at its bound and without ground truth. The log evidence is NaN for
    parameters of the evidence rule as well, since likelihoods are not normalised and their scale
    would count, and if the model does not allow a frame.

    Raises InputError as `checking.single_drive`, and without any number to move.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> found = ego.sensitivity(result)
    >>> found.loc["p1", ["value", "value_low", "value_high"]].tolist()
    [0.9, 0.89, 0.91]
    """
    if not 0 < step <= 1:
        raise InputError(f"step: {step} is not a share of the search range (0 to 1)")
    model, [log] = single_drive(result).model, result.lines.values()
    specs = declared_parameters(model.rule, model.graph)
    space = make_space(specs, model.parameters, {}, model.n_lanes, "sensitivity")
    of_rule = {spec.name for spec in getattr(model.rule, "PARAMETERS", ())}
    here, start = coordinates(space, model.parameters), _scores(result, model, result.evidence)
    rows: dict[str, dict[str, float]] = {}
    for key, distribution in bar(space.distributions.items(), unit="number"):
        if isinstance(distribution, CategoricalDistribution) or isinstance(here[key], str):
            continue
        row = rows[key] = {"value": here[key]}
        for side, sign, end in (("down", -1, "low"), ("up", 1, "high")):
            row[f"value_{end}"] = there = _stepped(distribution, here[key], sign * step)
            if there == here[key]:
                continue
            changed = with_parameters(model, to_parameters(space, {**here, key: there}))
            evidence, kept = result.evidence, list(SCORES)
            if key.partition("[")[0] in of_rule:
                evidence, kept = _evidence(changed, log), list(SCORES[:2])
            found = _scores(result, changed, evidence)
            row |= {f"{name}_{side}": found[name] - start[name] for name in kept}
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


def _evidence(model: Model, log: LineLog) -> Evidence:
    with warnings.catch_warnings():
        # The result has the rule's warnings.
        warnings.simplefilter("ignore", UserWarning)
        return make_evidence(model, log)[0]


def _scores(result: Result, model: Model, evidence: Evidence) -> dict[str, float]:
    """Return SCORES of a model of a result; NaN if undefined."""
    e, frames = result.experiment, result.frames
    method = e.filter if e.filter in METHODS else "exact"
    beliefs = filter_beliefs(model.compiled, evidence, method)
    total = np.nan if beliefs.is_impossible.any() else beliefs.log_evidence.sum()
    known = (frames["true_lane"].notna() & frames.get("is_trusted", True)).to_numpy(bool)
    lane, truth = beliefs.lane[known], frames["true_lane"][known].to_numpy(int)
    losses = log_loss_per_frame(lane, truth)
    right = assigned_lane(lane, e.min_confidence) == truth
    right = right[~frames["is_crossing"][known].to_numpy(bool)]
    means = [values.mean() if len(values) else np.nan for values in (right, losses)]
    return dict(zip(SCORES, [*means, total], strict=True))
