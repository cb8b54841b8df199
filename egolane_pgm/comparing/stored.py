"""Results that are stored already, side by side: their beliefs are scored on the frames of the
ground truth that they share, and differ by paired intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from egolane_pgm.results import SCHEMA_VERSION, Result
from egolane_pgm.scoring.bootstrap import Interval, score_counts, score_intervals
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import InputError, LaneTruth
from egolane_pgm.views.tables import with_interval


def compare_results(results: Sequence[Result]) -> dict[str, Any]:
    """The scores of several results, and how each differs from the first.

    `schema_version`, `frames` (annotated), `results`: a list of `directory`, `name`, `tuned_on`,
    `scores` (as `scoring.summary.score_with_intervals`), `difference_to` (the directory of the
    first; null for itself) and `difference` (per score [estimate, low, high], 95 % by paired block
    bootstrap; null for a short drive).

    Raises InputError for less than two results, one without ground truth, and annotated frames
    that are not the same.
    """
    if len(results) < 2:
        raise InputError("compare: needs two result directories or more")
    first = results[0]
    truth = _truth(first)
    for other in results[1:]:
        _check_same(first, truth, other)
    counts = [_counts(result) for result in results]
    found = []
    for result, mine in zip(results, counts, strict=True):
        known = _known(result)
        difference: dict[str, Interval | None] = {}
        if result is not first:
            difference = score_intervals([mine], [counts[0]])
        found.append(
            {
                "directory": str(result.directory),
                "name": result.run["name"],
                "tuned_on": result.run["tuned_on"],
                "scores": score_with_intervals(
                    result.marginals["Lane"][known],
                    truth,
                    float(result.run["frame_rate"]),
                    assigned=result.assigned_lane[known],
                ),
                "difference_to": str(first.directory) if difference else None,
                "difference": {
                    name: i and [i.estimate, i.low, i.high] for name, i in difference.items()
                },
            }
        )
    return {"schema_version": SCHEMA_VERSION, "frames": len(truth), "results": found}


def stored_rows(found: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of a table of what `compare_results` says."""
    names = {"accuracy": "accuracy", "f1": "F1", "log_loss": "log-loss"}
    header = ["result", *names.values(), *(f"{name} - first" for name in names.values())]
    rows = []
    for each in found["results"]:
        scores, intervals = each["scores"], each["scores"]["intervals"]
        cells = [with_interval(scores[key], intervals.get(key)) for key in names]
        differences = [each["difference"].get(key) for key in names]
        cells += [with_interval(d[0], d[1:], "+.3f") if d else "" for d in differences]
        mark = " *" if each["tuned_on"] in ("same_frames", "unknown") else ""
        rows.append([each["directory"] + mark, *cells])
    return header, rows


def _known(result: Result) -> Any:
    return result.true_lane > 0


def _counts(result: Result) -> dict[str, Any]:
    known = _known(result)
    return score_counts(
        result.marginals["Lane"][known],
        result.true_lane[known],
        result.is_crossing[known],
        assigned=result.assigned_lane[known],
    )


def _truth(result: Result) -> LaneTruth:
    truth = result.truth
    if truth is None:
        raise InputError(f"{result.directory}: has no ground truth, there is nothing to compare")
    return truth


def _check_same(first: Result, truth: LaneTruth, other: Result) -> None:
    theirs = _truth(other)
    for name in ("frame_id", "lane", "is_crossing"):
        if not np.array_equal(getattr(truth, name), getattr(theirs, name)):
            raise InputError(
                f"{other.directory}: {name} of the annotated frames ({_range(theirs)}) is not that"
                f" of {first.directory} ({_range(truth)}); a difference needs the same frames and"
                " ground truth"
            )
    if other.n_lanes != first.n_lanes:
        raise InputError(
            f"{other.directory}: has {other.n_lanes} lanes, {first.directory} {first.n_lanes}"
        )


def _range(truth: LaneTruth) -> str:
    return f"{len(truth)} from {truth.frame_id[0]} to {truth.frame_id[-1]}"
