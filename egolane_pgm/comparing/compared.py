"""Results side by side: scored on the annotated frames that they share, and less the first by
paired intervals. Several results of one experiment, with a seed each, are averaged."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.comparing.lags import lag_notes, lag_scores, lagged_beliefs
from egolane_pgm.drive import drive_key, may_fit
from egolane_pgm.fleet import first_names
from egolane_pgm.inference.events import lane_events
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.results import SCHEMA_VERSION, Result
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import INTERVAL_STATISTICS, score_counts
from egolane_pgm.scoring.events import event_scores
from egolane_pgm.scoring.health import DetectorErrors, detector_errors, doubt, roc_auc
from egolane_pgm.scoring.seeds import (
    mean_of,
    on_timeline,
    over_seeds,
    resampled_scores,
    spread,
    with_bounds,
)
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, InputError, IntArray, LaneTruth

#: Per score the values of all frames and of each resample (1 + R,); None for a short drive.
Means = Mapping[str, FloatArray] | None

#: The keys of a recording's part that are not in the document.
_NOT_WRITTEN = ("resampled", "results")


@dataclass(frozen=True)
class Asked:
    """What is compared in addition to the scores.

    - health: how well each notices that the detector is wrong.
    - events: the lane changes that each reports.
    - lags: seconds, increasing: beliefs that wait this long.
    """

    health: bool = False
    events: bool = False
    lags: tuple[float, ...] = ()


def compare_results(
    title: str,
    columns: Sequence[Sequence[Result]],
    asked: Asked = Asked(),
    *,
    run: int | None = None,
) -> dict[str, Any]:
    """Compare results of one recording; differences are to the first.

    - title: names the recording.
    - columns: for each experiment its result, or one for each seed of its search.
    - run: number of the paper's run, or None.

    Returns the recording's part of the `document`; in addition `resampled`, which `together` takes,
    and `results`, by name. Raises InputError for a result without ground truth, annotated frames
    that are not the same, lags where the evidence allows none, and health where no result has the
    detector's own answer.
    """
    names = _names([column[0] for column in columns])
    given, columns = columns, [[annotated(each) for each in column] for column in columns]
    first = columns[0][0]
    for column in columns[1:]:
        _check_same(first, column[0])
    errors = _detector_errors([column[0] for column in columns]) if asked.health else None
    keep = _subsets([column[0] for column in columns])
    means = [{key: _means(column, kept, title) for key, kept in keep.items()} for column in columns]
    notes = [note for column in columns for each in column for note in each.notes]
    entries = []
    for k, (column, mine) in enumerate(zip(columns, means, strict=True)):
        entry = {"name": names[k], **_entry(column, keep, mine)}
        if k:
            entry["difference_to"] = names[0]
            entry["difference"] = {key: _bounds(_minus(mine[key], means[0][key])) for key in keep}
        if errors is not None:
            entry["health"] = _each(keep, column, lambda r, kept: _health(r, errors, kept))
        if asked.events:
            entry["events"] = _each(keep, column, _events)
        if asked.lags:
            entry["lags"] = _lags(column, keep, asked.lags)
            notes += lag_notes(column[0], asked.lags)
        entries.append(entry)
    drive, every = _drive_of(first)
    trusted = list(keep.values())[-1]
    return {
        "title": title,
        "run": run,
        "frames": len(first),
        "blocks": first.run.get("blocks"),
        "health": errors and {key: _baseline(errors, kept) for key, kept in keep.items()},
        "experiments": entries,
        "notes": list(dict.fromkeys(notes)),
        "drive": drive,
        "resampled": [_means(column, trusted, title, (drive, every)) for column in columns],
        "results": {
            name + (f"_seed{each.run['seed']}" if len(column) > 1 else ""): each
            for name, column in zip(names, given, strict=True)
            for each in column
        },
    }


def _names(results: Sequence[Result]) -> list[str]:
    """The name of each; its directory where several are called so."""
    names = [each.name for each in results]
    return [
        str(each.directory) if names.count(name) > 1 else name
        for name, each in zip(names, results, strict=True)
    ]


def annotated(result: Result) -> Result:
    """The result of the annotated frames alone. Raises InputError where there are none."""
    rows = result.scored
    if not len(rows):
        raise InputError(f"{result.directory}: has no ground truth, there is nothing to compare")
    return result if len(rows) == len(result) else result.take(rows)


def truth_of(result: Result) -> LaneTruth:
    """The ground truth of a result of annotated frames."""
    assert result.truth is not None
    return result.truth


def _check_same(first: Result, other: Result) -> None:
    theirs, truth = truth_of(other), truth_of(first)
    for name in ("frame_id", "lane", "is_crossing"):
        if not np.array_equal(getattr(truth, name), getattr(theirs, name)):
            raise InputError(
                f"{other.directory}: {name} of the annotated frames ({_range(theirs)}) is not that"
                f" of {first.directory} ({_range(truth)}); a difference needs the same frames,"
                " missing_frames and ground truth"
            )
    if other.n_lanes != first.n_lanes:
        raise InputError(
            f"{other.directory}: has {other.n_lanes} lanes, {first.directory} {first.n_lanes}"
        )


def _range(truth: LaneTruth) -> str:
    return f"{len(truth)} from {truth.frame_id[0]} to {truth.frame_id[-1]}"


def _subsets(results: Sequence[Result]) -> dict[str, BoolArray]:
    """Which frames count: all, and, where an experiment names untrusted labels, the others."""
    trusted = np.logical_and.reduce(
        [may_fit(each.frame_id, each.run.get("never_fit", ())) for each in results]
    )
    keep = {"all_frames": np.ones(len(trusted), dtype=bool)}
    return keep if trusted.all() else {**keep, "without_never_fit": trusted}


def _drive_of(result: Result) -> tuple[str, IntArray]:
    """The key of a result's drive, see `drive.drive_key`, and the frame ids (T,) of the whole of
    it, of which one detector's recording may lack some."""
    experiment, own = result.experiment, result.frame_id
    try:
        key = drive_key(experiment)
        if experiment.ground_truth is None:
            return key, own
        path = find_file(experiment.ground_truth.path, experiment.folder)
        return key, np.union1d(read_ground_truth(path).frame_id, own)
    except InputError:
        # A stored result outlives the files that it was made from.
        truth = truth_of(result)
        content = b"".join(v.tobytes() for v in (truth.frame_id, truth.lane, truth.is_crossing))
        return hashlib.sha256(content).hexdigest(), own


