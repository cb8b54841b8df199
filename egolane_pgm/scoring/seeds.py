"""Scores of searches that differ in their seed only: mean, spread and interval.

Two things are left to chance: which stretches of road were driven, and which parameters a search
happened to find. Each resample draws blocks of frames, the same ones for every model, and for each
model S of its S seeds, with replacement. With one seed it is the block bootstrap of `bootstrap`. A
few seeds give their spread only roughly, and S drawn of S show it too small by sqrt(1 - 1/S).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.scoring import bootstrap
from egolane_pgm.types import FloatArray, IntArray

#: Per score the values of all frames and of each of R resamples, (S, 1 + R).
Resampled = Mapping[str, FloatArray]


def resampled_scores(
    counts: Sequence[Mapping[str, NDArray[np.generic]]], seed: int | Sequence[int] = 0
) -> Resampled | None:
    """Accuracy, F1 and log-loss of S seeds over the same resamples of a drive.

    counts: per seed the counts of T frames, as `bootstrap.score_counts` gives them.
    seed: of the resamples.

    None where the drive is too short for an interval.
    """
    n_frames = len(counts[0]["accuracy"])
    if n_frames < 2 * bootstrap.BLOCK_FRAMES:
        return None
    drawn = bootstrap.circular_block_bootstrap(n_frames, seed=seed)
    return {
        name: np.array(
            [
                [
                    bootstrap._of_all_frames(mine[name], statistic),
                    *statistic(bootstrap.resampled_sums(mine[name], drawn)),
                ]
                for mine in counts
            ]
        )
        for name, statistic in bootstrap.INTERVAL_STATISTICS.items()
    }


def over_seeds(values: FloatArray, chance: str) -> FloatArray:
    """The mean over the seeds that each resample drew: (S, 1 + R) -> (1 + R,).

    The first number, of all frames, is the mean over the S seeds.

    chance: a text that seeds the draws, a different one for each model and recording, because
        their searches are independent.
    """
    n_seeds, n = values.shape
    mean: FloatArray = values.mean(axis=0)
    drawn = np.random.default_rng([*chance.encode()]).integers(n_seeds, size=(n_seeds, n - 1))
    mean[1:] = np.take_along_axis(values[:, 1:], drawn, axis=0).mean(axis=0)
    return mean


def with_bounds(values: FloatArray) -> list[float]:
    """A score of all frames and of the resamples (1 + R,) as [estimate, low, high], 95 %."""
    return [float(values[0]), *bootstrap._percentiles(values[1:], bootstrap.LEVEL)]


def spread(values: Sequence[float]) -> float | None:
    """The standard deviation of a score over the seeds (n - 1 in the denominator); None for one."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def mean_of(scores: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """The mean of each number of dicts of one form, as `summary.score_all` gives them. None where a
    score of one of them is undefined."""
    return {name: _mean([each[name] for each in scores]) for name in scores[0]}


def _mean(values: Sequence[object]) -> object:
    first = values[0]
    if all(value == first for value in values):
        return first
    if isinstance(first, Mapping):
        return mean_of(values)  # type: ignore[arg-type]
    if any(value is None for value in values):
        return None
    return np.mean(np.asarray(values, dtype=np.float64), axis=0).tolist()


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
