"""What a search is worth on frames that it has not seen: the study is run anew without each block
of the drive (or without each recording) and scored there only."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.model import Drive, belief_of, may_fit
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import (
    BLOCK_FRAMES,
    LEVEL,
    circular_block_bootstrap,
    confusion_counts,
    mean_counts,
    ratio,
    resampled_sums,
)
from egolane_pgm.scoring.confusion import accuracy, macro_f1, scores_from_confusion
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.scoring.probabilistic import brier_per_frame, log_loss_per_frame
from egolane_pgm.scoring.stability import lane_changes
from egolane_pgm.tune.plan import Problem, evaluator, parameters_at
from egolane_pgm.tune.space import Point
from egolane_pgm.tune.study import Evaluate, Report, Settings, best_trial, run_study
from egolane_pgm.types import BoolArray, FloatArray, InputError

#: The scores that every result shows, and those of them that have an interval.
SCORES = ("accuracy", "precision", "recall", "f1", "log_loss", "brier")
WITH_INTERVAL = ("accuracy", "f1", "log_loss")


@dataclass(frozen=True)
class Nested:
    """What a study without one part of the frames came to. values: its scores on the frames that
    it saw (in-sample for those). seconds: how long it took."""

    part: int
    point: Mapping[str, Any]
    values: tuple[float, ...]
    trials: int


def block_frames(drive: Drive, n_blocks: int) -> list[BoolArray]:
    """Per block the frames (K,) that belong to it."""
    masks = []
    for part in blocks(len(drive), n_blocks):
        mask = np.zeros(len(drive), dtype=bool)
        mask[part] = True
        masks.append(mask)
    return masks


def check_blocks(problem: Problem) -> list[str]:
    """Raise InputError for more blocks than the drive has lane changes, and where the frames that
    are left to fit on lack a lane that was driven. Returns notes: blocks in which a lane does not
    occur."""
    n_blocks = problem.plan.tuning.blocks
    never_fit = problem.plan.tuning.never_fit
    notes = []
    for drive in problem.drives:
        where, truth = drive.experiment.source, drive.truth
        changes = len(lane_changes(truth.lane, truth.is_crossing))
        if n_blocks > changes:
            advice = f"take at most {changes}" if changes > 1 else "search with --in-sample-only"
            raise InputError(
                f"{where}: {n_blocks} blocks, but the drive has {changes} lane change(s): a block"
                f" without one says nothing; {advice}"
            )
        trusted = may_fit(drive, never_fit)
        lost = _lost_lane(drive, trusted, n_blocks)
        if lost is not None:
            fine = [n for n in range(2, min(changes, 20) + 1) if not _lost_lane(drive, trusted, n)]
            advice = (
                f"take {' or '.join(map(str, fine[:3]))} (--blocks)"
                if fine
                else ("search with --in-sample-only")
            )
            raise InputError(
                f"{where}: without block {lost[0]} of {n_blocks} no frame in lane {lost[1]} is"
                f" left to fit on; {advice}"
            )
        driven = set(truth.lane[~truth.is_crossing].tolist())
        for b, inside in enumerate(block_frames(drive, n_blocks)):
            absent = sorted(driven - set(truth.lane[inside & ~truth.is_crossing].tolist()))
            if absent:
                lanes = ", ".join(map(str, absent))
                notes.append(f"{drive.experiment.name}: block {b + 1} has no frame in lane {lanes}")
    return notes


def _lost_lane(drive: Drive, trusted: BoolArray, n_blocks: int) -> tuple[int, int] | None:
    """The first block without which a lane is not left to fit on, and that lane."""
    truth = drive.truth
    driven = set(truth.lane[~truth.is_crossing].tolist())
    for b, inside in enumerate(block_frames(drive, n_blocks)):
        left = set(truth.lane[trusted & ~inside & ~truth.is_crossing].tolist())
        if driven - left:
            return b + 1, min(driven - left)
    return None


def training_frames(problem: Problem, part: int, by_recording: bool) -> list[BoolArray]:
    """Per drive the frames (K,) that the study without a part may look at."""
    used = []
    for k, drive in enumerate(problem.drives):
        mask = may_fit(drive, problem.plan.tuning.never_fit)
        if by_recording:
            mask &= k != part
        else:
            mask &= ~block_frames(drive, problem.plan.tuning.blocks)[part]
        used.append(mask)
    return used


def run_nested(
    problem: Problem, part: int, by_recording: bool, report: Report | None = None
) -> Nested:
    """The study anew without one part, in memory and from scratch: values that were tuned on the
    frames held out, such as the published ones, would tell it about them."""
    evaluate, own = without_part(problem, part, by_recording)
    study = run_study(problem.space, evaluate, own, report=report)
    best = best_trial(study)
    return Nested(part, dict(best.params), tuple(best.values), own.trials)


def without_part(problem: Problem, part: int, by_recording: bool) -> tuple[Evaluate, Settings]:
    """Scores over the frames that the study without a part may look at, and how it is run."""
    used = training_frames(problem, part, by_recording)
    settings = problem.settings
    chosen = list(range(len(used)))
    if by_recording:
        chosen = [k for k in chosen if k != part]
    smaller = Problem(
        problem.plan,
        settings,
        tuple(problem.drives[k] for k in chosen),
        tuple(problem.spaces[k] for k in chosen),
    )
    evaluate = evaluator(smaller, [used[k] for k in chosen])
    # Another seed for each part: equal studies would share their luck.
    own = Settings(
        settings.objectives,
        settings.sampler,
        settings.trials,
        int(np.random.SeedSequence([settings.seed, part + 1]).generate_state(1)[0]),
    )
    return evaluate, own


def beliefs_at(problem: Problem, point: Point) -> list[FloatArray]:
    """Per drive the belief (K, n) with the parameters of a point."""
    sets = parameters_at(problem, point)
    return [belief_of(d, p) for d, p in zip(problem.drives, sets, strict=True)]


def stitched(problem: Problem, nested: Sequence[Nested], by_recording: bool) -> list[FloatArray]:
    """Per drive the belief (K, n), each part of it with the parameters found without it."""
    stitched_beliefs = []
    for k, drive in enumerate(problem.drives):
        belief = np.empty((len(drive), drive.n_lanes))
        masks = (
            [np.full(len(drive), part == k) for part in range(len(problem.drives))]
            if by_recording
            else block_frames(drive, problem.plan.tuning.blocks)
        )
        for result, mask in zip(nested, masks, strict=True):
            if mask.any():
                parameters = parameters_at(problem, result.point)[k]
                belief[mask] = belief_of(drive, parameters)[mask]
        stitched_beliefs.append(belief)
    return stitched_beliefs


def assess(
    drives: Sequence[Drive], beliefs: Sequence[FloatArray], keep: Sequence[BoolArray]
) -> dict[str, Any]:
    """Scores with intervals over the kept frames, per recording and their plain mean."""
    each = []
    for drive, belief, kept in zip(drives, beliefs, keep, strict=True):
        truth = drive.truth.take(kept)
        rows = belief[kept]
        assigned = assigned_lane(rows, drive.experiment.unassigned_below)
        counts = confusion_counts(assigned, truth.lane, truth.is_crossing, drive.n_lanes)
        scores = scores_from_confusion(counts.sum(axis=0))
        scored = ~truth.is_crossing
        brier = brier_per_frame(rows[scored], truth.lane[scored])
        each.append(
            {
                "name": drive.experiment.name,
                "accuracy": scores.accuracy,
                "precision": scores.mean_precision,
                "recall": scores.mean_recall,
                "f1": scores.mean_f1,
                "log_loss": float(log_loss_per_frame(rows, truth.lane).mean()),
                "brier": float(brier.mean()),
                "confusion": scores.confusion.tolist(),
                "frames_scored": scores.frames_scored,
            }
        )
    found: dict[str, Any] = {
        name: float(np.mean([scores[name] for scores in each])) for name in SCORES
    }
    found["frames_scored"] = sum(scores["frames_scored"] for scores in each)
    found["intervals"] = _intervals(
        lambda name: [_counts(d, b, k, name) for d, b, k in zip(drives, beliefs, keep, strict=True)]
    )
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
) -> dict[str, Any]:
    """First less second with intervals, over the same resamples of the same frames."""

    def counts(beliefs: Sequence[FloatArray]) -> Callable[[str], list[FloatArray]]:
        return lambda name: [
            _counts(d, b, k, name) for d, b, k in zip(drives, beliefs, keep, strict=True)
        ]

    one, other = assess(drives, first, keep), assess(drives, second, keep)
    found: dict[str, Any] = {name: one[name] - other[name] for name in WITH_INTERVAL}
    found["intervals"] = _intervals(counts(first), counts(second))
    return found


_STATISTIC = {"accuracy": accuracy, "f1": macro_f1, "log_loss": ratio}


def _counts(drive: Drive, belief: FloatArray, kept: BoolArray, name: str) -> Any:
    truth = drive.truth.take(kept)
    if name == "log_loss":
        return mean_counts(log_loss_per_frame(belief[kept], truth.lane))
    assigned = assigned_lane(belief[kept], drive.experiment.unassigned_below)
    return confusion_counts(assigned, truth.lane, truth.is_crossing, drive.n_lanes)


def _intervals(
    first: Callable[[str], Sequence[Any]], second: Callable[[str], Sequence[Any]] | None = None
) -> dict[str, list[float] | None]:
    """Per score [low, high]; each recording is resampled by itself, with a seed of its own."""
    found: dict[str, list[float] | None] = {}
    for name in WITH_INTERVAL:
        statistic = _STATISTIC[name]
        mine = first(name)
        theirs = second(name) if second is not None else [None] * len(mine)
        if any(len(counts) < 2 * BLOCK_FRAMES for counts in mine):
            found[name] = None
            continue
        means = []
        for seed, (a, b) in enumerate(zip(mine, theirs, strict=True)):
            drawn = circular_block_bootstrap(len(a), seed=seed)
            values = statistic(resampled_sums(a, drawn))
            if b is not None:
                values = values - statistic(resampled_sums(b, drawn))
            means.append(values)
        bounds = np.quantile(np.mean(means, axis=0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        found[name] = [float(bounds[0]), float(bounds[1])]
    return found
