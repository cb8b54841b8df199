"""The held-out engine: whatever is fitted for a block of a drive uses the other blocks only.

A block's labels do not reach the fit: it is given a drive from which they were removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import Beliefs, BoolArray, InputError, IntArray

#: The default number of blocks.
N_BLOCKS = 5


class Labelled(Protocol):
    """The drive of K annotated frames that the engine takes; see `model.Drive`."""

    def __len__(self) -> int: ...

    @property
    def may_fit(self) -> BoolArray:
        """(K,): marks the frames whose labels may be used for fitting."""

    def only_labels_of(self, train: IntArray) -> Self:
        """The same drive, the labels of all frames but `train` removed."""


D = TypeVar("D", bound=Labelled)
P = TypeVar("P")
N = TypeVar("N", bound=np.generic)


@dataclass(frozen=True)
class HeldOut(Generic[P]):
    """The belief in each frame with parameters that were fitted without the frame's block.

    beliefs: of the K annotated frames, each block with its own parameters; any score can be
    computed from them.
    block (K,): the block of each frame, 0..B-1.
    parameters: what `fit` returned for each block.
    """

    beliefs: Beliefs
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


def without_block(drive: D, n_blocks: int, block: int) -> tuple[D, IntArray]:
    """The drive with the labels of the frames that may be used for fitting when a block (0..B-1) is
    held out, and the increasing indices of these frames.

    Raises InputError for impossible numbers of blocks, or where no frame is left.
    """
    is_train = drive.may_fit.copy()
    is_train[blocks(len(drive), n_blocks)[block]] = False
    if not is_train.any():
        raise InputError(
            f"block {block + 1} of {n_blocks}: no frame is left to fit on; exclude fewer frames"
        )
    train = np.flatnonzero(is_train)
    return drive.only_labels_of(train), train


def held_out(
    drive: D,
    fit: Callable[[D, IntArray, int], P],
    beliefs_with: Callable[[P], Beliefs],
    n_blocks: int = N_BLOCKS,
) -> HeldOut[P]:
    """Filter each block of a drive with parameters fitted on the other blocks.

    drive: of K annotated frames.
    fit: called as fit(drive, train, block) -> parameters. `drive` is without the labels that must
        not be used, `train` has the indices of the frames that may be. A search that proposes
        adaptively belongs inside, so that it is run anew for each block.
    beliefs_with: gives the beliefs of all K frames with some parameters, filtered from the first
        frame of the recording on; only the block's are kept.
    n_blocks: B, at least 2.

    Raises InputError for impossible numbers of blocks, a block that leaves no frame to fit on, or
    beliefs that are not those of K frames.
    """
    parts = blocks(len(drive), n_blocks)
    parameters: list[P] = []
    beliefs: list[Beliefs] = []
    for b in range(n_blocks):
        parameters.append(fit(*without_block(drive, n_blocks, b), b))
        found = beliefs_with(parameters[-1])
        if len(found) != len(drive):
            raise InputError(
                f"block {b + 1} of {n_blocks}: beliefs of {len(found)} frames, not of {len(drive)}"
            )
        beliefs.append(found)
    block = np.repeat(np.arange(n_blocks, dtype=np.int64), [len(part) for part in parts])
    return HeldOut(stitched(beliefs), block, tuple(parameters))


def stitched(each: Sequence[Beliefs]) -> Beliefs:
    """Block b of the b-th beliefs, for each of B beliefs of the same K frames; one is for all."""
    if len(each) == 1:
        return each[0]
    parts = blocks(len(each[0]), len(each))
    return Beliefs.joined([mine.take(part) for mine, part in zip(each, parts, strict=True)])


def stitched_rows(each: Sequence[NDArray[N]]) -> NDArray[N]:
    """As `stitched`, of arrays (K, ...) with a row per frame."""
    if len(each) == 1:
        return each[0]
    parts = blocks(len(each[0]), len(each))
    return np.concatenate([rows[part] for rows, part in zip(each, parts, strict=True)])
