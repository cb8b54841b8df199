"""How far a score can be trusted: intervals by a circular block bootstrap.

Neighbouring frames are much alike, so a bootstrap of single frames says nothing about the next
drive: contiguous blocks of frames are drawn instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import accuracy, confusion_cell, macro_f1
from egolane_pgm.scoring.probabilistic import log_loss_per_frame
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

BLOCK_FRAMES = 300
RESAMPLES = 2000
LEVEL = 0.95

#: The most numbers in memory at once while resamples are summed. It does not change the result.
_CHUNK = 1 << 22


#: Sums (R, ...) of per-frame counts -> the statistic of each resample (R,).
Statistic = Callable[[NDArray[np.generic]], FloatArray]


@dataclass(frozen=True)
class BlockResamples:
    """Resamples of a drive in circular blocks.

    n_frames: of the drive, and of each resample.
    block: frames of a block. It runs on from the last frame of the drive to the first; the last
        block of a resample is cut.
    starts (R, K): the first frame of each of the K blocks of each resample.
    """

    n_frames: int
    block: int
    starts: IntArray

    def __len__(self) -> int:
        return len(self.starts)

    def __iter__(self) -> Iterator[IntArray]:
        """The frames (n_frames,) of each resample, for statistics that are not sums over frames."""
        within = np.arange(self.block)
        for starts in self.starts:
            frames = (starts[:, None] + within).ravel()[: self.n_frames]
            yield frames % self.n_frames


@dataclass(frozen=True)
class Interval:
    """A statistic of all frames with its bootstrap interval (percentiles of the resamples).

    low and high are None for a recording that is too short.
    """

    estimate: float
    low: float | None
    high: float | None
    level: float


def circular_block_bootstrap(
    n_frames: int,
    block: int = BLOCK_FRAMES,
    resamples: int = RESAMPLES,
    seed: int | Sequence[int] = 0,
) -> BlockResamples:
    """Draw the resamples of a circular block bootstrap (Politis & Romano 1992).

    Each resample strings together blocks of `block` frames whose first frames are uniform over the
    drive, ceil(n_frames / block) of them, cut to n_frames. Only the first frames are kept. The
    same arguments give the same resamples, so that two sides of a difference share them.

    Raises InputError for a drive shorter than two blocks (its resamples would all be nearly the
    same, and the interval far too short).
    """
    if n_frames < 2 * block:
        raise InputError(
            f"{n_frames} frames are too few for an interval from blocks of {block} frames;"
            f" at least {2 * block} are needed, or a shorter block"
        )
    n_parts = -(-n_frames // block)
    starts = np.random.default_rng(seed).integers(0, n_frames, size=(resamples, n_parts))
    return BlockResamples(n_frames, block, starts)


def resampled_sums(values: NDArray[np.generic], resamples: BlockResamples) -> NDArray[np.generic]:
    """Sum of per-frame values over each resample: (T, ...) -> (R, ...).

    Costs one look-up per block, not per frame: the sum over each possible block comes from
    cumulative sums. Counts (integers, booleans) are summed exactly.
    """
    array = np.asarray(values)
    n_frames = resamples.n_frames
    kinds = {"b": np.int32, "i": np.int64, "u": np.int64}
    flat = array.reshape(n_frames, -1).astype(kinds.get(array.dtype.kind, np.float64), copy=False)
    wrapped = np.concatenate([np.zeros_like(flat[:1]), flat, flat[: resamples.block]])
    np.cumsum(wrapped, axis=0, out=wrapped)
    n_parts = resamples.starts.shape[1]
    last_length = n_frames - (n_parts - 1) * resamples.block
    whole = wrapped[resamples.block :][:n_frames] - wrapped[:n_frames]
    last = wrapped[last_length:][:n_frames] - wrapped[:n_frames]
    sums = last[resamples.starts[:, -1]]
    step = max(1, _CHUNK // max(1, n_parts * flat.shape[1]))
    for k in range(0, len(resamples), step):
        sums[k : k + step] += whole[resamples.starts[k : k + step, :-1]].sum(axis=1)
    return np.asarray(sums.reshape(len(resamples), *array.shape[1:]))


def confusion_counts(
    assigned: ArrayLike, lane: ArrayLike, is_crossing: ArrayLike, n_lanes: int
) -> BoolArray:
    """Per frame its confusion matrix, (T, n + 1, n): True in one cell, none where it is crossing.

    For `bootstrap_interval` with `scoring.confusion.accuracy`, `macro_f1` and the like. Arguments
    as `scoring.confusion.confusion`.
    """
    cell = confusion_cell(assigned, lane, is_crossing, n_lanes)
    counts = np.zeros((len(cell), (n_lanes + 1) * n_lanes), dtype=bool)
    is_scored = cell >= 0
    counts[np.flatnonzero(is_scored), cell[is_scored]] = True
    return counts.reshape(len(cell), n_lanes + 1, n_lanes)


def mean_counts(values: ArrayLike, is_counted: ArrayLike | None = None) -> FloatArray:
    """Per frame (value, 1), or (0, 0) where it is not counted: (T,) -> (T, 2), for `ratio`.

    For the mean of a per-frame score such as `scoring.probabilistic.log_loss_per_frame`.
    """
    array = np.asarray(values, dtype=np.float64)
    counted = np.ones(len(array), dtype=bool) if is_counted is None else np.asarray(is_counted)
    return np.stack([np.where(counted, array, 0.0), counted.astype(np.float64)], axis=1)


def ratio(sums: NDArray[np.generic]) -> FloatArray:
    """First over second of (..., 2), NaN where the second is 0."""
    array = np.asarray(sums, dtype=np.float64)
    below = array[..., 1]
    return np.asarray(array[..., 0] / np.where(below == 0, np.nan, below))


#: The scores that have an interval in every result.
INTERVAL_STATISTICS: Mapping[str, Statistic] = {
    "accuracy": accuracy,
    "f1": macro_f1,
    "log_loss": ratio,
}


def bootstrap_interval(
    counts: Sequence[NDArray[np.generic]],
    statistic: Statistic,
    *,
    minus: Sequence[NDArray[np.generic]] | None = None,
    block: int = BLOCK_FRAMES,
    resamples: int = RESAMPLES,
    seeds: Sequence[int] | None = None,
    level: float = LEVEL,
) -> Interval:
    """A statistic with its circular-block-bootstrap percentile interval: of one recording, or the
    mean over several; of one side, or the difference of two over the same resamples.

    counts: per recording (T, ...), per frame what the statistic sums over (`confusion_counts`,
        `mean_counts`), in the order of the drive, with crossing frames in their place, counting
        nothing.
    statistic: sums (R, ...) -> (R,), such as `scoring.confusion.accuracy`, `macro_f1`, or `ratio`.
    minus: the other side of a difference, the same frames of the same recordings.
    seeds: one per recording; recordings of the same length with the same seed are resampled
        together. By default 0, 1, 2, ...

    Resamples in which the statistic is undefined (NaN) are left out; NaN bounds if none is left.
    Raises InputError as `circular_block_bootstrap` does, and where the two sides have different
    numbers of frames.
    """
    of_all, of_resamples = [], []
    for k, mine in enumerate(counts):
        seed = k if seeds is None else seeds[k]
        drawn = circular_block_bootstrap(len(mine), block, resamples, seed)
        whole, values = _of_all_frames(mine, statistic), statistic(resampled_sums(mine, drawn))
        if minus is not None:
            theirs = minus[k]
            if len(theirs) != len(mine):
                raise InputError(
                    f"a difference needs the same frames on both sides, got {len(mine)} and"
                    f" {len(theirs)}; join the two by frame id first"
                )
            whole -= _of_all_frames(theirs, statistic)
            values = values - statistic(resampled_sums(theirs, drawn))
        of_all.append(whole)
        of_resamples.append(values)
    low, high = _percentiles(np.mean(of_resamples, axis=0), level)
    return Interval(float(np.mean(of_all)), low, high, level)


def score_counts(
    belief: ArrayLike,
    lane: ArrayLike,
    is_crossing: ArrayLike,
    unassigned_below: float = 0.0,
    assigned: ArrayLike | None = None,
) -> dict[str, NDArray[np.generic]]:
    """Per score that has an interval, what it sums over in each frame; for `score_intervals`.

    belief (T, n), lane (T,), is_crossing (T,). unassigned_below, assigned: as in
    `score_all`.
    """
    if assigned is None:
        assigned = assigned_lane(belief, unassigned_below)
    cells = confusion_counts(assigned, lane, is_crossing, np.shape(belief)[1])
    losses = mean_counts(log_loss_per_frame(belief, lane))
    return {"accuracy": cells, "f1": cells, "log_loss": losses}


def score_intervals(
    counts: Sequence[Mapping[str, NDArray[np.generic]]],
    minus: Sequence[Mapping[str, NDArray[np.generic]]] | None = None,
    *,
    seeds: Sequence[int] | None = None,
) -> dict[str, Interval]:
    """The interval of accuracy, F1 and log-loss: the mean over recordings, or the difference of
    that to the same of another side. The bounds are None if a recording is too short.

    - counts, minus: per recording the counts of `score_counts`.
    - seeds: see `bootstrap_interval`.
    """
    is_short = any(len(values) < 2 * BLOCK_FRAMES for mine in counts for values in mine.values())
    found = {}
    for name, statistic in INTERVAL_STATISTICS.items():
        mine = [each[name] for each in counts]
        theirs = None if minus is None else [each[name] for each in minus]
        if is_short:
            means = [_of_all_frames(each, statistic) for each in mine]
            others = [_of_all_frames(each, statistic) for each in theirs or ()]
            estimate = float(np.mean(means) - (np.mean(others) if others else 0.0))
            found[name] = Interval(estimate, None, None, LEVEL)
        else:
            found[name] = bootstrap_interval(mine, statistic, minus=theirs, seeds=seeds)
    return found


def on_timeline(
    counts: Mapping[str, NDArray[np.generic]], frame_id: IntArray, timeline: IntArray
) -> dict[str, NDArray[np.generic]]:
    """The counts of frames (K,), placed among the frames of their whole drive (T,): 0 elsewhere.

    Recordings of one drive, by several detectors, are resampled together so.
    """
    at = np.searchsorted(timeline, frame_id)
    placed = {}
    for name, values in counts.items():
        placed[name] = np.zeros((len(timeline), *values.shape[1:]), dtype=values.dtype)
        placed[name][at] = values
    return placed


def _of_all_frames(counts: NDArray[np.generic], statistic: Statistic) -> float:
    array = np.asarray(counts)
    total = array.sum(axis=0, dtype=np.int64 if array.dtype.kind in "biu" else np.float64)
    return float(statistic(np.asarray(total)[None])[0])


def _percentiles(values: FloatArray, level: float) -> tuple[float, float]:
    defined = values[~np.isnan(values)]
    if not defined.size:
        return float("nan"), float("nan")
    low, high = np.quantile(defined, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
