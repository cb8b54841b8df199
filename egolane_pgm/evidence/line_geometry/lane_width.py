"""Estimate the lane width in the detector's metres from the gaps between its lines, without
labels.

Lines lie on a lattice whose step is the lane width. Under a candidate width, a gap between two
lines of a frame is a whole number of steps plus noise, or is off the lattice; the share of gaps off
the lattice is the one that fits best. Half the true width also explains every gap, but it allows
twice as many places at half the density, and so loses ln 2 per gap. The answer is the most probable
candidate, with a prior in favour of widths near the expected one. A width at which no two
neighbouring lanes are ever seen at once is excluded, because a line half a lane off the road
would fit half the true width.

All of this is relative to the gaps themselves, so that it also works for detectors that do not
report metres.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from egolane_pgm.evidence.line_geometry.scale import (
    ALIKE,
    DOUBLE,
    ENOUGH_PAIRS,
    EXPECTED_WITHIN,
    GAP_SIGMA,
    LEAST_PAIRS,
    MOST_LANES,
    PAIR_WITHIN,
    line_classes,
)
from egolane_pgm.types import FloatArray, LineLog

#: Gaps are counted in logarithmic bins of one per cent.
_STEP = 0.01

#: The smallest and the largest gap that is counted, in any unit.
_SMALLEST = 1e-3
_LARGEST = 1e5

#: The range of candidates, relative to the median over frames of the largest gap between
#: neighbours. That gap is one lane if all lines are seen, and several if some are missed.
NARROWEST = 0.2
WIDEST = 1.5

#: The shares of gaps off the lattice that are tried.
OFF_LATTICE = (0.05, 0.3, 0.6, 0.9)

#: The least log odds (natural) of a sure answer, against no lattice and against any other maximum.
LEAST_ODDS = math.log(20)

_N_BINS = math.ceil(math.log(_LARGEST / _SMALLEST) / _STEP)
_N_CANDIDATES = math.ceil(math.log(WIDEST / NARROWEST) / _STEP) + 1
#: The window of bins that candidates are judged by, relative to the bin of the narrowest one.
_BELOW = math.floor(math.log(0.5) / _STEP)
_N_WINDOW = _N_CANDIDATES + math.ceil(math.log(MOST_LANES + 0.5) / _STEP) - _BELOW
#: Candidates nearer than this to another are the same maximum.
_APART = math.ceil(math.log(1.15) / _STEP)


class LaneWidth(NamedTuple):
    """An estimate of the lane width.

    - width_m: the answer; the fallback if it is not sure
    - found_m: the best candidate; NaN without gaps
    - odds: log odds (natural) of the best candidate against the better one of the runner-up and no
      lattice
    - message: all of this in one line
    """

    width_m: float
    is_sure: bool
    found_m: float
    odds: float
    message: str


def gap_counts(log: LineLog) -> FloatArray:
    """Count gaps per bin, (3, B): those between neighbouring strong lines of a frame, those
    between every other line, and the largest gap between neighbours of each frame.

    Counts of several logs may be added before `width_of_gaps`.
    """
    counts = np.zeros((3, _N_BINS))

    def add(kind: int, gaps: FloatArray) -> None:
        inside = gaps[(gaps > _SMALLEST) & (gaps < _LARGEST)]
        where = (np.log(inside / _SMALLEST) / _STEP).astype(np.int64)
        counts[kind] += np.bincount(np.minimum(where, _N_BINS - 1), minlength=_N_BINS)

    _, is_strong = line_classes(log.offset_m, log.is_valid, log.is_continuous, log.lri)
    offsets = np.sort(np.where(is_strong, log.offset_m, np.inf), axis=1)
    if offsets.shape[1] < 2:
        return counts
    offsets = offsets[np.isfinite(offsets[:, 1])]
    gaps = _gaps(offsets, 1)
    largest = gaps.max(axis=1)
    is_double = gaps < DOUBLE * largest[:, None]
    is_double &= np.isfinite(offsets[:, 1:])
    if is_double.any():
        offsets[:, 1:][is_double] = np.inf
        offsets.sort(axis=1)
    add(2, largest)
    for apart in range(1, min(3, offsets.shape[1])):
        gaps = _gaps(offsets, apart)
        add(apart - 1, gaps[gaps != 0])
    return counts


def width_of_gaps(counts: FloatArray, fallback_m: float, source: str) -> LaneWidth:
    """Estimate the lane width from the counts (3, B) of all gaps.

    - fallback_m: the expected width, which is the answer if the estimate is not sure
    - source: for the message
    """
    gaps = counts[:2].sum(axis=0)
    n_gaps = int(gaps.sum())
    if not n_gaps:
        message = f"{source}: no two lines in one frame, so the lane width is unknown"
        message += f"; {fallback_m:g} m is assumed"
        return LaneWidth(fallback_m, False, math.nan, 0.0, message)
    frames = counts[2].cumsum()
    middle = int(np.argmax(frames >= max(frames[-1] / 2, 0.5)))
    # The bin of the narrowest candidate.
    first = middle + round(math.log(NARROWEST) / _STEP)
    bins = first + _BELOW + np.arange(_N_WINDOW)
    is_bin = (bins >= 0) & (bins < _N_BINS)
    near = np.where(is_bin, counts[:2, np.clip(bins, 0, _N_BINS - 1)], 0.0)
    of_gap, is_pair = _tables()
    # The log likelihood of each candidate relative to no lattice, in independent gaps.
    fit = (near.sum(axis=0) @ of_gap).reshape(len(OFF_LATTICE), -1).max(axis=0) / ALIKE
    n_pairs = counts[1].sum()
    may_be = (n_pairs < ENOUGH_PAIRS) | (near[1] @ is_pair >= LEAST_PAIRS * n_pairs)
    log_width = math.log(_SMALLEST) + _STEP * (first + np.arange(_N_CANDIDATES) + 0.5)
    away = (log_width - math.log(fallback_m)) / EXPECTED_WITHIN
    # Excluded candidates come after all others, in their order.
    score = fit - np.log1p(away**2) - np.where(may_be, 0.0, 1e9)
    best = int(score.argmax())
    others = np.abs(np.arange(_N_CANDIDATES) - best) > _APART
    odds = float(min(fit[best], score[best] - score[others].max()))
    width = math.exp(log_width[best] + _peak(fit, best) * _STEP)
    lanes = np.exp(math.log(_SMALLEST) + _STEP * (np.arange(_N_BINS) + 0.5)) / width
    is_on = np.abs(lanes - np.clip(np.round(lanes), 1, MOST_LANES)) < 2 * GAP_SIGMA
    share = float(gaps[is_on].sum() / n_gaps)
    found = (
        f"{width:.{2 if width < 20 else 0}f} m from {n_gaps} gaps between lines,"
        f" {100 * share:.0f} % of them on the lattice"
    )
    if odds >= LEAST_ODDS and may_be[best] and 0 < best < _N_CANDIDATES - 1:
        return LaneWidth(width, True, width, odds, f"{source}: lane width {found}")
    message = f"{source}: lane width unsure ({found}); {fallback_m:g} m is assumed"
    return LaneWidth(fallback_m, False, width, odds, message)


def _gaps(offsets: FloatArray, apart: int) -> FloatArray:
    """Return the gaps between sorted lines `apart` places apart, (T, L - apart); 0 if none."""
    is_there = np.isfinite(offsets[:, apart:])
    return np.subtract(
        offsets[:, apart:], offsets[:, :-apart], out=np.zeros(is_there.shape), where=is_there
    )


@lru_cache(maxsize=1)
def _tables() -> tuple[FloatArray, FloatArray]:
    """Return tables of a gap in each bin of the window: its log likelihood relative to a uniform
    one, (window, shares * candidates), and whether it is two lanes, (window, candidates)."""
    gap = np.exp((np.arange(-(_N_CANDIDATES - 1), _N_WINDOW) + _BELOW) * _STEP)
    lanes = np.maximum(1, np.round(gap))
    normal = np.exp(-0.5 * ((gap - lanes) / GAP_SIGMA) ** 2) / (GAP_SIGMA * math.sqrt(2 * math.pi))
    density = np.where(lanes <= MOST_LANES, normal, 0.0)

    def of_candidates(values: FloatArray) -> FloatArray:
        # In row b, the gap is b, b - 1, ... bins away from candidates 0, 1, ...
        return sliding_window_view(values, _N_CANDIDATES)[:, ::-1]

    tables = [of_candidates(np.log((1 - off) * density + off)) for off in OFF_LATTICE]
    is_pair = np.where(np.abs(gap - 2) < PAIR_WITHIN, 1.0, 0.0)
    return np.concatenate(tables, axis=1), np.ascontiguousarray(of_candidates(is_pair))


def _peak(score: FloatArray, best: int) -> float:
    """Return the offset of a maximum in steps, from a parabola through it and its neighbours."""
    if best in (0, len(score) - 1):
        return 0.0
    left, middle, right = score[best - 1 : best + 2]
    curve = left - 2 * middle + right
    return float(np.clip(0.5 * (left - right) / curve, -0.5, 0.5)) if curve < 0 else 0.0
