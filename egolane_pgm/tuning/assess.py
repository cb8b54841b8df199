"""What searched parameters are worth: scores with intervals, per recording or of a fleet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.drive import Drive
from egolane_pgm.scoring.bootstrap import (
    INTERVAL_STATISTICS,
    Interval,
    over_drives,
    score_counts,
    score_intervals,
)
from egolane_pgm.scoring.confusion import SCORES as CONFUSION_SCORES
from egolane_pgm.scoring.confusion import on_widest
from egolane_pgm.scoring.summary import score_all
from egolane_pgm.types import BoolArray, FloatArray

#: The scores that every result shows.
SCORES = ("accuracy", "precision", "recall", "f1", "log_loss", "brier")


def assess(
    drives: Sequence[Drive],
    beliefs: Sequence[FloatArray],
    keep: Sequence[BoolArray],
    *,
    drive_of: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Scores with intervals over the kept frames, per recording and their plain mean.

    beliefs: per drive (K, n). keep: per drive (K,).
    drive_of: for a fleet, the drive of each row: then it is the score of all their frames
        instead, with an interval over drives.
    """
    each, counts = _each(drives, beliefs, keep), _counts(drives, beliefs, keep)
    frames = np.array([scores["frames_scored"] for scores in each])
    if drive_of is None:
        found: dict[str, Any] = {**_means(each), "intervals": _bounds(score_intervals(counts))}
    else:
        matrices = on_widest([np.array(scores["confusion"]) for scores in each]).sum(axis=0)
        found = {
            name: float(score(matrices))
            for name, score in CONFUSION_SCORES.items()
            if name in SCORES
        }
        brier = [scores["brier"] or 0.0 for scores in each]
        found["brier"] = float(np.dot(frames, brier) / frames.sum())
        intervals = _over_drives(counts, drive_of)
        found["log_loss"] = intervals["log_loss"][0]
        found["intervals"] = {name: interval for name, (_, interval) in intervals.items()}
    found["frames_scored"] = int(frames.sum())
    if len(each) == 1:
        found["confusion"] = each[0]["confusion"]
    else:
        found["recordings"] = each
    return found


def difference(
    drives: Sequence[Drive],
    first: Sequence[FloatArray],
    second: Sequence[FloatArray],
    keep: Sequence[BoolArray],
    *,
    drive_of: Sequence[str] | None = None,
) -> dict[str, Any]:
    """First less second with intervals, over the same resamples of the same frames, or drives."""
    counts = _counts(drives, first, keep), _counts(drives, second, keep)
    if drive_of is not None:
        found = _over_drives(counts[0], drive_of, counts[1])
        intervals = {name: interval for name, (_, interval) in found.items()}
        return {**{name: value for name, (value, _) in found.items()}, "intervals": intervals}
    one, other = (_means(_each(drives, side, keep)) for side in (first, second))
    bounds = _bounds(score_intervals(*counts))
    return {**{name: one[name] - other[name] for name in bounds}, "intervals": bounds}


def _each(
    drives: Sequence[Drive], beliefs: Sequence[FloatArray], keep: Sequence[BoolArray]
) -> list[dict[str, Any]]:
    """Per recording its name, scores and confusion matrix."""
    each = []
    for drive, belief, kept in zip(drives, beliefs, keep, strict=True):
        truth, experiment = drive.truth.take(kept), drive.experiment
        scores = score_all(
            belief[kept],
            truth.lane,
            truth.is_crossing,
            truth.frame_id,
            experiment.recording.frame_rate,
            experiment.unassigned_below,
        )
        shown = (*SCORES, "confusion", "frames_scored")
        each.append({"name": experiment.name, **{name: scores[name] for name in shown}})
    return each


def _means(each: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    return {name: float(np.mean([scores[name] for scores in each])) for name in SCORES}


def _over_drives(
    counts: Sequence[Mapping[str, NDArray[Any]]],
    drive_of: Sequence[str],
    minus: Sequence[Mapping[str, NDArray[Any]]] | None = None,
) -> dict[str, tuple[float, tuple[float, float] | None]]:
    """Each score that has an interval, of all frames of the drives, and that interval."""

    def sums(side: Sequence[Mapping[str, NDArray[Any]]], name: str) -> NDArray[Any]:
        of_drives = [mine[name].sum(axis=0) for mine in side]
        return np.stack(of_drives) if name == "log_loss" else on_widest(of_drives)

    return {
        name: over_drives(
            sums(counts, name),
            statistic,
            None if minus is None else sums(minus, name),
            drive_of=drive_of,
        )
        for name, statistic in INTERVAL_STATISTICS.items()
    }


def _counts(
    drives: Sequence[Drive], beliefs: Sequence[FloatArray], keep: Sequence[BoolArray]
) -> list[dict[str, Any]]:
    found = []
    for drive, belief, kept in zip(drives, beliefs, keep, strict=True):
        truth, below = drive.truth.take(kept), drive.experiment.unassigned_below
        found.append(score_counts(belief[kept], truth.lane, truth.is_crossing, below))
    return found


def _bounds(intervals: Mapping[str, Interval | None]) -> dict[str, list[float] | None]:
    return {name: None if i is None else [i.low, i.high] for name, i in intervals.items()}
