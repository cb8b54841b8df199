"""Confidence intervals of scores by a circular block bootstrap.

Neighbouring frames are nearly the same frame, so resampling single frames would give intervals far
too short: contiguous blocks of frames are drawn instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.scoring.scores import SCORES, Statistic
from egolane_pgm.types import FloatArray, InputError, IntArray

#: Frames of a block: half a minute at 10 Hz, much longer than most errors last.
BLOCK_FRAMES = 300

#: Number of resamples.
RESAMPLES = 2000

#: Share of the resamples within an interval.
LEVEL = 0.95


#: With fewer blocks, chance has the same sign in all of them too often.
LEAST_BLOCKS = 5


@dataclass(frozen=True)
class Interval:
    """A statistic of all frames with its bootstrap interval (percentiles of the resamples).

    low and high are None if a recording is too short.
    """

    estimate: float
    low: float | None
    high: float | None


def circular_blocks(n_frames: int, block: int, resamples: int, seed: int) -> IntArray:
    """Draw the resamples of a circular block bootstrap (Politis & Romano 1992).

    Each resample concatenates K = ceil(n_frames / block) blocks of `block` frames and is cut to
    n_frames. The first frames of the blocks are uniform over the drive; a block continues from the
    last frame of the drive with the first. The same arguments give the same resamples, so that two
    sides of a difference share them.

    Returns (R, K): the first frames of the blocks.
    """
    n_blocks = -(-n_frames // block)
    return np.random.default_rng(seed).integers(0, n_frames, size=(resamples, n_blocks))


def resampled_sums(
    values: NDArray[np.generic], starts: IntArray, block: int
) -> NDArray[np.generic]:
    """Sum of per-frame values over each resample: (T, ...) -> (R, ...).

    - starts, block: see `circular_blocks`.

    Costs one look-up per block, not per frame: the sum over each possible block comes from
    cumulative sums. Counts (integers, booleans) are summed exactly.
    """
    n_frames = len(values)
    n_blocks = starts.shape[1]
    kinds = {"b": np.int32, "i": np.int64, "u": np.int64}
    kind = kinds.get(values.dtype.kind, np.float64)
    # Contiguous frames: a block is looked up as one row.
    flat = values.reshape(n_frames, -1).astype(kind, order="C", copy=False)
    wrapped = np.concatenate([np.zeros_like(flat[:1]), flat, flat[:block]])
    np.cumsum(wrapped, axis=0, out=wrapped)
    last_length = n_frames - (n_blocks - 1) * block
    whole = wrapped[block:][:n_frames] - wrapped[:n_frames]
    last = wrapped[last_length:][:n_frames] - wrapped[:n_frames]
    # One block at a time: all of them together would take gigabytes for a long drive.
    sums = np.zeros((len(starts), flat.shape[1]), np.result_type(whole, np.int64))
    for k in starts.T[:-1]:
        sums += whole[k]
    return np.asarray((sums + last[starts[:, -1]]).reshape(len(starts), *values.shape[1:]))


def bootstrap_interval(
    counts: Sequence[NDArray[np.generic]],
    statistic: Statistic,
    *,
    minus: Sequence[NDArray[np.generic]] | None = None,
    block: int = BLOCK_FRAMES,
    resamples: int = RESAMPLES,
    seeds: Sequence[int] | None = None,
) -> Interval:
    """A statistic with its circular-block-bootstrap percentile interval.

    For several recordings, the mean over them; for two sides, their difference over the same
    resamples.

    - counts: per recording (T, ...), the summands of a score in the order of the
      drive; crossing frames are included and count zero.
    - statistic: sums (R, ...) -> (R,), see `Score`.
    - minus: the other side of a difference, the same frames of the same recordings.
    - seeds: one per recording; recordings of the same length with the same seed are resampled
      together. By default 0, 1, 2, ...

    Resamples with an undefined statistic (NaN) are left out; if all are, the bounds are NaN.
    They are None if a recording is shorter than two blocks: its resamples would be nearly the same.
    Raises InputError if the two sides have different numbers of frames.
    """
    is_short = any(len(mine) < 2 * block for mine in counts)
    estimates = []
    of_resamples = []
    for k, mine in enumerate(counts):
        sides = [mine] if minus is None else [mine, minus[k]]
        if len(sides[-1]) != len(mine):
            raise InputError(
                f"a difference needs the same frames on both sides, got {len(mine)} and"
                f" {len(sides[-1])}; join the two by frame id first"
            )
        whole = [float(statistic(side.sum(axis=0))) for side in sides]
        estimates.append(whole[0] - sum(whole[1:]))
        if not is_short:
            starts = circular_blocks(len(mine), block, resamples, k if seeds is None else seeds[k])
            drawn = [statistic(resampled_sums(side, starts, block)) for side in sides]
            of_resamples.append(drawn[0] - sum(drawn[1:]))
    estimate = float(np.mean(estimates))
    if is_short:
        return Interval(estimate, None, None)
    values = np.mean(of_resamples, axis=0)
    values = values[~np.isnan(values)]
    if not values.size:
        return Interval(estimate, math.nan, math.nan)
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(estimate, float(low), float(high))


def score_intervals(
    counts: Sequence[Mapping[str, NDArray[np.generic]]],
    minus: Sequence[Mapping[str, NDArray[np.generic]]] | None = None,
    *,
    seeds: Sequence[int] | None = None,
) -> dict[str, Interval]:
    """The intervals of some scores, or of their differences.

    - counts, minus: per recording the summands of each score, by its name.
    - seeds: see `bootstrap_interval`.
    """
    found = {}
    for name in counts[0]:
        statistic = SCORES[name].statistic
        mine = [each[name] for each in counts]
        theirs = None if minus is None else [each[name] for each in minus]
        found[name] = bootstrap_interval(mine, statistic, minus=theirs, seeds=seeds)
    return found


def block_gains(
    better: Sequence[NDArray[Any]],
    worse: Sequence[NDArray[Any]],
    statistic: Statistic,
    drives: Sequence[int],
    block: int = BLOCK_FRAMES,
) -> FloatArray:
    """Return what each block of frames contributes to a gain; the mean is the gain, (B,).

    The contribution is the jackknife's pseudo-value: of a mean its difference within the block.

    - better, worse: summands of a score as for `bootstrap_interval`; larger is better.
    - drives: the number of each recording's drive. Recordings of a drive share blocks.
    """
    found: dict[int, FloatArray] = {}
    for mine, other, drive in zip(better, worse, drives, strict=True):
        shortest = min(len(each) for each, of in zip(better, drives, strict=True) if of == drive)
        n_blocks = max(1, shortest // block)
        edges = np.linspace(0, len(mine), n_blocks + 1).astype(int)[:-1]
        whole, left_out = [], []
        for side in (mine, other):
            sums = np.add.reduceat(side, edges, axis=0, dtype=np.float64)
            whole.append(statistic(sums.sum(axis=0)))
            left_out.append(statistic(sums.sum(axis=0) - sums))
        gain = whole[0] - whole[1]
        values = n_blocks * gain - (n_blocks - 1) * (left_out[0] - left_out[1])
        # A score that is undefined without the block: the block is as the others.
        values = np.nan_to_num(np.where(np.isnan(values), gain, values))
        found[drive] = found.get(drive, 0.0) + values / len(better)
    n_blocks = sum(map(len, found.values()))
    return np.concatenate([each * n_blocks / len(each) for each in found.values()])


def beyond_chance(gains: FloatArray) -> tuple[float, FloatArray]:
    """Return the gain that chance gives the best of all candidates; a larger one passes.

    Chance turns the sign of the contribution of each block. The result is the 95 % quantile of the
    largest gain of all candidates. As of Hansen (2005), clear losses do not count as candidates,
    and other losses have mean zero. It is infinite for fewer than LEAST_BLOCKS.

    - gains: of K candidates, from `block_gains`, (K, B).

    Returns also in which share of bootstrap resamples of the blocks each gain passes, (K,).
    """
    mean = gains.mean(axis=1)
    n_blocks = gains.shape[1]
    if n_blocks < LEAST_BLOCKS:
        return math.inf, np.zeros(len(gains))
    error = gains.std(axis=1) / math.sqrt(n_blocks)
    is_clear_loss = mean < -error * math.sqrt(2 * math.log(math.log(n_blocks)))
    centred = (gains - np.minimum(mean, 0.0)[:, None])[~is_clear_loss]
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], (RESAMPLES, n_blocks))
    by_chance = signs @ centred.T / n_blocks
    least = np.quantile(by_chance.max(axis=1, initial=0.0), LEVEL, method="higher")
    weight = rng.multinomial(n_blocks, np.full(n_blocks, 1 / n_blocks), RESAMPLES) / n_blocks
    return float(least), (gains @ weight.T > least).mean(axis=1)
