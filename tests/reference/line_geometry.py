"""The kernels of `evidence.line_geometry` in plain NumPy, same arguments; and the evidence that the
rule gives with these in their place."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from egolane_pgm.evidence.line_geometry import kernels, rule
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """As `rule.evidence`."""
    with plain():
        return rule.evidence(log, n_lanes, parameters)


@contextmanager
def plain() -> Iterator[None]:
    """While this lasts, the rule computes with what is here."""
    ours = {f.__name__: f for f in (follow_lines, drop_doubles, weigh_positions)}
    with patch.multiple(kernels, **ours):
        yield


def follow_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lri: FloatArray,
    follows: BoolArray,
    reach_m: FloatArray,
    is_held: BoolArray,
    displacement_m: FloatArray,
) -> None:
    """Write is_held (T, L) and displacement_m (T,), NaN where unknown."""
    displacement_m[:] = np.nan
    is_held[:] = False
    if len(offset_m) < 2 or offset_m.shape[1] == 0:
        return
    with np.errstate(invalid="ignore"):
        same = offset_m[1:, :, None] == offset_m[:-1, None, :]
        falls = lri[1:, :, None] < lri[:-1, None, :]
        distance = np.abs(offset_m[1:, :, None] - offset_m[:-1, None, :])
    is_held[1:] = (same & falls).any(axis=2) & follows[1:, None]
    now = (kind[1:] >= 0) & ~is_held[1:] & follows[1:, None]
    for take_held in (False, True):
        before = (kind[:-1] >= 0) & (take_held | ~is_held[:-1])
        apart = np.where(now[:, :, None] & before[:, None, :], distance, np.inf)
        match = apart.argmin(axis=2)
        nearest = np.take_along_axis(apart, match[:, :, None], axis=2)[:, :, 0]
        rival = np.take_along_axis(apart.min(axis=1), match, axis=1)
        is_match = (nearest < reach_m[1:, None]) & (nearest <= rival)
        with np.errstate(invalid="ignore"):
            moves = offset_m[1:] - np.take_along_axis(offset_m[:-1], match, axis=1)
        moves = np.where(is_match, moves, np.nan)
        found = is_match.any(axis=1) & np.isnan(displacement_m[1:])
        displacement_m[1:][found] = np.nanmedian(moves[found], axis=1)


def drop_doubles(offset_m: FloatArray, kind: IntArray, near_m: FloatArray) -> None:
    """Set kind (T, L) to -1 where a better line is nearer than near_m (T,)."""
    counts = kind >= 0
    offset = np.where(counts, offset_m, np.inf)
    with np.errstate(invalid="ignore"):
        near = np.abs(offset[:, :, None] - offset[:, None, :]) < near_m[:, None, None]
    # Class, then distance, then place in the list; lexsort has its first key last.
    place = np.broadcast_to(np.arange(kind.shape[1]), kind.shape)
    rank = np.argsort(np.lexsort((place, np.abs(offset), kind), axis=1), axis=1)
    is_better = rank[:, None, :] < rank[:, :, None]
    both = counts[:, :, None] & counts[:, None, :]
    kind[(near & is_better & both).any(axis=2)] = -1


def weigh_positions(
    offset_m: FloatArray,
    kind: IntArray,
    log_intensity: FloatArray,
    log_mean: FloatArray,
    first_m: float,
    step_m: float,
    expected: FloatArray,
    width_m: float,
    alpha: FloatArray,
    beta: FloatArray,
    likelihood: FloatArray,
) -> None:
    """Write likelihood (T, n cells, 2), each frame's maximum 1."""
    n_lanes = len(log_intensity)
    cells = likelihood.shape[1] // n_lanes
    of_lane = np.zeros((len(offset_m), n_lanes, cells))
    mean = np.zeros((len(offset_m), cells))
    centre_m = (np.arange(cells) + 0.5) / cells * width_m - width_m / 2
    for i in range(offset_m.shape[1]):
        frames = np.flatnonzero(kind[:, i] >= 0)
        c = kind[frames, i][:, None]
        at = (offset_m[frames, i][:, None] + centre_m - first_m) / step_m
        z = at.astype(np.int64)
        right = at - z
        for lane in range(n_lanes):
            table = log_intensity[lane]
            of_lane[frames, lane] += (1 - right) * table[c, z] + right * table[c, z + 1]
        mean[frames] += (1 - right) * log_mean[c, z] + right * log_mean[c, z + 1]
    known = of_lane - expected[:, None] - mean[:, None] + expected.mean()
    log_likelihood = np.empty((*of_lane.shape, 2))
    log_likelihood[..., 1] = (beta[:, None] * mean)[:, None]
    log_likelihood[..., 0] = log_likelihood[..., 1] + alpha[:, None, None] * known
    log_likelihood -= log_likelihood.max(axis=(1, 2, 3), keepdims=True)
    likelihood[:] = np.exp(log_likelihood).reshape(likelihood.shape)
