"""Studies without one part of the frames: searched from scratch, and scored in that part only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import optuna

from egolane_pgm.drive import Drive
from egolane_pgm.scoring.held_out import blocks, without_block
from egolane_pgm.tuning.plan import Problem, scorer
from egolane_pgm.tuning.search import (
    Report,
    Score,
    Settings,
    best_trial,
    n_complete,
    search,
    search_in_memory,
)
from egolane_pgm.tuning.space import SearchSpace
from egolane_pgm.types import BoolArray, LaneTruth


@dataclass(frozen=True)
class Nested:
    """The result of a study without one part of the frames.

    - part: number of the block, or of the part of a fleet, from 0.
    - point: the best one.
    - values: its scores on the frames that the study saw (in-sample for those).
    - trials: how many there were.
    """

    part: int
    point: Mapping[str, Any]
    values: tuple[float, ...]
    trials: int


def nested_search(problem: Problem, used: Sequence[BoolArray], part: int) -> Nested:
    """`search_without` a part of recordings, in memory.

    - problem: without the labels of the part that is held out.
    - used: per drive (K,), marks the frames that are scored.
    """
    return search_without(problem.space, scorer(problem, used), problem.settings, part)


def search_without(
    space: SearchSpace,
    score: Score,
    settings: Settings,
    part: int,
    *,
    study: optuna.Study | None = None,
    report: Report | None = None,
) -> Nested:
    """Run a study from scratch: values that were tuned on the frames held out, such as the
    published ones, would give their labels away.

    - score: without the labels of the part that is held out.
    - settings: those of the study on everything.
    - part: number of the part; each has a seed of its own.
    - study: the one to go on with; by default one in memory.
    - report: as `search` takes it.
    """
    settings = settings_of_part(settings, part)
    if study is None:
        study = search_in_memory(space, score, settings, report)
    else:
        search(study, space, score, settings, report=report)
    best = best_trial(study)
    return Nested(part, dict(best.params), tuple(best.values), n_complete(study))


def settings_of_part(settings: Settings, part: int) -> Settings:
    """The settings of a study without a part. Each such study has a seed of its own, because with
    one seed all of them would share its luck."""
    seed = np.random.SeedSequence([settings.seed, part + 1]).generate_state(1)[0]
    return replace(settings, seed=int(seed))


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
