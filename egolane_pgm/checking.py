"""Does the model look like the data? Predictive checks of a result.

A statistic of a drive, such as the number of lane changes, is computed for the ground truth, for
paths drawn from the posterior, and for drives drawn from the model without data. If the last two
differ, the model is wrong in that respect, however good its beliefs are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from egolane_pgm.inference.sampling import drawn_paths, predicted, sampled_states
from egolane_pgm.result import Result, as_result
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

#: The bins of predicted probabilities.
N_BINS = 10

#: The interval of the draws, per cent.
INTERVAL = (5.0, 95.0)


class Draws(NamedTuple):
    """n drives of T frames.

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
    """Make a statistic: the share of the frames with this value of a node."""
    return lambda draws: np.asarray((draws.values[node] == value).mean(axis=1))


def mean_run(node: str, value: int) -> Statistic:
    """Make a statistic: the mean time for which a node keeps this value, seconds."""

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
                found[f"{node} {name} share"] = share(node, k)
                found[f"{node} {name} mean run, s"] = mean_run(node, k)
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

    Returns a row per statistic: `truth` (NaN if unknown), median and 90 % interval of the posterior
    (`posterior`, `posterior_low`, `posterior_high`) and of the model (`model`, ...), and
    `probability`: how often a drive of the model is at least as far out as the median of the
    posterior, on its side, times two (at most 1). The parameters may have been found on the same
    frames. Raises InputError as `single_drive`, and for a statistic of an unknown node.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> list(ego.check(result, n=50).index)
    ['lane changes per hour', 'SensorState BAD share', 'SensorState BAD mean run, s']
    """
    result = single_drive(result)
    compiled = result.model.compiled
    rate = result.frame_rate
    evidence = result.evidence
    posterior = Draws(drawn_paths(compiled, evidence, n, seed), rate)
    states = sampled_states(
        compiled, len(evidence), n, np.random.default_rng(seed), evidence.inputs
    )
    model = Draws({name: compiled.node_value[name][states] for name in compiled.hidden}, rate)
    true = _true_lanes(result)
    rows = {}
    for name, statistic in (statistics or usual_statistics(result)).items():
        try:
            seen = statistic(posterior)
            drawn = statistic(model)
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
            known = drawn[~np.isnan(drawn)]
            beyond = (known >= row["posterior"]).mean(), (known <= row["posterior"]).mean()
            row["probability"] = min(1.0, 2 * float(min(beyond)))
        rows[name] = row
    columns = ["truth", "posterior", "posterior_low", "posterior_high"]
    columns += ["model", "model_low", "model_high", "probability"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def prediction_calibration(result: Result, n_bins: int = N_BINS) -> pd.DataFrame:
    """Compare predictions with what comes, for each observed node, one frame ahead.

    A prediction is made for each frame and value, before the frame's evidence; the value comes
    if the evidence makes it the most probable value. Frames in which it has no such value are left
    out.

    Returns a row per node and bin: `node`, `predicted` (mean probability), `comes` (share),
    `count` (predictions). Raises InputError as `single_drive`.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> ego.prediction_calibration(result).node.unique().tolist()
    ['DetectorOutput', 'WOR']
    """
    result = single_drive(result)
    evidence = result.evidence
    tables = []
    for node, probability in predicted(result.model, evidence).items():
        if node not in evidence.likelihoods:
            continue
        likelihood = evidence.likelihoods[node]
        largest = likelihood == likelihood.max(axis=1, keepdims=True)
        clear: BoolArray = largest.sum(axis=1) == 1
        values = probability[clear].ravel()
        comes = largest[clear].ravel()
        bins = np.clip((values * n_bins).astype(np.int64), 0, n_bins - 1)
        grouped = pd.DataFrame({"predicted": values, "comes": comes}).groupby(bins)
        tables.append(grouped.mean().assign(count=grouped.size(), node=node))
    columns = ["node", "predicted", "comes", "count"]
    found = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=columns)
    return found[columns]


def single_drive(result: Result) -> Result:
    """Return a result whose evidence one model made from the lines of one drive.

    Raises InputError for several drives, for several models, and for a result without its lines.
    """
    result = as_result(result, "check")
    what = f"check: {result.directory or result.name}"
    if "drive" in result.frames:
        raise InputError(f"{what}: has several drives; run one of them alone and check that")
    if result.run.get("fit", "none") != "none":
        raise InputError(
            f"{what}: is held out, with a model per block; check a run of its best.yaml"
        )
    if not result.lines:
        raise InputError(f"{what}: has no lines (lines.parquet); run the experiment again")
    return result


def _true_lanes(result: Result) -> Draws | None:
    """Return the true lanes of the annotated frames as a drive."""
    if result.truth is None:
        return None
    lane = result.truth["true_lane"].to_numpy(np.int64) - 1
    return Draws({"Lane": lane[None]}, result.frame_rate)