# --- an experiment -----------------------------------------------------------------------------


def _entry(
    column: Sequence[Result], keep: Mapping[str, BoolArray], means: Mapping[str, Means]
) -> dict[str, Any]:
    """An experiment's part of the document: results that are alike but for the seed."""
    experiment, run = column[0].experiment, column[0].run
    each = [{key: _scores(one, kept) for key, kept in keep.items()} for one in column]
    scores = {key: mean_of([found[key] for found in each]) for key in keep}
    if len(column) > 1:
        for key, found in scores.items():
            bounds = _bounds(means[key])
            found["intervals"] = {
                name: (bounds[name] or [])[1:] or None for name in ("accuracy", "f1")
            }
    is_causal = {
        key: all(one.run["causal"][key] for one in column) for key in ("filter", "evidence")
    }
    why = [line for one in column for line in one.run["why_not_causal"]]
    parameters = [one.run.get("parameters_per_block", []) for one in column]
    times = [one.run.get("microseconds_per_frame", math.nan) for one in column]
    return {
        "source": Path(experiment.source).name,
        "evidence": experiment.evidence,
        "graph": Path(experiment.graph).name,
        "filter": experiment.filter,
        "fit": run.get("fit", "none"),
        "tuned_on": run["tuned_on"],
        "is_causal": all(is_causal.values()),
        "causal": is_causal,
        "why_not_causal": list(dict.fromkeys(why)),
        "unassigned_below": experiment.unassigned_below,
        "free_parameters": run.get("free_parameters"),
        "fixed_parameters": run.get("fixed_parameters"),
        "trials": run.get("trials"),
        "microseconds_per_frame": None if math.isnan(times[0]) else min(times),
        "parameters": parameters[0] if len(column) == 1 else [],
        "scores": scores,
        "spread": {key: _spread([found[key] for found in each]) for key in keep},
        "seeds": [
            {"seed": one.run["seed"], "parameters": found, "scores": mine}
            for one, found, mine in zip(column, parameters, each, strict=True)
            if "seed" in one.run
        ],
        "lags": None,
        "difference_to": None,
        "difference": None,
        "health": None,
        "events": None,
    }


def _each(
    keep: Mapping[str, BoolArray], column: Sequence[Result], score: Callable[..., Mapping[str, Any]]
) -> dict[str, Any]:
    """Per choice of frames the mean over the seeds of what `score(result, kept)` gives."""
    return {key: mean_of([score(one, kept) for one in column]) for key, kept in keep.items()}


