"""Does the model look like the data? Predictive checks of a result.

A statistic of a drive, such as the number of lane changes, is computed three ways: of the ground
truth, of paths drawn from the posterior (what the data say, under the model), and of drives drawn
from the model (what it expects before it sees any). Where the last two differ the model is wrong in
that respect, however good its beliefs are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from egolane_pgm.inference.sampling import posterior_paths, predicted, sampled_states
from egolane_pgm.result import Result, as_result
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray

#: The bins of predicted probabilities.
N_BINS = 10

#: The interval of the draws, per cent.
INTERVAL = (5.0, 95.0)


class Draws(NamedTuple):
    """Drives of T frames that a statistic is computed of.

    - values: per node the index of its value, (n, T); lanes count from 0.
    - frame_rate: Hz.
    """

    values: Mapping[str, IntArray]
    frame_rate: float


#: From drives to a number for each, (n,); NaN where it has no value.
Statistic = Callable[[Draws], FloatArray]


def changes_per_hour(draws: Draws) -> FloatArray:
    """Lane changes per hour."""
    lane = draws.values["Lane"]
    hours = lane.shape[1] / draws.frame_rate / 3600
    return np.asarray((np.diff(lane, axis=1) != 0).sum(axis=1) / hours)


def share(node: str, value: int) -> Statistic:
    """Make the statistic: share of the frames in which a node has a value."""
    return lambda draws: np.asarray((draws.values[node] == value).mean(axis=1))


def mean_run(node: str, value: int) -> Statistic:
    """Make the statistic: mean time for which a node keeps a value, seconds."""

    def of(draws: Draws) -> FloatArray:
        held = draws.values[node] == value
        n_runs = held[:, 0] + (held[:, 1:] & ~held[:, :-1]).sum(axis=1)
        seconds = held.sum(axis=1) / draws.frame_rate
        return np.asarray(np.where(n_runs > 0, seconds / np.maximum(n_runs, 1), np.nan))

    return of


def usual_statistics(result: Result) -> dict[str, Statistic]:
    """Return the statistics of any graph: lane changes per hour; and of each other hidden node with
    at most four values the share and the mean run length of all but its first value."""
    found: dict[str, Statistic] = {"lane changes per hour": changes_per_hour}
    for node, names in result.model.compiled.values.items():
        if node in result.model.compiled.hidden and node != "Lane" and len(names) <= 4:
            for k, name in list(enumerate(names))[1:]:
                found[f"share of {node} {name}"] = share(node, k)
                found[f"mean run of {node} {name}, s"] = mean_run(node, k)
    return found


def check(
    result: Result,
    statistics: Mapping[str, Statistic] | None = None,
    *,
    n: int = 500,
    seed: int = 0,
) -> pd.DataFrame:
    """Compare the model of a result with its recording.

    - statistics: by name, functions of `Draws`; by default `usual_statistics`.
    - n: number of posterior paths, and of drives drawn from the model.

    Returns a row per statistic: `truth` (NaN without it), median and 90 % interval of the posterior
    (`posterior`, `posterior_low`, `posterior_high`) and of the model (`model`, ...), and
    `probability`: how often a drive of the model is at least as far out as the median of the
    posterior, on its side, times two (at most 1). The parameters may have been found on the same
    frames. Raises InputError for several drives, and for statistics that a node is missing for.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> list(ego.check(result, n=50).index)
    ['lane changes per hour', 'share of SensorState BAD', 'mean run of SensorState BAD, s']
    """
    result = as_result(result, "check")
    compiled, rate = result.model.compiled, result.frame_rate
    evidence = _evidence_of(result)
    posterior = Draws(posterior_paths(compiled, evidence, n, seed), rate)
    states = sampled_states(
        compiled, len(evidence), n, np.random.default_rng(seed), evidence.inputs
    )
    model = Draws({name: compiled.node_value[name][states] for name in compiled.hidden}, rate)
    true = _true_lanes(result)
    rows = {}
    for name, statistic in (statistics or usual_statistics(result)).items():
        try:
            seen, drawn = statistic(posterior), statistic(model)
        except KeyError as error:
            nodes = ", ".join(compiled.hidden)
            raise InputError(f"check: {name}: no node {error}; there are {nodes}") from None
        row = {"truth": np.nan}
        if true is not None and statistic is changes_per_hour:
            row["truth"] = float(changes_per_hour(true)[0])
        for what, values in (("posterior", seen), ("model", drawn)):
            if not np.isnan(values).all():
                low, middle, high = np.nanpercentile(values, (INTERVAL[0], 50, INTERVAL[1]))
                row |= {what: middle, f"{what}_low": low, f"{what}_high": high}
        if "posterior" in row and "model" in row:
            beyond = np.nanmean(drawn >= row["posterior"]), np.nanmean(drawn <= row["posterior"])
            row["probability"] = min(1.0, 2 * float(min(beyond)))
        rows[name] = row
    columns = ["truth", "posterior", "posterior_low", "posterior_high"]
    columns += ["model", "model_low", "model_high", "probability"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def prediction_calibration(result: Result, n_bins: int = N_BINS) -> pd.DataFrame:
    """Compare predictions with what comes, for each observed node, one frame ahead.

    A prediction is made for each frame and value, before the frame's evidence; the value comes
    where the evidence makes it the most probable one. Frames in which it has no such value are left
    out.

    Returns a row per node and bin: `node`, `predicted` (mean probability), `comes` (share),
    `count` (predictions). Raises InputError for several drives.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> ego.prediction_calibration(result).node.unique().tolist()
    ['DetectorOutput', 'WOR']
    """
    result = as_result(result, "prediction_calibration")
    evidence = _evidence_of(result)
    tables = []
    for node, probability in predicted(result.model, evidence).items():
        if node not in evidence.likelihoods:
            continue
        likelihood = evidence.likelihoods[node]
        largest = likelihood == likelihood.max(axis=1, keepdims=True)
        clear: BoolArray = largest.sum(axis=1) == 1
        values, comes = probability[clear].ravel(), largest[clear].ravel()
        bins = np.clip((values * n_bins).astype(np.int64), 0, n_bins - 1)
        found = pd.DataFrame({"bin": bins, "predicted": values, "comes": comes}).groupby("bin")
        table = found.agg(
            predicted=("predicted", "mean"), comes=("comes", "mean"), count=("comes", "size")
        )
        tables.append(table.reset_index(drop=True).assign(node=node))
    columns = ["node", "predicted", "comes", "count"]
    return (
        pd.concat(tables, ignore_index=True)[columns] if tables else pd.DataFrame(columns=columns)
    )


def _evidence_of(result: Result) -> Evidence:
    if "drive" in result.frames:
        raise InputError(f"check: {result.name} has several drives; check one of them")
    return result.evidence


def _true_lanes(result: Result) -> Draws | None:
    """Return the true lanes of the annotated frames as a drive."""
    if result.truth is None:
        return None
    lane = result.truth["true_lane"].to_numpy(np.int64) - 1
    return Draws({"Lane": lane[None]}, result.frame_rate)
