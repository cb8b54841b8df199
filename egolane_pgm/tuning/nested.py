"""Scores a search on frames that it has not seen: the study is run anew without each block of the
drive (or without each recording), and its result is scored there only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import optuna
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
from egolane_pgm.scoring.held_out import blocks, without_block
from egolane_pgm.scoring.summary import score_all
from egolane_pgm.tuning.objective import tried_belief
from egolane_pgm.tuning.plan import Problem, parameters_at, scorer
from egolane_pgm.tuning.search import Report, Settings, best_trial, search, search_in_memory
from egolane_pgm.tuning.space import Point, to_parameters
from egolane_pgm.types import BoolArray, FloatArray, LaneTruth

#: The scores that every result shows.
SCORES = ("accuracy", "precision", "recall", "f1", "log_loss", "brier")


@dataclass(frozen=True)
class Nested:
    """The result of a study without one part of the frames.

    - part: number of the block, or of the recording, from 0.
    - point: the best one.
    - values: its scores on the frames that the study saw (in-sample for those).
    - trials: how many there were.
    """

    part: int
    point: Mapping[str, Any]
    values: tuple[float, ...]
    trials: int


def blocks_lacking_lanes(drive: Drive, n_blocks: int) -> list[str]:
    """A note, or none, on the blocks of a drive: those in which a lane that is driven does not
    occur, and those without which one is not left to fit on. Raises InputError for impossible
    numbers of blocks, or where no frame is left to fit on."""
    driven = _lanes(drive.truth)
    lacking, lost = [], []
    for b, part in enumerate(blocks(len(drive), n_blocks)):
        _, train = without_block(drive, n_blocks, b)
        if driven - _lanes(drive.truth.take(part)):
            lacking.append(str(b + 1))
        gone = sorted(driven - _lanes(drive.truth.take(train)))
        lost += [f"lane {lane} without block {b + 1}" for lane in gone]
    said = f"{len(lacking)} of {n_blocks} blocks lack a lane that is driven ({', '.join(lacking)})"
    if lost:
        said += f"; no frame is left to fit on in {', '.join(lost)}"
    return [said] if lacking else []


def _lanes(truth: LaneTruth) -> set[int]:
    """The lanes that are driven in the frames that are not crossing."""
    return set(truth.lane[~truth.is_crossing].tolist())


def run_nested(problem: Problem, part: int, by_recording: bool, **options: Any) -> Nested:
    """Run the study anew without one part; options as `nested_search` takes them."""
    return nested_search(*without_part(problem, part, by_recording), part, **options)


def without_part(
    problem: Problem, part: int, by_recording: bool
) -> tuple[Problem, list[BoolArray]]:
    """The problem without the labels of a part, and per drive the frames that may be used."""
    if by_recording:
        kept = [k for k in range(len(problem.drives)) if k not in problem.parts[part]]
        drives = tuple(problem.drives[k] for k in kept)
        spaces = tuple(problem.spaces[k] for k in kept)
        smaller = replace(problem, drives=drives, spaces=spaces)
        return smaller, [drive.may_fit for drive in drives]
    n_blocks = problem.plan.tuning.blocks
    pairs = [without_block(drive, n_blocks, part) for drive in problem.drives]
    used = [np.isin(np.arange(len(drive)), train) for drive, train in pairs]
    return replace(problem, drives=tuple(drive for drive, _ in pairs)), used


def nested_search(
    problem: Problem,
    used: Sequence[BoolArray],
    part: int,
    *,
    study: optuna.Study | None = None,
    worker: int = 0,
    report: Report | None = None,
) -> Nested:
    """Run a study from scratch: values that were tuned on the frames held out, such as the
    published ones, would give their labels away.

    - problem: without the labels of the part that is held out.
    - used: per drive (K,), marks the frames that are scored.
    - part: number of the part; each has a seed of its own.
    - study: the one to go on with; by default one in memory.
    - worker, report: as `search` takes them.
    """
    settings, score = settings_without(problem, part), scorer(problem, used)
    if study is None:
        study = search_in_memory(problem.space, score, settings, report)
    else:
        search(study, problem.space, score, settings, worker=worker, report=report)
    best = best_trial(study)
    return Nested(part, dict(best.params), tuple(best.values), settings.trials)


def settings_without(problem: Problem, part: int) -> Settings:
    """The settings of the study without a part."""
    return settings_of_part(problem.settings, part)


def settings_of_part(settings: Settings, part: int) -> Settings:
    """The settings of a study without a part. Each such study has a seed of its own, because with
    one seed all of them would share its luck."""
    seed = np.random.SeedSequence([settings.seed, part + 1]).generate_state(1)[0]
    return replace(settings, seed=int(seed))


def beliefs_at(problem: Problem, point: Point) -> list[FloatArray]:
    """Per drive the belief (K, n) with the parameters of a point."""
    sets = parameters_at(problem, point)
    return [tried_belief(d, p) for d, p in zip(problem.drives, sets, strict=True)]


def beliefs_held_out(
    problem: Problem, nested: Sequence[Nested], by_recording: bool
) -> list[FloatArray]:
    """Per drive the belief (K, n), each part of it with the parameters found without it."""
    if by_recording:
        at = {k: result.point for result in nested for k in problem.parts[result.part]}
        return [
            tried_belief(drive, to_parameters(space, at[k]))
            for k, (drive, space) in enumerate(zip(problem.drives, problem.spaces, strict=True))
        ]
    each = [beliefs_at(problem, result.point) for result in nested]
    return [
        np.concatenate([each[b][k][part] for b, part in enumerate(blocks(len(drive), len(nested)))])
        for k, drive in enumerate(problem.drives)
    ]


def assess(
    drives: Sequence[Drive],
    beliefs: Sequence[FloatArray],
    keep: Sequence[BoolArray],
    *,
    drive_of: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Scores with intervals over the kept frames, per recording and their plain mean.

    drive_of: for a fleet, the drive of each row: then it is the score of all their frames
        instead, with an interval over drives.
    """
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
    counts = _counts(drives, beliefs, keep)
    frames = np.array([scores["frames_scored"] for scores in each])
    found: dict[str, Any] = {}
    if drive_of is not None:
        matrices = on_widest([np.array(scores["confusion"]) for scores in each])
        found |= {
            name: float(score(matrices.sum(axis=0)))
            for name, score in CONFUSION_SCORES.items()
            if name in SCORES
        }
        brier = [scores["brier"] or 0.0 for scores in each]
        found["brier"] = float(np.dot(frames, brier) / frames.sum())
        intervals = _over_drives(counts, drive_of)
        found["log_loss"] = intervals["log_loss"][0]
        found["intervals"] = {name: interval for name, (_, interval) in intervals.items()}
    else:
        found |= {name: float(np.mean([scores[name] for scores in each])) for name in SCORES}
        found["intervals"] = _bounds(score_intervals(counts))
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
    one, other = assess(drives, first, keep), assess(drives, second, keep)
    bounds = _bounds(score_intervals(*counts))
    return {**{name: one[name] - other[name] for name in bounds}, "intervals": bounds}


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
