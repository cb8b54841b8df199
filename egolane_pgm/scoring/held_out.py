"""The held-out engine: whatever is fitted for a block of a drive uses the other blocks only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.checks import as_belief, as_lanes, as_mask
from egolane_pgm.scoring.confusion import confusion
from egolane_pgm.types import FloatArray, InputError, IntArray

#: Defaults of the definitions that hold everywhere: blocks, intervals.
N_BLOCKS = 5


P = TypeVar("P")


@dataclass(frozen=True)
class HeldOut(Generic[P]):
    """What was believed in each frame with parameters fitted without the frame's block.

    belief (T, n): stitched together; any score can be computed from it. block (T,): the block of
    each frame, 0..B-1. parameters: what `fit` returned for each block.
    """

    belief: FloatArray
    block: IntArray
    parameters: tuple[P, ...]


def blocks(n_frames: int, n_blocks: int = N_BLOCKS) -> list[IntArray]:
    """The frames of each block: `np.array_split` of the joined frames, crossing ones included.

    Returns n_blocks index arrays, contiguous, in order. Raises InputError for fewer than 2 blocks
    or more blocks than frames.
    """
    if n_blocks < 2:
        raise InputError(f"n_blocks: {n_blocks} must be at least 2, one is held out at a time")
    if n_blocks > n_frames:
        raise InputError(f"n_blocks: {n_blocks} blocks are more than the {n_frames} frames")
    return np.array_split(np.arange(n_frames, dtype=np.int64), n_blocks)


def held_out(
    n_frames: int,
    n_blocks: int,
    fit: Callable[[IntArray], P],
    predict: Callable[[P], FloatArray],
    *,
    fit_exclude: ArrayLike | None = None,
) -> HeldOut[P]:
    """Believe each block of a drive with parameters fitted on the other blocks.

    fit(train_index) -> parameters, with the increasing indices of the frames it may look at: all
    outside the block, except those marked in fit_exclude (T,) (labels that cannot be trusted; they
    are still predicted). predict(parameters) -> belief (T, n) over the whole drive, filtered from
    the first frame; only the block's rows are kept. A search that proposes adaptively belongs
    inside `fit`, so that it is run anew for each block.

    Raises InputError for impossible numbers of blocks, a block that leaves no frame to fit on, or a
    prediction that is not a belief (T, n) with the same n throughout.
    """
    parts = blocks(n_frames, n_blocks)
    may_fit = np.ones(n_frames, dtype=bool)
    if fit_exclude is not None:
        may_fit = ~as_mask(fit_exclude, n_frames, "fit_exclude")
    beliefs: list[FloatArray] = []
    parameters: list[P] = []
    for b, part in enumerate(parts):
        is_train = may_fit.copy()
        is_train[part] = False
        if not is_train.any():
            raise InputError(
                f"block {b + 1} of {n_blocks}: no frame is left to fit on; exclude fewer frames"
            )
        fitted = fit(np.flatnonzero(is_train))
        belief = as_belief(predict(fitted), normalised=True)
        n_lanes = beliefs[0].shape[1] if beliefs else belief.shape[1]
        if belief.shape != (n_frames, n_lanes):
            raise InputError(
                f"block {b + 1} of {n_blocks}: predict gave a belief of shape {belief.shape},"
                f" needs ({n_frames}, {n_lanes}): the whole drive"
            )
        beliefs.append(belief[part])
        parameters.append(fitted)
    block = np.repeat(np.arange(n_blocks, dtype=np.int64), [len(part) for part in parts])
    return HeldOut(np.concatenate(beliefs), block, tuple(parameters))


def confusion_by_block(
    result: HeldOut[P], lane: ArrayLike, is_crossing: ArrayLike
) -> NDArray[np.int64]:
    """The confusion matrix of each held-out block, (B, n + 1, n); their sum is the held-out one.

    lane (T,), is_crossing (T,). Raises InputError as `scoring.confusion.confusion` does.
    """
    n_frames, n_lanes = result.belief.shape
    actual, crossing = as_lanes(lane, n_frames), as_mask(is_crossing, n_frames)
    assigned = assigned_lane(result.belief)
    return np.stack(
        [
            confusion(assigned[inside], actual[inside], crossing[inside], n_lanes)
            for inside in (result.block == b for b in range(len(result.parameters)))
        ]
    )


def held_out_confusion(
    n_frames: int,
    n_blocks: int,
    fit: Callable[[IntArray], P],
    predict: Callable[[P], FloatArray],
    *,
    lane: ArrayLike,
    is_crossing: ArrayLike,
    fit_exclude: ArrayLike | None = None,
) -> tuple[IntArray, HeldOut[P]]:
    """The held-out confusion matrix (n + 1, n), added over the blocks, and what it comes from.

    Arguments and errors as `held_out` and `confusion_by_block`.
    """
    result = held_out(n_frames, n_blocks, fit, predict, fit_exclude=fit_exclude)
    return confusion_by_block(result, lane, is_crossing).sum(axis=0), result
