"""Results side by side: scored on the annotated frames that they share, and less the first by
paired intervals."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.drive import drive_key, may_fit
from egolane_pgm.fleet import first_names
from egolane_pgm.inference.events import lane_events
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.results import SCHEMA_VERSION, Result
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import (
    INTERVAL_STATISTICS,
    on_timeline,
    resampled_scores,
    score_counts,
    with_bounds,
)
from egolane_pgm.scoring.events import event_scores
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LaneTruth

#: Per score the values of all frames and of each resample (1 + R,); None for a short drive.
Means = Mapping[str, FloatArray] | None

#: The keys of a recording's part that are not in the document.
_NOT_WRITTEN = ("resampled", "results")


def compare_results(
    title: str,
    results: Sequence[Result],
    *,
    events: bool = False,
    run: int | None = None,
) -> dict[str, Any]:
    """Compare results of one recording; differences are to the first.

    - title: names the recording.
    - events: whether the lane changes that each reports are scored too.
    - run: number of the paper's run, or None.

    Returns the recording's part of the `document`; in addition `resampled`, which `together` takes,
    and `results`, by name. Raises InputError for a result without ground truth, and for annotated
    frames that are not the same.
    """
    names = _names(results)
    given, results = results, [annotated(each) for each in results]
    first = results[0]
    for each in results[1:]:
        _check_same(first, each)
    keep = _subsets(results)
    means = [{key: _means(each, kept) for key, kept in keep.items()} for each in results]
    entries = []
    for k, (each, mine) in enumerate(zip(results, means, strict=True)):
        entry = {"name": names[k], **_entry(each, keep)}
        if k:
            entry["difference_to"] = names[0]
            entry["difference"] = {key: _bounds(_minus(mine[key], means[0][key])) for key in keep}
        if events:
            entry["events"] = {key: _events(each, kept) for key, kept in keep.items()}
        entries.append(entry)
    key, every = _drive_of(first)
    trusted = list(keep.values())[-1]
    return {
        "title": title,
        "run": run,
        "frames": len(first),
        "blocks": first.run.get("blocks"),
        "experiments": entries,
        "notes": list(dict.fromkeys(note for each in results for note in each.notes)),
        "drive": key,
        "resampled": [_means(each, trusted, (key, every)) for each in results],
        "results": dict(zip(names, given, strict=True)),
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


def _entry(result: Result, keep: Mapping[str, BoolArray]) -> dict[str, Any]:
    """An experiment's part of the document."""
    experiment, run = result.experiment, result.run
    microseconds = run.get("microseconds_per_frame", math.nan)
    return {
        "source": Path(experiment.source).name,
        "evidence": experiment.evidence,
        "graph": Path(experiment.graph).name,
        "filter": experiment.filter,
        "fit": run.get("fit", "none"),
        "tuned_on": run["tuned_on"],
        "is_causal": run["causal"]["filter"] and run["causal"]["evidence"],
        "causal": {key: run["causal"][key] for key in ("filter", "evidence")},
        "why_not_causal": list(dict.fromkeys(run["why_not_causal"])),
        "unassigned_below": experiment.unassigned_below,
        "free_parameters": run.get("free_parameters"),
        "fixed_parameters": run.get("fixed_parameters"),
        "trials": run.get("trials"),
        "microseconds_per_frame": None if math.isnan(microseconds) else microseconds,
        "parameters": run.get("parameters_per_block", []),
        "scores": {key: _scores(result, kept) for key, kept in keep.items()},
        "difference_to": None,
        "difference": None,
        "events": None,
    }


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


# --- resamples ---------------------------------------------------------------------------------


def _means(result: Result, kept: BoolArray, drive: tuple[str, IntArray] | None = None) -> Means:
    """The scores of the frames that are kept: of all and of each resample.

    - drive: key and frames of the drive, to draw from all of these, so that the draws are the same
      ones for all its recordings.
    """
    counts = score_counts(
        result.marginals["Lane"][kept],
        result.true_lane[kept],
        result.is_crossing[kept],
        assigned=result.assigned_lane[kept],
    )
    if drive is None:
        return resampled_scores(counts)
    key, every = drive
    return resampled_scores(on_timeline(counts, result.frame_id[kept], every), [*key.encode()])


def _minus(mine: Means, theirs: Means) -> Means:
    if mine is None or theirs is None:
        return None
    return {name: values - theirs[name] for name, values in mine.items()}


def _bounds(means: Means) -> dict[str, list[float] | None]:
    """Per score [estimate, low, high]; None for a short drive."""
    return {name: with_bounds(means[name]) if means else None for name in INTERVAL_STATISTICS}


# --- several recordings ------------------------------------------------------------------------


def document(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The content of `egolane compare --json`.

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
    experiment (per score [estimate, low, high], or null where a drive is short).

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
                "difference": _bounds(_minus(means[k], means[0])) if k else None,
            }
        )
    return found