def _scores(result: Result, kept: BoolArray) -> dict[str, Any]:
    log_evidence = result.beliefs.take(kept).mean_log_evidence
    return {
        **score_with_intervals(
            result.marginals["Lane"][kept],
            truth_of(result).take(kept),
            result.run["frame_rate"],
            assigned=result.assigned_lane[kept],
        ),
        "mean_log_evidence": None if np.isnan(log_evidence) else log_evidence,
    }


def _lags(
    column: Sequence[Result], keep: Mapping[str, BoolArray], lags: Sequence[float]
) -> dict[str, Any]:
    late = [lagged_beliefs(each, lags) for each in column]
    found = {}
    for key, kept in keep.items():
        scores = [lag_scores(*each, lags, kept) for each in zip(column, late, strict=True)]
        found[key] = mean_of(scores)
        if len(column) > 1:
            # The mean of the seeds' intervals is none of the mean.
            found[key]["intervals"] = None
    return found


def _events(result: Result, kept: BoolArray) -> dict[str, Any]:
    """The scores of a result's lane changes, as `event_scores`, over the frames (K,) that are kept.
    The changes are found in all annotated frames."""
    rate, truth = result.run["frame_rate"], truth_of(result).take(kept)
    lag, places = result.experiment.lag, result.place_in_lane
    events = lane_events(result.beliefs, rate, lag=lag, places=places)
    crossing = None if result.crossing is None else result.crossing[kept]
    return event_scores(events, crossing, truth, rate)


# --- what the detector alone answers -----------------------------------------------------------


def detector_alone(result: Result) -> Result | None:
    """What a result's detector alone answers, as a result that can be compared; None where it does
    not say."""
    if result.tentative is None:
        return None
    names = {"Lane": tuple(map(str, range(1, result.n_lanes + 1)))}
    run = {**result.run, "name": "detector", "tuned_on": "not_tuned", "values": names}
    run |= {"free_parameters": 0, "mean_log_evidence": None}
    return replace(
        result,
        run={k: v for k, v in run.items() if k != "microseconds_per_frame"},
        marginals={"Lane": result.tentative},
        values=names,
        assigned_lane=assigned_lane(result.tentative),
        log_evidence=np.full(len(result), np.nan),
        is_impossible=np.zeros(len(result), dtype=bool),
        crossing=None,
        place_in_lane=None,
    )


def _detector_errors(results: Sequence[Result]) -> DetectorErrors:
    """Where the detector alone is wrong, by the first result whose evidence rule answers itself."""
    for each in results:
        if each.tentative is not None:
            return detector_errors(each.tentative, each.true_lane, each.is_crossing)
    raise InputError(
        "health: no experiment here has the detector's own answer; add with_paper, or one with"
        " evidence: counting"
    )


def _baseline(errors: DetectorErrors, kept: BoolArray) -> dict[str, Any]:
    """What health scores are compared with: "the detector says Unassigned" as the score for "the
    detector is not right", over all non-crossing frames among those kept (K,).

    Keys: `frames` (non-crossing), `committed` (those with a lane), `wrong` (committed and wrong),
    `auc_unassigned`.
    """
    scored, committed = errors.is_scored & kept, errors.is_committed & kept
    return {
        "frames": int(scored.sum()),
        "committed": int(committed.sum()),
        "wrong": int((committed & errors.is_wrong).sum()),
        "auc_unassigned": roc_auc(errors.assigned[scored] == UNASSIGNED, errors.is_wrong[scored]),
    }


def _health(result: Result, errors: DetectorErrors, kept: BoolArray) -> Mapping[str, Any]:
    """The areas under the ROC curve of a result's health scores for "the detector alone is wrong",
    over the kept frames (K,) in which it commits to a lane.

    Keys: `auc_doubt` (score: 1 - P(the detector's lane)), `auc_bad` (P(SensorState = BAD), None
    without that node), `auc_doubt_all` (doubt over all non-crossing frames; 1 where Unassigned).
    """
    committed, scored, wrong = errors.is_committed & kept, errors.is_scored & kept, errors.is_wrong
    score, bad = doubt(result.marginals["Lane"], errors.assigned), None
    if "BAD" in result.values.get("SensorState", ()):
        at = result.values["SensorState"].index("BAD")
        bad = roc_auc(result.marginals["SensorState"][committed, at], wrong[committed])
    return {
        "auc_doubt": roc_auc(score[committed], wrong[committed]),
        "auc_bad": bad,
        "auc_doubt_all": roc_auc(score[scored], wrong[scored]),
    }


# --- resamples ---------------------------------------------------------------------------------


def _spread(scores: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    return {name: spread([each[name] for each in scores]) for name in INTERVAL_STATISTICS}


def _means(
    column: Sequence[Result],
    kept: BoolArray,
    title: str,
    drive: tuple[str, IntArray] | None = None,
) -> Means:
    """The scores of the frames that are kept, the mean over the seeds: of all and of each resample.

    - title: the recording's.
    - drive: key and frames of the drive, to draw from all of these, so that the draws are the same
      ones for all its recordings.
    """
    counts = [
        score_counts(
            each.marginals["Lane"][kept],
            each.true_lane[kept],
            each.is_crossing[kept],
            assigned=each.assigned_lane[kept],
        )
        for each in column
    ]
    if drive is None:
        values = resampled_scores(counts)
    else:
        (key, every), frames = drive, column[0].frame_id[kept]
        placed = [on_timeline(each, frames, every) for each in counts]
        values = resampled_scores(placed, [*key.encode()])
    chance = f"{title}: {column[0].name}"
    return values and {name: over_seeds(found, chance) for name, found in values.items()}


def _minus(mine: Means, theirs: Means) -> Means:
    if mine is None or theirs is None:
        return None
    return {name: values - theirs[name] for name, values in mine.items()}


def _bounds(means: Means) -> dict[str, list[float] | None]:
    """Per score [estimate, low, high]; None for a short drive."""
    return {name: with_bounds(means[name]) if means else None for name in INTERVAL_STATISTICS}


# --- several recordings ------------------------------------------------------------------------


def document(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What `egolane compare --json` writes; its keys are those of `comparing.document.Comparison`.

    - parts: what `compare_results` gives for each recording; for one that failed its `title`, `run`
      and `error`.

    Subsets of the frames are `all_frames` and, where an experiment's `tuning.never_fit` names
    frames with untrusted labels, `without_never_fit`.
    """
    parts = list(parts)
    done = [part for part in parts if "error" not in part]
    of = first_names([part["title"] for part in done], [part["drive"] for part in done])
    blocks = {part["blocks"] for part in done}
    return {
        "schema_version": SCHEMA_VERSION,
        "held_out": None not in blocks,
        "blocks": blocks.pop() if len(blocks) == 1 else None,
        "recordings": [
            {**{k: v for k, v in part.items() if k not in _NOT_WRITTEN}, "drive": first}
            for part, first in zip(done, of, strict=True)
        ],
        "together": together(done),
        "failed": [part for part in parts if "error" in part],
    }


def together(parts: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Several recordings as one: of each experiment, the plain means over the recordings.

    - parts: what `compare_results` gives for each.

    `name`, `recordings` and `drives` (how many there are), `scores` and `difference`, to the first
    experiment (per score [estimate, low, high], or null where a drive is short), and `spread` (per
    score the standard deviation over the seeds of this mean).

    Recordings of one drive by several detectors share its luck: their frames are resampled
    together. Frames of untrusted labels (`tuning.never_fit`) are left out. Empty for one recording,
    or where the recordings do not have the same experiments.
    """
    names = {tuple(entry["name"] for entry in part["experiments"]) for part in parts}
    if len(parts) < 2 or len(names) > 1:
        return []
    found: list[dict[str, Any]] = []
    means: list[Means] = []
    for k, name in enumerate(next(iter(names))):
        entries = [part["experiments"][k] for part in parts]
        values = [part["resampled"][k] for part in parts]
        means.append(
            None
            if any(each is None for each in values)
            else {n: np.mean([each[n] for each in values], axis=0) for n in INTERVAL_STATISTICS}
        )
        found.append(
            {
                "name": name,
                "recordings": len(parts),
                "drives": len({part["drive"] for part in parts}),
                "scores": _bounds(means[k]),
                "spread": _spread_of_means(entries),
                "difference": _bounds(_minus(means[k], means[0])) if k else None,
            }
        )
    return found


def _spread_of_means(entries: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """The spread over the seeds of the mean over recordings. Searches are independent: which of
    them are taken together does not matter, and the k-th seeds are."""
    runs = [[list(one["scores"].values())[-1] for one in entry["seeds"]] for entry in entries]
    means = [
        {name: float(np.mean([scores[name] for scores in each])) for name in INTERVAL_STATISTICS}
        for each in zip(*runs, strict=True)
    ]
    return _spread(means) if means else dict.fromkeys(INTERVAL_STATISTICS)
